"""Pixels whose label in a minimum cut is known before cutting.

A pixel whose own evidence outweighs all its bonds takes the label that the evidence asks for, whatever its
neighbours take; its bonds then speak to the neighbours as evidence does, which may settle them too. What is
left to cut is a few pixels along the edges of shadows: the same labels for a tenth of the time.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

Grid = npt.NDArray[np.float32]
Signs = npt.NDArray[np.int8]


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
