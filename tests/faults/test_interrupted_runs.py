"""Ended at any moment by any signal, a run goes on where it stopped and ends with the same bytes.

VNTOOLKIT_KILLS sets how often `reconstruct` is struck (50 in `make fuzz`), the other verbs in proportion.
"""

import importlib.util
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from interruptions import Verb, content_of, interrupt_often, lines_of, run_until

from tests.pipeline.conftest import RESPONSE, RIG, SIZE
from tests.result_files import write_mesh_sequence
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.rigs import write_rig
from vntoolkit.photometry.response import rgb_from_normals

pytestmark = pytest.mark.slow
KILLS = int(os.environ.get("VNTOOLKIT_KILLS", "4"))
H, W = SIZE


def _write_waves(folder: Path, count: int) -> None:
    """A surface of waves that drifts over the picture, 16-bit."""
    folder.mkdir()
    v, u = np.mgrid[:H, :W].astype(float)
    for number in range(count):
        at = u - 0.2 * number
        p, q = 0.4 * np.cos(at / 6) * np.cos(v / 9), -0.3 * np.sin(at / 6) * np.sin(v / 9)
        normals = np.stack([p, q, -np.ones((H, W))], axis=-1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        rgb = np.clip(rgb_from_normals(normals, RESPONSE), 0, 1)
        write_png(folder / f"f{number:03d}.png", np.round(rgb * 65535).astype(np.uint16))


@pytest.fixture(scope="module")
def waves(tmp_path_factory) -> Path:
    """A folder with the footage, 200 frames and 24 of them apart, and its rig."""
    folder = tmp_path_factory.mktemp("waves")
    _write_waves(folder / "long", 200)
    _write_waves(folder / "short", 24)
    write_rig(folder / "rig.json", RIG)
    return folder


def _reconstruction(waves: Path, name: str, *more: str) -> Verb:
    return Verb(
        arguments=lambda out: [
            "reconstruct", str(waves / name), "--rig", str(waves / "rig.json"), "--out", str(out), *more
        ],
        done=lambda out: lines_of(out / "frames.log"),
    )  # fmt: skip


def _require_same(folders: list[Path], reference: Path) -> None:
    want = content_of(reference)
    assert want
    for folder in folders:
        assert content_of(folder) == want


def test_a_reconstruction_struck_at_random_ends_with_the_same_bytes(waves, tmp_path, rng):
    verb = _reconstruction(waves, "long", "--shadows", "none")
    assert run_until(verb, tmp_path / "whole", None, signal.SIGKILL, 0).status == 0
    stride = 60 if KILLS < 20 else 30
    folders, ends = interrupt_often(verb, lambda k: tmp_path / f"out{k}", KILLS, rng, stride)
    assert sum(end.by is not None for end in ends) == KILLS
    # by a signal that is heard: SIGINT is not where a shell's background job starts this
    assert KILLS < 20 or any(end.status == 130 for end in ends if end.by is signal.SIGINT)
    _require_same(folders, tmp_path / "whole")
    _require_advice(ends)


def _require_advice(ends) -> None:
    """SIGINT leaves a sentence that says how to go on; nothing leaves a traceback."""
    for end in ends:
        assert "Traceback" not in end.error or "vntoolkit" not in end.error  # Python's own start is not ours
        # while the interpreter starts, or shuts down with all work done, the signal's own default ends it
        if end.by is signal.SIGINT and end.status == 130 and "Traceback" not in end.error:
            assert "run the same command again" in end.error


def test_an_interrupted_reconstruction_says_how_to_go_on(waves, tmp_path):
    end = run_until(_reconstruction(waves, "long"), tmp_path / "out", 3, signal.SIGINT, 0)
    assert end.status == 130
    assert "frames were finished" in end.error
    assert "run the same command again to go on" in end.error


def test_tracks_struck_at_random_end_with_the_same_bytes(waves, tmp_path, rng):
    first = _reconstruction(waves, "short", "--to", "depth", "--shadows", "none")
    assert run_until(first, tmp_path / "r", None, signal.SIGKILL, 0).status == 0
    verb = Verb(
        arguments=lambda out: ["track", str(tmp_path / "r"), "--template", "8", "--out", str(out)],
        done=_tracked_frames,
    )
    assert run_until(verb, tmp_path / "whole", None, signal.SIGKILL, 0).status == 0
    kills = max(2, KILLS * 2 // 5)
    folders, ends = interrupt_often(verb, lambda k: tmp_path / f"out{k}", kills, rng, 10)
    _require_same(folders, tmp_path / "whole")
    _require_advice(ends)


def _tracked_frames(out: Path) -> int:
    """Frames in the arrays that grow, by their size; the part before the template is written apart."""
    row = H * W * 12
    paths = (out / "backwards" / "vertices.npy", out / "vertices.npy")
    return sum(path.stat().st_size // row for path in paths if path.exists())


def test_a_dressed_figure_struck_at_random_ends_with_the_same_bytes(tmp_path, rng):
    place = Path(__file__).parent.parent / "skinning" / "conftest.py"
    spec = importlib.util.spec_from_file_location("skinning_garment", place)
    garment = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(garment)
    write_mesh_sequence(tmp_path / "cloth" / "track", garment.rippling(garment.sleeved_tube(), 60))
    walk = Path(__file__).parent.parent.parent / "data" / "walk.bvh"
    for name in ("a.usdc", "a_%03d.ply"):
        verb = Verb(
            arguments=lambda out, name=name: [
                "dress", str(tmp_path / "cloth"), "--motion", str(walk), "--out", str(out / name)
            ],
            done=lambda out: len([p for p in out.glob("*") if p.is_file()]),
        )  # fmt: skip
        whole = tmp_path / f"whole_{name[-4:]}"
        assert run_until(verb, whole, None, signal.SIGKILL, 0).status == 0
        kills = max(1, KILLS // 5)
        folders, ends = interrupt_often(
            verb, lambda k, name=name: tmp_path / f"{k}{name[-4:]}", kills, rng, 5 if "%" in name else 1
        )
        _require_same(folders, whole)
        _require_advice(ends)


@pytest.mark.parametrize("kind", ["ply", "npz", "usd"])
def test_an_export_struck_at_random_ends_with_the_same_bytes(waves, tmp_path, rng, kind):
    verb = _reconstruction(waves, "short", "--shadows", "none")
    assert run_until(verb, tmp_path / "r", None, signal.SIGKILL, 0).status == 0
    name, stride = ("a.usdc", 1) if kind == "usd" else ("files", 12)  # one file, or many
    export = Verb(
        arguments=lambda out: ["export", str(tmp_path / "r"), "--to", kind, "--out", str(out / name)],
        done=lambda out: len([p for p in out.rglob("*") if p.is_file()]),
    )
    assert run_until(export, tmp_path / "whole", None, signal.SIGKILL, 0).status == 0
    folders, ends = interrupt_often(export, lambda k: tmp_path / f"out{k}", max(1, KILLS // 5), rng, stride)
    _require_same(folders, tmp_path / "whole")
    _require_advice(ends)
