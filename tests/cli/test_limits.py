"""`--max-megapixels` and `--max-vertices` reach every reader of a verb, and are named by what they refuse."""

import inspect
import pickle

import numpy as np
import pytest
from cyclopts import App

from tests.result_files import write_mesh_sequence
from vntoolkit.__main__ import main
from vntoolkit.cli import VERBS, build_app
from vntoolkit.errors import BadCapture, BadInput, BadMesh
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.io.files import limited_to, reading_limits
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.images import read_image, read_opaque_image
from vntoolkit.io.maps_and_meshes.meshes import read_mesh, write_mesh
from vntoolkit.io.results.manifest import ReconstructionFolder
from vntoolkit.io.rigs import read_rig, write_rig
from vntoolkit.options.footage import ReadingLimits
from vntoolkit.options.reconstruction import ReconstructOptions
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.request import Request

PIXELS, VERTICES = "--max-megapixels", "--max-vertices"
TRIANGLE = Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]], dtype=np.int32))


def _line(command, capsys):
    assert main(list(map(str, command))) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.json"
    matrix = np.array([[0.35, -0.02, -0.5], [-0.17, 0.3, -0.48], [-0.15, -0.28, -0.52]])
    write_rig(
        path, Rig(camera=Camera.orthographic(width=40, height=30), response=LightResponse(matrix=matrix))
    )
    return path


@pytest.fixture
def footage(tmp_path):
    folder = tmp_path / "footage"
    for number in range(2):
        write_png(folder / f"{number}.png", np.full((30, 40, 3), 90, dtype=np.uint8))
    return folder


def test_a_frame_above_the_limit_is_refused_by_the_flag_that_raises_it(tmp_path, footage, rig, capsys):
    command = ["reconstruct", footage, "--rig", rig, "--out", tmp_path / "out", "--to", "normals"]
    error = _line([*command, PIXELS, "0.001"], capsys)
    assert "0.png: 40×30 is 0.001 megapixels, more than the limit of 0.001; raise --max-megapixels" in error
    assert main([*map(str, command), PIXELS, "0.0012"]) == 0


def test_worker_processes_keep_to_it_too(tmp_path, footage, rig):
    """They are sent the job, and know nothing of this process's limits."""
    with limited_to(ReadingLimits(max_megapixels=0.001)):
        job = Request(
            source=str(footage),
            rig=read_rig(rig),
            options=ReconstructOptions(),
            folder=ReconstructionFolder(root=tmp_path),
        )
    with pytest.raises(BadCapture, match=r"the limit of 0\.001"):
        pickle.loads(pickle.dumps(job)).open_footage()


def test_the_other_readers_of_images_keep_to_it(tmp_path, footage, rig, capsys):
    write_png(tmp_path / "mask.png", np.full((300, 400), 255, dtype=np.uint8))
    small = [PIXELS, "0.01"]
    reconstruct = ["reconstruct", footage, "--rig", rig, "--out", tmp_path / "out"]
    for command in (
        ["doctor", tmp_path / "mask.png"],
        ["doctor", footage, "--rig", rig, "--mask", tmp_path / "mask.png"],
        [*reconstruct, "--mask", tmp_path / "mask.png"],
        [*reconstruct, "--background", tmp_path / "mask.png"],
        ["calibrate", "sphere", tmp_path / "mask.png", "--out", tmp_path / "rig2.json"],
        ["evaluate", "normals", tmp_path / "mask.png", tmp_path / "mask.png"],
    ):  # fmt: skip
        assert "mask.png: 400×300 is 0.120 megapixels" in _line([*command, *small], capsys)


def test_a_mesh_above_the_limit_is_refused_by_the_flag_that_raises_it(tmp_path, capsys):
    for name in ("a.ply", "a.obj"):
        write_mesh(tmp_path / name, TRIANGLE)
        error = _line(["evaluate", "mesh", tmp_path / name, tmp_path / name, VERTICES, "2"], capsys)
        assert f"{name}: 3 vertices are more than the limit of 2; raise --max-vertices" in error
    cloth = MeshSequence(template=TRIANGLE, vertices=np.eye(3, dtype=np.float32)[None])
    write_mesh_sequence(tmp_path / "cloth", cloth)
    dress = ["dress", tmp_path / "cloth", "--motion", "walk.bvh", "--out", tmp_path / "a.usdc"]
    assert "3 vertices are more than the limit of 2" in _line([*dress, VERTICES, "2"], capsys)


def test_a_file_too_long_for_its_vertices_is_refused_unread(tmp_path):
    with (tmp_path / "a.obj").open("wb") as file:
        file.truncate(1_100_000)
    with limited_to(ReadingLimits(max_vertices=9)), pytest.raises(BadMesh, match="at most of a mesh of 9"):
        read_mesh(tmp_path / "a.obj")
    write_mesh(tmp_path / "a.ply", TRIANGLE)
    with limited_to(ReadingLimits(max_vertices=2)), pytest.raises(BadMesh, match="3 vertices are more"):
        read_mesh(tmp_path / "a.ply")


def test_limits_end_with_their_block_and_a_call_may_set_its_own(tmp_path):
    write_png(tmp_path / "a.png", np.zeros((30, 40, 3), dtype=np.uint8))
    with limited_to(ReadingLimits(max_megapixels=0.001)):
        assert read_opaque_image(tmp_path / "a.png", max_megapixels=1).rgb.shape == (30, 40, 3)
        with pytest.raises(BadCapture):
            read_image(tmp_path / "a.png")
    assert reading_limits() == ReadingLimits()
    assert read_image(tmp_path / "a.png").shape == (30, 40, 3)


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_limits_that_limit_nothing_are_refused(value):
    with pytest.raises(BadInput, match="max megapixels: expected a number above 0"):
        ReadingLimits(max_megapixels=float(value))
    with pytest.raises(BadInput, match="max vertices: expected a whole number above 0"):
        ReadingLimits(max_vertices=0)


def test_every_verb_that_reads_images_or_meshes_has_the_flag():
    """A verb without one reads none: it writes, or reads JSON."""
    without = {"demo", "board", "simulate", "schema", "data", "recipe list", "recipe run"}
    names = set(VERBS)
    assert without <= names
    for name in sorted(names):
        limited = {"max_megapixels", "max_vertices"} & set(_parameters(build_app(), name))
        assert bool(limited) == (name not in without), name


def _parameters(app: App, name: str):
    for word in name.split():
        app = app[word]
    return inspect.signature(app.default_command).parameters
