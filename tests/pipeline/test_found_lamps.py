"""A rig of M alone learns its lamps' colours from the shadows on the subject."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vntoolkit as vt
from vntoolkit.io.results.manifest import read_manifest, rig_of_result
from vntoolkit.io.rigs import read_rig, write_rig
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.pipeline.opened_result import read_result
from vntoolkit.pipeline.truth_comparison import true_normals


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five frames of a face, 480x360, and beside it the true rig with and without the lamps' colours."""
    root = tmp_path_factory.mktemp("film")
    vt.simulate("face", out=root / "film", size="480x360", frames="0:250:50", seed=164)
    rig = read_rig(root / "film/truth/rig.json")
    write_rig(root / "known.json", rig)
    write_rig(root / "alone.json", replace(rig, response=replace(rig.response, light_colours=None)))
    return root


def mean_error_deg(film: Path, result: Path) -> float:
    found, truth = read_result(result).normals(0), true_normals(film / "film", 0)
    both = found.mask & truth.mask
    return float(angles_deg(found.normals_in_camera[both], truth.normals_in_camera[both]).mean())


@pytest.mark.slow
def test_face_with_m_alone_is_as_good_as_with_the_lamps_colours(film: Path) -> None:
    errors = {}
    for name, rig, materials in (
        ("known", "known", "auto"), ("found", "alone", "auto"), ("alone", "alone", "calibrated"),
    ):  # fmt: skip
        vt.reconstruct(
            film / "film/capture.mkv", rig=film / f"{rig}.json", out=film / name, to="normals",
            materials=materials,
        )  # fmt: skip
        errors[name] = mean_error_deg(film, film / name)
    assert errors["found"] < errors["known"] + 0.5
    assert errors["found"] < errors["alone"] - 1.0
    colours = rig_of_result(read_manifest(film / "found")).response.light_colours
    known = rig_of_result(read_manifest(film / "known")).response.light_colours
    assert colours is not None
    assert known is not None
    turned = angles_deg(colours / np.linalg.norm(colours, axis=1, keepdims=True),
                                known / np.linalg.norm(known, axis=1, keepdims=True))  # fmt: skip
    assert turned.max() < 6.0
    doubts_deg = rig_of_result(read_manifest(film / "found")).response.light_doubts_deg
    assert doubts_deg is not None
    assert 1.0 < doubts_deg.max() <= 4.0
    frame, truth = read_result(film / "found").normals(0), true_normals(film / "film", 0)
    both = frame.mask & truth.mask
    off = angles_deg(frame.normals_in_camera[both], truth.normals_in_camera[both])
    assert frame.error_deg is not None
    assert 0.86 < (off <= frame.error_deg[both]).mean() < 0.95
    assert rig_of_result(read_manifest(film / "alone")).response.light_colours is None


@pytest.mark.slow
def test_run_that_goes_on_keeps_the_colours_it_found(film: Path) -> None:
    run = {"rig": film / "alone.json", "to": "normals", "out": film / "again"}
    vt.reconstruct(film / "film/capture.mkv", **run)
    before = read_manifest(film / "again").known
    (film / "again/normals/000003.exr").unlink()
    vt.reconstruct(film / "film/capture.mkv", **run)
    after = read_manifest(film / "again").known
    assert before.light_colours is not None
    assert before.light_doubts_deg is not None
    assert after == before
    assert (film / "again/normals/000003.exr").exists()


@pytest.mark.slow
def test_sweater_of_few_shadows_is_told_by_several_frames(tmp_path: Path) -> None:
    vt.simulate("sweater", out=tmp_path / "film", frames="0:250:50", seed=169)
    rig = read_rig(tmp_path / "film/truth/rig.json")
    write_rig(tmp_path / "alone.json", replace(rig, response=replace(rig.response, light_colours=None)))
    vt.reconstruct(
        tmp_path / "film/capture.mkv", rig=tmp_path / "alone.json", out=tmp_path / "found", to="normals"
    )
    found = rig_of_result(read_manifest(tmp_path / "found")).response
    assert found.light_colours is not None
    off = angles_deg(found.light_directions, rig.response.light_directions)
    assert found.light_doubts_deg is not None
    assert np.all(off < found.light_doubts_deg)


@pytest.mark.slow
def test_dark_print_is_not_taken_for_shadow(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    vt.simulate("sweater_logo", out=tmp_path / "film", frames="0:50:50", seed=169)
    rig = read_rig(tmp_path / "film/truth/rig.json")
    write_rig(tmp_path / "alone.json", replace(rig, response=replace(rig.response, light_colours=None)))
    vt.reconstruct(
        tmp_path / "film/capture.mkv", rig=tmp_path / "alone.json", out=tmp_path / "found", to="normals"
    )
    assert rig_of_result(read_manifest(tmp_path / "found")).response.light_colours is None
    assert "are off by more than 25 %" in caplog.text
    assert "shadows on it do not tell where the lamps stand (lamp 0 to" in caplog.text


@pytest.mark.slow
def test_rig_of_another_colour_is_said(film: Path, caplog: pytest.LogCaptureFixture) -> None:
    response = read_rig(film / "known.json").response
    assert response.light_colours is not None
    matrix = response.light_colours.T @ np.diag([0.9, 0.3, 0.25]) @ response.lights
    rig = replace(
        read_rig(film / "known.json"), response=replace(response, matrix=matrix, light_colours=None)
    )
    write_rig(film / "red.json", rig)
    vt.reconstruct(
        film / "film/capture.mkv",
        rig=film / "red.json",
        out=film / "wrong",
        to="normals",
        materials="calibrated",
    )
    assert "degrees away from the camera on average (expected below 45)" in caplog.text
