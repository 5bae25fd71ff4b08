"""Runs of the whole program under odd systems: another user, no home, a full disk, two runs at once.

A case passes when the program ends in time with status 0 or 1, says a line of ours for the latter and shows
no traceback. `python tests/faults/system_cases.py --seed SEED --only CASE` repeats one.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]

from programs import CHECKOUT, Hang, end_of, start  # noqa: E402
from specimens import write_specimens  # noqa: E402

from tests.calibration.turning_egg import CAMERA as EGG_CAMERA  # noqa: E402
from tests.calibration.turning_egg import render_egg, turning_poses, write_frames  # noqa: E402
from tests.result_files import write_mesh_sequence  # noqa: E402
from tests.skinning.conftest import rippling, sleeved_tube  # noqa: E402

_NOBODY = 65534
_GIANT = 3 << 30  # bytes
_VARIABLES = {
    "COLUMNS": ("0", "-1", "x"), "LINES": ("0",), "PYTHONIOENCODING": ("ascii", "latin-1"), "LANG": ("C",),
    "MPLBACKEND": ("nosuch", "tkagg"), "SOURCE_DATE_EPOCH": ("tomorrow", "1e9", "-1"), "TERM": ("dumb",),
    "TMPDIR": ("/nonexistent",), "NUMBA_CACHE_DIR": ("/nonexistent", "/proc"), "OMP_NUM_THREADS": ("1",),
}  # fmt: skip


@dataclass
class Case:
    """One command: what is started, how, and what became of it."""

    arguments: list[str]
    out: Path
    what: str = ""
    environment: dict[str, str] = field(default_factory=dict)
    ended: list[int] = field(default_factory=list)
    prepare: Callable[[], None] | None = None
    times: int = 1
    cleanup: Callable[[], object] = lambda: None
    strike: signal.Signals | None = None
    after_s: float = 0.0
    hostile: list[bytes] = field(default_factory=list)


def prepare(folder: Path) -> Path:
    """Write what the verbs read: specimens, a sphere with its result and track, a garment, a turning egg."""
    good = folder / "good"
    good.mkdir()
    write_specimens(good)
    sphere, rig = good / "sphere", good / "sphere.json"
    _run_well("simulate", "sphere", "--frames", "0:4", "--size", "96x72", "--samples", "1", "--out", sphere)
    _run_well("calibrate", "sphere", sphere / "capture.mkv", "--out", rig)
    result = ["reconstruct", sphere / "capture.mkv", "--rig", rig, "--to", "mesh", "--shadows", "none"]
    _run_well(*result, "--out", good / "result")
    _run_well("track", good / "result", "--template", "1")
    write_mesh_sequence(good / "cloth" / "track", rippling(sleeved_tube(), 12))
    (good / "lamps.txt").write_text("-0.5 0 0.8\n0.3 0.4 0.8\n0.3 -0.4 0.8\n")
    (good / "egg").mkdir()
    write_frames(good / "egg", [render_egg(pose) for pose in turning_poses(13, 40.0)])
    for path in (folder, good, *good.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
    return good


def _run_well(*arguments: str | Path) -> None:
    command = [sys.executable, "-m", "vntoolkit", *map(str, arguments)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=CHECKOUT)


def verbs(good: Path, out: Path) -> list[list[str]]:
    """Short commands of every sort: that read only, write files or a folder, or start workers."""
    rig, source, result = good / "sphere.json", good / "sphere/capture.mkv", good / "result"
    normals, mesh = good / "maps/n.exr", next((result / "mesh").glob("*.ply"))
    reconstruct = ["reconstruct", source, "--rig", rig, "--out", out, "--shadows", "none"]
    walk = CHECKOUT / "data" / "walk.bvh"
    corners = ["--corners", "4", "4", "90", "4", "4", "66", "90", "66", "--size-mm", "24", "18"]
    head = ["--focal-px", f"{EGG_CAMERA.matrix[0, 0]:g}"]
    commands: list[list[str | Path]] = [
        reconstruct,
        [*reconstruct, "--jobs", "2"],
        ["track", result, "--template", "1", "--out", out],
        ["evaluate", "normals", normals, normals, "--out", out],
        ["evaluate", "mesh", mesh, mesh, "--out", out],
        ["doctor", source, "--rig", rig],
        ["export", result, "--to", "npz", "--out", out],
        ["export", result, "--to", "usd", "--out", out / "a.usdc"],
        ["dress", good / "cloth", "--motion", walk, "--out", out / "a_%03d.ply"],
        ["report", result, "--out", out / "page.html"],
        ["view", result, "--html", out / "scene.html"],
        ["calibrate", "head", good / "egg", *head, "--out", out / "head.json"],
        ["simulate", "sphere", "--frames", "0:1", "--size", "32x24", "--samples", "1", "--out", out],
        ["session", source, "--rig", rig, "--out", out, "--shadows", "none", "--track"],
        ["calibrate", "sphere", source, "--out", out / "rig.json"],
        ["calibrate", "lights", good / "lamps.txt", "--like", source, "--out", out / "rig.json"],
        ["rectify", source, *corners, "--pixel-mm", "0.5", "--out", out],
        ["board", "--out", out / "board.pdf"],
    ]
    return [[str(word) for word in command] for command in commands]


def draw(good: Path, out: Path, rng: np.random.Generator) -> Case:
    """Return a case; the same generator always gives the same."""
    commands = verbs(good, out)
    case = Case(arguments=commands[int(rng.integers(len(commands)))], out=out)
    kinds = [
        _another_user, _no_home, _full_disk, _two_runs, _giant, _odd_shell, _broken_cache, _pipe, _killed,
        _foreign_hosts,
    ]  # fmt: skip
    kind = kinds[int(rng.integers(len(kinds)))]
    case.what = kind.__name__.strip("_").replace("_", " ")
    kind(case, rng)
    return case


def _another_user(case: Case, _rng: np.random.Generator) -> None:
    """Needs root, and a Python that others may start; else only the home is missing."""
    case.environment["HOME"] = "/nonexistent"
    try:
        subprocess.run([sys.executable, "-c", ""], check=True, user=_NOBODY)
    except (OSError, subprocess.CalledProcessError):
        case.what = "no home"
        return
    case.out.parent.chmod(0o777)
    case.prepare = lambda: os.setuid(_NOBODY)


def _no_home(case: Case, _rng: np.random.Generator) -> None:
    case.environment["HOME"] = "/nonexistent"


def _full_disk(case: Case, rng: np.random.Generator) -> None:
    """A disk of its own that is full after so many bytes, at whatever write that is; else a limit a file."""
    case.out.mkdir()
    most = int(2 ** rng.uniform(12, 22))
    small = ["mount", "-t", "tmpfs", "-o", f"size={most}", "tmpfs", str(case.out)]
    if shutil.which("mount") and subprocess.run(small, check=False, capture_output=True).returncode == 0:
        case.cleanup = lambda: subprocess.run(["umount", str(case.out)], check=True)
        return

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    case.prepare = limit


def _killed(case: Case, rng: np.random.Generator) -> None:
    """Struck at any moment; then the same command again must end well."""
    case.strike = [signal.SIGINT, signal.SIGTERM, signal.SIGKILL][int(rng.integers(3))]
    case.after_s = float(rng.uniform(0.2, 12.0 if case.arguments[0] == "calibrate" else 4.0))


def _foreign_hosts(case: Case, rng: np.random.Generator) -> None:
    """The viewer's server, asked by pages of other sites, strangers without its token, and half a request."""
    case.arguments = ["view", str(case.out.parent.parent / "good/result"), "--port", str(_free_port())]
    port = int(case.arguments[-1])
    hosts = ("evil.example", f"127.0.0.1.evil.example:{port}", "", "[::1", "127.0.0.1:1:2", "\u0130")
    case.hostile = [
        _request(
            str(rng.choice(["GET", "POST", "PUT", "OPTIONS", "\0", "G" * 9000])),
            str(rng.choice(["/", "/frame?index=0", "/../../etc/passwd", "/topology", "//", "/%00"])),
            str(rng.choice([*hosts, f"127.0.0.1:{port}"])),
            str(rng.choice(["", "Origin: http://evil.example", "Content-Length: -1", "A: " + "x" * 70000])),
        )
        for _ in range(20)
    ]


def _request(method: str, path: str, host: str, header: str) -> bytes:
    lines = [f"{method} {path} HTTP/1.1", f"Host: {host}", *filter(None, [header]), "", ""]
    return "\r\n".join(lines).encode()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _two_runs(case: Case, _rng: np.random.Generator) -> None:
    case.times = 2


def _giant(case: Case, rng: np.random.Generator) -> None:
    inputs = [i for i, word in enumerate(case.arguments) if Path(word).exists() and Path(word) != case.out]
    if not inputs:
        return
    place = inputs[int(rng.integers(len(inputs)))]
    path = Path(case.arguments[place])
    giant = case.out.parent / f"giant{path.suffix or '.png'}"
    with giant.open("wb") as file:
        file.write(path.read_bytes()[:2000] if path.is_file() and rng.random() < 0.5 else b"")
        file.truncate(_GIANT)
    case.arguments[place] = str(giant)


def _odd_shell(case: Case, rng: np.random.Generator) -> None:
    for name in rng.choice(sorted(_VARIABLES), 3, replace=False):
        case.environment[str(name)] = str(rng.choice(_VARIABLES[str(name)]))


def _broken_cache(case: Case, rng: np.random.Generator) -> None:
    """Machine code of an earlier case, cut off; with none yet, a cache that is made anew."""
    cache = case.out.parent.parent / "cache"
    for path in cache.rglob("*.nb?") if cache.exists() else ():
        if rng.random() < 0.3:
            os.truncate(path, int(rng.integers(0, 100)))
    case.environment["NUMBA_CACHE_DIR"] = str(cache)


def _pipe(case: Case, rng: np.random.Generator) -> None:
    case.out.mkdir()
    name = str(
        rng.choice(["frames.log", "reconstruction.json", "simulation.json", "export.json", "normals.json"])
    )
    os.mkfifo(case.out / name)


def run_case(case: Case) -> str:
    """Run it; return its fault, empty where it was handled as promised."""
    try:
        if case.hostile:
            return _besieged(case)
        if case.strike is not None:
            struck = _start(case)
            with contextlib.suppress(subprocess.TimeoutExpired):
                struck.wait(case.after_s)
            struck.send_signal(case.strike)
            end_of(struck)
        faults = _outcome(case, [_start(case) for _ in range(case.times)])
        if case.strike is not None and faults == [] and case.ended != [0]:
            faults.append(f"the run after {case.strike.name} ended with {case.ended}")
        left = [path.name for path in case.out.rglob("*") if ".part" in path.name]
        return "; ".join(faults + [f"left {name}" for name in left])
    except Hang as hang:
        return str(hang)
    finally:
        case.cleanup()


def _start(case: Case) -> subprocess.Popen[str]:
    return start(case.arguments, environment=case.environment, prepare=case.prepare)


def _outcome(case: Case, running: list[subprocess.Popen[str]]) -> list[str]:
    faults = []
    for process in running:
        said, error = end_of(process)
        case.ended.append(process.returncode)
        ours = [line for line in error.splitlines() if line.startswith("vntoolkit: ")]
        if case.arguments[0] == "doctor":
            ours += said.splitlines()  # its findings are its result
        if process.returncode not in (0, 1) or "Traceback" in error or len(ours) < process.returncode:
            faults.append(f"status {process.returncode}: {error[-600:]!r}")
    if case.times == 2 and 0 not in case.ended:
        faults.append(f"neither of two runs was done: {case.ended}")
    return faults


def _besieged(case: Case) -> str:
    """Send every hostile request at once and keep them open; none may be given anything."""
    server, faults, held = _start(case), [], []
    assert server.stdout is not None
    while line := server.stdout.readline():
        if "http://" in line:
            break
    port = int(case.arguments[-1])
    for request in case.hostile:
        connection = socket.create_connection(("127.0.0.1", port), timeout=30)
        with contextlib.suppress(OSError):
            connection.sendall(request)
        held.append(connection)
    for request, connection in zip(case.hostile, held, strict=True):
        with contextlib.suppress(OSError), connection:
            if connection.recv(100).startswith((b"HTTP/1.0 200", b"HTTP/1.1 200")):
                faults.append(f"answered {request[:200]!r}")
    server.send_signal(signal.SIGINT)
    error = end_of(server)[1]
    if "Traceback" in error or server.returncode not in (0, 130):
        faults.append(f"status {server.returncode}: {error[-600:]!r}")
    return "; ".join(faults)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--only", type=int, help="repeat this case")
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    faults = []
    with tempfile.TemporaryDirectory(prefix="vntoolkit-system-") as folder:
        good = prepare(Path(folder))
        for index in range(options.count) if options.only is None else (options.only,):
            place = Path(folder) / "case"
            place.mkdir()
            case = draw(good, place / "out", np.random.default_rng([options.seed, index]))
            fault = run_case(case)
            counts[case.what] += 1
            if fault:
                faults.append(f"case {index}: {case.what}: {case.arguments[0]} {case.environment}: {fault}")
                sys.stdout.write(f"{faults[-1]}\n")
            shutil.rmtree(place)
    for what, number in sorted(counts.items()):
        sys.stdout.write(f"{what:>14}  {number:4d}\n")
    total = f"{sum(counts.values())} system cases: {len(faults)} faults; seed {options.seed}"
    sys.stdout.write(f"{total}\n")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
