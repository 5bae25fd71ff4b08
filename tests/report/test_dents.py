"""The picture of a touch tells its depth by colours, and their scale in millimetres at its foot."""

import numpy as np
import pytest

from vntoolkit.geometry.maps import DepthMap
from vntoolkit.report.dents import picture_of_dents, scale_end_mm


@pytest.mark.parametrize(
    ("deepest", "end"), [(0, 0.1), (0.1, 0.1), (0.11, 0.2), (0.3, 0.5), (1.9, 2), (7, 10)]
)
def test_a_scale_ends_at_the_next_of_1_2_5(deepest: float, end: float) -> None:
    assert scale_end_mm(deepest) == pytest.approx(end)


def test_deeper_is_brighter_up_to_the_end_of_the_scale_and_what_is_unknown_is_ground() -> None:
    depth = np.zeros((240, 320), np.float32)
    depth[:10] = np.linspace(0, -0.002, 320)
    depth[20, 20] = 0.001  # above rest
    mask = np.ones(depth.shape, bool)
    mask[50, 50] = False
    picture = picture_of_dents(DepthMap(depth=depth, mask=mask), 1.0, ground=77)
    brightness = picture[5].astype(float) @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(brightness[:160]) > -1).all()
    assert brightness[159] > 4 * brightness[0]
    assert (picture[5, 160:] == picture[5, 319]).all()  # beyond the end
    assert (picture[20, 20] == picture[100, 100]).all()  # as at rest
    assert (picture[50, 50] == 77).all()
    foot = picture[-18:, :150]
    assert (foot == picture[5, 319]).all(axis=-1).any()  # the scale's end
    assert (picture[-18:, 200:] == picture[100, 100]).all()


def test_a_picture_smaller_than_its_scale_shows_what_fits() -> None:
    small = DepthMap(depth=np.zeros((6, 9), np.float32), mask=np.ones((6, 9), bool))
    assert picture_of_dents(small, 0.5).shape == (6, 9, 3)
