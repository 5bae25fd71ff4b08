"""Labels by a minimum cut: the cheapest labelling of pixels with log odds each and prices between them."""

from collections.abc import Callable
from typing import Any

import numpy as np

from vntoolkit.arrays import BoolArray, Float64Array, FloatArray, Int32Array, IntArray, Mask
from vntoolkit.native import njit

Nodes = Int32Array
_LEAST_WEIGHT = 0.05  # part of the full price that a change of label across a sharp edge still costs
_DARK_COSINE = 0.03  # added to a cosine before its logarithm: noise is no edge
_SHADOW, _LIT, _NOWHERE = -1, -2, -3  # what is no node: its label is known, or there is nothing


def lit_by_cut(
    log_odds: FloatArray,
    weights: Callable[[Nodes], tuple[FloatArray, FloatArray]],
    mask: Mask,
    strongest: float,
) -> BoolArray:
    """Minimise Σ |log_odds| over pixels labelled against it plus the weights cut (boykov2001).

    log_odds: (h, w), positive speaks for light, negative for shadow. weights: returns those to the east and
    to the south neighbour, (h, w) each, at least 0, the price of a change there, known at least at nodes,
    whose number is not negative; those of the last column and row lead nowhere. strongest: no weight costs
    more. Returns (h, w), True where lit (and outside `mask`). Of several cheapest labellings it is the one
    with the most light.

    A pixel whose log odds outweigh its four weights has its label whatever its neighbours have; only the
    others enter the cut.
    """
    given = np.asarray(log_odds)
    number: Nodes = np.empty(mask.shape, np.int32)
    lit: BoolArray = np.empty(mask.shape, np.bool_)
    count = _number_kernel(given, mask, 4.0 * strongest, number, lit)
    if count:
        _cut_kernel(given, *weights(number), number, count, lit)
    return lit


@njit
def _number_kernel(log_odds: FloatArray, mask: Mask, most: Any, number: Nodes, lit: Mask) -> int:
    """Number the pixels that the cut must decide, and label the others."""
    h, w = mask.shape
    count = 0
    for v in range(h):
        for u in range(w):
            lit[v, u] = True
            if not mask[v, u]:
                number[v, u] = _NOWHERE
            elif log_odds[v, u] >= most:
                number[v, u] = _LIT
            elif log_odds[v, u] < -most:
                number[v, u] = _SHADOW
                lit[v, u] = False
            else:
                number[v, u] = count
                count += 1
    return count


@njit
def _cut_kernel(
    log_odds: FloatArray, east: FloatArray, south: FloatArray, number: Nodes, count: int,
    lit: Mask,
) -> None:  # fmt: skip
    """Label the numbered pixels."""
    h, w = number.shape
    excess, capacity = np.zeros(count), np.zeros((count, 4))
    neighbour = np.full((count, 4), -1, np.int32)
    for v in range(h):
        for u in range(w):
            i = number[v, u]
            if i < 0:
                continue
            excess[i] += log_odds[v, u]
            for way in range(4):  # east, west, south, north
                y, x = v + (way == 2) - (way == 3), u + (way == 0) - (way == 1)
                if y < 0 or x < 0 or y >= h or x >= w or number[y, x] == _NOWHERE:
                    continue
                weight = east[v, min(u, x)] if way < 2 else south[min(v, y), u]
                j = number[y, x]
                if j == _LIT:
                    excess[i] += weight
                elif j == _SHADOW:
                    excess[i] -= weight
                else:
                    neighbour[i, way] = j
                    capacity[i, way] = weight
    shadow = _cut(excess, capacity, neighbour)
    for v in range(h):
        for u in range(w):
            if number[v, u] >= 0:
                lit[v, u] = not shadow[number[v, u]]


@njit
def _cut(excess: Float64Array, capacity: Float64Array, neighbour: Int32Array) -> BoolArray:
    """Push as much flow as the graph takes; return the nodes that could still pass some on to a sink.

    Dinic's algorithm (dinic1970): all shortest paths are filled, then all that are longer by one, and so on.
    Sources are the nodes of positive excess, sinks those of negative: each ends with what it has left.
    excess: (n,); capacity: (n, 4), what fits through to the next node east, west, south and north. Both
    are changed. neighbour: (n, 4), that node, or -1.
    """
    count = excess.size
    distance = np.full(count, -1, np.int32)  # to the nearest sink that it can reach
    turn = np.zeros(count, np.int8)  # the way that a node tries; those before it lead nowhere
    queue = np.empty(count, np.int32)
    path = np.empty(count, np.int32)
    sinks, left = np.arange(count).astype(np.int32), count
    while True:
        end = 0
        for k in range(left):
            i = sinks[k]
            if excess[i] < 0.0:
                sinks[end], queue[end], distance[i] = i, i, 0
                end += 1
        left = end
        nearest = count + 1  # distance of the sources that are nearest to a sink
        head = 0
        while head < end and distance[queue[head]] < nearest:
            i = queue[head]
            head += 1
            for way in range(4):
                j = neighbour[i, way]
                if j >= 0 and distance[j] < 0 and capacity[j, way ^ 1] > 0.0:
                    distance[j] = distance[i] + 1
                    turn[j] = 0
                    queue[end] = j
                    end += 1
                    if excess[j] > 0.0:
                        nearest = distance[j]
        if nearest > count:
            return distance >= 0
        for k in range(end):
            if distance[queue[k]] == nearest:
                _drain(queue[k], excess, capacity, neighbour, distance, turn, path)
        for k in range(end):
            distance[queue[k]] = -1


@njit
def _drain(
    source: int,
    excess: Float64Array,
    capacity: Float64Array,
    neighbour: Int32Array,
    distance: Int32Array,
    turn: IntArray,
    path: Int32Array,
) -> None:
    """Send what a source has down every way on which each step comes closer to a sink."""
    length, i = 0, source
    while excess[source] > 0.0:
        if distance[i] == 0:
            flow = min(excess[source], -excess[i])
            for k in range(length):
                flow = min(flow, capacity[path[k], turn[path[k]]])
            for k in range(length):
                way = turn[path[k]]
                capacity[path[k], way] -= flow
                capacity[neighbour[path[k], way], way ^ 1] += flow
            excess[source] -= flow
            excess[i] += flow
            length, i = 0, source
        elif turn[i] < 4:
            j = neighbour[i, turn[i]]
            closer = j >= 0 and distance[j] == distance[i] - 1 and (distance[j] > 0 or excess[j] < 0.0)
            if closer and capacity[i, turn[i]] > 0.0:
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


def weights_of_light(
    cosines: FloatArray, light: int, number: Nodes, strength: float, contrast: float
) -> tuple[FloatArray, FloatArray]:
    """Weights that give way where this light alone changes: paint and folds change the other lights too.

    cosines: (h, w, 3). number: (h, w), see `lit_by_cut`. strength: full price. contrast: difference of log
    cosines, between this light and the more similar of the other two, at which a weight falls to 1/e. Returns
    the weights to the east and to the south (h, w), known where one of their ends is a node.
    """
    given = np.ascontiguousarray(cosines, dtype=np.float32)
    east, south = np.empty(number.shape, np.float32), np.empty(number.shape, np.float32)
    _weights_kernel(given, light, number, np.float32(strength), np.float32(1.0 / contrast), east, south)
    return east, south


@njit(forceinline=True)
def _change(first: Any, second: Any, other_first: Any, other_second: Any) -> Any:
    """Return by what factor, at least 1, one cosine changes more than another from pixel to pixel."""
    dark, zero = np.float32(_DARK_COSINE), np.float32(0.0)
    one = (max(second, zero) + dark) * (max(other_first, zero) + dark)
    two = (max(first, zero) + dark) * (max(other_second, zero) + dark)
    return max(one, two) / min(one, two)


@njit
def _weights_kernel(
    cosines: FloatArray, light: int, number: Nodes, strength: Any, sharpness: Any, east: FloatArray,
    south: FloatArray,
) -> None:  # fmt: skip
    h, w = number.shape
    second, third = (light + 1) % 3, (light + 2) % 3
    weakest, rest = np.float32(_LEAST_WEIGHT), np.float32(1.0 - _LEAST_WEIGHT)
    for v in range(h):
        here, below = number[v], number[min(v + 1, h - 1)]
        for u in range(w):
            n = min(u + 1, w - 1)
            if here[u] < 0 and here[n] < 0 and below[u] < 0:
                continue
            for j in range(2):
                i, n = v + j, u + 1 - j
                if i >= h or n >= w or (here[u] < 0 and number[i, n] < 0):
                    continue
                one, two = cosines[v, u], cosines[i, n]
                alone = min(
                    _change(one[light], two[light], one[second], two[second]),
                    _change(one[light], two[light], one[third], two[third]),
                )
                sharp = np.log(alone) * sharpness
                weight = strength * (weakest + rest * np.exp(-sharp * sharp))
                if j == 0:
                    east[v, u] = weight
                else:
                    south[v, u] = weight
