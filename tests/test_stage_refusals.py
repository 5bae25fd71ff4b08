"""Stages refuse arrays and scenes that they cannot work on, by one line: what is wrong, and what to do."""

import sys

import numpy as np
import pytest

from vntoolkit import native
from vntoolkit.calibration.ball_outline import Circle
from vntoolkit.calibration.fit import fit_response
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
from vntoolkit.options.calibration import FitMethod, ResponseFitOptions
from vntoolkit.options.dressing import GarmentFitOptions
from vntoolkit.options.export import MeshUpAxis
from vntoolkit.options.simulation import Lighting, Nuisances, SceneOptions
from vntoolkit.photometry.response import LightResponse, rgb_from_normals
from vntoolkit.simulation.lights import WAVELENGTHS_NM, Lights
from vntoolkit.simulation.scene import build_scene
from vntoolkit.skinning.fitting import fit_garment_to_figure
from vntoolkit.tracking.template import template_from_maps

MATRIX = np.array([[0.35, -0.02, -0.5], [-0.17, 0.3, -0.48], [-0.15, -0.28, -0.52]])
PINHOLE = Camera.pinhole(width=64, height=48, focal_px=60.0)
ORTHOGRAPHIC = Camera.orthographic(width=64, height=48)
TRIANGLE = np.array([[0, 1, 2]], dtype=np.int32)


def flat_map(height: int = 48, width: int = 64) -> NormalMap:
    normals = np.tile(np.float32([0, 0, -1]), (height, width, 1))
    return NormalMap(normals_in_camera=normals, mask=np.ones((height, width), dtype=bool))


def test_colours_that_no_light_explains(rng):
    normals = rng.normal(size=(300, 3))
    normals[:, 2] = -np.abs(normals[:, 2]) - 1
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rgb = rgb_from_normals(normals, LightResponse(matrix=MATRIX))
    assert fit_response(normals, rgb).response.condition_number < 10
    options = ResponseFitOptions(method=FitMethod.TRIMMED, shadow_share=0.99)
    with pytest.raises(BadCalibration, match="calibration: "):
        fit_response(normals, np.abs(rng.normal(size=(300, 3))), options)


def test_balls_that_are_not_in_sight():
    circle = Circle(centre_px=np.array([900.0, 900.0]), radius_px=9.0, points_px=np.zeros((0, 2)), arc=1.0)
    with pytest.raises(BadCalibration, match="the ball lies outside the image"):
        sphere_normals(circle, ORTHOGRAPHIC)
    point = np.tile([31.5, 23.5], (9, 1)) + 1e-9
    circle = Circle(centre_px=np.array([31.5, 23.5]), radius_px=9.0, points_px=point, arc=1.0)
    with pytest.raises(BadCalibration, match=r"is not that of a ball seen by this camera"):
        sphere_normals(circle, PINHOLE)


def test_cylinders_that_are_none(rng):
    with pytest.raises(SolverFailed, match="frame 3 shows a plane, its normals span no axis"):
        axis_from_normals(np.tile([0, 0, -1.0], (99, 1)), 0.1, rng, "frame 3")
    every = rng.normal(size=(4000, 3))
    every /= np.linalg.norm(every, axis=1, keepdims=True)
    with pytest.raises(SolverFailed, match="less than a third of the normals agree on an axis; is a"):
        axis_from_normals(every, 0.1, rng, "frame 3")


def test_tracks_are_judged_by_the_camera_that_filmed():
    with pytest.raises(BadInput, match="the perspective camera that the truth was filmed with"):
        anchors_on_mesh(np.zeros((1, 2)), np.eye(3), TRIANGLE, ORTHOGRAPHIC)


def test_meshes_without_triangles_cannot_be_cleaned():
    with pytest.raises(BadMesh, match="mesh: no triangle to clean"):
        clean_mesh(Mesh(vertices=np.eye(3), faces=np.zeros((0, 3), np.int32)))


def test_templates_of_another_size_or_without_a_surface():
    depth = DepthMap(depth=np.ones((48, 64)), mask=np.ones((48, 64), dtype=bool))
    with pytest.raises(BadInput, match="template is 64×48 but the camera is 9×9"):
        template_from_maps(flat_map(), depth, Camera.orthographic(width=9, height=9))
    empty = DepthMap(depth=np.ones((48, 64)), mask=np.zeros((48, 64), dtype=bool))
    with pytest.raises(BadInput, match=r"no valid pixel with normal and depth; choose another frame"):
        template_from_maps(flat_map(), empty, ORTHOGRAPHIC)


def figure() -> Motion:
    skeleton = Skeleton(
        names=("hips", "chest"), parents=np.array([-1, 0]), offsets=np.array([[0, 0, 0], [0, 0.5, 0]])
    )
    turns = np.tile([0, 0, 0, 1.0], (1, 2, 1))
    return Motion(
        skeleton=skeleton,
        rotations=turns,
        root_positions=np.zeros((1, 3)),
        frame_rate_hz=30,
        metres_per_unit=1.0,
    )


def test_garments_that_do_not_fit_the_figure():
    flat = Mesh(vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1.0]]), faces=TRIANGLE)
    with pytest.raises(BadInput, match="fit: bind_frame 9 is not among the 1 frames"):
        fit_garment_to_figure(flat, figure(), GarmentFit(bind_frame=9), GarmentFitOptions())
    with pytest.raises(BadInput, match=r"the garment has no height \(its vertices share one y\)"):
        fit_garment_to_figure(flat, figure(), GarmentFit(), GarmentFitOptions())


def lamps(count: int, power: float = 1.0) -> Lights:
    return Lights(
        positions=np.tile([0, 0, -1.0], (count, 1)),
        spectra=np.full((count, len(WAVELENGTHS_NM)), power),
        ambient_spectrum=np.zeros(len(WAVELENGTHS_NM)),
    )


def test_lamps_and_nuisances_that_are_not_there():
    single = next(lighting for lighting in Lighting if lighting.value.endswith("3"))
    with pytest.raises(BadInput, match=f"lighting {single.value}: the scene has 1 lights"):
        lamps(1).under(single)
    with pytest.raises(BadInput, match="nuisance 'cheese': expected one of near_lights"):
        Nuisances().only("cheese")


def test_scenes_that_cannot_be_filmed():
    from dataclasses import replace

    from vntoolkit.simulation.image_formation import true_response

    scene = build_scene("sphere", SceneOptions(width=32, height=24))
    with pytest.raises(BadInput, match="scene sphere: expected a perspective camera, at the origin"):
        replace(scene, camera=ORTHOGRAPHIC)
    with pytest.raises(BadInput, match="scene sphere: expected at least one frame and a positive frame rate"):
        replace(scene, frame_count=0)
    surface = replace(scene.surface, reference_weights=np.zeros_like(scene.surface.reference_weights))
    with pytest.raises(BadInput, match="its reference material reflects none of the light"):
        true_response(replace(scene, surface=surface), Nuisances.none())
    texture = np.ones((2, 2, len(scene.surface.pigments)))
    with pytest.raises(BadInput, match=r"a texture or detail needs uv, \(m, 3, 2\) per face corner"):
        replace(scene.surface, texture=texture, uv=None)


def test_libraries_that_are_not_there_are_named_with_the_line_that_installs_them(monkeypatch):
    lacked = {"libGL.so.1": "libgl1", "libEGL.so.1": "libegl1"}
    monkeypatch.setattr(native, "missing_libraries", lambda libraries: lacked)
    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    with pytest.raises(
        MissingDependency,
        match=r"open3d needs libGL.so.1, libEGL.so.1, .*: sudo apt-get install libegl1 libgl1",
    ):
        native.import_open3d()
    monkeypatch.setattr(native, "missing_libraries", lambda libraries: {})
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(
        MissingDependency, match=r"cannot import open3d .*: pip install --force-reinstall open3d"
    ):
        native.import_open3d()


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

    monkeypatch.setattr(native, "missing_libraries", lambda libraries: {})
    monkeypatch.setattr(native.importlib, "import_module", refuse)
    with pytest.raises(MissingDependency, match=rf"pymeshlab needs {said.split(':')[0]}, .*: {line}"):
        native.import_pymeshlab()


def test_usd_files_that_hold_no_surface_of_ours(tmp_path):
    from pxr import Usd

    stage = Usd.Stage.CreateNew(str(tmp_path / "a.usdc"))  # a layer dies with its stage
    stage.GetRootLayer().Save()
    mesh = Mesh(vertices=np.eye(3), faces=TRIANGLE)
    with pytest.raises(BadInput, match="a skeleton is written with y up only"):
        write_usd_sequence(tmp_path / "b.usdc", mesh, [], frame_rate_hz=30, motion=figure(), up=MeshUpAxis.Z)
