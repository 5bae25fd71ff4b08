"""Faults that attacks found: two runs at once, names that lead elsewhere, inputs written over, odd shells."""

import os
import re
import resource
import shutil
import subprocess
import sys
import typing
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from specimens import write_specimens
from test_faults_at_the_command_line import fails_in_one_line, reconstruct

import vntoolkit
from tests.result_files import write_mesh_sequence
from tests.skinning.conftest import rippling, sleeved_tube
from vntoolkit import (
    DepthIntegrator,
    mesh_from_depth,
    normals_from_frame,
    open_capture,
    read_rig,
    recover_normals,
)
from vntoolkit.__main__ import main
from vntoolkit.calibration.fit import fit_response
from vntoolkit.diagnosis import inspection
from vntoolkit.errors import BadInput, CannotWrite, VntError
from vntoolkit.io.atomic import require_writable_folder, write_text
from vntoolkit.io.files import require_name
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.exr import ExrCompression, write_exr
from vntoolkit.io.results.folder import LOCK_NAME, read_lock, write_lock
from vntoolkit.io.results.sequences import read_mesh_sequence

ENVIRONMENT = dict(os.environ)


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("good")
    write_specimens(folder)
    return folder


# One run at a time.


def test_a_second_writer_is_told_the_first_ones_process(tmp_path):
    with write_lock(tmp_path / "out"):
        for second in (write_lock, read_lock):
            with (
                pytest.raises(CannotWrite, match=f"process {os.getpid()} on .* is at work there"),
                second(tmp_path / "out"),
            ):
                pass
    assert not (tmp_path / "out").exists()  # made for nothing


def test_readers_keep_a_writer_out_and_not_each_other(tmp_path):
    refused = pytest.raises(CannotWrite, match="is at work there")
    with read_lock(tmp_path), read_lock(tmp_path), refused, write_lock(tmp_path):
        pass
    with write_lock(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_the_lock_of_a_killed_run_is_taken_over_and_said_so(tmp_path, caplog):
    code = (
        "import os; from vntoolkit.io.results.folder import write_lock\n"
        f"with write_lock({str(tmp_path)!r}): os.kill(os.getpid(), 9)"
    )
    killed = subprocess.run([sys.executable, "-c", code], check=False)
    assert killed.returncode == -9
    assert (tmp_path / LOCK_NAME).exists()
    with write_lock(tmp_path):
        assert "was ended before it was done there; taken over" in caplog.text
    assert not (tmp_path / LOCK_NAME).exists()


@pytest.mark.slow
def test_every_verb_that_writes_a_folder_leaves_a_locked_one_alone(good, tmp_path, capfd):
    assert main([*reconstruct(good, tmp_path / "r"), "--to", "mesh"]) == 0
    result, out, maps = tmp_path / "r", tmp_path / "locked", f"{good}/maps/n.exr"
    plane = "--corners 0 0 20 0 0 20 20 20 --size-mm 5 5 --pixel-mm 0.5"
    verbs = [
        reconstruct(good, out),
        f"track {result} --out {out}".split(),
        f"export {result} --to npz --out {out}".split(),
        f"simulate sphere --out {out} --frames 0:1 --size 32x24".split(),
        f"rectify {good}/captures/8.png --out {out} {plane}".split(),
        f"evaluate normals {maps} {maps} --out {out}".split(),
        f"dress {result} --motion data/walk.bvh --out {out}/a_%03d.ply".split(),
    ]
    out.mkdir()
    with write_lock(out):
        before = sorted(out.iterdir())
        for arguments in verbs:
            assert f"process {os.getpid()}" in fails_in_one_line(arguments, capfd)
        assert sorted(out.iterdir()) == before
    with write_lock(tmp_path / "r"):
        assert f"process {os.getpid()}" in fails_in_one_line(verbs[1], capfd)


# Names that become paths.


@pytest.mark.parametrize("name", ["", ".", "..", " .", "a/b", "a\0b", "x" * 256])
def test_a_name_that_is_none_or_leads_elsewhere_is_refused(name):
    with pytest.raises(BadInput, match="which is not allowed for a file"):
        require_name(name, "a.mkv")


def test_a_session_writes_nowhere_but_into_its_folder(good, tmp_path, capfd):
    (tmp_path / "...mkv").write_bytes((good / "captures/8.mkv").read_bytes())
    out = tmp_path / "deep/day"
    session = ["session", str(tmp_path / "...mkv"), "--rig", str(good / "texts/rig.json"), "--out", str(out)]
    line = fails_in_one_line(session, capfd)
    if Path("...mkv").stem == "..":  # for Python up to 3.13
        assert "gives the name '..'" in line
    assert not (tmp_path / "deep").exists()


def test_a_name_of_255_bytes_can_be_written(tmp_path):
    path = tmp_path / ("x" * 250 + ".json")
    write_text(path, "{}")
    assert path.read_text() == "{}"


# What is read, and what is the user's own, is not written over or removed.


def test_an_input_is_not_written_over(good, tmp_path, capfd):
    lights = tmp_path / "l.json"
    lights.write_text("0 0 1\n0.5 0 0.8\n0 0.5 0.8\n")
    frames = tmp_path / "frames"
    frames.mkdir()
    for number in range(2):
        (frames / f"{number}.png").write_bytes((good / "captures/8.png").read_bytes())
    figure = f"--out {tmp_path}/h.json --figure {frames}/0.png"
    for arguments in (
        f"calibrate lights {lights} --like {good}/captures/8.png --out {lights}".split(),
        f"calibrate head {frames} {figure}".split(),
        f"calibrate head {frames}/%d.png {figure}".split(),
    ):
        before = {path: path.read_bytes() for path in (lights, *frames.iterdir())}
        assert "would be written over" in fails_in_one_line(arguments, capfd)
        assert all(path.read_bytes() == content for path, content in before.items())


def test_overwriting_removes_only_what_the_run_wrote(good, tmp_path):
    out, scene = tmp_path / "r", tmp_path / "s"
    simulate = f"simulate sphere --out {scene} --frames 0:1 --size 32x24 --samples 1".split()
    assert main(reconstruct(good, out)) == 0
    assert main(["export", str(out), "--to", "npz"]) == 0
    assert main(simulate) == 0
    own = [
        *(out / name for name in ("normals/notes.txt", "normals/000900.exr", "export/npz/mine.npz")),
        *(scene / "truth" / name for name in ("mine.json", "normals/a.exr")),
    ]
    for path in own:
        path.write_text("mine")
    assert main([*reconstruct(good, out), "--overwrite"]) == 0
    assert main([*simulate, "--overwrite"]) == 0
    assert main(["export", str(out), "--to", "npz", "--overwrite"]) == 0
    assert all(path.read_text() == "mine" for path in own)


def test_footage_in_the_folder_that_is_written_is_refused(good, tmp_path, capfd):
    out = tmp_path / "r"
    assert main(reconstruct(good, out)) == 0
    before = (out / "shadows/000000.png").read_bytes()
    again = [*reconstruct(good, out, source=out / "shadows"), "--overwrite"]
    assert "is what would be written" in fails_in_one_line(again, capfd)
    assert (out / "shadows/000000.png").read_bytes() == before
    for place in (out, out / "mesh"):
        line = fails_in_one_line(["export", str(out), "--to", "npz", "--out", str(place)], capfd)
        assert "choose another --out" in line


# The environment.


def run(*arguments: str, **changed: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "vntoolkit", *arguments],
        env=ENVIRONMENT | changed, capture_output=True, text=True, check=False, errors="replace",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "status"),
    [({"COLUMNS": "0", "PYTHONIOENCODING": "ascii", "LANG": "C", "MPLBACKEND": "nosuch",
       "HOME": "/nonexistent", "TMPDIR": "/nonexistent"}, 0), ({"SOURCE_DATE_EPOCH": "tomorrow"}, 1)],
)  # fmt: skip
def test_an_odd_environment_is_no_fault_of_ours(good, tmp_path, changed, status):
    maps = good / "maps/n.exr"
    done = run("evaluate", "normals", str(maps), str(maps), "--out", str(tmp_path / "größe"), **changed)
    assert done.returncode == status, done.stderr
    assert done.stderr.count("\n") == status, done.stderr


@pytest.mark.parametrize("arguments", [["--help"], ["recipe", "list"]])
def test_a_full_screen_is_one_line(arguments):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "vntoolkit", *arguments],
            env=ENVIRONMENT, stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.startswith("vntoolkit: cannot write what is to be shown: no space left on device;")
    assert done.stderr.count("\n") == 1


def test_a_name_that_is_no_utf8_is_refused_before_the_work(good, tmp_path, capfd):
    line = fails_in_one_line(reconstruct(good, tmp_path / os.fsdecode(b"\xff\xfe")), capfd)
    assert "expected a name in UTF-8" in line
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_damaged_or_unwritable_cache_is_passed_over(tmp_path):
    """In a process of its own: the kernels of this one are compiled."""
    kernel = "@njit\ndef double(x):\n    return 2 * x\nprint(double(21))\n"
    (tmp_path / "k.py").write_text(f"from vntoolkit.native import njit\n{kernel}")
    cache = {"PYTHONPATH": os.pathsep.join(sys.path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    environment = ENVIRONMENT | cache
    command = [sys.executable, "-c", "import k"]

    def answer(**changed: str) -> str:
        return subprocess.run(
            command, env=environment | changed, cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout

    assert answer() == "42\n"
    kept = [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]
    assert kept
    for path in kept:
        path.write_bytes(path.read_bytes()[:20])
    assert answer() == "42\n"
    assert all(path.stat().st_size > 20 for path in (tmp_path / "cache").rglob("*.nbi"))  # repaired
    assert answer(NUMBA_CACHE_DIR="/proc/none", HOME="/proc/none", TMPDIR=str(tmp_path)) == "42\n"


# What is refused, is refused before it is read.


def sparse(path: Path, start: bytes, size: int = 3 << 30) -> None:
    with path.open("wb") as file:
        file.write(start)
        file.truncate(size)


def test_sparse_giants_and_bombs_are_refused_within_300_mb(good, tmp_path):
    """In a process of its own, whose peak is known."""
    ply = "ply\nformat binary_little_endian 1.0\nelement vertex 9\n"
    ply += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    starts = {"zeros.png": b"", "rig.json": b"{", "zeros.obj": b"", "a.obj": b"v 0 0 0\n"}
    starts |= {"a.ply": ply.encode(), "a.bvh": b"HIERARCHY\n", "a.npz": b"PK\3\4"}
    starts |= {
        name: (good / "captures" / name).read_bytes() for name in ("16.png", "plain.tif", "a.jpg", "zip.exr")
    }
    for name, start in starts.items():
        sparse(tmp_path / name, start)
    with (
        zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("depth.npy", "w", force_zip64=True) as member,
    ):
        header = {"descr": "<f8", "fortran_order": False, "shape": (20_000, 20_000)}
        np.lib.format.write_array_header_1_0(member, header)
        for _ in range(20):
            member.write(bytes(1 << 20))
    planes = {f"layer{number}.R": np.zeros((2000, 2000), np.float16) for number in range(40)}
    write_exr(tmp_path / "layers.exr", planes, compression=ExrCompression.ZIP)
    os.mkfifo(tmp_path / "frames.log")
    command = [sys.executable, str(Path(__file__).with_name("peaks.py")), str(tmp_path)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    peaks = {line.split()[0]: int(line.split()[1]) for line in done.stdout.splitlines()}
    assert len(peaks) == len(list(tmp_path.iterdir()))
    assert max(peaks.values()) < 300, done.stdout


def test_nan_in_a_moving_mesh_is_refused_by_all_that_read_it(good, tmp_path, capfd):
    shutil.copytree(good / "meshes/moving", tmp_path / "track")
    vertices = np.load(tmp_path / "track/vertices.npy")
    vertices[1, 0, 0] = np.nan
    np.save(tmp_path / "track/vertices.npy", vertices)
    walk = Path(__file__).parents[2] / "data/walk.bvh"
    dress = ["dress", str(tmp_path), "--motion", str(walk), "--out", str(tmp_path / "a.usdc")]
    assert "vertices.npy: frame 1: 1 of" in fails_in_one_line(dress, capfd)


def test_usd_without_room_is_one_line():
    """It would end the process."""
    code = (
        "import resource; from vntoolkit.libraries import require_address_space\n"
        "resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30)); require_address_space(2 << 30, 'USD')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "USD needs 2 GiB of address space" in done.stderr


def test_workers_end_with_their_parent(tmp_path):
    (tmp_path / "parent.py").write_text(
        "import multiprocessing, os, time\nfrom vntoolkit.native import end_with_parent\n"
        "def work():\n    end_with_parent()\n    print(os.getpid(), flush=True)\n    time.sleep(600)\n"
        "if __name__ == '__main__':\n    multiprocessing.get_context('spawn').Process(target=work).start()\n"
        "    time.sleep(600)\n"
    )
    environment = ENVIRONMENT | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "parent.py"]
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        assert int(parent.stdout.readline()) > 0
        parent.kill()
        assert parent.stdout.read() == b""  # ends once no process holds the other end


# What is passed in Python.


def test_public_functions_name_what_to_pass(good):
    frame = open_capture(good / "captures/16.png").frame(0)
    rig = read_rig(good / "texts/rig.json")
    cases = {
        "a NormalMap, got an array": lambda: DepthIntegrator(rig.camera).integrate(np.ones((24, 32, 3))),
        "a Camera, got Rig; pass its .camera": lambda: DepthIntegrator(rig),
        "frame: expected a LinearFrame, got an array": lambda: normals_from_frame(frame.rgb, rig.response),
        "a LightResponse, got Rig; pass its .response": lambda: normals_from_frame(frame, rig),
        "labels: expected an array, got None": lambda: recover_normals(frame, None, rig.response),
        "depth_map: expected a DepthMap, got Camera": lambda: mesh_from_depth(rig.camera, rig.camera),
    }
    for message, call in cases.items():
        with pytest.raises(BadInput, match=re.escape(message)):
            call()


@pytest.mark.parametrize("name", [n for n in vntoolkit.__all__ if callable(getattr(vntoolkit, n))])
def test_kinds_are_known_of_every_public_function(name):
    checked = getattr(vntoolkit, name)
    checked = getattr(checked.__init__, "__wrapped__", checked) if isinstance(checked, type) else checked
    typing.get_type_hints(checked, localns=vars(inspection))  # `doctor` imports what it returns when it runs


# Small ones.


def test_no_probe_is_left_where_nothing_can_be_stored(tmp_path):
    _, hard = before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        with pytest.raises(CannotWrite, match="file too large"):
            require_writable_folder(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


# What is left out or replaced is said.


def test_errors_that_a_track_lost_are_missed(tmp_path, caplog):
    write_mesh_sequence(tmp_path / "track", rippling(sleeved_tube(), 2))
    read_mesh_sequence(tmp_path / "track")
    assert not caplog.messages
    (tmp_path / "track/track.json").write_text("{}")
    read_mesh_sequence(tmp_path / "track")
    assert "no vertex has an expected error" in caplog.text


def test_the_evaluation_of_another_subject_is_named_when_it_goes(good, tmp_path, caplog):
    evaluate = ["evaluate", "normals", "--out", str(tmp_path / "e")]
    for name in ("a.exr", "a.exr", "b.exr"):
        shutil.copy(good / "maps/n.exr", tmp_path / name)
        assert main([*evaluate, str(tmp_path / name), str(good / "maps/n.exr")]) == 0
        assert ("held the evaluation of" in caplog.text) == (name == "b.exr")


def test_rectify_says_what_it_leaves_out(tmp_path, capsys):
    for k in range(2):
        write_png(tmp_path / f"in/{k}.png", np.full((20, 30, 3), 90, np.uint8))
    (tmp_path / "in/notes.txt").write_text("two presses")
    plane = "--corners 2 2 27 2 2 17 27 17 --size-mm 10 6 --pixel-mm 0.5"
    assert main(f"rectify {tmp_path}/in {plane} --out {tmp_path}/out".split()) == 0
    assert "1 files that are no images were left out" in capsys.readouterr().out


def test_numpy_says_nothing_of_data_that_are_refused():
    flat = np.tile([0.0, 0.0, -1.0], (40, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(VntError):
            fit_response(flat, np.zeros((40, 3)))
        with pytest.raises(VntError):
            fit_response(flat, np.full((40, 3), 1e-320))
        cloth = rippling(sleeved_tube(), 1)
        vertices = np.zeros((1, len(cloth.template.vertices), 3), np.float32)
        vertices[0, 3, 1], vertices[0, 5, 2] = np.inf, -np.inf
        with pytest.raises(VntError, match=r"2 of \d+ values are NaN or infinite"):
            replace(cloth, vertices=vertices).require_finite("vertices.npy")
