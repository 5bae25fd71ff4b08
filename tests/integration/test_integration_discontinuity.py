"""Depth may jump: analytic tears, and real objects against what others published."""

import numpy as np
import pytest
from analytic_surfaces import largest_error, sphere_before_camera

from vntoolkit.evaluation.depth_error import peaks, tear
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.integration.edges import chords_from_slopes
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.integration.slopes import rays_from_camera, slopes_from_normals
from vntoolkit.options.depth import IntegrationOptions, Integrator

POISSON = IntegrationOptions(integrator=Integrator.POISSON)
# mean absolute error in mm of the better of Cao et al.'s code and the best least-squares program
BETTER_PEER_MM = {"pot2": 0.158, "cow": 0.058, "bear": 0.133, "goblet": 3.88, "reading": 0.257}


def root_mean_square_percent(found, truth):
    difference = found - truth
    return 100 * (difference - difference.mean()).std() / np.ptp(truth)


@pytest.mark.parametrize("steepness", [0.25, 1.0, 2.0])
def test_a_flat_that_turns_into_a_ramp(steepness):
    truth, normals = tear(256, steepness)
    normal_map = NormalMap(normals_in_camera=normals, mask=np.ones(truth.shape, dtype=bool))
    camera = Camera.orthographic(width=256, height=256)
    assert root_mean_square_percent(DepthIntegrator(camera).integrate(normal_map).depth, truth) < 0.42
    assert root_mean_square_percent(DepthIntegrator(camera, POISSON).integrate(normal_map).depth, truth) > 10


@pytest.mark.parametrize("noise_deg", [1.0, 5.0])
def test_noise_of_the_normals_is_measured_not_taken_for_jumps(noise_deg, rng):
    """On a smooth surface without jumps the robust solution stays near least squares, which is best there."""
    truth, normals = peaks(128)
    noisy = normals + rng.normal(scale=np.deg2rad(noise_deg), size=normals.shape)
    noisy /= np.linalg.norm(noisy, axis=-1, keepdims=True)
    normal_map = NormalMap(normals_in_camera=noisy, mask=np.ones(truth.shape, dtype=bool))
    camera = Camera.orthographic(width=128, height=128)
    robust = DepthIntegrator(camera).integrate(normal_map).depth
    plain = DepthIntegrator(camera, POISSON).integrate(normal_map).depth
    assert root_mean_square_percent(robust, truth) < 2 * root_mean_square_percent(plain, truth)


@pytest.mark.parametrize("says", ["error_deg", "weight"])
def test_a_residual_within_the_stated_errors_is_no_jump(says):
    """What neighbours share shows in no circulation: only who made the normals can know of it."""
    truth, normals = tear(64, 0.1)
    shape = truth.shape
    camera, everywhere = Camera.orthographic(width=64, height=64), np.ones(shape, dtype=bool)
    plain = DepthIntegrator(camera, POISSON).integrate(NormalMap(normals_in_camera=normals, mask=everywhere))
    for error_deg, is_torn in ((0.5, True), (60.0, False)):
        stated = error_deg if says == "error_deg" else 1 / (1 + (error_deg / 12.0) ** 2)
        normal_map = NormalMap(
            normals_in_camera=normals, mask=everywhere, **{says: np.full(shape, stated, np.float32)}
        )
        found = DepthIntegrator(camera).integrate(normal_map).depth
        assert (root_mean_square_percent(found, truth) < 2) == is_torn
        assert is_torn or np.allclose(found, plain.depth, atol=1e-3)


def test_chords_are_exact_on_a_sphere():
    camera = Camera.orthographic(width=120, height=100)
    depth, normals, mask = sphere_before_camera(camera, (3.0, -2.0, 180.0), 36.0, 85.0)
    slopes = slopes_from_normals(normals, rays_from_camera(camera), 89.9)
    difference = chords_from_slopes(*slopes)
    for k, axis in ((0, 1), (1, 0)):
        both = np.logical_and(*((mask[:, 1:], mask[:, :-1]) if axis else (mask[1:], mask[:-1])))
        found = difference[k, :, :-1] if axis else difference[k, :-1]
        assert np.abs(found - np.diff(depth, axis=axis))[both].max() < 1e-3


def test_one_sphere_before_another_keeps_both_round():
    """The one in front hides part of the one behind: each must come back without the other's mark."""
    camera = Camera.orthographic(width=160, height=120)
    back, back_normals, back_mask = sphere_before_camera(camera, (-18.0, 0.0, 100.0), 45.0, 70.0)
    front, front_normals, front_mask = sphere_before_camera(camera, (30.0, 0.0, 60.0), 35.0, 70.0)
    normals = np.where(front_mask[..., None], front_normals, back_normals)
    normal_map = NormalMap(normals_in_camera=normals, mask=front_mask | back_mask)
    found = DepthIntegrator(camera).integrate(normal_map).depth
    plain = DepthIntegrator(camera, POISSON).integrate(normal_map).depth
    for depth, mask in ((front, front_mask), (back, back_mask & ~front_mask)):
        assert largest_error(found, depth, mask) < 1e-3
    assert largest_error(plain, back, back_mask & ~front_mask) > 0.1


def read_object(folder):
    import cv2

    stored = cv2.imread(str(folder / "normal_map.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    mask = cv2.imread(str(folder / "mask.png"), cv2.IMREAD_GRAYSCALE) > 0
    normals = (stored / 65535.0 * 2.0 - 1.0) * [1.0, -1.0, -1.0]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[~mask] = 0.0
    matrix = np.loadtxt(folder / "K.txt")
    camera = Camera(model=CameraModel.PINHOLE, width=mask.shape[1], height=mask.shape[0], matrix=matrix)
    truth = np.load(folder / "depth_gt.npz")["depth_gt"].astype(np.float64)
    return camera, NormalMap(normals_in_camera=normals, mask=mask), truth


def test_real_objects_come_nearer_than_the_better_peer(real_data):
    better = []
    for name, peer_mm in BETTER_PEER_MM.items():
        camera, normal_map, truth = read_object(real_data / "normal_integration" / name)
        seen = normal_map.mask & np.isfinite(truth)
        found = DepthIntegrator(camera).integrate(normal_map).depth[seen]
        error_mm = np.abs(found * np.median(truth[seen] / found) - truth[seen]).mean()
        if error_mm <= peer_mm:
            better.append(name)
    assert {"pot2", "bear", "reading"} <= set(better)
