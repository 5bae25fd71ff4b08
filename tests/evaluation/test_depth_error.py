import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.evaluation.depth_error import compare_depths
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit

PINHOLE = Camera.pinhole(width=64, height=48, focal_px=100)
ORTHOGRAPHIC = Camera.orthographic(width=64, height=48, pixels_per_unit=100)


def hill(unit: LengthUnit) -> DepthMap:
    v, u = np.mgrid[:48, :64]
    mask = (u - 32) ** 2 + (v - 24) ** 2 < 20**2
    depth = np.where(mask, 5 + 0.01 * np.hypot(u - 32, v - 24), np.nan)
    return DepthMap(depth=depth, mask=mask, unit=unit)


def changed(depth_map: DepthMap, depth: np.ndarray) -> DepthMap:
    return DepthMap(depth=depth, mask=depth_map.mask, unit=depth_map.unit)


def test_the_free_factor_or_offset_costs_nothing() -> None:
    metres, pixels = hill(LengthUnit.METRE), hill(LengthUnit.PIXEL)
    assert compare_depths(changed(metres, 3 * metres.depth), metres, PINHOLE).mean < 1e-6
    assert compare_depths(changed(pixels, pixels.depth - 7), pixels, ORTHOGRAPHIC).mean < 1e-6


def test_an_error_is_measured_along_the_axis_and_against_the_diagonal() -> None:
    truth = hill(LengthUnit.METRE)
    v, _ = np.mgrid[:48, :64]
    wrong = changed(truth, truth.depth + np.choose(v % 4, [0.02, 0.0, -0.02, 0.0]))  # half is right
    error = compare_depths(wrong, truth, PINHOLE)
    assert error.mean == pytest.approx(0.01, rel=0.05)
    assert error.p95 == pytest.approx(0.02, rel=0.05)
    width = 39 / 100 * 5.1  # 39 pixels across at 5 m and a little
    assert error.diagonal == pytest.approx(np.hypot(width, width), rel=0.05)
    assert error.mean_percent == pytest.approx(100 * error.mean / error.diagonal)


def test_refusals() -> None:
    truth = hill(LengthUnit.METRE)
    elsewhere = DepthMap(depth=truth.depth, mask=np.zeros_like(truth.mask), unit=truth.unit)
    with pytest.raises(BadInput, match="common mask"):
        compare_depths(elsewhere, truth, PINHOLE)
    one_pixel = elsewhere.mask.copy()
    one_pixel[tuple(np.argwhere(truth.mask)[0])] = True
    with pytest.raises(BadInput, match="a single pixel is valid in both"):
        compare_depths(DepthMap(depth=truth.depth, mask=one_pixel, unit=truth.unit), truth, PINHOLE)
