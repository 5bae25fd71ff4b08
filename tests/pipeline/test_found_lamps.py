"""A rig of M alone learns its lamps' colours from the shadows on the subject."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vntoolkit as vt
from vntoolkit.evaluation.angular_error import angles_between_deg
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.io.rigs import read_rig, rig_from_entry, write_rig
from vntoolkit.pipeline.opened_result import open_result
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
    found, truth = open_result(result).normals(0), true_normals(film / "film", 0)
    both = found.mask & truth.mask
    return float(angles_between_deg(found.normals_in_camera[both], truth.normals_in_camera[both]).mean())


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
    colours = rig_from_entry(read_manifest(film / "found").rig).response.light_colours
    known = rig_from_entry(read_manifest(film / "known").rig).response.light_colours
    assert colours is not None
    assert known is not None
    turned = angles_between_deg(colours / np.linalg.norm(colours, axis=1, keepdims=True),
                                known / np.linalg.norm(known, axis=1, keepdims=True))  # fmt: skip
    assert turned.max() < 6.0
    assert rig_from_entry(read_manifest(film / "alone").rig).response.light_colours is None


@pytest.mark.slow
def test_run_that_goes_on_keeps_the_colours_it_found(film: Path) -> None:
    run = {"rig": film / "alone.json", "to": "normals", "out": film / "again"}
    vt.reconstruct(film / "film/capture.mkv", **run)
    before = read_manifest(film / "again").rig.response
    (film / "again/normals/000003.exr").unlink()
    vt.reconstruct(film / "film/capture.mkv", **run)
    after = read_manifest(film / "again").rig.response
    assert before is not None
    assert after is not None
    assert before.light_colours is not None
    assert before.light_colours == after.light_colours
    assert (film / "again/normals/000003.exr").exists()
