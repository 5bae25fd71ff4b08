"""The compiled loops of jumps against their plain numpy forms."""

from dataclasses import replace

import numpy as np
import pytest

from vntoolkit.integration import discontinuity
from vntoolkit.integration.discontinuity import JumpSolver, SlopeErrors, normalised_residuals
from vntoolkit.integration.edges import FarEdges
from vntoolkit.integration.poisson import MaskedSolver

SHAPE = (13, 17)


@pytest.fixture
def edges(rng):
    """Depth, wanted differences and variances, of which a quarter is of no edge."""
    depth = rng.normal(size=SHAPE).cumsum(axis=0)
    difference = rng.normal(scale=2.0, size=(2, *SHAPE))
    variance = rng.uniform(0.01, 3.0, (2, *SHAPE)).astype(np.float32)
    variance[rng.random(variance.shape) < 0.25] = 0.0
    variance[0, :, -1] = variance[1, -1] = 0.0
    return depth, difference, variance


def plain_residuals(depth, difference):
    """(2, h, w): by how much depth rises more than wanted, to the right and down; NaN beyond the border."""
    rises = np.full(difference.shape, np.nan)
    rises[0, :, :-1], rises[1, :-1] = np.diff(depth, axis=1), np.diff(depth, axis=0)
    return rises - difference


def plain_weights(depth, difference, variance, scale):
    """Geman and McClure's, over the inverse variance; tolerant to depth that rises less than the slope."""
    residual, edge = plain_residuals(depth, difference), variance > 0
    slack = np.where(residual * difference < 0, 1 + (discontinuity._AGAINST_SLOPE * difference) ** 2, 1.0)
    share = 1 / (1 + residual**2 / scale**2 / np.where(edge, variance * slack, 1.0))
    share = np.maximum(share**2, discontinuity._LEAST_WEIGHT)
    weight = share * variance[edge].min() / np.where(edge, variance, 1.0)
    return np.where(edge, -residual, 0.0), np.where(edge, weight, 0.0)


def test_normalised_residuals(edges):
    depth, difference, variance = edges
    edge = variance > 0
    wanted = np.abs(plain_residuals(depth, difference)) / np.sqrt(np.where(edge, variance, 1.0))
    found = normalised_residuals(depth, difference, variance)
    np.testing.assert_allclose(found, np.where(edge, wanted, -1.0), rtol=1e-5)


@pytest.mark.parametrize("scale", [1.0, 12.0, np.inf])
def test_weights_and_what_edges_miss(edges, scale):
    depth, difference, variance = edges
    missing, weight = np.zeros((2, *variance.shape), np.float32)
    smallest = variance[variance > 0].min()
    discontinuity._reweigh(depth, difference, variance, scale, smallest, missing, weight)
    wanted_missing, wanted_weight = plain_weights(depth, difference, variance, scale)
    np.testing.assert_allclose(missing, wanted_missing, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(weight, wanted_weight, rtol=1e-4, atol=1e-9)
    assert weight.max() <= 1.0


def plain_spread(p, q, first, last, bend):
    leaning = [(1 + p[at] ** 2 + q[at] ** 2) ** 2 for at in (first, last)]
    return 0.5 * (leaning[0] + leaning[1]) + (discontinuity._BEND * bend) ** 2


@pytest.mark.parametrize("stated", [False, True])
def test_variances(rng, stated):
    p, q = rng.normal(scale=0.5, size=(2, *SHAPE)).astype(np.float32)
    inside = rng.random(SHAPE) > 0.1
    error = rng.uniform(1.0, 30.0, SHAPE).astype(np.float32)
    errors = SlopeErrors(p=p, q=q, inside=inside, error_deg=error if stated else None)

    left, right, top, bottom = np.s_[:, :-1], np.s_[:, 1:], np.s_[:-1], np.s_[1:]
    spread = (
        plain_spread(p, q, left, right, np.diff(p, axis=1)),
        plain_spread(p, q, top, bottom, np.diff(q, axis=0)),
    )
    edge = inside[left] & inside[right], inside[top] & inside[bottom]
    along, down = p[left] + p[right], q[top] + q[bottom]
    square = edge[0][top] & edge[0][bottom]
    turns = np.where(square, 0.5 * np.abs(along[top] - along[bottom] + down[right] - down[left]), np.inf)
    around = spread[0][top] + spread[0][bottom] + spread[1][left] + spread[1][right]
    noise = 1.4826 * np.median((turns / np.sqrt(around))[square])
    for k, (first, last) in enumerate(((left, right), (top, bottom))):
        better = np.full((2, *edge[k].shape), np.inf)  # of the squares on either side of an edge
        before, after = ((top, bottom), (left, right))[k]
        better[0][after], better[1][before] = turns, turns
        better = better.min(axis=0)
        wanted = noise**2 * spread[k] + np.where(np.isfinite(better), better, 0.0) ** 2 / 16
        if stated:
            of_ends = 0.5 * (error[first] ** 2 + error[last] ** 2)
            wanted = np.maximum(wanted, (np.radians(1.0) / 2.146) ** 2 * of_ends * spread[k])
        np.testing.assert_allclose(errors.variance[k][first], np.where(edge[k], wanted, 0.0), rtol=1e-4)


def test_parts_that_normals_do_not_connect_lie_where_far_edges_say(rng):
    """Two planes, and between them columns whose slopes contradict each other. Every 10th edge is wrong."""
    p, q = rng.normal(scale=0.02, size=(2, 40, 60)).astype(np.float32)
    p[:, 28:48] = rng.uniform(-8.0, 8.0, (40, 20))
    rows = np.arange(40)
    far = FarEdges(
        first=np.stack([rows, np.full(40, 25)], axis=1),
        last=np.stack([rows, np.full(40, 52)], axis=1),
        difference=np.where(rows % 10 == 5, 65.0, 25.0),
        weight=np.full(40, 4.0),
    )
    errors = SlopeErrors(p=p, q=q, inside=np.ones(p.shape, bool), far=far)
    steps = []
    for each in (errors, replace(errors, far=None)):
        depth = JumpSolver(MaskedSolver(each.inside), each).solve(np.zeros(p.shape))
        steps.append(depth[:, 52:].mean() - depth[:, :25].mean())
    assert steps[0] == pytest.approx(25.0, abs=1.0)
    assert abs(steps[1] - 25.0) > 10.0  # without, chance decides
