"""Depth that is known beside the normals joins by its expected error."""

from dataclasses import replace

import numpy as np
import pytest
from analytic_surfaces import sphere_before_camera

from vntoolkit.errors import BadInput
from vntoolkit.evaluation.depth_error import normals_from_gradient, peaks
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import LengthUnit, NormalMap
from vntoolkit.integration.expected_error import with_expected_depth_error
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.integration.prior import DepthPrior, with_prior_error
from vntoolkit.options.depth import IntegrationOptions, Integrator

SIZE = 96
CAMERA = Camera.orthographic(width=SIZE, height=SIZE)
EVERYWHERE = np.ones((SIZE, SIZE), dtype=bool)


def biased_peaks(rng):
    """True depth, and normals that are one degree off, all to the same side: they tilt the surface."""
    truth, normals = peaks(SIZE)
    p, q = -normals[..., 0] / normals[..., 2], -normals[..., 1] / normals[..., 2]
    tilted = normals_from_gradient(p + np.tan(np.deg2rad(1.0)), q)
    error = np.full(truth.shape, 1.5, np.float32)
    return truth, NormalMap(normals_in_camera=tilted, mask=EVERYWHERE, error_deg=error)


@pytest.mark.parametrize("integrator", [Integrator.POISSON, Integrator.DISCONTINUITY])
def test_normals_and_prior_together_are_better_than_either(integrator, rng):
    truth, normal_map = biased_peaks(rng)
    measured = truth + 40.0 + rng.normal(scale=0.5, size=truth.shape)
    prior = DepthPrior(depth=measured, mask=EVERYWHERE, error=0.5 * 1.645)
    options = IntegrationOptions(integrator=integrator)
    alone = DepthIntegrator(CAMERA, options).integrate(normal_map).depth
    fused = DepthIntegrator(CAMERA, options).integrate(normal_map, prior=prior).depth
    off = fused - truth - 40.0
    assert off.std() < 0.6 * min((alone - truth).std(), (measured - truth).std())
    assert abs(off.mean()) < 0.02


def test_the_less_exact_of_two_counts_less(rng):
    truth, normal_map = biased_peaks(rng)
    wrong = np.zeros_like(truth)
    integrator = DepthIntegrator(CAMERA)
    errors = [
        np.std(
            integrator.integrate(normal_map, prior=DepthPrior(depth=wrong, mask=EVERYWHERE, error=e)).depth
        )
        for e in (0.001, 1.0, 1e4)
    ]
    assert errors[0] < 0.01 < errors[1] < errors[2]
    assert errors[2] == pytest.approx(np.std(integrator.integrate(normal_map).depth), rel=1e-3)


def test_a_few_known_pixels_fix_distance_and_scale_of_a_sphere():
    camera = Camera.pinhole(width=120, height=100, focal_px=300)
    depth, normals, mask = sphere_before_camera(camera, (0.02, -0.01, 2.0), 0.25, 70.0)
    known = np.zeros_like(mask)
    known[40:60:7, 40:80:9] = True
    prior = DepthPrior(depth=np.where(known, depth, np.nan), mask=known & mask, error=1e-4)
    found = DepthIntegrator(camera).integrate(NormalMap(normals_in_camera=normals, mask=mask), prior=prior)
    assert found.unit is LengthUnit.METRE
    assert np.abs(found.depth - depth)[mask].max() < 1e-4


def test_parts_without_a_common_side_find_their_place():
    truth, normals = peaks(SIZE)
    mask = EVERYWHERE.copy()
    mask[:, 45:50] = False
    rows = np.zeros_like(mask)
    rows[::20] = True
    prior = DepthPrior(depth=truth, mask=mask & rows, error=0.01)
    found = DepthIntegrator(CAMERA).integrate(NormalMap(normals_in_camera=normals, mask=mask), prior=prior)
    assert np.abs(found.depth - truth)[mask].max() < 0.02


def test_heights_at_the_outline_are_a_prior():
    truth, normal_map = biased_peaks(None)
    outline = EVERYWHERE.copy()
    outline[1:-1, 1:-1] = False
    prior = DepthPrior(depth=truth, mask=outline, error=0.01)
    found = DepthIntegrator(CAMERA).integrate(normal_map, prior=prior).depth
    assert np.abs(found - truth)[outline].max() < 0.02
    alone = DepthIntegrator(CAMERA).integrate(normal_map).depth
    assert np.abs(found - truth).mean() < 0.5 * np.abs(alone - truth + truth.mean()).mean()


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"mask": ~EVERYWHERE}, "prior depth"),
        ({"error": 0.0}, "errors above 0"),
        ({"error": np.ones((3, 3))}, "error of the prior"),
        ({"depth": np.full((SIZE, SIZE), np.nan)}, "finite depths"),
    ],
)
def test_priors_that_are_refused(change, line):
    given = {"depth": np.ones((SIZE, SIZE)), "mask": EVERYWHERE, "error": 1.0}
    with pytest.raises(BadInput, match=line):
        DepthPrior(**(given | change))


def test_a_prior_of_another_size_or_for_another_integrator_is_refused():
    _, normal_map = biased_peaks(None)
    small = DepthPrior(depth=np.ones((9, 9)), mask=np.ones((9, 9), dtype=bool), error=1.0)
    with pytest.raises(BadInput, match="prior depth"):
        DepthIntegrator(CAMERA).integrate(normal_map, prior=small)
    whole = replace(small, depth=np.ones((SIZE, SIZE)), mask=EVERYWHERE, error=1.0)
    options = IntegrationOptions(integrator=Integrator.COSINE)
    with pytest.raises(BadInput, match="takes no prior"):
        DepthIntegrator(CAMERA, options).integrate(normal_map, prior=whole)


def test_the_expected_error_with_a_prior_holds(rng):
    """Nine of ten pixels stay within it, and it is below that of the normals alone."""
    truth, normals = peaks(SIZE)
    turned = normals + rng.normal(scale=np.deg2rad(1.0), size=normals.shape)
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    normal_map = NormalMap(
        normals_in_camera=turned, mask=EVERYWHERE, error_deg=np.full(truth.shape, 2.146, np.float32)
    )
    measured = truth + rng.normal(scale=0.3, size=truth.shape)
    prior = DepthPrior(depth=measured, mask=EVERYWHERE, error=0.3 * 1.645)
    found = DepthIntegrator(CAMERA).integrate(normal_map, prior=prior)
    by_normals = with_expected_depth_error(found, normal_map, CAMERA)
    together = with_prior_error(by_normals, prior)
    bound = together.error_percent / 100 * np.ptp(found.depth)
    assert np.mean(np.abs(found.depth - truth) <= bound) > 0.9
    assert np.all(together.error_percent < by_normals.error_percent)
    assert np.all(bound < 0.3 * 1.645)
