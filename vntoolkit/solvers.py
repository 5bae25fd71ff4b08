"""Weighted graph Laplacians on a pixel grid, solved by conjugate gradients with a multigrid cycle.

The matrix is L = Σ_edges w_ij (e_i − e_j)(e_i − e_j)ᵀ + ground · I over the eight-neighbour edges of a grid.
Edge weights may be zero (pixels outside the mask, cut edges) or negative as long as L stays positive
semidefinite, which the assembly in `geometry/slope_grid.py` guarantees.

Pixels are swept in four colours, by whether row and column are even: no two of one colour share an edge, so
that the compiler does eight at a time. One thread works: frames are what is spread over the cores.

A coarser level sums the edges between blocks of 2×2 pixels and halves them: in two dimensions that is the
matrix the coarse grid itself would have. Corrections are interpolated linearly between blocks, less across
an edge that is weaker than the one inside the block, not at all across a cut one. Each pixel's value taken
from its block alone needs half as many cycles more, or two thirds.

All images within have a rim of zeros, so that no loop asks for a border.
"""

from typing import NamedTuple

import numpy as np

from vntoolkit.arrays import Box, Float32Array, box_of
from vntoolkit.native import njit

_SMALLEST_SIDE = 4
_LAST_SWEEPS = 4  # on the coarsest grid, each way
Grid = Float32Array
Row = Float32Array
_GROUND = np.float32(1e-6)  # pins the free constant of every connected piece; far below any data weight
_WEAK = np.float32(0.05)  # share of an edge in all edges of its pixel; .03 to .1 need as many cycles


class GridLevel(NamedTuple):
    """One grid, with a rim of zeros.

    edges: (4, h + 2, w + 2) to the east, south, south-east and (stored at the upper left pixel of the 2×2
    block) from the upper right to the lower left pixel, or 2 without the diagonal ones. inverse: (h + 2,
    w + 2), 1 over the diagonal; 0 where a pixel has no edge: it belongs to nothing and stays at 0. shares:
    (3, h + 2, w + 2), of the pixel's own block, the block beside and the one above or below in its
    correction.
    """

    edges: Grid
    inverse: Grid
    shares: Grid


class GridHierarchy(NamedTuple):
    """Grids, each about half as high and wide as the one before, of the part of an image that has edges."""

    box: Box
    levels: tuple[GridLevel, ...]


def grid_hierarchy(edges: Grid) -> GridHierarchy:
    """Build all grids from the finest edges, (4, h, w) or (2, h, w); those that leave the grid are 0."""
    rows, columns = box_of((edges != 0).any(axis=0))
    box = slice(rows.start, rows.stop + 1), slice(columns.start, columns.stop + 1)  # where edges end
    edges, levels = edges[:, *box], []
    while True:
        levels.append(_level_of(edges))
        if min(edges.shape[1:]) <= _SMALLEST_SIDE:
            return GridHierarchy(box, tuple(levels))
        edges = coarse_edges(edges)


def solve_grid(
    grids: GridHierarchy, right: Grid, start: Grid, tolerance: float, most_iterations: int
) -> Grid:
    """Solve L x = right from `start` until the residual falls to `tolerance` of the right-hand side.

    right, start: (h, w) float32. Returns (h, w) float32, which after `most_iterations` may be short of the
    tolerance: a Gauss–Newton step need not be solved to the end.
    """
    box, levels = grids
    edges, x, residual = levels[0].edges, _rimmed(start[box]), _rimmed(right[box])
    target = tolerance**2 * _dot(residual, residual)
    residual -= _product(edges, x)
    direction, previous = np.zeros_like(x), np.inf
    for _ in range(most_iterations):
        if _dot(residual, residual) <= target:
            break
        correction = _cycle(levels, residual)
        energy = _dot(residual, correction)
        if not energy > 0.0:
            break
        direction *= np.float32(energy / previous)
        direction += correction
        previous = energy
        image = _product(edges, direction)
        curvature = _dot(direction, image)
        if not curvature > 0.0:
            break
        step = np.float32(energy / curvature)
        x += step * direction
        residual -= step * image
    solved = start.copy()
    solved[box] = x[1:-1, 1:-1]
    return solved


def multigrid_cycle(grids: GridHierarchy, right: Grid) -> Grid:
    """Approximate the x of L x = right by one symmetric V cycle."""
    solved = np.zeros_like(right)
    solved[grids.box] = _cycle(grids.levels, _rimmed(right[grids.box]))[1:-1, 1:-1]
    return solved


def _cycle(levels: tuple[GridLevel, ...], right: Grid) -> Grid:
    (edges, inverse, shares), coarser = levels[0], levels[1:]
    x = np.zeros_like(right)
    if not coarser:
        for k in range(2 * _LAST_SWEEPS):
            _sweep_kernel(edges, inverse, right, k < _LAST_SWEEPS, x)
        return x
    _sweep_kernel(edges, inverse, right, True, x)
    asked = np.zeros_like(coarser[0].inverse)
    _restrict_kernel(shares, right - _product(edges, x), asked)
    _prolong_kernel(shares, _cycle(coarser, asked), x)
    _sweep_kernel(edges, inverse, right, False, x)
    return x


def _rimmed(image: Grid) -> Grid:
    """Return (…, h + 2, w + 2), with a rim of zeros."""
    out = np.zeros((*image.shape[:-2], image.shape[-2] + 2, image.shape[-1] + 2), np.float32)
    out[..., 1:-1, 1:-1] = image
    return out


def _dot(first: Grid, second: Grid) -> float:
    return float(np.einsum("vu,vu->v", first, second).sum(dtype=np.float64))


def _product(edges: Grid, x: Grid) -> Grid:
    """Return L x."""
    out = np.zeros_like(x)
    _product_kernel(edges, x, out)
    return out


def coarse_edges(edges: Grid) -> Grid:
    """Return half the sum of the edges between blocks of 2×2 pixels; those inside one drop out."""
    kinds, height, width = edges.shape
    even = np.zeros((kinds, height + height % 2, width + width % 2), np.float32)
    even[:, :height, :width] = edges
    upper, lower = even[:, ::2], even[:, 1::2]
    out = np.empty((kinds, *upper.shape[1:2], upper.shape[2] // 2), np.float32)
    out[0] = upper[0, :, 1::2] + lower[0, :, 1::2]
    out[1] = lower[1, :, ::2] + lower[1, :, 1::2]
    if kinds == 4:
        out[0] += upper[2, :, 1::2] + upper[3, :, 1::2]
        out[1] += lower[2, :, ::2] + lower[3, :, ::2]
        out[2:] = lower[2:, :, 1::2]
    out *= np.float32(0.5)
    return out


def _level_of(edges: Grid) -> GridLevel:
    """Return a grid of its edges (kinds, h, w)."""
    padded = _rimmed(edges)
    inverse, shares = np.zeros_like(padded[0]), np.zeros((3, *padded.shape[1:]), np.float32)
    _level_kernel(padded, inverse, shares)
    return GridLevel(padded, inverse, shares)


# Compiled loops over images with a rim of zeros.


@njit
def _level_kernel(edges: Grid, inverse: Grid, shares: Grid) -> None:
    """Fill what `GridLevel` holds beside the edges."""
    one = np.float32(1.0)
    h, w = inverse.shape
    for v in range(1, h - 1):
        for u in range(1, w - 1):
            east, west, south, north = edges[0, v, u], edges[0, v, u - 1], edges[1, v, u], edges[1, v - 1, u]
            diagonal = _GROUND + (east + west) + (south + north)
            if len(edges) == 4:
                diagonal += (edges[2, v, u] + edges[2, v - 1, u - 1]) + (
                    edges[3, v, u - 1] + edges[3, v - 1, u]
                )
            if diagonal > 2 * _GROUND:
                inverse[v, u] = one / diagonal
                beside = _share(west, east, diagonal) if u % 2 else _share(east, west, diagonal)
                along = _share(north, south, diagonal) if v % 2 else _share(south, north, diagonal)
                over = max(beside + along, one)
                shares[0, v, u] = one - (beside + along) / over
                shares[1, v, u], shares[2, v, u] = beside / over, along / over


@njit
def _share(outer: np.float32, within: np.float32, diagonal: np.float32) -> np.float32:
    """Return the share of the next block: a quarter where all edges are alike, as between blocks' centres.

    outer, within: the pixel's edges to the next block and within its own. The share is less where the edge to
    the next block is weak among all edges of the pixel. That block may be almost free. Then its correction is
    large, and pixels that take it over make it larger on every finer grid.
    """
    zero = np.float32(0.0)
    return max(outer, zero) / (max(outer, zero) + np.float32(3.0) * max(within, zero) + _WEAK * diagonal)


@njit
def _product_kernel(edges: Grid, x: Grid, out: Grid) -> None:
    h, w = x.shape
    for v in range(1, h - 1):
        here, above, below, to = x[v, 1 : w - 1], x[v - 1], x[v + 1], out[v, 1 : w - 1]
        to_east, to_west, down, up = edges[0, v, 1:], edges[0, v], edges[1, v, 1:], edges[1, v - 1, 1:]
        west, east, north, south = x[v], x[v, 2:], above[1:], below[1:]
        for u in range(w - 2):
            to[u] = (
                _GROUND * here[u] + to_east[u] * (here[u] - east[u]) + to_west[u] * (here[u] - west[u])
                + down[u] * (here[u] - south[u]) + up[u] * (here[u] - north[u])
            )  # fmt: skip
        if len(edges) == 4:
            to_east, to_west, down, up = edges[2, v, 1:], edges[2, v - 1], edges[3, v], edges[3, v - 1, 1:]
            for u in range(w - 2):
                to[u] += (
                    to_east[u] * (here[u] - below[u + 2]) + to_west[u] * (here[u] - above[u])
                    + down[u] * (here[u] - below[u]) + up[u] * (here[u] - above[u + 2])
                )  # fmt: skip


@njit
def _sweep_kernel(edges: Grid, inverse: Grid, right: Grid, forward: bool, x: Grid) -> None:
    """One Gauss–Seidel sweep over the four colours; backward, the reverse of that."""
    h, w = x.shape
    known, sums = np.empty(w - 2, np.float32), np.empty(w - 2, np.float32)
    for k in range(2):
        for v in range(1 + (k if forward else 1 - k), h - 1, 2):
            here, west, east, above, below = x[v, 1 : w - 1], x[v], x[v, 2:], x[v - 1], x[v + 1]
            asked, scale, south, north = right[v, 1:], inverse[v, 1:], below[1:], above[1:]
            down, up = edges[1, v, 1:], edges[1, v - 1, 1:]
            for u in range(w - 2):
                known[u] = asked[u] + down[u] * south[u] + up[u] * north[u]
            if len(edges) == 4:
                to_east, to_west, down, up = (
                    edges[2, v, 1:], edges[2, v - 1], edges[3, v], edges[3, v - 1, 1:]
                )  # fmt: skip
                for u in range(w - 2):
                    known[u] += (
                        to_east[u] * below[u + 2] + to_west[u] * above[u]
                        + down[u] * below[u] + up[u] * above[u + 2]
                    )  # fmt: skip
            to_east, to_west = edges[0, v, 1:], edges[0, v]
            for colour in range(2):
                parity = colour if forward else 1 - colour
                for u in range(w - 2):
                    sums[u] = known[u] + to_east[u] * east[u] + to_west[u] * west[u]
                for u in range(w - 2):
                    here[u] = sums[u] * scale[u] if u & 1 == parity else here[u]


@njit
def _restrict_kernel(shares: Grid, residual: Grid, coarse: Grid) -> None:
    """Fill with the residuals of the pixels whose corrections a block gives: the transpose of prolonging."""
    h, w = residual.shape
    within, across = np.zeros(w + 2, np.float32), np.zeros(w + 2, np.float32)
    for block in range(1, coarse.shape[0] - 1):
        first, last = 2 * block - 1, min(2 * block, h - 2)
        within[:], across[:] = np.float32(0.0), np.float32(0.0)
        for v in range(max(first - 1, 0), min(last + 2, h)):
            left, beside = residual[v], shares[1, v]
            share = shares[0, v] if first <= v <= last else shares[2, v]
            for u in range(w):
                within[u] += share[u] * left[u]
            if first <= v <= last:
                for u in range(w):
                    across[u] += beside[u] * left[u]
        to = coarse[block]
        for k in range(1, len(to) - 1):
            to[k] = within[2 * k - 1] + within[2 * k] + across[2 * k - 2] + across[2 * k + 1]


@njit
def _prolong_kernel(shares: Grid, coarse: Grid, x: Grid) -> None:
    """Add the coarser grid's correction."""
    h, w = x.shape
    for v in range(1, h - 1):
        row, other_row = coarse[(v + 1) // 2], coarse[(v + 1) // 2 + (-1 if v % 2 else 1)]
        to, own, beside, along = x[v], shares[0, v], shares[1, v], shares[2, v]
        for first in range(1, 3):  # the columns of blocks' first pixels, and of their last
            there = row[2 * first - 2 :]  # the block before, and the one after
            for k in range((w - first) // 2):
                u = 2 * k + first
                to[u] += own[u] * row[k + 1] + beside[u] * there[k] + along[u] * other_row[k + 1]
