"""Bad input through the program itself: exit status 1, one line on stderr, nothing half-written."""

import json
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from specimens import rig as small_rig
from specimens import write_specimens

from vntoolkit.__main__ import main
from vntoolkit.io.rigs import text_from_rig


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("good")
    write_specimens(folder)
    return folder


def fails_in_one_line(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    """Run the program; require status 1 and one line; return it."""
    capfd.readouterr()
    status = main(arguments)
    error = capfd.readouterr().err
    assert status == 1, error
    assert error.startswith("vntoolkit: ")
    assert error.count("\n") == 1
    return error


def leftovers(folder: Path) -> list[str]:
    """Every file below a folder, hidden ones too, but for the manifest, which is whole."""
    return [str(p) for p in folder.rglob("*") if p.is_file() and p.name != "reconstruction.json"]


def reconstruct(good: Path, out: Path, **changed: Path | str) -> list[str]:
    arguments = {"source": good / "captures/16.png", "--rig": good / "texts/rig.json", "--out": out}
    arguments.update(
        {name.replace("_", "--") if name != "source" else name: v for name, v in changed.items()}
    )
    source = arguments.pop("source")
    words = [str(word) for pair in arguments.items() for word in pair]
    return ["reconstruct", str(source), *words, "--allow", "noise"]  # the specimens are noise


def huge_png(path: Path, width: int, height: int) -> Path:
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    body = b"".join(
        struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
        for chunk in (head, b"IDAT" + zlib.compress(bytes(1000)), b"IEND")
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return path


def test_files_that_are_no_files_are_one_line(good, tmp_path, capfd):
    (tmp_path / "loop.png").symlink_to("loop.png")
    (tmp_path / "broken.json").symlink_to("nowhere")
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "empty.png").touch()
    os.mkfifo(tmp_path / "pipe.png")
    name = tmp_path / os.fsdecode(b"\xff\xfe.png")
    name.write_bytes(b"no image")
    out = tmp_path / "out"
    for changed in (
        {"source": tmp_path / "loop.png"}, {"source": tmp_path / "empty.png"}, {"source": name},
        {"source": tmp_path / "none_%04d.png"}, {"source": tmp_path / "folder.json"},
        {"source": tmp_path / "pipe.png"}, {"_rig": tmp_path / "broken.json"},
        {"_rig": tmp_path / "pipe.png"}, {"_rig": tmp_path / "folder.json"},
        {"_mask": tmp_path / "folder.json"}, {"_mask": tmp_path / "loop.png"},
        {"_background": tmp_path / "empty.png"}, {"_out": tmp_path / "empty.png"},
    ):  # fmt: skip
        fails_in_one_line(reconstruct(good, out, **changed), capfd)
        assert not list(out.rglob("*"))  # the folder itself may be made, to prove that it can be written to


def test_headers_that_declare_a_terabyte_are_refused_before_allocation(good, tmp_path, capfd):
    vertices = "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\n"
    (tmp_path / "a.ply").write_text(f"{vertices}property float y\nproperty float z\nend_header\n")
    header = np.lib.format.header_data_from_array_1_0(np.zeros(1, np.float32)) | {"shape": (10**9, 36, 3)}
    with (tmp_path / "vertices.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
    shutil.copytree(good / "meshes/moving", tmp_path / "cloth")
    shutil.copy(tmp_path / "vertices.npy", tmp_path / "cloth")
    exr = bytearray((good / "captures/zip.exr").read_bytes())
    at = exr.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    exr[at : at + 16] = struct.pack("<4i", 0, 0, 999_999, 999_999)
    (tmp_path / "a.exr").write_bytes(exr)
    walk = Path(__file__).parents[2] / "data/walk.bvh"
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for source in (huge_png(tmp_path / "a.png", 1_000_000, 1_000_000), tmp_path / "a.exr"):
        error = fails_in_one_line(reconstruct(good, tmp_path / "out", source=source), capfd)
        assert "megapixels, more than the limit" in error
    dress = ["dress", str(tmp_path / "cloth"), "--motion", str(walk), "--out", str(tmp_path / "a.usdc")]
    assert "not a whole .npy array" in fails_in_one_line(dress, capfd)
    (tmp_path / "cloth/template.ply").write_bytes((tmp_path / "a.ply").read_bytes())
    assert "the header promises" in fails_in_one_line(dress, capfd)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < 600_000  # kB: imports, no terabyte


@contextmanager
def as_nobody() -> Iterator[None]:
    """Root may read anything: be somebody else for a while."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_no_permission_is_one_line(good, tmp_path, capfd):
    above = [path for path in tmp_path.parents if "pytest" in str(path)]
    for path in (tmp_path, *above, good, *good.rglob("*"), good.parent):
        path.chmod(path.stat().st_mode | 0o055 if path.is_dir() else 0o644)
    for name, source in (
        ("a.png", "captures/16.png"),
        ("rig.json", "texts/rig.json"),
        ("m.png", "maps/mask.png"),
    ):
        shutil.copy(good / source, tmp_path / name)
        (tmp_path / name).chmod(0)
    (tmp_path / "locked").mkdir(mode=0o500)
    with as_nobody():
        for changed in (
            {"source": tmp_path / "a.png"}, {"_rig": tmp_path / "rig.json"}, {"_mask": tmp_path / "m.png"},
            {"_out": tmp_path / "locked/out"},
        ):  # fmt: skip
            error = fails_in_one_line(reconstruct(good, tmp_path / "out", **changed), capfd)
            assert "permission denied" in error.lower()
    assert not leftovers(tmp_path / "locked")


def test_a_full_disk_leaves_no_half_file(good, tmp_path, capfd):
    """A file system of 64 kB where it may be mounted, else files of 1 kB at most."""
    small = tmp_path / "small"
    small.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "none", str(small)]
    is_mounted = (
        shutil.which("mount") and subprocess.run(mount, capture_output=True, check=False).returncode == 0
    )
    source = str(good / "captures/8.mkv")
    command = [*reconstruct(good, small / "out", source=source), "--shadows", "none"]
    try:
        if is_mounted:
            error = fails_in_one_line(command, capfd)
            assert "no space left" in error
        else:
            done = subprocess.run(
                [sys.executable, "-m", "vntoolkit", *command],
                preexec_fn=_only_small_files, capture_output=True, text=True, check=False,
            )  # fmt: skip
            assert done.returncode == 1
            assert done.stderr.count("vntoolkit: cannot write") == 1
            assert "Traceback" not in done.stderr
        for path in small.rglob("*"):
            assert ".part" not in path.name
            assert path.is_dir() or path.stat().st_size > 0
    finally:
        if is_mounted:
            subprocess.run(["umount", str(small)], check=True)


def _only_small_files() -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))


def test_missing_double_and_odd_frames_of_a_sequence(good, tmp_path, capfd):
    """A gap in the numbers is refused unless told; a frame of another size or no image is named."""
    frames = tmp_path / "frames"
    shutil.copytree(good / "captures/sequence", frames)
    (frames / "f1.png").unlink()
    error = fails_in_one_line(reconstruct(good, tmp_path / "a", source=frames), capfd)
    assert "are missing: f1.png; copy them too" in error
    assert main([*reconstruct(good, tmp_path / "a", source=frames), "--gaps", "skip"]) == 0
    shutil.copy(good / "captures/sequence/f1.png", frames)
    shutil.copy(good / "captures/alpha.png", frames / "f4.png")
    shutil.copy(good / "maps/n.png", frames / "f5.png")
    error = fails_in_one_line(reconstruct(good, tmp_path / "b", source=frames), capfd)
    assert "f5.png" in error
    (frames / "f5.png").write_bytes((frames / "f0.png").read_bytes()[:-40])
    assert "f5.png" in fails_in_one_line(reconstruct(good, tmp_path / "c", source=frames), capfd)


def test_a_manifest_of_other_input_or_options_is_named_not_mixed(good, tmp_path, capfd):
    out = tmp_path / "out"
    assert main(reconstruct(good, out)) == 0
    before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    other = fails_in_one_line(reconstruct(good, out, source=good / "captures/8.png"), capfd)
    assert "the input files" in other
    changed = json.loads(text_from_rig(small_rig()))
    changed["response"]["matrix"][0][0] += 0.01
    (tmp_path / "rig.json").write_text(json.dumps(changed))
    assert "the rig's response" in fails_in_one_line(
        reconstruct(good, out, _rig=tmp_path / "rig.json"), capfd
    )
    assert "shadows" in fails_in_one_line([*reconstruct(good, out), "--shadows", "none"], capfd)
    (out / "reconstruction.json").write_text("{")
    assert "is not JSON" in fails_in_one_line(reconstruct(good, out), capfd)
    del before[out / "reconstruction.json"]
    assert all(path.read_bytes() == content for path, content in before.items())


def test_a_clock_that_jumps_back_changes_nothing(good, tmp_path, monkeypatch):
    """Times are noted, never compared: the second half is done an hour before the first."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "2000000000")
    out, source = tmp_path / "out", good / "captures/sequence"
    assert main([*reconstruct(good, out, source=source), "--frames", "0:2"]) == 0
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000")
    assert main(reconstruct(good, out, source=source)) == 0
    assert main(reconstruct(good, tmp_path / "whole", source=source)) == 0
    for path in sorted((tmp_path / "whole" / "normals").iterdir()):
        assert (out / "normals" / path.name).read_bytes() == path.read_bytes()
