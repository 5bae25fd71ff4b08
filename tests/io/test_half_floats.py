"""The conversion to half floats is IEEE 754's, as numpy's is, to the bit."""

from types import SimpleNamespace

import numpy as np
import pytest

from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.maps_and_meshes.maps import half_planes_from_normals


def _as_map(values):
    normals = np.asarray(values, dtype=np.float32)[: len(values) // 3 * 3].reshape(1, -1, 3)
    mask = np.ones(normals.shape[:2], dtype=bool)  # a map of normals would refuse most of these numbers
    return SimpleNamespace(
        normals_in_camera=normals, mask=mask, weight=None, error_deg=None, shape=mask.shape
    )


def _halves():
    return np.arange(0x7C00, dtype=np.uint16).view(np.float16).astype(np.float32)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    "values",
    [
        _halves(),
        (_halves()[1:] + _halves()[:-1]) / 2,  # ties
        np.nextafter((_halves()[1:] + _halves()[:-1]) / 2, np.float32(0)),
        np.nextafter((_halves()[1:] + _halves()[:-1]) / 2, np.float32(1e9)),
        np.arange(0, 2**32, 9973, dtype=np.uint64).astype(np.uint32).view(np.float32),  # any bits, NaN too
    ],
    ids=["exact", "ties", "below ties", "above ties", "any"],
)
def test_every_kind_of_number_is_rounded_as_numpy_does(values, sign):
    normal_map = _as_map(values)
    planes = half_planes_from_normals(normal_map, (sign, sign, sign))
    with np.errstate(over="ignore", invalid="ignore"):
        expected = (sign * normal_map.normals_in_camera[0]).astype(np.float16).T
    nan = np.isnan(expected)
    np.testing.assert_array_equal(np.isnan(planes[:3, 0]), nan)
    np.testing.assert_array_equal(planes[:3, 0].view(np.uint16)[~nan], expected.view(np.uint16)[~nan])


def test_weight_is_one_without_a_weight_and_zero_where_invalid(rng):
    normals = np.tile(np.float32([0, 0, -1]), (4, 5, 1))
    mask = rng.random((4, 5)) > 0.5
    planes = half_planes_from_normals(NormalMap(normals_in_camera=normals, mask=mask), (1, -1, -1))
    np.testing.assert_array_equal(planes[3], mask)
    weight = rng.random((4, 5), dtype=np.float32)
    planes = half_planes_from_normals(
        NormalMap(normals_in_camera=normals, mask=mask, weight=weight), (1, -1, -1)
    )
    np.testing.assert_array_equal(planes[3], (weight * mask).astype(np.float16))
    np.testing.assert_array_equal(planes[2], np.ones((4, 5)))
