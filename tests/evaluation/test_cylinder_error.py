import numpy as np
import pytest

from tests.evaluation.seen_cylinder import cylinder_normals
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.cylinder import (
    Cylinder,
    axis_error_deg,
    intersect,
    radius_from_distance,
    side_angles,
)
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.rays import pixel_rays

CAMERA = Camera.pinhole(width=200, height=160, focal_px=800)
AXIS = np.array([0.3, 0.9, -0.4]) / np.linalg.norm([0.3, 0.9, -0.4])
CENTRE = 10.0 * np.array([0.02, 0.01, 1.0])
CYLINDER = Cylinder(axis=AXIS, centre=CENTRE - (CENTRE @ AXIS) * AXIS)
POINT = 0.1 * CENTRE  # on the true axis of a cylinder of radius 0.1


def with_cap(half_length: float) -> NormalMap:
    """The side to one end; beyond it the cap, whose normal is the axis' direction towards the camera."""
    exact = cylinder_normals(CYLINDER, CAMERA)
    along = intersect(CYLINDER, *pixel_rays(CAMERA, CAMERA.pixel_grid())).along
    middle = (CENTRE - CYLINDER.centre) @ AXIS
    cap = -np.sign(AXIS[2]) * AXIS
    normals = np.where((along > middle + half_length)[..., None], cap, exact.normals_in_camera)
    return NormalMap(normals_in_camera=normals, mask=exact.mask & (along > middle - half_length))


def test_the_end_is_left_out_and_the_side_is_exact() -> None:
    seen = with_cap(0.5)
    angles_deg, seen_side = side_angles(CYLINDER, seen, CAMERA)
    assert angles_deg[seen_side].max() < 0.1
    side = seen.mask & (np.abs(seen.normals_in_camera @ AXIS) < 0.5)
    assert np.mean(seen_side[side]) > 0.999


def test_wrong_normals_on_the_side_still_count(rng: np.random.Generator) -> None:
    seen = with_cap(0.5)
    normals = np.array(seen.normals_in_camera)
    wrong = seen.mask & (rng.random(seen.mask.shape) < 0.1)
    normals[wrong] = AXIS
    measured = NormalMap(normals_in_camera=normals, mask=seen.mask)
    angles_deg, seen_side = side_angles(CYLINDER, measured, CAMERA)
    share = np.mean(angles_deg[seen_side] > 80)
    assert 0.08 < share < 0.12


def test_the_axis_has_no_direction_and_the_distance_fixes_the_radius() -> None:
    tilted = AXIS + 0.01 * np.cross(AXIS, [1, 0, 0]) / np.linalg.norm(np.cross(AXIS, [1, 0, 0]))
    assert axis_error_deg(CYLINDER, -tilted) == pytest.approx(np.rad2deg(np.arctan(0.01)), rel=1e-3)
    assert radius_from_distance(CYLINDER, CAMERA, POINT) == pytest.approx(0.1, rel=1e-9)


def test_too_few_pixels_are_refused() -> None:
    seen = with_cap(0.5)
    few = np.zeros_like(seen.mask)
    few[80, 95:105] = True
    with pytest.raises(BadInput, match=r"frame 3 shows 10 valid pixels of the side, at least 200"):
        side_angles(
            CYLINDER,
            NormalMap(normals_in_camera=seen.normals_in_camera, mask=seen.mask & few),
            CAMERA,
            "frame 3",
        )
