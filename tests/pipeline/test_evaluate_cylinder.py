"""From film to Figure 7, small: the simulated cylinder, reconstructed with the true rig."""

import json
from pathlib import Path

import pytest

import vntoolkit as vt
from vntoolkit.cli import run_verb
from vntoolkit.errors import BadInput
from vntoolkit.pipeline.evaluate import evaluate_cylinder
from vntoolkit.pipeline.opened_result import read_result


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    root = tmp_path_factory.mktemp("cylinder")
    vt.simulate("cylinder", out=root / "sim", frames="60:142:80", size="320x240", near_lights=False)
    rig = root / "sim" / "truth" / "rig.json"
    vt.reconstruct(root / "sim" / "capture.mkv", rig=rig, out=root / "rec", to="normals", shadows="none")
    return root / "rec", root / "sim"


def test_the_fit_and_the_normals_are_right(folders, tmp_path, capsys):
    found = run_verb(f"evaluate cylinder {folders[0]} --truth {folders[1]} --out {tmp_path}".split())
    assert "the fit against the truth" in capsys.readouterr().out
    written = json.loads((tmp_path / "cylinder.json").read_text())
    assert written["mean_deg"] == pytest.approx(found.mean_deg)
    assert [frame["frame"] for frame in written["frames"]] == [0, 1]
    assert (tmp_path / "cylinder.png").read_bytes()[:4] == b"\x89PNG"
    for frame in found.frames:
        assert frame.truth is not None
        assert frame.truth.axis_deg < 0.3
        assert abs(frame.truth.radius_percent) < 1.0
        assert abs(frame.mean_deg - frame.truth.normals_mean_deg) < 1.0
    assert 0.5 < found.mean_deg < 3.5


def test_without_footage_the_mask_is_the_silhouette(folders, monkeypatch):
    hidden = folders[1] / "moved.mkv"
    (folders[1] / "capture.mkv").rename(hidden)
    try:
        found = evaluate_cylinder(read_result(folders[0], frames=":1"))
    finally:
        hidden.rename(folders[1] / "capture.mkv")
    assert found.frames[0].truth is None
    assert 0.5 < found.mean_deg < 8.0


def test_the_truth_of_another_scene_is_refused(folders: tuple[Path, Path], tmp_path: Path) -> None:
    truth = tmp_path / "truth"
    truth.mkdir()
    for name in ("poses.json", "scene.json"):
        text = (folders[1] / "truth" / name).read_text().replace('"cylinder"', '"sphere"')
        (truth / name).write_text(text)
    (truth / "normals").symlink_to(folders[1] / "truth" / "normals")
    with pytest.raises(BadInput, match="holds the scene sphere, not a cylinder"):
        evaluate_cylinder(read_result(folders[0]), tmp_path)
