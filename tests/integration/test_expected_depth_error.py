"""Depth tells its error: what errors that the normals share do to it, and next to nothing for noise."""

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.evaluation.depth_error import peaks
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NOISE_CELL_PX, NormalMap
from vntoolkit.integration.expected_error import with_expected_depth_error
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.io.maps_and_meshes.maps import read_depth_map, write_depth_map

SIZE = 120
EVERYWHERE = np.ones((SIZE, SIZE), bool)
CAMERAS = {
    "orthographic": Camera.orthographic(width=SIZE, height=SIZE),
    "perspective": Camera.pinhole(width=SIZE, height=SIZE, focal_px=400.0),
}


def unit(normals):
    return (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)


def map_of(normals, error_deg, shared_deg):
    return NormalMap(
        normals_in_camera=unit(normals),
        mask=EVERYWHERE,
        error_deg=np.full((SIZE, SIZE), error_deg),
        noise_deg=np.full(2 * (-(-SIZE // NOISE_CELL_PX),), np.sqrt(error_deg**2 - shared_deg**2)),
    )


def depth_and_error(camera, truth, measured):
    """Return the depth of `measured` with its expected error, and its true error in % of the range."""
    right, found = (DepthIntegrator(camera).integrate(m) for m in (truth, measured))
    found = with_expected_depth_error(found, measured, camera)
    departure = found.depth - right.depth
    return found, 100 * np.abs(departure - departure.mean()) / np.ptp(found.depth)


@pytest.mark.parametrize("kind", CAMERAS)
def test_a_shared_error_is_foretold(rng, kind):
    """Over random ΔM of the size that the normals state, about nine of ten pixels are within the bound."""
    camera, truth = CAMERAS[kind], peaks(SIZE)[1]
    bound_deg, within = 8.0, []
    for _ in range(12):
        change = np.radians(bound_deg / 2.146) * rng.normal(size=(3, 3))
        measured = map_of(truth + truth @ change.T, bound_deg, bound_deg)
        found, error = depth_and_error(camera, map_of(truth, 0, 0), measured)
        within.append((error <= found.error_percent).mean())
    assert 0.6 < np.mean(within) < 0.98


def test_noise_hardly_counts(rng):
    camera, truth = CAMERAS["orthographic"], peaks(SIZE)[1]
    sigma_deg = 4.0
    noisy = truth + np.radians(sigma_deg) * rng.normal(size=truth.shape)
    measured = map_of(noisy, 2.146 * sigma_deg, 0.0)
    found, error = depth_and_error(camera, map_of(truth, 0, 0), measured)
    assert (error <= found.error_percent).mean() > 0.75
    shared = with_expected_depth_error(found, map_of(noisy, 2.146 * sigma_deg, 2.146 * sigma_deg), camera)
    assert np.median(shared.error_percent) > 5 * np.median(found.error_percent)


def test_parts_without_a_normal_have_no_error_and_files_keep_it(tmp_path, rng):
    camera = CAMERAS["perspective"]
    mask = EVERYWHERE.copy()
    mask[:, 55:65] = False
    normals = np.where(mask[..., None], peaks(SIZE)[1], 0)
    error = rng.uniform(2, 20, mask.shape)
    normal_map = NormalMap(normals_in_camera=normals, mask=mask, error_deg=error)
    found = with_expected_depth_error(DepthIntegrator(camera).integrate(normal_map), normal_map, camera)
    assert (found.error_percent[~mask] == 0).all()
    assert (found.error_percent[mask] > 0).all()
    write_depth_map(tmp_path / "z.exr", found)
    np.testing.assert_allclose(
        read_depth_map(tmp_path / "z.exr").error_percent, found.error_percent, rtol=1e-3
    )


def test_normals_without_an_error_are_refused():
    camera = CAMERAS["orthographic"]
    plain = NormalMap(normals_in_camera=peaks(SIZE)[1], mask=EVERYWHERE)
    with pytest.raises(BadInput, match="normals: their expected error is not known"):
        with_expected_depth_error(DepthIntegrator(camera).integrate(plain), plain, camera)
