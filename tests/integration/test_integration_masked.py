"""Inside a mask: nothing outside counts, nothing at the border is flattened, components are independent."""

from dataclasses import replace

import numpy as np
import pytest
from analytic_surfaces import largest_error

from vntoolkit.errors import SolverFailed
from vntoolkit.evaluation.depth_error import disc_with_hole, normals_from_gradient, peaks
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.integration.edges import EdgeField, FarEdges, edges_from_slopes
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.integration.poisson import MaskedSolver
from vntoolkit.integration.slopes import rays_from_camera, slopes_from_normals
from vntoolkit.options.depth import IntegrationOptions, Integrator

POISSON = IntegrationOptions(integrator=Integrator.POISSON)


def integrator_of(mask, options=POISSON):
    return DepthIntegrator(Camera.orthographic(width=mask.shape[1], height=mask.shape[0]), options)


@pytest.mark.parametrize("size", [128, 512])
def test_a_disc_with_a_hole_to_a_hundred_thousandth(size):
    depth, normals = peaks(size)
    mask = disc_with_hole(size)
    found = integrator_of(mask).integrate(NormalMap(normals_in_camera=normals, mask=mask))
    assert largest_error(found.depth, depth, mask) < 1e-5
    assert (found.depth[~mask] == 0).all()


def test_weights_of_one_change_nothing():
    """The weighted solver (multigrid) and the unweighted one (cosine preconditioner) agree."""
    depth, normals = peaks(128)
    mask = disc_with_hole(128)
    ones = np.ones(mask.shape, dtype=np.float32)
    found = integrator_of(mask).integrate(NormalMap(normals_in_camera=normals, mask=mask, weight=ones))
    assert largest_error(found.depth, depth, mask) < 1e-5


def test_what_lies_outside_the_mask_does_not_matter(rng):
    _, normals = peaks(80)
    mask = disc_with_hole(80)
    changed = np.where(mask[..., None], normals, normals_from_gradient(*rng.normal(size=(2, 80, 80))))
    first, second = (
        integrator_of(mask).integrate(NormalMap(normals_in_camera=n, mask=mask)).depth
        for n in (normals, changed)
    )
    assert np.array_equal(first, second)


@pytest.mark.parametrize("integrator", [Integrator.POISSON, Integrator.DISCONTINUITY])
def test_every_component_has_its_own_offset(integrator):
    mask = np.zeros((40, 60), dtype=bool)
    mask[5:35, 5:25] = True
    mask[2:30, 30:55] = True
    mask[36, 40] = True  # a lone pixel
    plane = np.tile(np.float32([0.6, 0.0, -0.8]), (40, 60, 1))
    options = IntegrationOptions(integrator=integrator)
    depth = integrator_of(mask, options).integrate(NormalMap(normals_in_camera=plane, mask=mask)).depth
    for part in (np.s_[5:35, 5:25], np.s_[2:30, 30:55]):
        assert abs(depth[part].mean()) < 1e-9
        assert np.allclose(np.diff(depth[part], axis=1), 0.75, atol=1e-4)
    assert depth[36, 40] == 0.0


def test_a_dozen_iterations_suffice_at_any_size_and_fewer_from_the_frame_before():
    for size in (128, 512):
        _, normals = peaks(size)
        mask = disc_with_hole(size)
        p, q = -normals[..., 0] / normals[..., 2], -normals[..., 1] / normals[..., 2]
        edges = edges_from_slopes(p, q, mask)
        solver = MaskedSolver(mask, tolerance=1e-6, most_iterations=100)
        depth = solver.solve(edges)
        cold = solver.iterations
        solver.solve(edges_from_slopes(p * 1.01, q * 1.01, mask), depth)
        assert 3 < cold <= 12
        assert solver.iterations < cold


def test_a_mask_that_changes_between_frames_is_noticed():
    depth, normals = peaks(96)
    first, second = disc_with_hole(96), disc_with_hole(96)
    second[:50] = False
    integrator = integrator_of(first)
    integrator.integrate(NormalMap(normals_in_camera=normals, mask=first))
    found = integrator.integrate(NormalMap(normals_in_camera=normals, mask=second))
    assert np.array_equal(found.mask, second)
    assert largest_error(found.depth, depth, second) < 1e-4


def test_a_doubtful_pixel_counts_less_and_a_hopeless_one_not_at_all():
    depth, normals = peaks(64)
    normals = normals.copy()
    normals[30:33, 30:33] = [0.9, 0.0, -np.sqrt(1 - 0.81)]
    mask = np.ones((64, 64), dtype=bool)
    trusted = np.abs(np.mgrid[:64, :64] - 31).max(axis=0) > 6
    errors = []
    for weight_there in (1.0, 0.05, 0.0):
        weight = np.ones((64, 64), dtype=np.float32)
        weight[30:33, 30:33] = weight_there
        normal_map = NormalMap(normals_in_camera=normals, mask=mask, weight=weight)
        found = integrator_of(mask).integrate(normal_map)
        errors.append(largest_error(found.depth, depth, trusted))
        assert found.mask.sum() == (64 * 64 if weight_there > 0 else 64 * 64 - 9)
    assert errors[1] < errors[0] / 3
    assert errors[2] < 1e-4


def test_running_out_of_iterations_is_said():
    _, normals = peaks(128)
    mask = disc_with_hole(128)
    edges = edges_from_slopes(
        *slopes_from_normals(normals, rays_from_camera(Camera.orthographic(width=128, height=128))), mask
    )
    with pytest.raises(SolverFailed, match="did not converge in 2 iterations"):
        MaskedSolver(mask, most_iterations=2).solve(edges)


def weights_at_random(weight, rng):
    """Two orders of magnitude between neighbours: more than confidence does."""
    return weight * 10.0 ** rng.uniform(-2, 0, weight.shape)


def weights_with_a_cut(weight, rng):
    """A disc that hangs on its surroundings by edges ten thousand times weaker than the others."""
    v, u = np.mgrid[:40, :50]
    disc = np.hypot(u - 22, v - 17) < 11.3
    weight = weight * rng.uniform(0.5, 1.0, weight.shape)
    weight[0, :, :-1][disc[:, 1:] != disc[:, :-1]] = 1e-4
    weight[1, :-1][disc[1:] != disc[:-1]] = 1e-4
    return weight


@pytest.mark.parametrize("make_weights", [weights_at_random, weights_with_a_cut])
def test_multigrid_finds_the_depth_of_its_differences(make_weights, rng):
    mask = rng.random((40, 50)) < 0.9
    flat = np.zeros(mask.shape, np.float32)
    weight = make_weights(edges_from_slopes(flat, flat, mask).weight, rng).astype(np.float32)
    truth, wanted = rng.normal(size=mask.shape), np.zeros((2, *mask.shape), np.float32)
    wanted[0, :, :-1], wanted[1, :-1] = np.diff(truth, axis=1), np.diff(truth, axis=0)
    solver = MaskedSolver(mask, tolerance=1e-7, most_iterations=100)
    found = solver.solve(EdgeField(difference=wanted, weight=weight), weighted=True)
    misfit = np.zeros_like(wanted)
    misfit[0, :, :-1], misfit[1, :-1] = np.diff(found, axis=1), np.diff(found, axis=0)
    misfit -= wanted
    assert (weight * misfit**2).sum() < 1e-11 * (weight * wanted**2).sum()
    assert solver.iterations < 60


def test_edges_between_pixels_apart_are_least_squares_like_all_others(rng):
    """Against a dense matrix, on a domain with holes and unequal weights."""
    domain = rng.random((9, 11)) < 0.85
    domain[4] = True
    edges = edges_from_slopes(*rng.normal(size=(2, *domain.shape)).astype(np.float32), domain)
    edges = replace(edges, weight=edges.weight * rng.uniform(0.1, 1.0, edges.weight.shape).astype(np.float32))
    places = np.argwhere(domain)
    ends = rng.choice(places, (2, 4))
    far = FarEdges(
        first=ends[0], last=ends[1], difference=rng.normal(size=4), weight=rng.uniform(0.5, 5.0, 4)
    )
    found = MaskedSolver(domain).solve(edges, weighted=True, far=far.within(domain, *np.s_[0:9, 0:11]))
    number = np.full(domain.shape, -1)
    number[domain] = np.arange(len(places))
    rows, wanted = [], []
    for k, v, u in np.argwhere(edges.weight > 0):
        rows.append((number[v, u], number[v + k, u + 1 - k], edges.weight[k, v, u]))
        wanted.append(edges.difference[k, v, u])
    rows += list(zip(number[tuple(far.first.T)], number[tuple(far.last.T)], far.weight, strict=True))
    wanted += list(far.difference)
    matrix = np.zeros((len(rows), len(places)))
    for row, (first, last, weight) in zip(matrix, rows, strict=True):
        row[last] += np.sqrt(weight)
        row[first] -= np.sqrt(weight)
    roots = np.sqrt([weight for *_, weight in rows])
    best = np.linalg.lstsq(matrix, roots * wanted, rcond=None)[0]
    np.testing.assert_allclose(matrix @ found[domain], matrix @ best, atol=1e-3)


def test_edges_that_leave_the_domain_are_left_out():
    domain = np.ones((6, 8), bool)
    domain[2, 2] = False
    ends = np.array([[2, 2], [3, 3], [5, 7]])
    far = FarEdges(first=ends, last=np.full((3, 2), 4), difference=np.arange(3.0), weight=np.ones(3))
    near = far.within(domain, slice(1, 6), slice(2, 8))
    assert near.difference.tolist() == [1.0, 2.0]
    assert near.first.tolist() == [[2, 1], [4, 5]]
    assert near.last.tolist() == [[3, 2]] * 2
