"""Weighted graph Laplacians on a pixel grid, solved by conjugate gradients with a multigrid cycle.

The matrix is L = Σ_edges w_ij (e_i − e_j)(e_i − e_j)ᵀ + ground · I over the eight-neighbour edges of a grid.
Edge weights may be zero (pixels outside the mask, cut edges) or negative as long as L stays positive
semidefinite, which the assembly in `surface_kernels` guarantees.

One thread works: two would meet thousands of times a frame, and on a busy machine every meeting can cost a
time slice (measured: 35 s for what one thread does in 2).

A coarser level sums the edges between blocks of 2×2 pixels and halves them: in two dimensions that is the
matrix the coarse grid itself would have, while the plain Galerkin sum is twice too stiff for piecewise
constant prolongation (over-correction of aggregation multigrid, braess1995).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.shadows.grid_kernels import (
    Grid,
    apply_kernel,
    coarse_edges_kernel,
    diagonal_kernel,
    inverse_kernel,
    prolong_add_kernel,
    restrict_kernel,
    sweep_kernel,
)

_SMALLEST_SIDE = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class GridLevel:
    """One grid of the hierarchy: edges (4, h, w) float32 to the east, south, south-east and (stored at the
    upper left pixel of the 2×2 block) from the upper right to the lower left pixel; inverse (h, w) of the
    diagonal, 0 where a pixel has no edge.
    """

    edges: Grid
    inverse: Grid


def grid_hierarchy(edges: Grid) -> list[GridLevel]:
    """Build all levels from the finest edges (4, h, w)."""
    levels = []
    while True:
        levels.append(GridLevel(edges=edges, inverse=inverse_kernel(diagonal_kernel(edges))))
        if min(edges.shape[1:]) <= _SMALLEST_SIDE:
            return levels
        edges = coarse_edges_kernel(edges)


def solve_grid(
    levels: list[GridLevel], right: Grid, start: Grid, tolerance: float, most_iterations: int
) -> Grid:
    """Solve L x = right from `start` until the residual falls to `tolerance` of the right-hand side.

    right, start: (h, w) float32. Returns (h, w) float32, which after `most_iterations` may be short of the
    tolerance: a Gauss–Newton step need not be solved to the end.
    """
    x = start.astype(np.float32).copy()
    residual = right - apply_kernel(levels[0].edges, x)
    target = tolerance * float(np.linalg.norm(right))
    direction = np.zeros_like(x)
    previous = 0.0
    for _ in range(most_iterations):
        if float(np.linalg.norm(residual)) <= target:
            break
        cleaned = _cycle(levels, 0, residual)
        now = _dot(residual, cleaned)
        if not now > 0.0:
            break
        direction = cleaned if previous == 0.0 else cleaned + np.float32(now / previous) * direction
        previous = now
        image = apply_kernel(levels[0].edges, direction)
        curvature = _dot(direction, image)
        if not curvature > 0.0:
            break
        step = np.float32(now / curvature)
        x += step * direction
        residual -= step * image
    return x


def _dot(first: Grid, second: Grid) -> float:
    return float(np.vdot(first, second))


def _cycle(levels: list[GridLevel], depth: int, right: Grid) -> Grid:
    """One symmetric V cycle: a forward sweep, the coarse correction, a backward sweep."""
    level = levels[depth]
    x = np.zeros_like(right)
    sweeps = 1 if depth + 1 < len(levels) else 20
    for _ in range(sweeps):
        sweep_kernel(level.edges, level.inverse, right, x, True)
    if depth + 1 < len(levels):
        coarse_right = restrict_kernel(right - apply_kernel(level.edges, x))
        prolong_add_kernel(_cycle(levels, depth + 1, coarse_right), level.inverse, x)
    for _ in range(sweeps):
        sweep_kernel(level.edges, level.inverse, right, x, False)
    return x
