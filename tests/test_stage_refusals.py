"""Stages refuse arrays and scenes that they cannot work on, by one line: what is wrong, and what to do."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from vntoolkit import libraries
from vntoolkit.calibration.ball_outline import Circle
from vntoolkit.calibration.fit import fit_by_trimming, fit_response
from vntoolkit.calibration.sphere import sphere_normals
from vntoolkit.errors import (
    BadCalibration,
    BadInput,
    BadMesh,
    MissingDependency,
    SolverFailed,
)
from vntoolkit.evaluation.cylinder_fit import axis_from_normals
from vntoolkit.evaluation.track_error import anchors_on_mesh
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.garment_fit import GarmentFit
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.motion import Motion, Skeleton
from vntoolkit.io.maps_and_meshes.usd import write_usd_sequence
from vntoolkit.meshing.clean import clean_mesh
from vntoolkit.options.dressing import GarmentFitOptions
from vntoolkit.options.export import MeshUpAxis
from vntoolkit.options.simulation import Lighting, Nuisances, SceneOptions
from vntoolkit.photometry.response import LightResponse, rgb_from_normals
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.lights import WAVELENGTHS_NM, Lights
from vntoolkit.simulation.scene import Scene, build_scene
from vntoolkit.skinning.fitting import fit_garment_to_figure
from vntoolkit.tracking.template import template_from_maps

MATRIX = np.array([[0.35, -0.02, -0.5], [-0.17, 0.3, -0.48], [-0.15, -0.28, -0.52]])
PINHOLE = Camera.pinhole(width=64, height=48, focal_px=60.0)
ORTHOGRAPHIC = Camera.orthographic(width=64, height=48)
TRIANGLE = np.array([[0, 1, 2]], dtype=np.int32)


def flat_map(height: int = 48, width: int = 64) -> NormalMap:
    normals = np.tile(np.float32([0, 0, -1]), (height, width, 1))
    return NormalMap(normals_in_camera=normals, mask=np.ones((height, width), dtype=bool))


def test_colours_that_no_light_explains(rng, monkeypatch):
    normals = rng.normal(size=(300, 3))
    normals[:, 2] = -np.abs(normals[:, 2]) - 1
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rgb = rgb_from_normals(normals, LightResponse(matrix=MATRIX))
    assert fit_response(normals, rgb).response.condition_number < 10
    monkeypatch.setattr(fit_by_trimming, "__defaults__", (0.99,))
    with pytest.raises(BadCalibration, match="calibration: "):
        fit_response(normals, np.abs(rng.normal(size=(300, 3))))


def outline(centre_px: float, points_px: np.ndarray) -> Circle:
    return Circle(centre_px=np.full(2, centre_px), radius_px=9.0, points_px=points_px, arc=1.0)


def axis_from_sphere() -> None:
    every = np.random.default_rng(0).normal(size=(4000, 3))
    every /= np.linalg.norm(every, axis=1, keepdims=True)
    axis_from_normals(every, 0.1, np.random.default_rng(1), "frame 3")


def template(valid: bool, camera: Camera) -> None:
    depth = DepthMap(depth=np.ones((48, 64)), mask=np.full((48, 64), valid))
    template_from_maps(flat_map(), depth, camera)


def figure() -> Motion:
    skeleton = Skeleton(
        names=("hips", "chest"), parents=np.array([-1, 0]), offsets=np.array([[0, 0, 0], [0, 0.5, 0]])
    )
    return Motion(
        skeleton=skeleton,
        rotations=np.tile([0, 0, 0, 1.0], (1, 2, 1)),
        root_positions=np.zeros((1, 3)),
        frame_rate_hz=30,
        metres_per_unit=1.0,
    )


def fitted(fit: GarmentFit) -> None:
    flat = Mesh(vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1.0]]), faces=TRIANGLE)
    fit_garment_to_figure(flat, figure(), fit, GarmentFitOptions())


def one_lamp() -> Lights:
    spectra = np.ones((1, len(WAVELENGTHS_NM)))
    return Lights(positions=np.array([[0, 0, -1.0]]), spectra=spectra, ambient_spectrum=0 * spectra[0])


def scene(**changed: object) -> Scene:
    return replace(build_scene("sphere", SceneOptions(width=32, height=24)), **changed)


def response_in_black() -> None:
    black = np.zeros_like(scene().surface.reference_weights)
    true_response(scene(surface=replace(scene().surface, reference_weights=black)), Nuisances.none())


def textured_without_places() -> None:
    texture = np.ones((2, 2, 3))
    replace(scene().surface, texture=texture, uv=None)


def usd_of_a_figure_with_z_up() -> None:
    mesh = Mesh(vertices=np.eye(3), faces=TRIANGLE)
    write_usd_sequence("b.usdc", mesh, [], frame_rate_hz=30, motion=figure(), up=MeshUpAxis.Z)


SMALL = Camera.orthographic(width=9, height=9)
FACING = np.tile([0, 0, -1.0], (99, 1))
RNG = np.random.default_rng(0)
SINGLE = next(lighting for lighting in Lighting if lighting.value.endswith("3"))
REFUSALS = [
    (lambda: sphere_normals(outline(900.0, np.zeros((0, 2))), ORTHOGRAPHIC), BadCalibration,
     "the ball lies outside the image"),
    (lambda: sphere_normals(outline(23.5, np.tile([31.5, 23.5], (9, 1)) + 1e-9), PINHOLE), BadCalibration,
     "is not that of a ball seen by this camera"),
    (lambda: axis_from_normals(FACING, 0.1, RNG, "frame 3"), SolverFailed,
     "frame 3 shows a plane, its normals span no axis"),
    (axis_from_sphere, SolverFailed, "less than a third of the normals agree on an axis; is a"),
    (lambda: anchors_on_mesh(np.zeros((1, 2)), np.eye(3), TRIANGLE, ORTHOGRAPHIC), BadInput,
     "the perspective camera that the truth was filmed with"),
    (lambda: clean_mesh(Mesh(vertices=np.eye(3), faces=TRIANGLE[:0])), BadMesh, "mesh: no triangle to clean"),
    (lambda: template(True, SMALL), BadInput, "template is 64×48 but the camera is 9×9"),
    (lambda: template(False, ORTHOGRAPHIC), BadInput,
     "no valid pixel with normal and depth; choose another frame"),
    (lambda: fitted(GarmentFit(bind_frame=9)), BadInput, "fit: bind_frame 9 is not among the 1 frames"),
    (lambda: fitted(GarmentFit()), BadInput, r"the garment has no height \(its vertices share one y\)"),
    (lambda: one_lamp().under(SINGLE), BadInput, f"lighting {SINGLE.value}: the scene has 1 lights"),
    (lambda: Nuisances().only("cheese"), BadInput, "nuisance 'cheese': expected one of near_lights"),
    (lambda: Nuisances().without("dust"), BadInput, "nuisance 'dust': expected one of"),
    (lambda: build_scene("board", SceneOptions(sample="cheese")), BadInput,
     "no scene 'cheese' to take a sample from"),
    (lambda: scene(camera=ORTHOGRAPHIC), BadInput,
     "scene sphere: expected a perspective camera, at the origin"),
    (lambda: scene(frame_count=0), BadInput,
     "scene sphere: expected at least one frame"),
    (response_in_black, BadInput, "its reference material reflects none of the light"),
    (textured_without_places, BadInput, r"a texture or detail needs uv, \(m, 3, 2\) per face corner"),
    (usd_of_a_figure_with_z_up, BadInput, "a skeleton is written with y up only"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "error", "line"), REFUSALS, ids=[line for _, _, line in REFUSALS])
def test_a_stage_refuses_by_a_line_what_it_cannot_work_on(tmp_path, monkeypatch, call, error, line):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=line):
        call()
    assert not list(tmp_path.iterdir())


def test_libraries_that_are_not_there_are_named_with_the_line_that_installs_them(monkeypatch):
    lacked = {"libGL.so.1": "libgl1", "libEGL.so.1": "libegl1"}
    monkeypatch.setattr(libraries, "missing_libraries", lambda libraries: lacked)
    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    with pytest.raises(
        MissingDependency,
        match=r"open3d needs libGL.so.1, libEGL.so.1, .*: sudo apt-get install libegl1 libgl1",
    ):
        libraries.import_open3d()
    monkeypatch.setattr(libraries, "missing_libraries", lambda libraries: {})
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(
        MissingDependency, match=r"cannot import open3d .*: pip install --force-reinstall open3d"
    ):
        libraries.import_open3d()


@pytest.mark.parametrize(
    ("said", "line"),
    [
        ("libidn2.so.0: cannot open shared object file: No such file", "sudo apt-get install libidn2-0"),
        (
            "libnew-1.2.so.3: cannot open shared object file",
            r"install the package that holds libnew-1.2.so.3",
        ),
    ],
)
def test_a_library_that_only_the_loader_names_is_named(monkeypatch, said, line):
    """A library that another one needs in turn is not on our list of what is looked for first."""

    def refuse(module):
        raise ImportError(said)

    monkeypatch.setattr(libraries, "missing_libraries", lambda libraries: {})
    monkeypatch.setattr(libraries.importlib, "import_module", refuse)
    with pytest.raises(MissingDependency, match=rf"pymeshlab needs {said.split(':')[0]}, .*: {line}"):
        libraries.import_pymeshlab()
