"""Labels by a minimum cut: the cheapest labelling of pixels with evidence each and prices between them."""

import numpy as np

from vntoolkit.arrays import BoolArray, Float64Array, FloatArray, Int32Array, IntArray, Mask
from vntoolkit.native import njit

Nodes = Int32Array
_WEAKEST_BOND = 0.05  # part of the full price that a change of label across a sharp edge still costs
_DARK_COSINE = 0.03  # added to a cosine before its logarithm: noise is no edge
_SHADOW, _LIT, _NOWHERE = -1, -2, -3  # what is no node: its label is known, or there is nothing


def lit_by_cut(
    evidence: FloatArray,
    bonds: tuple[FloatArray, FloatArray],
    mask: Mask,
    strongest: float,
) -> BoolArray:
    """Minimise Σ |evidence| over pixels labelled against it plus the bonds cut (boykov2001).

    evidence: (h, w), positive speaks for light, negative for shadow. bonds: to the east and to the south
    neighbour, (h, w) each, at least 0, the price of a change there; those of the last column and row lead
    nowhere. strongest: no bond costs more.
    Returns (h, w), True where lit (and outside `mask`). Of several cheapest labellings it is the one with the
    most light.

    A pixel whose evidence outweighs its four bonds has its label whatever its neighbours have; only the
    others enter the cut.
    """
    given, most = np.asarray(evidence), 4.0 * strongest
    number: Nodes = np.full(mask.shape, _NOWHERE, np.int32)
    number[mask & (given >= most)], number[mask & (given < -most)] = _LIT, _SHADOW
    free = mask & (given < most) & (given >= -most)
    count = np.count_nonzero(free)
    number[free] = np.arange(count, dtype=np.int32)
    lit: BoolArray = number != _SHADOW
    if count:
        _cut_kernel(given, *bonds, number, count, lit)
    return lit


@njit(cache=True)
def _cut_kernel(
    evidence: FloatArray, east: FloatArray, south: FloatArray, number: Nodes, count: int,
    lit: Mask,
) -> None:  # fmt: skip
    """Label the numbered pixels."""
    h, w = number.shape
    pull, room = np.zeros(count), np.zeros((count, 4))
    neighbour = np.full((count, 4), -1, np.int32)
    for v in range(h):
        for u in range(w):
            i = number[v, u]
            if i < 0:
                continue
            pull[i] += evidence[v, u]
            for way in range(4):  # east, west, south, north
                y, x = v + (way == 2) - (way == 3), u + (way == 0) - (way == 1)
                if y < 0 or x < 0 or y >= h or x >= w or number[y, x] == _NOWHERE:
                    continue
                bond = east[v, min(u, x)] if way < 2 else south[min(v, y), u]
                j = number[y, x]
                if j == _LIT:
                    pull[i] += bond
                elif j == _SHADOW:
                    pull[i] -= bond
                else:
                    neighbour[i, way] = j
                    room[i, way] = bond
    shadow = _cut(pull, room, neighbour)
    for v in range(h):
        for u in range(w):
            if number[v, u] >= 0:
                lit[v, u] = not shadow[number[v, u]]


@njit(cache=True)
def _cut(pull: Float64Array, room: Float64Array, neighbour: Int32Array) -> BoolArray:
    """Push as much flow as the graph takes; return the nodes that could still pass some on to a sink.

    Dinic's algorithm (dinic1970): all shortest paths are filled, then all that are longer by one, and so on.
    Sources are the nodes of positive pull, sinks those of negative: each ends with what it has left. pull:
    (n,); room: (n, 4), what fits through to the next node east, west, south and north. Both are changed.
    neighbour: (n, 4), that node, or -1.
    """
    count = pull.size
    distance = np.full(count, -1, np.int32)  # to the nearest sink that it can reach
    turn = np.zeros(count, np.int8)  # the way that a node tries; those before it lead nowhere
    queue = np.empty(count, np.int32)
    path = np.empty(count, np.int32)
    sinks = np.flatnonzero(pull < 0.0)
    while True:
        sinks = sinks[pull[sinks] < 0.0]
        end = sinks.size
        queue[:end] = sinks
        distance[sinks] = 0
        nearest = count + 1  # distance of the sources that are nearest to a sink
        head = 0
        while head < end and distance[queue[head]] < nearest:
            i = queue[head]
            head += 1
            for way in range(4):
                j = neighbour[i, way]
                if j >= 0 and distance[j] < 0 and room[j, way ^ 1] > 0.0:
                    distance[j] = distance[i] + 1
                    turn[j] = 0
                    queue[end] = j
                    end += 1
                    if pull[j] > 0.0:
                        nearest = distance[j]
        if nearest > count:
            return distance >= 0
        for k in range(end):
            if distance[queue[k]] == nearest:
                _drain(queue[k], pull, room, neighbour, distance, turn, path)
        distance[queue[:end]] = -1


@njit(cache=True)
def _drain(
    source: int,
    pull: Float64Array,
    room: Float64Array,
    neighbour: Int32Array,
    distance: Int32Array,
    turn: IntArray,
    path: Int32Array,
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
                room[neighbour[path[k], way], way ^ 1] += flow
            pull[source] -= flow
            pull[i] += flow
            length, i = 0, source
        elif turn[i] < 4:
            j = neighbour[i, turn[i]]
            closer = j >= 0 and distance[j] == distance[i] - 1 and (distance[j] > 0 or pull[j] < 0.0)
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


def bonds_of_lights(
    cosines: FloatArray, strength: float, contrast: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Bonds of each light, which give way where it changes alone: paint and folds change the others too.

    cosines: (h, w, 3). strength: full price. contrast: difference of log cosines, between a light and the
    more similar of the other two, at which a bond falls to 1/e. Returns for each light the bonds to the east
    and to the south (h, w).
    """
    logs = [np.log(np.maximum(cosines[..., k], np.float32(0)) + np.float32(_DARK_COSINE)) for k in range(3)]
    # how each light's change from pixel to pixel differs from the next light's
    apart = [logs[k] - logs[k - 2] for k in range(3)]

    def between(axis: int) -> list[FloatArray]:
        steps = [np.abs(np.diff(each, axis=axis)) for each in apart]
        alone = [np.minimum(steps[k], steps[k - 1]) * np.float32(1.0 / contrast) for k in range(3)]
        bonds = [strength * (_WEAKEST_BOND + (1.0 - _WEAKEST_BOND) * np.exp(-each * each)) for each in alone]
        pad = ((0, 0), (0, 1)) if axis else ((0, 1), (0, 0))
        return [np.pad(bond, pad) for bond in bonds]

    return list(zip(between(1), between(0), strict=True))
