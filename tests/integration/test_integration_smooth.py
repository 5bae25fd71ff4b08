"""Smooth surfaces come back to parts per million, by every integrator, at every size."""

import numpy as np
import pytest
from analytic_surfaces import largest_error, sphere_before_camera

from vntoolkit.errors import BadInput
from vntoolkit.evaluation.depth_error import normals_from_gradient, peaks
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.maps import LengthUnit, NormalMap
from vntoolkit.integration.integrate import DepthIntegrator, divergence_from_slopes
from vntoolkit.integration.poisson import CosineSolver, FourierSolver
from vntoolkit.integration.slopes import slopes_from_normals
from vntoolkit.options.depth import IntegrationOptions, Integrator

LEAST_SQUARES = [Integrator.FOURIER, Integrator.COSINE, Integrator.POISSON]

RECTANGLE = [Integrator.FOURIER, Integrator.COSINE]  # solve on every pixel


def integrate(normals, mask=None, camera=None, weight=None, **options):
    height, width = normals.shape[:2]
    camera = camera or Camera.orthographic(width=width, height=height)
    mask = np.ones((height, width), dtype=bool) if mask is None else mask
    normal_map = NormalMap(normals_in_camera=normals, mask=mask, weight=weight)
    return DepthIntegrator(camera, IntegrationOptions(**options)).integrate(normal_map)


@pytest.mark.parametrize("integrator", LEAST_SQUARES)
@pytest.mark.parametrize("size", [128, 300, 1024])
def test_peaks_to_a_hundred_thousandth_of_the_range(integrator, size):
    depth, normals = peaks(size)
    found = integrate(normals, integrator=integrator)
    assert largest_error(found.depth, depth, found.mask) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [Integrator.COSINE, Integrator.POISSON])
def test_peaks_at_4096(integrator):
    depth, normals = peaks(4096)
    found = integrate(normals, integrator=integrator)
    assert largest_error(found.depth, depth, found.mask) < 1e-5


def test_the_error_falls_with_the_fourth_power_of_the_pixel():
    errors = []
    for size in (64, 128):
        depth, normals = peaks(size)
        found = integrate(normals, integrator=Integrator.COSINE)
        errors.append(largest_error(found.depth, depth, found.mask))
    assert 2**3.5 < errors[0] / errors[1] < 2**4.6


@pytest.mark.parametrize("shape", [(300, 1000), (1000, 300), (2, 7), (1, 9)])
def test_single_precision_loses_nothing_of_the_lowest_frequencies(rng, shape):
    z = np.cumsum(np.cumsum(rng.normal(size=shape), axis=0), axis=1)
    z -= z.mean()
    divergence = np.zeros(shape)
    for axis in (0, 1):
        step = np.diff(z, axis=axis)
        ahead, behind = [[(0, 0), (0, 0)] for _ in range(2)]
        ahead[axis], behind[axis] = (0, 1), (1, 0)
        divergence += np.pad(step, ahead) - np.pad(step, behind)
    exact = CosineSolver(*shape, np.float64).solve(divergence.copy())
    np.testing.assert_allclose(exact, z, atol=1e-9 * np.ptp(z))
    single = CosineSolver(*shape).solve(divergence.astype(np.float32))
    assert np.abs(single - z).max() < 2e-6 * np.ptp(z) * np.sqrt(max(shape))


def test_fourier_on_the_mirrored_image_is_the_cosine_solution(rng):
    rough = divergence_from_slopes(*rng.normal(size=(2, 60, 77)).astype(np.float32))
    cosine = CosineSolver(60, 77, np.float64).solve(rough.copy())
    fourier = FourierSolver(60, 77, np.float64).solve(rough.copy())
    assert np.abs(cosine - fourier).max() < 1e-10 * np.ptp(cosine)


def test_poisson_and_cosine_agree_on_slopes_that_no_surface_has(rng):
    rough = normals_from_gradient(*rng.normal(size=(2, 60, 77)))
    cosine = integrate(rough, integrator=Integrator.COSINE).depth
    poisson = integrate(rough, integrator=Integrator.POISSON).depth
    assert np.abs(cosine - poisson).max() < 1e-5 * np.ptp(cosine)


@pytest.mark.parametrize("integrator", list(Integrator))
def test_depth_grows_away_from_the_camera(integrator):
    """A plane whose normal leans right is nearer on its left... and rises by tan of its angle."""
    lean = np.tile(np.float32([0.6, 0.0, -0.8]), (40, 50, 1))
    found = integrate(lean, integrator=integrator).depth
    assert np.allclose(np.diff(found, axis=1), 0.75, atol=1e-4)
    assert np.allclose(np.diff(found, axis=0), 0.0, atol=1e-4)
    assert abs(found.mean()) < 1e-3


@pytest.mark.parametrize("integrator", list(Integrator))
def test_a_perspective_plane(integrator):
    camera = Camera.pinhole(width=90, height=70, focal_px=60.0)
    normal = np.array([0.3, -0.5, -0.8]) / np.linalg.norm([0.3, -0.5, -0.8])
    rays = camera.unproject(camera.pixel_grid(), np.ones((70, 90)))
    depth = -1.0 / (rays @ normal)
    found = integrate(np.tile(normal.astype(np.float32), (70, 90, 1)), camera=camera, integrator=integrator)
    assert found.unit is LengthUnit.FREE
    assert found.depth.mean() == pytest.approx(1.0, abs=1e-5)
    assert np.abs(found.depth / found.depth.mean() * depth.mean() / depth - 1).max() < 2e-5


@pytest.mark.parametrize("integrator", [Integrator.POISSON, Integrator.DISCONTINUITY])
@pytest.mark.parametrize("perspective", [False, True])
def test_a_sphere_is_round_and_convex(integrator, perspective):
    if perspective:
        camera = Camera.pinhole(width=120, height=100, focal_px=200.0)
        centre, radius = (0.05, -0.02, 3.0), 0.6
    else:
        camera = Camera.orthographic(width=120, height=100, pixels_per_unit=50.0)
        centre, radius = (0.05, -0.02, 3.0), 0.8
    depth, normals, mask = sphere_before_camera(camera, centre, radius, 70.0)
    found = integrate(normals, mask=mask, camera=camera, integrator=integrator)
    truth = depth / depth[mask].mean() if perspective else depth
    assert largest_error(found.depth, truth, mask) < (2e-3 if integrator is Integrator.POISSON else 2e-4)
    v, u = np.unravel_index(np.where(mask, found.depth, np.inf).argmin(), mask.shape)
    assert np.abs(camera.project(np.array(centre)) - (u, v)).max() < 1.5


def test_a_distorted_camera_sees_the_same_plane():
    matrix = np.array([[80.0, 0, 44.5], [0, 80.0, 34.5], [0, 0, 1]])
    camera = Camera(
        model=CameraModel.OPENCV, width=90, height=70, matrix=matrix,
        distortion=np.array([-0.2, 0.03, 0.002, -0.001]),
    )  # fmt: skip
    normal = np.array([0.3, -0.5, -0.8]) / np.linalg.norm([0.3, -0.5, -0.8])
    depth = -1.0 / (camera.unproject(camera.pixel_grid(), np.ones((70, 90))) @ normal)
    found = integrate(np.tile(normal.astype(np.float32), (70, 90, 1)), camera=camera)
    assert np.abs(found.depth * depth.mean() / depth - 1).max() < 2e-4


@pytest.mark.parametrize("integrator", list(Integrator))
def test_backward_and_grazing_normals_do_not_explode(integrator, monkeypatch):
    monkeypatch.setattr(slopes_from_normals, "__defaults__", (80.0,))
    normals = np.tile(np.float32([0.0, 0.0, -1.0]), (40, 40, 1))
    normals[20, 20] = [0.9999, 0.0, -0.0141]
    if integrator not in RECTANGLE:  # the others refuse a map with a normal that faces away: below
        normals[10, 10] = [0.6, 0.0, 0.8]
    found = integrate(normals, integrator=integrator).depth[normals[..., 2] < 0]
    limit = np.tan(np.deg2rad(80.0))  # of one pixel's slope, shared by its two edges
    assert np.isfinite(found).all()
    assert np.ptp(found) < 2 * limit


@pytest.mark.parametrize("integrator", RECTANGLE)
def test_a_rectangle_solver_refuses_a_normal_that_faces_away(integrator):
    normals = np.tile(np.float32([0.0, 0.0, -1.0]), (40, 40, 1))
    normals[10, 10] = [0.6, 0.0, 0.8]
    with pytest.raises(BadInput, match="1 are masked or doubtful: use poisson"):
        integrate(normals, integrator=integrator)


@pytest.mark.parametrize("integrator", RECTANGLE)
def test_a_rectangle_solver_refuses_a_mask(integrator):
    _, normals = peaks(32)
    mask = np.ones((32, 32), dtype=bool)
    mask[3, 4] = False
    with pytest.raises(BadInput, match="1 are masked or doubtful: use poisson"):
        integrate(normals, mask=mask, integrator=integrator)


def test_another_size_and_an_empty_mask_are_refused():
    _, normals = peaks(32)
    with pytest.raises(BadInput, match="normals are 32×32 but the camera is 64×48"):
        integrate(normals, camera=Camera.orthographic(width=64, height=48))
    with pytest.raises(BadInput, match="no valid pixel"):
        integrate(normals, mask=np.zeros((32, 32), dtype=bool))
    with pytest.raises(BadInput, match="at least 5×5"):
        integrate(normals[:3, :4])
