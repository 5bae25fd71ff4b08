"""Four corners make a plane's map: they land where they should, lines stay lines."""

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.geometry.rectification import Rectification

CORNERS = (33.0, 58.0, 208.0, 61.0, 56.0, 250.0, 185.0, 244.0)


def apply(matrix, points):
    moved = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return moved[:, :2] / moved[:, 2:]


def test_corners_land_on_the_rectangle() -> None:
    rectification = Rectification(corners_px=CORNERS, width_mm=24.0, height_mm=34.88, pixel_mm=0.1)
    moved = apply(rectification.homography, np.reshape(CORNERS, (4, 2)))
    np.testing.assert_allclose(moved, [[0, 0], [240, 0], [0, 348.8], [240, 348.8]], atol=1e-8)
    assert rectification.size == (240, 349)
    assert rectification.camera.matrix[0, 0] == pytest.approx(10_000)  # pixels per metre


def test_numbers_and_orders_that_make_no_plane_are_refused() -> None:
    plane = {"corners_px": CORNERS, "width_mm": 24.0, "height_mm": 35.0, "pixel_mm": 0.1}
    for name in ("width_mm", "height_mm", "pixel_mm"):
        for value in (np.inf, np.nan, -1.0):
            with pytest.raises(BadInput, match=r"positive sizes in millimetres, got .*(inf|nan|-1)"):
                Rectification(**{**plane, name: value})
    top_left, top_right, bottom_left, bottom_right = np.reshape(CORNERS, (4, 2))
    clockwise = np.concatenate([top_left, top_right, bottom_right, bottom_left])
    dented = np.concatenate([top_left, top_right, bottom_left, (100.0, 100.0)])
    for corners in (clockwise, dented):
        with pytest.raises(BadInput, match="no convex outline; give them in the order top left, top right"):
            Rectification(**{**plane, "corners_px": tuple(corners.tolist())})
    turned = np.concatenate([bottom_right, bottom_left, top_right, top_left])
    Rectification(**{**plane, "corners_px": tuple(turned.tolist())})  # upside down is a way to film


def test_corners_and_size_tell_the_side_of_a_pixel() -> None:
    square = (10.0, 20.0, 110.0, 20.0, 10.0, 70.0, 110.0, 70.0)
    plane = Rectification.as_filmed(square, 20.0, 10.0)
    assert plane.pixel_mm == pytest.approx(0.2)
    assert plane.size == (100, 50)
    # as many pixels as were filmed, where x and y are filmed at other scales
    stretched = Rectification.as_filmed(square, 20.0, 20.0)
    assert np.prod(stretched.size) == pytest.approx(100 * 50, rel=0.02)
    assert stretched.size[0] == stretched.size[1]
    with pytest.raises(BadInput, match="eight numbers"):
        Rectification.as_filmed(square[:6], 20.0, 10.0)
