"""A domain as a graph: one node per pixel, one edge per pair of pixels that share a side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Mask

Int32 = npt.NDArray[np.int32]


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelGraph:
    """The edges of a domain and its adjacency.

    pixels: (n,) flat index of each node in the image, scan order. tail, head: (m,) nodes of each edge; first
    the `across` edges that go right, then those that go down. row_start (n+1,), neighbour (2m,), edge (2m,):
    for node i, slots row_start[i] … row_start[i+1] give its neighbours and the edges that lead to them.
    """

    pixels: npt.NDArray[np.int64]
    tail: Int32
    head: Int32
    across: int
    row_start: Int32
    neighbour: Int32
    edge: Int32


def graph_from_domain(domain: Mask) -> PixelGraph:
    """Build the graph of `domain`, (h, w) bool."""
    node = np.full(domain.shape, -1, dtype=np.int32)
    pixels = np.flatnonzero(domain)
    node.ravel()[pixels] = np.arange(len(pixels), dtype=np.int32)
    right, down = domain[:, :-1] & domain[:, 1:], domain[:-1] & domain[1:]
    tail = np.concatenate([node[:, :-1][right], node[:-1][down]])
    head = np.concatenate([node[:, 1:][right], node[1:][down]])
    row_start, neighbour, edge = _adjacency(tail, head, len(pixels))
    return PixelGraph(
        pixels=pixels,
        tail=tail,
        head=head,
        across=int(np.count_nonzero(right)),
        row_start=row_start,
        neighbour=neighbour,
        edge=edge,
    )


@numba.njit(cache=True)
def _adjacency(tail, head, count):  # type: ignore[no-untyped-def]
    row_start = np.zeros(count + 1, np.int32)
    for e in range(len(tail)):
        row_start[tail[e] + 1] += 1
        row_start[head[e] + 1] += 1
    for i in range(count):
        row_start[i + 1] += row_start[i]
    fill = row_start[:-1].copy()
    neighbour = np.empty(2 * len(tail), np.int32)
    edge = np.empty(2 * len(tail), np.int32)
    for e in range(len(tail)):
        i, j = tail[e], head[e]
        neighbour[fill[i]], edge[fill[i]] = j, e
        neighbour[fill[j]], edge[fill[j]] = i, e
        fill[i] += 1
        fill[j] += 1
    return row_start, neighbour, edge


def divergence_on_graph(
    graph: PixelGraph, weight: npt.NDArray[np.floating[Any]], difference: npt.NDArray[np.floating[Any]]
) -> npt.NDArray[np.float64]:
    """Right-hand side of the weighted least squares over edges, (n,): sums to 0 over every component."""
    load = np.zeros(len(graph.pixels))
    _accumulate(graph.tail, graph.head, weight * difference, load)
    return load


@numba.njit(cache=True)
def _accumulate(tail, head, flow, out):  # type: ignore[no-untyped-def]
    for e in range(len(flow)):
        out[head[e]] += flow[e]
        out[tail[e]] -= flow[e]
