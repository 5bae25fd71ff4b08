"""The verbs as functions take and refuse what the command line does, and return what was written."""

import inspect

import numpy as np
import pytest

import vntoolkit as vt
from vntoolkit.__main__ import main
from vntoolkit.errors import BadInput
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.rigs import write_rig

MATRIX = [[0.35, -0.02, -0.5], [-0.17, 0.3, -0.48], [-0.15, -0.28, -0.52]]


@pytest.fixture
def studio(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    camera = vt.Camera.orthographic(width=40, height=30)
    write_rig(tmp_path / "rig.json", vt.Rig(camera=camera, response=vt.LightResponse(matrix=MATRIX)))
    write_png(tmp_path / "-frame.png", np.full((30, 40, 3), 90, dtype=np.uint8))
    (tmp_path / "lamps.txt").write_text("0.5 0.0 0.87\n-0.25 0.43 0.87\n-0.25 -0.43 0.87\n")
    return tmp_path


def test_reconstruct_returns_the_opened_result(studio, capsys) -> None:
    allowed = ("flat", "noise", "matrix", "outline")
    options = {
        "shadows": "none",
        "to": "normals",
        "materials": "calibrated",
        "allow": allowed,
        "frames": None,
    }
    result = vt.reconstruct("-frame.png", rig=studio / "rig.json", out="out", **options)
    assert result.numbers == (0,)
    assert result.normals(0).mask.all()
    assert result.manifest.options["materials"] == "calibrated"
    assert capsys.readouterr().out == ""  # only the command line prints


def test_calibrate_returns_the_rig(studio) -> None:
    rig = vt.calibrate_lights("lamps.txt", out="lamps.json", like="-frame.png", lights=(0, 1, 2))
    assert rig.camera.width == 40
    assert np.array_equal(rig.response.matrix, vt.read_rig("lamps.json").response.matrix)


def test_what_the_command_line_refuses_is_an_error_of_one_line(studio) -> None:
    with pytest.raises(BadInput, match=r"reconstruct: unknown option shadow; did you mean shadows\?"):
        vt.reconstruct("-frame.png", rig="rig.json", out="out", shadow="none")
    with pytest.raises(BadInput, match="lights: expected 3 values, got 2"):
        vt.calibrate_lights("lamps.txt", out="lamps.json", lights=(0, 1))
    with pytest.raises(BadInput, match=r"other\.json"):
        vt.reconstruct("-frame.png", rig="other.json", out="out")


def test_values_of_another_kind_are_refused_before_anything_is_read() -> None:
    for wrong, line in (
        ({"distance": "far"}, "distance: expected a number, got 'far'"),
        ({"distance": (1.0, 2.0)}, r"distance: expected a number, got \(1.0, 2.0\)"),
        ({"jobs": 1.5}, "jobs: expected a whole number, got 1.5"),
        ({"overwrite": "yes"}, "overwrite: expected True or False, got 'yes'"),
        ({"shadows": "nun"}, "shadows: expected one of none, published, robust, got 'nun'"),
        ({"allow": "tag"}, "allow: expected several values, got 'tag'"),
        ({"relative_albedo": 2.0}, "unknown option relative_albedo"),
    ):
        with pytest.raises(BadInput, match=line):
            vt.reconstruct("frame.png", rig="nowhere.json", out="out", **wrong)


def test_a_removed_flag_says_what_to_do_instead(studio, capsys) -> None:
    assert main(["track", "out", "--refine-albedo"]) == 1
    assert "--refine-albedo: was removed" in capsys.readouterr().err
    with pytest.raises(BadInput, match="--field-width: is --field-width-m now"):
        vt.simulate("sphere", out="film", field_width=1.0)


def test_the_signature_shows_every_option() -> None:
    parameters = inspect.signature(vt.reconstruct).parameters
    assert next(iter(parameters)) == "source"
    assert {"rig", "out", "shadows", "integrator", "jobs", "corners"} <= set(parameters)
    assert parameters["shadows"].default is vt.ShadowMethod.ROBUST
    assert not {"relative_albedo", "inversion", "options"} & set(parameters)


def test_a_shipped_file_is_copied_and_none_is_written_over(studio, capsys) -> None:
    assert main(["data"]) == 0
    assert "walk.bvh" in capsys.readouterr().out.split()
    assert main(["data", "walk.bvh"]) == 0
    assert (studio / "walk.bvh").read_text().startswith("HIERARCHY")
    assert main(["data", "walk.bvh"]) == 0  # the same file
    (studio / "walk.bvh").write_text("mine")
    assert main(["data", "walk.bvh"]) == 1
    assert (studio / "walk.bvh").read_text() == "mine"
    assert main(["data", "run.bvh"]) == 1
    assert "expected one of walk.bvh, got 'run.bvh'" in capsys.readouterr().err
