"""Many lights: exact on a matte sphere, untouched by shadow and gloss, refused where undetermined."""

import numpy as np

from vntoolkit.normals.photometric_stereo import (
    normals_from_lights,
    solve_photometric_stereo,
)
from vntoolkit.photometry.fit_quality import angles_deg

SIZE = 64


def ring_of_lights(count: int, tilt_deg: float) -> np.ndarray:
    azimuth = np.arange(count) * 2 * np.pi / count
    tilt = np.deg2rad(tilt_deg)
    return np.stack(
        [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.full(count, -np.cos(tilt))],
        axis=1,
    )


LIGHTS = np.vstack([ring_of_lights(8, 50.0), ring_of_lights(4, 20.0)]) * np.linspace(0.7, 1.0, 12)[:, None]


def sphere():
    axis = np.linspace(-1.05, 1.05, SIZE)
    x, y = np.meshgrid(axis, axis)
    inside = x**2 + y**2 < 0.96
    z = -np.sqrt(np.where(inside, 1 - x**2 - y**2, 1))
    return np.stack([x, y, z], axis=-1) * inside[..., None], inside


def test_sphere_with_attached_shadow_is_exact() -> None:
    normals, inside = sphere()
    albedo = 0.3 + 0.5 * inside
    images = albedo * np.maximum(np.einsum("hwc,kc->khw", normals, LIGHTS), 0)
    result = solve_photometric_stereo(images, LIGHTS, inside)
    assert result.normal_map.mask[inside].mean() > 0.99  # a few pixels at the rim see two lights only
    valid = result.normal_map.mask
    assert angles_deg(result.normal_map.normals_in_camera, normals)[valid].max() < 1e-3
    np.testing.assert_allclose(result.albedo[valid], albedo[valid], rtol=1e-5)
    assert not valid[~inside].any()


def test_gloss_cast_shadow_and_clipping_are_left_out(rng) -> None:
    normals, inside = sphere()
    images = np.maximum(np.einsum("hwc,kc->khw", normals, LIGHTS), 0) * 0.8
    images = np.minimum(images + rng.normal(0, 0.001, images.shape), 1)
    bad = rng.integers(0, 12, (SIZE, SIZE))
    gloss = rng.random((SIZE, SIZE)) < 0.5
    v, u = np.indices((SIZE, SIZE))
    spoiled = images.copy()
    spoiled[bad, v, u] = np.where(gloss, np.minimum(images[bad, v, u] + 0.5, 1.0), 0.3 * images[bad, v, u])
    well_lit = inside & ((images > 0.1).sum(axis=0) >= 8)
    robust = normals_from_lights(spoiled, LIGHTS, well_lit)
    naive = np.linalg.lstsq(LIGHTS, spoiled.reshape(12, -1), rcond=None)[0].T.reshape(SIZE, SIZE, 3)
    naive /= np.linalg.norm(naive, axis=-1, keepdims=True) + 1e-9
    robust_error = angles_deg(robust.normals_in_camera, normals)[well_lit]
    naive_error = angles_deg(naive, normals)[well_lit]
    assert np.percentile(robust_error, 95) < 0.4  # the noise alone: 0.001 / 0.8 over eleven lights is 0.1
    assert np.median(naive_error) > 3


def test_undetermined_pixels_are_left_out() -> None:
    images = np.ones((3, 4, 5)) * 0.5
    lights = ring_of_lights(3, 40.0)
    dark = images.copy()
    dark[0, 0, 0] = 0.0  # two samples left
    dark[:, 1, 1] = np.nan
    result = normals_from_lights(dark, lights)
    assert not result.mask[0, 0]
    assert not result.mask[1, 1]
    assert result.mask.sum() == 18
    assert np.isfinite(result.normals_in_camera).all()
