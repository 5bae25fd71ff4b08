"""What ambient light does to dark paint, and how noisy a frame's slopes are."""

from __future__ import annotations

import numpy as np
import pytest

from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.contributions import contributions_from_frame
from vntoolkit.shadows.initialisation import noise_of_frame

EVERYWHERE = np.ones((20, 30), bool)
MATRIX = np.array([[-0.3, -0.2, -0.5], [0.4, -0.1, -0.5], [0.0, 0.4, -0.6]])


def test_ambient_light_scales_with_the_albedo(rng: np.random.Generator) -> None:
    normals = rng.normal(size=(20, 30, 3)) * 0.3 - (0.0, 0.0, 1.0)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    response = LightResponse(matrix=MATRIX, ambient=np.array([0.03, 0.02, 0.04]))
    albedo = rng.uniform(0.05, 1.5, (20, 30))
    rgb = albedo[..., None] * (normals @ MATRIX.T + response.ambient)
    measured = contributions_from_frame(
        LinearFrame(rgb=rgb.astype(np.float32), clipped=~EVERYWHERE), response
    )
    assert np.abs(measured.length / albedo - 1.0).max() < 1e-4
    assert np.abs(measured.normals - normals).max() < 1e-4
    assert np.abs(measured.relative_to(albedo) - normals @ MATRIX.T).max() < 1e-4


def test_noise_of_slopes_is_measured_whatever_the_shape(rng: np.random.Generator) -> None:
    v, u = np.mgrid[:120, :150] / 30.0
    depth = 12.0 * np.sin(u) * np.cos(1.3 * v)
    slopes = np.stack([np.gradient(depth, axis=1), np.gradient(depth, axis=0)], axis=-1)
    response = LightResponse(matrix=MATRIX)
    for deviation in (0.01, 0.05):
        noisy = slopes + rng.normal(0, deviation, slopes.shape) * (1 + (slopes**2).sum(-1, keepdims=True))
        normals = np.concatenate([noisy, -np.ones((120, 150, 1))], axis=-1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        found = noise_of_frame(normals @ MATRIX.T, response, np.ones((120, 150), bool))
        assert found == pytest.approx(deviation, rel=0.15)
    assert noise_of_frame(normals @ MATRIX.T, response, np.zeros((120, 150), bool)) is None
