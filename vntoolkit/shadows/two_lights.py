"""Normals from two lights under a known albedo: the quadratic of Onn and Bruckstein (onn1990)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from vntoolkit.arrays import FloatArray, Mask, Normals, VisibilityLabels
from vntoolkit.photometry.frame import ALL_LIT
from vntoolkit.shadows.lengths import lengths_of

_PAIRS = ((1, 2, 6), (0, 2, 5), (0, 1, 3))  # the two lights that remain, and the label that says so


def roots_from_two_lights(
    first: FloatArray, second: FloatArray, light_first: FloatArray, light_second: FloatArray
) -> tuple[Normals, Normals, FloatArray]:
    """Solve l₁·n = first, l₂·n = second, |n| = 1 (onn1990, equation 5).

    first, second: (...,), contributions over the albedo. light_*: (3,), direction times strength. Returns the
    two unit normals (..., 3) and the discriminant 1 − |n₀|² (...,), n₀ the part of n in the lights' plane;
    where it is negative no normal is bright enough, and both roots are n₀ brought to unit length.
    """
    lights = np.stack([light_first, light_second])
    across = np.cross(light_first, light_second)
    across = across / np.linalg.norm(across)
    values = np.stack([first, second], axis=-1)
    in_plane: FloatArray = values @ np.linalg.pinv(lights).T
    discriminant = 1.0 - np.sum(in_plane**2, axis=-1)
    reach = np.sqrt(np.maximum(discriminant, 0.0))[..., None] * across
    plus, minus = in_plane + reach, in_plane - reach
    return _unit(plus), _unit(minus), discriminant


def continue_with_two_lights(
    normals: Normals, relative: FloatArray, labels: VisibilityLabels, lights: FloatArray, mask: Mask
) -> tuple[Normals, Mask]:
    """Fill in the pixels that two lights reach, choosing roots by continuity from the fully lit ones inwards.

    normals: (h, w, 3), right where the label is 7. relative: (h, w, 3), contributions over the albedo.
    Returns the normals and the mask of decided pixels; shadows that touch no lit pixel take the root
    that faces the viewer more.
    """
    roots = np.zeros((*mask.shape, 2, 3))
    for i, j, label in _PAIRS:
        here = mask & (labels == label)
        plus, minus, _ = roots_from_two_lights(
            relative[here][:, i], relative[here][:, j], lights[i], lights[j]
        )
        roots[here] = np.stack([plus, minus], axis=1)
    out = np.array(normals, dtype=np.float64)
    two = mask & np.isin(labels, [pair[2] for pair in _PAIRS])
    decided = mask & (labels == ALL_LIT)
    _propagate(out, roots, two, decided)
    rest = two & ~decided
    facing = np.where(roots[rest][:, :1, 2] <= roots[rest][:, 1:, 2], roots[rest][:, 0], roots[rest][:, 1])
    out[rest] = facing
    return out, decided | rest


@njit(cache=True)
def _propagate(
    normals: npt.NDArray[np.float64],
    roots: npt.NDArray[np.float64],
    two: npt.NDArray[np.bool_],
    decided: npt.NDArray[np.bool_],
) -> None:
    """Breadth first from the decided pixels: each takes the root nearer to its decided neighbours' mean."""
    h, w = two.shape
    queue = np.empty((h * w, 2), np.int64)
    queued = np.zeros((h, w), np.bool_)
    head, tail = 0, 0
    for v in range(h):
        for u in range(w):
            if two[v, u] and _beside(decided, v, u):
                queue[tail, 0], queue[tail, 1] = v, u
                queued[v, u] = True
                tail += 1
    while head < tail:
        v, u = queue[head, 0], queue[head, 1]
        head += 1
        mean = np.zeros(3)
        for i in range(max(v - 1, 0), min(v + 2, h)):
            for j in range(max(u - 1, 0), min(u + 2, w)):
                if decided[i, j]:
                    mean += normals[i, j]
        better = 0 if np.sum(roots[v, u, 0] * mean) >= np.sum(roots[v, u, 1] * mean) else 1
        normals[v, u] = roots[v, u, better]
        decided[v, u] = True
        for i in range(max(v - 1, 0), min(v + 2, h)):
            for j in range(max(u - 1, 0), min(u + 2, w)):
                if two[i, j] and not queued[i, j]:
                    queue[tail, 0], queue[tail, 1] = i, j
                    queued[i, j] = True
                    tail += 1


@njit(cache=True)
def _beside(decided: npt.NDArray[np.bool_], v: int, u: int) -> bool:
    h, w = decided.shape
    for i in range(max(v - 1, 0), min(v + 2, h)):
        for j in range(max(u - 1, 0), min(u + 2, w)):
            if decided[i, j]:
                return True
    return False


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(lengths_of(vectors), 1e-12)
