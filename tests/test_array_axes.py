"""Arrays of the right shape and the wrong meaning are refused, with the remedy."""

import numpy as np
import pytest

import vntoolkit as vt

FACING = np.tile(np.float32([0.6, 0.0, -0.8]), (24, 32, 1))
MASK = np.ones((24, 32), bool)
LAMPS = np.array([[0.4, 0.0, -0.9], [-0.2, 0.35, -0.9], [-0.2, -0.35, -0.9]])


def test_normals_as_files_hold_them_are_refused_with_the_remedy() -> None:
    with pytest.raises(vt.BadInput, match=r"n_z > 0 in 100% of the pixels: multiply by \[1, -1, -1\]"):
        vt.NormalMap(normals_in_camera=FACING * [1, -1, -1], mask=MASK)
    with pytest.raises(vt.BadInput, match="expected unit length, got 2"):
        vt.NormalMap(normals_in_camera=2 * FACING, mask=MASK)
    assert vt.NormalMap(normals_in_camera=FACING * [1, -1, -1], mask=~MASK).mask.sum() == 0
    assert vt.evaluate_normals(FACING, vt.NormalMap(normals_in_camera=FACING, mask=MASK)).mean_deg == 0.0


def test_lights_as_files_hold_them_are_refused_with_the_remedy() -> None:
    images = np.clip(FACING @ LAMPS.T, 0, None).transpose(2, 0, 1)
    assert vt.normals_from_lights(0.8 * images, LAMPS).mask.all()
    with pytest.raises(vt.BadInput, match=r"lights: .* multiply by \[1, -1, -1\]"):
        vt.normals_from_lights(images, LAMPS * [1, -1, -1])


def test_a_pinhole_camera_takes_one_focal_length_or_two() -> None:
    matrix = vt.Camera.pinhole(width=640, height=480, focal_px=(900, 905)).matrix
    assert (matrix[0, 0], matrix[1, 1]) == (900, 905)
    with pytest.raises(vt.BadInput, match="one focal length, or f_x and f_y, got 3"):
        vt.Camera.pinhole(width=640, height=480, focal_px=(1, 2, 3))  # type: ignore[arg-type]
