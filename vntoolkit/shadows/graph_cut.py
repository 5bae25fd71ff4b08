"""One binary label per pixel, smooth over the image, by a minimum cut (boykov2001)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from vntoolkit.arrays import FloatArray, Mask

_WEAKEST_BOND = 0.05  # share of the full price that a change of label across a sharp edge still costs
_DARK_SHARE = 0.03  # added to a share before its logarithm: noise is no edge
Grid = npt.NDArray[np.float32]
Signs = npt.NDArray[np.int8]


def lit_by_cut(
    evidence: FloatArray, bonds: tuple[FloatArray, FloatArray], mask: Mask
) -> npt.NDArray[np.bool_]:
    """Minimise Σ |evidence| over pixels labelled against it plus the bonds cut.

    evidence: (h, w), positive speaks for light, negative for shadow. bonds: to the east and to the south
    neighbour, (h, w) each, the price of a change there. Returns (h, w), True where lit (and outside `mask`).
    """
    pull = np.where(mask, evidence, 0.0).astype(np.float32)
    if not (pull < 0).any():
        return np.ones(mask.shape, dtype=np.bool_)
    if not (pull > 0).any():
        return ~mask
    east, south = (np.ascontiguousarray(bond, dtype=np.float32) for bond in bonds)
    signs, pull = sure_labels(pull, east, south)
    lit = signs > 0
    left = signs == 0
    if left.any():
        lit[left] = _lit_of_undecided(left, pull, east, south)
    return lit | ~mask


def _lit_of_undecided(
    left: Mask, pull: FloatArray, east: FloatArray, south: FloatArray
) -> npt.NDArray[np.bool_]:
    """Cut the graph of the pixels of `left` alone; return their labels, row by row."""
    import maxflow

    graph = maxflow.GraphFloat()
    number = np.full(left.shape, -1, dtype=np.int64)
    number[left] = graph.add_nodes(int(np.count_nonzero(left)))
    for bond, axis in ((east, 1), (south, 0)):
        first, second = (slice(None), slice(-1)), (slice(None), slice(1, None))
        if axis == 0:
            first, second = first[::-1], second[::-1]
        both = left[first] & left[second]
        price = bond[first][both]
        graph.add_edges(number[first][both], number[second][both], price, price)
    own = pull[left]
    graph.add_grid_tedges(number[left], np.maximum(own, 0.0), np.maximum(-own, 0.0))
    graph.maxflow()
    segments: npt.NDArray[np.bool_] = ~graph.get_grid_segments(number[left])
    return segments


def bonds_of_light(
    shares: FloatArray, light: int, mask: Mask, strength: float, contrast: float
) -> tuple[FloatArray, FloatArray]:
    """Bonds that give way where this light alone changes: paint and folds change the other lights too.

    shares: (h, w, 3). strength: full price. contrast: difference of log shares, between this light and the
    more similar of the other two, at which a bond falls to 1/e.
    """
    logarithm = np.log(np.maximum(shares, 0.0) + _DARK_SHARE)
    others = [k for k in range(3) if k != light]
    bonds = []
    for axis in (1, 0):
        change = np.diff(logarithm, axis=axis)
        own = change[..., light]
        alone = np.minimum(np.abs(own - change[..., others[0]]), np.abs(own - change[..., others[1]]))
        bond = strength * (_WEAKEST_BOND + (1 - _WEAKEST_BOND) * np.exp(-((alone / contrast) ** 2)))
        inside = mask[:, 1:] & mask[:, :-1] if axis == 1 else mask[1:] & mask[:-1]
        bonds.append(np.pad(bond * inside, ((0, 0), (0, 1)) if axis == 1 else ((0, 1), (0, 0))))
    return bonds[0], bonds[1]


# Pixels whose label in a minimum cut is known before cutting.


def sure_labels(evidence: Grid, east: Grid, south: Grid) -> tuple[Signs, Grid]:
    """Return (h, w): 1 lit for sure, −1 in shadow for sure, 0 undecided; and the evidence for the undecided.

    evidence: (h, w), positive speaks for light. east, south: (h, w), the price of a change towards the next
    pixel there; 0 in the last column and row. What settled neighbours ask for is part
    of the evidence returned.
    """
    pull, across, down = (np.pad(values, 1) for values in (evidence, east, south))
    signs = np.zeros(pull.shape, np.int8)
    _settle_all(signs, pull, across, down, np.empty((evidence.size, 2), np.int32))
    return signs[1:-1, 1:-1], pull[1:-1, 1:-1]


@njit(cache=True)
def _settle_all(signs: Signs, pull: Grid, east: Grid, south: Grid, waiting: npt.NDArray[np.int32]) -> None:
    """Everything has a border of one pixel, so that every pixel has four neighbours."""
    h, w = signs.shape
    for v in range(1, h - 1):
        for u in range(1, w - 1):
            bonds = east[v, u] + east[v, u - 1] + south[v, u] + south[v - 1, u]
            if abs(pull[v, u]) >= bonds:
                signs[v, u] = 1 if pull[v, u] >= 0.0 else -1
    for v in range(1, h - 1):
        for u in range(1, w - 1):
            count = 0
            if signs[v, u] == 0:
                count = _settle(signs, pull, east, south, v, u, waiting, count)
            while count > 0:
                count -= 1
                i, j = waiting[count, 0], waiting[count, 1]
                if signs[i, j - 1] == 0 and j > 1:
                    count = _settle(signs, pull, east, south, i, j - 1, waiting, count)
                if signs[i, j + 1] == 0 and j < w - 2:
                    count = _settle(signs, pull, east, south, i, j + 1, waiting, count)
                if signs[i - 1, j] == 0 and i > 1:
                    count = _settle(signs, pull, east, south, i - 1, j, waiting, count)
                if signs[i + 1, j] == 0 and i < h - 2:
                    count = _settle(signs, pull, east, south, i + 1, j, waiting, count)
    for v in range(1, h - 1):
        for u in range(1, w - 1):
            if signs[v, u] == 0:
                pull[v, u] = _asked(signs, pull, east, south, v, u)[0]


@njit(cache=True, inline="always")
def _settle(
    signs: Signs, pull: Grid, east: Grid, south: Grid, v: int, u: int,
    waiting: npt.NDArray[np.int32], count: int,
) -> int:  # fmt: skip
    """Label a pixel if it is sure, and put it on the stack `waiting`; return the stack's height."""
    asked, open_bonds = _asked(signs, pull, east, south, v, u)
    if abs(asked) < open_bonds:
        return count
    signs[v, u] = 1 if asked >= 0.0 else -1
    waiting[count, 0], waiting[count, 1] = v, u
    return count + 1


@njit(cache=True, inline="always")
def _asked(signs: Signs, pull: Grid, east: Grid, south: Grid, v: int, u: int) -> tuple[float, float]:
    """What evidence and settled neighbours ask of a pixel, and the bonds to its undecided ones."""
    b0, b1, b2, b3 = east[v, u - 1], east[v, u], south[v - 1, u], south[v, u]
    s0, s1, s2, s3 = signs[v, u - 1], signs[v, u + 1], signs[v - 1, u], signs[v + 1, u]
    asked = pull[v, u] + b0 * s0 + b1 * s1 + b2 * s2 + b3 * s3
    return asked, b0 * (1 - abs(s0)) + b1 * (1 - abs(s1)) + b2 * (1 - abs(s2)) + b3 * (1 - abs(s3))
