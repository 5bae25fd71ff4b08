"""A triangle mesh of an implicit body: an isosurface, smoothed and pulled onto the surface in turns."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import Faces, FloatArray, IntArray, Points
from vntoolkit.geometry.mesh import isosurface
from vntoolkit.simulation.body.implicit import ImplicitBody

_ROUNDS = 3  # of smoothing and pulling back
_COARSE = 4  # cells of the search grid per side, in cells of the mesh


def mesh_from_implicit(
    body: ImplicitBody, low: FloatArray, high: FloatArray, cell: float
) -> tuple[Points, Faces]:
    """Return vertices (n, 3) and outward faces (m, 3) of the surface inside the box, cells of size `cell`."""
    counts = _COARSE * np.ceil((np.asarray(high) - low) / (_COARSE * cell)).astype(int) + 1
    values = _values_near_surface(body, np.asarray(low, dtype=np.float64), counts, cell)
    vertices, faces = isosurface(-values)
    vertices = low + cell * vertices
    for _ in range(_ROUNDS):
        vertices = _pull_onto_surface(body, _relaxed(vertices, faces), cell)
    return _pull_onto_surface(body, vertices, cell), faces


def _relaxed(vertices: Points, faces: Faces) -> Points:
    """Return every vertex moved half-way to the mean of its neighbours; a rim stays where it is."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = np.sort(edges, axis=1).astype(np.int64) @ [len(vertices), 1]
    _, place, times = np.unique(key, return_inverse=True, return_counts=True)
    count = np.bincount(edges[:, 0], minlength=len(vertices))
    mean = (
        np.stack(
            [np.bincount(edges[:, 0], vertices[edges[:, 1], a], minlength=len(vertices)) for a in range(3)],
            axis=1,
        )
        / np.maximum(count, 1)[:, None]
    )
    on_rim = np.zeros(len(vertices), dtype=bool)
    on_rim[edges[times[place] == 1]] = True
    return np.where(on_rim[:, None], vertices, 0.5 * (vertices + mean))


def _pull_onto_surface(body: ImplicitBody, vertices: Points, cell: float) -> Points:
    """Return the vertices after one Newton step along the gradient."""
    slope = body.gradient(vertices, 0.25 * cell)
    step = body.signed_distance(vertices) / np.maximum(np.sum(slope**2, axis=1), 0.1)
    return vertices - np.clip(step, -cell, cell)[:, None] * slope


def _values_near_surface(body: ImplicitBody, low: FloatArray, counts: IntArray, cell: float) -> FloatArray:
    """Return the grid of signed distances, in cells; exact only in blocks that the surface can cross."""
    blocks = (counts - 1) // _COARSE
    centres = _grid(blocks) * (_COARSE * cell) + low + 0.5 * _COARSE * cell
    distance = body.signed_distance(centres) / cell
    values = np.empty(tuple(counts))
    near = np.flatnonzero(np.abs(distance) < 1.3 * _COARSE)
    coarse = np.kron(distance.reshape(blocks), np.ones((_COARSE,) * 3))
    values[:-1, :-1, :-1] = coarse
    values[-1], values[:, -1], values[:, :, -1] = values[-2], values[:, -2], values[:, :, -2]
    corner = np.stack(np.unravel_index(near, blocks), axis=1) * _COARSE
    nodes = (corner[:, None] + _grid(np.full(3, _COARSE + 1)).astype(int)).reshape(-1, 3)
    flat = np.unique(np.ravel_multi_index(tuple(nodes.T), tuple(counts)))
    places = np.stack(np.unravel_index(flat, tuple(counts)), axis=1)
    values.ravel()[flat] = body.signed_distance(low + cell * places) / cell
    return values


def _grid(counts: IntArray) -> Points:
    return np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), -1).reshape(-1, 3) * 1.0
