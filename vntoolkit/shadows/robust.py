"""Shadow detection against a surface: a light is missing where the surface should return more of it.

Start, on a small image: a light is doubted where its cosine, its contribution over albedo and strength, is
too small for the surrounding albedo. Then alternate: solve the surface from the lights that are not doubted
(`surface`), predict each light's cosine on it, compare with the cosine measured, and find labels by a minimum
cut. Go on from that surface at twice the size, and so on up to the working size; on the frame itself only
pixels in doubt are looked at again. A pixel that is dark in all three lights alike is dark paint; paint that
changes within eight pixels is told from shadow by that. Every frame stands alone: the surface of the frame
before lies beside a moving shadow, and leads into the wrong one of two valleys.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import BoolArray, Float64Array, FloatArray, Int32Array, IntArray, Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame, labels_from_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import albedo_from_lit
from vntoolkit.shadows.contributions import (
    LightContributions,
    WorkingImage,
    all_of_three,
    flat,
    largest_of_three,
    working_image,
)
from vntoolkit.shadows.evidence import (
    PAINT_COSINE,
    SMALLEST_ALBEDO,
    evidence_of_frame,
    evidence_over,
    inset_of,
    lamps_of,
    largest_dark_cosine,
    paint_scale,
    sharpened_cosines,
    typical_dark_cosine,
)
from vntoolkit.shadows.shadow_edges import labels_beyond_half, turned_from_lights
from vntoolkit.shadows.surface import LabelledImage, Surface, SurfaceOptions

# A cosine is 1 where a surface of the local albedo faces the light.
_WEAK_COSINE = 0.35  # a frame without any that is less has no shadow
_FIRST_COSINE = 0.2  # lights with less are doubted at the start
_SMOOTHNESS = 0.5  # price of a change of label between neighbours, in units of evidence
_CONTRAST = 0.6  # see `bonds_of_light`
_ROUNDS = 3  # alternations of surface and labels on the smallest image; most of the change comes in the first
_FINER_ROUNDS = 2  # the same on every larger one
_START_PIXELS = 15_000  # images are halved until they are not larger; there the labels start
# Of a surface whose labels may still be wrong.
_SURFACE = SurfaceOptions(noise=0.08, smoothness=1.5, cycles=3)
_ITERATIONS = (3, 2, 1)  # on the smallest image, the next, and all larger ones, which start nearer
Nodes = Int32Array
_WEAKEST_BOND = 0.05  # part of the full price that a change of label across a sharp edge still costs
_DARK_COSINE = 0.03  # added to a cosine before its logarithm: noise is no edge
_SHADOW, _LIT, _NOWHERE = -1, -2, -3  # what is no node: its label is known, or there is nothing


def labels_by_surface(
    frame: LinearFrame, response: LightResponse, mask: Mask, camera: Camera | None = None
) -> tuple[VisibilityLabels, Surface | None]:
    """Return (h, w) labels, bit k set where light k arrives, and their surface on the working size.

    The surface is None where no light is weak anywhere.
    """
    image, factor = working_image(frame, response, mask, camera)
    small = image.light
    labels: VisibilityLabels = np.full(mask.shape, ALL_LIT, np.uint8)
    if not _is_doubted(image):
        return labels, None
    surface, albedo = _surface_by_rounds(image)
    predicted = _predicted(surface, small)
    raw = small.cosines(albedo)
    if factor == 1:
        raw = sharpened_cosines(raw, image.mask)
    dark = typical_dark_cosine(_without_paint(raw, predicted), predicted, albedo, image.mask)
    expected = np.stack([*np.moveaxis(predicted, -1, 0), albedo]).astype(np.float32)
    inset = inset_of(mask)
    found = evidence_of_frame(
        np.ascontiguousarray(frame.rgb), mask, inset, lamps_of(response), expected, dark
    )
    if found.near.any():
        for k in range(3):
            lit = _cut_light(found.evidence[k], found.cosines, k, found.near)
            labels[~lit] &= ALL_LIT - (1 << k)
        if inset is not None:
            labels &= ~turned_from_lights(surface.normals, found.cosines, small.directions, inset, found.near)
        labels = labels_beyond_half(labels, found.cosines, found.facing, mask, found.near)
    return labels, replace(surface, image=image)


def _is_doubted(image: WorkingImage) -> bool:
    """Tell whether any light is weak anywhere, so that a surface must say whether it is missing."""
    cosines = image.light.cosines(albedo_from_lit(image.light.length, image.mask))
    weak = cosines < _WEAK_COSINE
    return bool(((weak[..., 0] | weak[..., 1] | weak[..., 2]) & image.mask).any())


def _surface_by_rounds(image: WorkingImage) -> tuple[Surface, FloatArray]:
    """Alternate between surface and labels, coarse to fine; return the surface and the albedo (h, w)."""
    size, halvings = image.mask.size, 0
    while size > _START_PIXELS:
        size, halvings = size // 4, halvings + 1
    options = replace(_SURFACE, iterations=_ITERATIONS[min(halvings, 2)])
    if halvings == 0:
        surface, rounds = None, _ROUNDS
        lit = _first_doubts(image)
    else:
        coarse, albedo = _surface_by_rounds(image.halved)
        surface, rounds = coarse.enlarged(image.mask.shape, 2), _FINER_ROUNDS
        lit = _lit_on(surface, image, _enlarged(albedo, image.mask.shape))
    for i in range(rounds):
        surface, albedo = _solved(image, lit, options, surface)
        if i + 1 < rounds:
            lit = _lit_on(surface, image, albedo)
    assert surface is not None
    return surface, albedo


def _solved(
    image: WorkingImage, lit: BoolArray, options: SurfaceOptions, start: Surface | None
) -> tuple[Surface, FloatArray]:
    """Return the surface (h, w) under these labels, and the albedo."""
    albedo = albedo_from_lit(image.light.length, all_of_three(lit) & image.mask)
    labelled = LabelledImage(image=image, labels=labels_from_lit(lit), albedo=albedo)
    return labelled.solve(options, start), albedo


def _predicted(surface: Surface, measured: LightContributions) -> FloatArray:
    """(h, w, 3): what the surface would return of each light."""
    normals: FloatArray = surface.normals.astype(np.float32)
    return normals @ measured.directions.T.astype(np.float32)


def _lit_on(surface: Surface, image: WorkingImage, albedo: FloatArray) -> BoolArray:
    """Label by what the surface would return."""
    predicted = _predicted(surface, image.light)
    cosines = _without_paint(image.light.cosines(albedo), predicted)
    evidence = _evidence(cosines, predicted, albedo, image.mask)
    return np.stack([_cut_light(evidence[k], cosines, k, image.mask) for k in range(3)], axis=-1)


def _cut_light(evidence: FloatArray, cosines: FloatArray, k: int, mask: Mask) -> BoolArray:
    def bonds(number: Nodes) -> tuple[FloatArray, FloatArray]:
        return bonds_of_light(cosines, k, number, _SMOOTHNESS, _CONTRAST)

    return lit_by_cut(evidence, bonds, mask, _SMOOTHNESS)


def _enlarged(image: Any, shape: tuple[int, ...]) -> FloatArray:
    if image.shape[:2] == shape:
        return image
    return np.asarray(cv2.resize(image, shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _first_doubts(image: WorkingImage) -> BoolArray:
    measured, mask = image.light, image.mask
    inside = measured.length[mask]
    typical = float(np.median(inside)) if inside.size else 1.0
    albedo: FloatArray = np.full(mask.shape, max(typical, SMALLEST_ALBEDO), dtype=np.float32)
    lit = np.ones((*mask.shape, 3), dtype=np.bool_)
    for _ in range(3):  # albedo and doubts settle each other
        cosines = measured.cosines(albedo)
        lit = cosines > _FIRST_COSINE
        brightest = largest_of_three(cosines)[..., None]
        paint = all_of_three(~lit)[..., None] & (brightest > PAINT_COSINE)
        lit |= paint & (cosines > _FIRST_COSINE * brightest)
        albedo = albedo_from_lit(measured.length, all_of_three(lit) & mask)
    return lit


def _without_paint(cosines: FloatArray, predicted: FloatArray) -> FloatArray:
    """Undo dark paint: where all three lights are missing alike, it is the albedo that is off."""
    out: FloatArray = np.empty(cosines.shape, np.float32)
    _paint_kernel(flat(cosines), flat(predicted), flat(out))
    return out


@njit(cache=True, error_model="numpy")
def _paint_kernel(cosines: FloatArray, predicted: FloatArray, out: FloatArray) -> None:
    h, w = cosines.shape[0], cosines.shape[1] // 3
    for v in range(h):
        line, surface, to = cosines[v], predicted[v], out[v]
        for u in range(w):
            a, b, c = line[3 * u], line[3 * u + 1], line[3 * u + 2]
            scale = paint_scale(a, b, c, surface[3 * u], surface[3 * u + 1], surface[3 * u + 2])
            to[3 * u], to[3 * u + 1], to[3 * u + 2] = a * scale, b * scale, c * scale


def _evidence(cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask) -> FloatArray:
    """(3, h, w), positive where more is measured than a shadow returns."""
    level, grain = largest_dark_cosine(cosines, predicted, albedo, mask)
    out: FloatArray = np.empty((3, *mask.shape), np.float32)
    _evidence_kernel(flat(cosines), flat(predicted), flat(level), flat(grain), out)
    return out


@njit(cache=True, error_model="numpy")
def _evidence_kernel(
    cosines: FloatArray, predicted: FloatArray, level: FloatArray, grain: FloatArray, out: FloatArray
) -> None:
    _, h, w = out.shape
    for v in range(h):
        line, surface, dark, noise = cosines[v], predicted[v], level[v], grain[v]
        for k in range(3):
            to = out[k, v]
            for u in range(w):
                i = 3 * u + k
                to[u] = evidence_over(line[i], dark[i], surface[i], noise[u])


def lit_by_cut(
    evidence: FloatArray,
    bonds: Callable[[Nodes], tuple[FloatArray, FloatArray]],
    mask: Mask,
    strongest: float,
) -> BoolArray:
    """Minimise Σ |evidence| over pixels labelled against it plus the bonds cut (boykov2001).

    evidence: (h, w), positive speaks for light, negative for shadow. bonds: returns those to the east and to
    the south neighbour, (h, w) each, at least 0, the price of a change there, known at least at nodes, whose
    number is not negative; those of the last column and row lead nowhere. strongest: no bond costs more.
    Returns (h, w), True where lit (and outside `mask`). Of several cheapest labellings it is the one with the
    most light.

    A pixel whose evidence outweighs its four bonds has its label whatever its neighbours have; only the
    others enter the cut.
    """
    given = np.asarray(evidence)
    number: Nodes = np.empty(mask.shape, np.int32)
    lit: BoolArray = np.empty(mask.shape, np.bool_)
    count = _number_kernel(given, mask, 4.0 * strongest, number, lit)
    if count:
        _cut_kernel(given, *bonds(number), number, count, lit)
    return lit


@njit(cache=True)
def _number_kernel(evidence: FloatArray, mask: Mask, most: Any, number: Nodes, lit: Mask) -> int:
    """Number the pixels that the cut must decide, and label the others."""
    h, w = mask.shape
    count = 0
    for v in range(h):
        for u in range(w):
            lit[v, u] = True
            if not mask[v, u]:
                number[v, u] = _NOWHERE
            elif evidence[v, u] >= most:
                number[v, u] = _LIT
            elif evidence[v, u] < -most:
                number[v, u] = _SHADOW
                lit[v, u] = False
            else:
                number[v, u] = count
                count += 1
    return count


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


def bonds_of_light(
    cosines: FloatArray, light: int, number: Nodes, strength: float, contrast: float
) -> tuple[FloatArray, FloatArray]:
    """Bonds that give way where this light alone changes: paint and folds change the other lights too.

    cosines: (h, w, 3). number: (h, w), see `lit_by_cut`. strength: full price. contrast: difference of log
    cosines, between this light and the more similar of the other two, at which a bond falls to 1/e. Returns
    the bonds to the east and to the south (h, w), known where one of their ends is a node.
    """
    given = np.ascontiguousarray(cosines, dtype=np.float32)
    east, south = np.empty(number.shape, np.float32), np.empty(number.shape, np.float32)
    _bonds_kernel(given, light, number, np.float32(strength), np.float32(1.0 / contrast), east, south)
    return east, south


@njit(cache=True, forceinline=True, error_model="numpy")
def _change(first: Any, second: Any, other_first: Any, other_second: Any) -> Any:
    """Return by what factor, at least 1, one cosine changes more than another from pixel to pixel."""
    dark, zero = np.float32(_DARK_COSINE), np.float32(0.0)
    one = (max(second, zero) + dark) * (max(other_first, zero) + dark)
    two = (max(first, zero) + dark) * (max(other_second, zero) + dark)
    return max(one, two) / min(one, two)


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _bonds_kernel(
    cosines: FloatArray, light: int, number: Nodes, strength: Any, sharpness: Any, east: FloatArray,
    south: FloatArray,
) -> None:  # fmt: skip
    h, w = number.shape
    second, third = (light + 1) % 3, (light + 2) % 3
    weakest, rest = np.float32(_WEAKEST_BOND), np.float32(1.0 - _WEAKEST_BOND)
    for v in prange(h):
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
                bond = strength * (weakest + rest * np.exp(-sharp * sharp))
                if j == 0:
                    east[v, u] = bond
                else:
                    south[v, u] = bond
