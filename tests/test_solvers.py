"""The multigrid solver against dense algebra."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from vntoolkit.solvers import (
    grid_hierarchy,
    multigrid_cycle,
    solve_grid,
)


def test_grid_solver_solves_what_a_dense_solver_solves(rng: np.random.Generator) -> None:
    edges = random_edges(rng, 4, 9, 7)
    dense = dense_matrix(edges)
    right = rng.normal(size=(9, 7)).astype(np.float32)
    right -= right.mean()
    found = solve_grid(grid_hierarchy(edges), right, np.zeros_like(right), 1e-7, 100)
    # Constants, and they alone, are what `dense` sends to zero; kept at zero, they leave one solution.
    expected = np.linalg.solve(dense + np.full_like(dense, 1 / 63), right.ravel()).reshape(9, 7)
    assert np.abs((found - found.mean()) - (expected - expected.mean())).max() < 1e-4


def dense_matrix(edges: np.ndarray) -> np.ndarray:
    """The Laplacian of edges (kinds, h, w) to the east, south, south-east and south-west."""
    _, h, w = edges.shape
    ends = ((0, 0, 0, 1), (0, 0, 1, 0), (0, 0, 1, 1), (0, 1, 1, 0))
    dense = np.zeros((h * w, h * w))
    for kind, v, u in np.argwhere(edges != 0):
        dv1, du1, dv2, du2 = ends[kind]
        i, j = (v + dv1) * w + u + du1, (v + dv2) * w + u + du2
        dense[[i, j], [i, j]] += edges[kind, v, u]
        dense[[i, j], [j, i]] -= edges[kind, v, u]
    return dense


def random_edges(rng: np.random.Generator, kinds: int, h: int, w: int) -> np.ndarray:
    edges = rng.random((kinds, h, w)).astype(np.float32)
    edges[0, :, -1] = edges[1, -1] = edges[2:, :, -1] = edges[2:, -1] = 0
    return edges


@pytest.mark.parametrize("kinds", [2, 4])
def test_five_cycles_inside_a_mask_leave_less_than_a_thousandth(rng: np.random.Generator, kinds: int) -> None:
    """A disc on a grid that memory left full of NaN, whose rows begin and end anywhere."""
    v, u = np.mgrid[:43, :38]
    mask = (u - 20) ** 2 + (v - 19) ** 2 < 17**2
    edges = 0.5 + 0.5 * random_edges(rng, kinds, 43, 38)
    for kind, (dv, du) in enumerate(((0, 1), (1, 0), (1, 1), (1, 1))[:kinds]):
        here, there = (mask, np.roll(mask, (-dv, -du), (0, 1)))
        if kind == 3:
            here, there = np.roll(mask, -1, 1), np.roll(mask, -1, 0)
        edges[kind] *= here & there
    right = np.where(mask, rng.normal(size=mask.shape), 0).astype(np.float32)
    right[mask] -= right[mask].mean()
    levels = grid_hierarchy(edges)
    levels.flat[levels.places[0, 2] + 3 * mask.size :][: 2 * mask.size] = np.nan
    found = solve_grid(levels, right, np.zeros_like(right), 0.0, 5)
    left = right.ravel() - dense_matrix(edges) @ found.ravel()
    assert np.linalg.norm(left) < 5e-4 * np.linalg.norm(right)
    assert not found[~mask].any()


@pytest.mark.parametrize("weak", [1e-4, 1e-3])
def test_blocks_on_a_weak_edge_do_not_spoil_the_correction(rng: np.random.Generator, weak: float) -> None:
    """Blocks of four lone pixels, one of them tied to a pixel that is cut off from its own block."""
    edges = random_edges(rng, 2, 40, 40)
    edges += 0.5 * (edges > 0)
    lone, tied = np.zeros((40, 40), bool), np.zeros((40, 40), bool)
    tied[2:38:6, 3:36:8] = True
    for dv, du in ((0, 0), (1, 0), (0, -1), (1, -1)):
        lone |= np.roll(tied, (dv, du), (0, 1))
    edges[0][lone | np.roll(lone, -1, 1) | np.roll(tied, 1, 1)] = edges[1][lone | np.roll(lone, -1, 0)] = 0
    edges[0][tied] = weak
    right = dense_matrix(edges) @ np.where(lone, 0, rng.normal(size=lone.shape)).ravel()
    asked = right.reshape(lone.shape).astype(np.float32)
    found = solve_grid(grid_hierarchy(edges), asked, np.zeros_like(asked), 0.0, 4)
    assert np.linalg.norm(right - dense_matrix(edges) @ found.ravel()) < 1e-3 * np.linalg.norm(right)


def test_a_cycle_is_symmetric_and_the_same_for_every_number_of_threads(rng: np.random.Generator) -> None:
    """Of a grid so large that it is swept in two halves."""
    edges = random_edges(rng, 4, 230, 181)
    levels = grid_hierarchy(edges)
    first, second = (rng.normal(size=(230, 181)).astype(np.float32) for _ in range(2))
    one, other = multigrid_cycle(levels, first), multigrid_cycle(levels, second)
    across, back = float(np.vdot(second, one)), float(np.vdot(first, other))
    size = float(np.linalg.norm(first) * np.linalg.norm(other))
    assert across == pytest.approx(back, abs=1e-5 * size)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    assert np.array_equal(multigrid_cycle(levels, first), one)
    numba.set_num_threads(threads)
