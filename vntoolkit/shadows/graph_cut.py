"""One binary label per pixel, smooth over the image, by a minimum cut (boykov2001)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.native import njit

_WEAKEST_BOND = 0.05  # part of the full price that a change of label across a sharp edge still costs
_DARK_COSINE = 0.03  # added to a cosine before its logarithm: noise is no edge


def lit_by_cut(
    evidence: FloatArray, bonds: tuple[FloatArray, FloatArray], mask: Mask
) -> npt.NDArray[np.bool_]:
    """Minimise Σ |evidence| over pixels labelled against it plus the bonds cut.

    evidence: (h, w), positive speaks for light, negative for shadow. bonds: to the east and to the south
    neighbour, (h, w) each, at least 0, the price of a change there; those of the last column and row lead
    nowhere. Returns (h, w), True where lit (and outside `mask`). Of several cheapest labellings it is the one
    with the most light.
    """
    h, w = mask.shape
    pull = np.zeros((h + 2, w + 2))  # a border of one pixel, which no bond leads to
    pull[1:-1, 1:-1] = np.where(mask, evidence, 0.0)
    room = np.zeros((h + 2, w + 2, 4))
    east, south = bonds
    room[1:-1, 1:-2, 0] = room[1:-1, 2:-1, 1] = east[:, :-1]
    room[1:-2, 1:-1, 2] = room[2:-1, 1:-1, 3] = south[:-1]
    shadow = _cut(pull.ravel(), room.reshape(-1, 4), w + 2).reshape(pull.shape)
    return ~shadow[1:-1, 1:-1] | ~mask


@njit(cache=True)
def _cut(pull: npt.NDArray[np.float64], room: npt.NDArray[np.float64], width: int) -> npt.NDArray[np.bool_]:
    """Push as much flow as the grid takes; return the pixels that could still pass some on to a sink.

    Dinic's algorithm (dinic1970): all shortest paths are filled, then all that are longer by one, and so on.
    Sources are the pixels of positive pull, sinks those of negative: each ends with what it has left. pull:
    (n,); room: (n, 4), what fits through to the next pixel east, west, south and north. Both are changed.
    """
    steps = (1, -1, width, -width)
    count = pull.size
    distance = np.full(count, -1, np.int32)  # to the nearest sink that it can reach
    turn = np.zeros(count, np.int8)  # the way that a pixel tries; those before it lead nowhere
    queue = np.empty(count, np.int32)
    path = np.empty(count, np.int32)
    sinks = np.flatnonzero(pull < 0.0)
    while True:
        sinks = sinks[pull[sinks] < 0.0]
        end = sinks.size
        queue[:end] = sinks
        distance[sinks] = 0
        nearest = count  # distance of the sources that are nearest to a sink
        head = 0
        while head < end and distance[queue[head]] < nearest:
            i = queue[head]
            head += 1
            for way in range(4):
                j = i - steps[way]
                if distance[j] < 0 and room[j, way] > 0.0:
                    distance[j] = distance[i] + 1
                    turn[j] = 0
                    queue[end] = j
                    end += 1
                    if pull[j] > 0.0:
                        nearest = distance[j]
        if nearest == count:
            return distance >= 0
        for k in range(end):
            if distance[queue[k]] == nearest:
                _drain(queue[k], pull, room, steps, distance, turn, path)
        distance[queue[:end]] = -1


@njit(cache=True)
def _drain(
    source: int,
    pull: npt.NDArray[np.float64],
    room: npt.NDArray[np.float64],
    steps: tuple[int, int, int, int],
    distance: npt.NDArray[np.int32],
    turn: npt.NDArray[np.int8],
    path: npt.NDArray[np.int32],
) -> None:
    """Send what a source has down every way on which each step comes closer to a sink."""
    length, i = 0, source
    while pull[source] > 0.0:
        if distance[i] == 0:
            flow = min(pull[source], -pull[i])
            for k in range(length):
                flow = min(flow, room[path[k], turn[path[k]]])
            for k in range(length):
                way = turn[path[k]]
                room[path[k], way] -= flow
                room[path[k] + steps[way], way ^ 1] += flow
            pull[source] -= flow
            pull[i] += flow
            length, i = 0, source
        elif turn[i] < 4:
            j = i + steps[turn[i]]
            closer = distance[j] == distance[i] - 1 and (distance[j] > 0 or pull[j] < 0.0)
            if closer and room[i, turn[i]] > 0.0:
                path[length] = i
                length, i = length + 1, j
            else:
                turn[i] += 1
        elif length > 0:
            length -= 1
            i = path[length]
            turn[i] += 1
        else:
            return


def bonds_of_light(
    cosines: FloatArray, light: int, mask: Mask, strength: float, contrast: float
) -> tuple[FloatArray, FloatArray]:
    """Bonds that give way where this light alone changes: paint and folds change the other lights too.

    cosines: (h, w, 3). strength: full price. contrast: difference of log cosines, between this light and the
    more similar of the other two, at which a bond falls to 1/e.
    """
    given = np.ascontiguousarray(cosines, dtype=np.float32)
    logarithm, east, south = (
        np.empty_like(given),
        np.zeros(mask.shape, np.float32),
        np.zeros(mask.shape, np.float32),
    )
    _bonds_kernel(given, light, np.asarray(mask), strength, 1.0 / contrast, logarithm, east, south)
    return east, south


@njit(cache=True, parallel=True, fastmath=True)
def _bonds_kernel(
    cosines: FloatArray, light: int, mask: Mask, strength: float, sharpness: float,
    logarithm: FloatArray, east: FloatArray, south: FloatArray,
) -> None:  # fmt: skip
    h, w = mask.shape
    second, third = (light + 1) % 3, (light + 2) % 3
    for v in prange(h):
        for u in range(w):
            if mask[v, u]:
                for k in range(3):
                    logarithm[v, u, k] = np.log(
                        max(cosines[v, u, k], np.float32(0.0)) + np.float32(_DARK_COSINE)
                    )
    for v in prange(h):
        for u in range(w):
            if not mask[v, u]:
                continue
            for j in range(2):
                i, n = v + j, u + 1 - j
                if i >= h or n >= w or not mask[i, n]:
                    continue
                own = logarithm[i, n, light] - logarithm[v, u, light]
                alone = min(
                    abs(own - logarithm[i, n, second] + logarithm[v, u, second]),
                    abs(own - logarithm[i, n, third] + logarithm[v, u, third]),
                )
                sharp = alone * np.float32(sharpness)
                bond = strength * (_WEAKEST_BOND + (1.0 - _WEAKEST_BOND) * np.exp(-sharp * sharp))
                if j == 0:
                    east[v, u] = bond
                else:
                    south[v, u] = bond
