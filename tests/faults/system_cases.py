"""Runs of the whole program under odd systems: another user, no home, a full disk, two runs at once.

A case passes when the program ends in time with status 0 or 1, says a line of ours for the latter and shows
no traceback. `python tests/faults/system_cases.py --seed SEED --only CASE` repeats one.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import signal
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

_LONGEST_S = 300.0
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
    prepare: Callable[[], None] | None = None
    times: int = 1


def verbs(good: Path, out: Path) -> list[list[str]]:
    """Short commands of every sort: that read only, write files or a folder, or start workers."""
    rig, source = str(good / "texts/rig.json"), str(good / "captures/sequence")
    normals = str(good / "maps/n.exr")
    reconstruct = ["reconstruct", source, "--rig", rig, "--out", str(out), "--shadows", "none"]
    return [
        reconstruct,
        [*reconstruct, "--jobs", "2"],
        ["evaluate", "normals", normals, normals, "--out", str(out)],
        ["doctor", source, "--rig", rig],
        ["export", str(good / "result"), "--to", "npz", "--out", str(out)],
        ["simulate", "sphere", "--frames", "0:1", "--size", "32x24", "--samples", "1", "--out", str(out)],
    ]


def draw(good: Path, out: Path, rng: np.random.Generator) -> Case:
    """Return a case; the same generator always gives the same."""
    commands = verbs(good, out)
    case = Case(arguments=commands[int(rng.integers(len(commands)))], out=out)
    kinds = [_another_user, _no_home, _full_disk, _two_runs, _giant, _odd_shell, _broken_cache, _pipe]
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
    most = int(rng.integers(0, 20_000))

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    case.prepare = limit


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
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", **case.environment}
    command = [sys.executable, "-m", "vntoolkit", *case.arguments]
    running = [
        subprocess.Popen(
            command, env=environment, preexec_fn=case.prepare,  # noqa: PLW1509 - no thread runs here
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, text=True, errors="replace", cwd=Path(__file__).parents[2],
        )
        for _ in range(case.times)
    ]  # fmt: skip
    faults, ended = [], []
    for process in running:
        try:
            error = process.communicate(timeout=_LONGEST_S)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return f"did not end within {_LONGEST_S:g} s"
        ended.append(process.returncode)
        ours = [line for line in error.splitlines() if line.startswith("vntoolkit: ")]
        if process.returncode not in (0, 1) or "Traceback" in error or len(ours) < process.returncode:
            faults.append(f"status {process.returncode}: {error[-600:]!r}")
    if case.times == 2 and 0 not in ended:
        faults.append(f"neither of two runs was done: {ended}")
    left = [
        path.name for path in case.out.rglob("*") if ".part" in path.name or path.name.startswith(".probe")
    ]
    return "; ".join(faults + [f"left {name}" for name in left])


def main() -> int:
    from specimens import write_specimens

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--only", type=int, help="repeat this case")
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    faults = []
    with tempfile.TemporaryDirectory(prefix="vntoolkit-system-") as folder:
        good = Path(folder) / "good"
        good.mkdir()
        write_specimens(good)
        subprocess.run(
            [sys.executable, "-m", "vntoolkit", *verbs(good, good / "result")[0]], check=True,
            stdout=subprocess.DEVNULL, cwd=Path(__file__).parents[2],
        )  # fmt: skip
        for path in (Path(folder), good, *good.rglob("*")):
            path.chmod(0o755 if path.is_dir() else 0o644)
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
