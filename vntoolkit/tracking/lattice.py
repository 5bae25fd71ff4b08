"""A lattice of cells on the template: sums over cells, smoothing between them, and back to the vertices.

A node is one connected piece of the surface within one square cell, so that neither a seam nor a gap in the
mask lets one side look at the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from vntoolkit.arrays import FloatArray, Points2
from vntoolkit.tracking.template import TrackingTemplate

NODES_BY_PASS = 4.2  # that smoothing averages: 4π σ², with σ² a third of a squared cell by pass


@dataclass(frozen=True, kw_only=True, eq=False)
class TemplateLattice:
    """Cells of the template and how they hang together.

    node_of_vertex: (n,). taps, shares: (n, 4) nodes whose values make a vertex's, and their weights, which
    sum to 1. adjacency: (nodes, nodes), 1 for neighbours. cells: (nodes, 2) column and row of each node's
    cell, cell_px its side. count: number of nodes.
    """

    node_of_vertex: npt.NDArray[np.int32]
    taps: npt.NDArray[np.int32]
    shares: npt.NDArray[np.float32]
    adjacency: sp.csr_array
    cells: npt.NDArray[np.int64]
    cell_px: int
    count: int

    def sums(self, values: FloatArray) -> npt.NDArray[np.float64]:
        """Return (nodes, k) sums of the vertices' values (n, k)."""
        columns = [np.bincount(self.node_of_vertex, each, self.count) for each in values.T]
        return np.stack(columns, axis=1)

    def smoothed(self, values: FloatArray, passes: int) -> npt.NDArray[np.float64]:
        """Return (nodes, k) values plus half of each neighbour's, `passes` times: a growing window."""
        out = np.asarray(values, dtype=np.float64)
        for _ in range(passes):
            out = out + 0.5 * (self.adjacency @ out)
        return out

    def at_vertices(self, values: FloatArray) -> npt.NDArray[np.float64]:
        """Return (n, k) values interpolated from the nodes' (nodes, k), bilinear within each piece."""
        return self._interpolation @ np.asarray(values, dtype=np.float64)

    @cached_property
    def edges(self) -> npt.NDArray[np.int64]:
        """(edges, 2) nodes that are neighbours, each pair once."""
        return np.stack(sp.triu(self.adjacency).nonzero(), axis=1).astype(np.int64)

    @cached_property
    def _interpolation(self) -> sp.csr_array:
        n = len(self.taps)
        entries = self.shares.ravel().astype(np.float64), self.taps.ravel(), 4 * np.arange(n + 1)
        return sp.csr_array(entries, shape=(n, self.count))


def lattice_on_template(template: TrackingTemplate, cell_px: int) -> TemplateLattice:
    """Lay cells of cell_px × cell_px pixels over the template."""
    cells = template.pixels // cell_px
    columns = int(cells[:, 0].max()) + 1
    cell = cells[:, 1].astype(np.int64) * columns + cells[:, 0]
    first, second = template.edges[:, 0], template.edges[:, 1]
    count = len(cell)
    within = cell[first] == cell[second]
    pieces = sp.coo_array(
        (np.ones(int(within.sum()), dtype=np.int8), (first[within], second[within])), shape=(count, count)
    )
    nodes, node = connected_components(pieces, directed=False)
    edges = _edges(node[first], node[second], nodes)
    cell_of_node = np.zeros(nodes, dtype=np.int64)
    cell_of_node[node] = cell
    taps, shares = _taps(template.pixels, cell_px, columns, node, cell_of_node, edges)
    return TemplateLattice(
        node_of_vertex=node.astype(np.int32),
        taps=taps,
        shares=shares,
        adjacency=edges.astype(np.float64),
        cells=np.stack([cell_of_node % columns, cell_of_node // columns], axis=1),
        cell_px=cell_px,
        count=int(nodes),
    )


def _edges(a: npt.NDArray[np.int64], b: npt.NDArray[np.int64], count: int) -> sp.csr_array:
    """Adjacency of `count` nodes by pairs a, b (n,) of which some are equal."""
    a, b = a[a != b], b[a != b]
    ones = np.ones(2 * len(a), dtype=np.int8)
    edges = sp.csr_array((ones, (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(count, count))
    edges.sum_duplicates()
    edges.data[:] = 1
    return edges


class LocalJacobians:
    """Fits the Jacobian at every node; what hangs on the template alone is computed once."""

    def __init__(self, lattice: TemplateLattice, pixels: Points2) -> None:
        """Sum the moments of the template's pixels (n, 2)."""
        self._lattice = lattice
        self._centre = pixels.mean(axis=0)
        self._x = pixels - self._centre
        ones = np.ones((len(pixels), 1))
        x, y = self._x[:, :1], self._x[:, 1:]
        sums = lattice.smoothed(lattice.sums(np.hstack([ones, x, y, x * x, x * y, y * y])), 1)
        self._count, self._mean = sums[:, 0], sums[:, 1:3] / sums[:, :1]
        xx = sums[:, 3] - self._count * self._mean[:, 0] ** 2
        xy = sums[:, 4] - self._count * self._mean[:, 0] * self._mean[:, 1]
        yy = sums[:, 5] - self._count * self._mean[:, 1] ** 2
        ridge = self._count  # of one pixel²: a piece too thin to measure keeps the identity
        xx, yy = xx + ridge, yy + ridge
        determinant = xx * yy - xy * xy
        self._inverse = np.stack([yy, -xy, -xy, xx], axis=1).reshape(-1, 2, 2) / determinant[:, None, None]

    def of(self, positions_px: Points2) -> npt.NDArray[np.float64]:
        """Return (nodes, 4): ∂u/∂x, ∂u/∂y, ∂v/∂x, ∂v/∂y of positions (n, 2) by the template's pixels."""
        moved = positions_px - self._centre - self._x
        moments = np.hstack([moved, moved[:, :1] * self._x, moved[:, 1:] * self._x])
        sums = self._lattice.smoothed(self._lattice.sums(moments), 1)
        mixed = sums[:, 2:].reshape(-1, 2, 2) - sums[:, :2, None] * self._mean[:, None, :]
        return np.asarray((mixed @ self._inverse + np.eye(2)).reshape(-1, 4))


def _taps(
    pixels: npt.NDArray[np.int32],
    cell_px: int,
    columns: int,
    node: npt.NDArray[np.int32],
    cell_of_node: npt.NDArray[np.int64],
    edges: sp.csr_array,
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]:
    """Of the four cells around each vertex, the pieces that its own reaches in two steps, or its own."""
    own = np.arange(len(cell_of_node))
    beside, two_away = np.repeat(own, np.diff(edges.indptr)), edges[edges.indices]
    starts = np.concatenate([own, beside, np.repeat(beside, np.diff(two_away.indptr))])
    reached = np.concatenate([own, edges.indices, two_away.indices])
    cells = int(cell_of_node.max()) + 1
    known, nearest = np.unique(starts * cells + cell_of_node[reached], return_index=True)
    place = (pixels + 0.5) / cell_px - 0.5
    low = np.floor(place).astype(np.int64)
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    u, v = np.moveaxis(low[:, None] + corners, -1, 0)
    wanted = v * columns + u
    inside = (u >= 0) & (u < columns) & (wanted >= 0) & (wanted < cells)
    codes = node[:, None].astype(np.int64) * cells + wanted
    found = np.minimum(np.searchsorted(known, codes), len(known) - 1)
    inside &= known[found] == codes
    part = (place - low)[:, None]
    shares = (inside * np.where(corners, part, 1.0 - part).prod(axis=2)).astype(np.float32)
    taps = np.where(inside, reached[nearest[found]], 0).astype(np.int32)
    return taps, shares / shares.sum(axis=1, keepdims=True)
