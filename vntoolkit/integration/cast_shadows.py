"""Steps of depth that cast shadows tell.

Normals say nothing of how far one surface lies behind another. A cast shadow does: from where it ends, the
ray to the lamp grazes what throws it (Kender and Smith 1987, `kender1987`; `daum1998`). Along that ray depth
changes by as much per pixel as the lamp's direction says, so that a shadow's length is a difference of depth.
What the slopes leave of it is the step at the rim of what throws the shadow: where, in the dark, a surface
that faces the lamp meets one that does not, or the light begins again towards the lamp. Normals in the dark
are poor: the step may lie elsewhere. The difference between the lit ends holds, whatever lies in between.

A shadow that runs out of sight, over the outline or into a surface turned away, is at least as long as what
is seen of it; so is its step.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vntoolkit.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    Int64Array,
    Points2,
    Vector3,
    VisibilityLabels,
)
from vntoolkit.geometry.maps import HALF_WEIGHT_DEG, NormalMap
from vntoolkit.integration.edges import EdgeField, FarEdges
from vntoolkit.integration.slopes import RayField
from vntoolkit.native import njit

_FACING = np.float32(0.1)  # cosine to the lamp above which a surface in the dark has a shadow cast upon it
# Beyond a shadow's border the light may be on the same surface, where what throws the shadow stands off it.
_STRAIGHT = np.float32(0.5)  # cosine to the lamp's way below which a border that faces the lamp …
_GRAZING = np.float32(0.35)  # … by more than this cosine is no rim
_STEEPEST = np.float32(8.0)  # slope of a pixel, by which a rim that is seen from the side counts
_UNIT_VARIANCE = math.tan(math.radians(HALF_WEIGHT_DEG)) ** 2  # of a slope, squared, that a weight divides
_LENGTH_DEVIATION_PX = np.float32(1.0)  # standard deviation of a shadow's length, both ends together


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthSteps:
    """What cast shadows add to the differences of depth between the pixels of an image.

    down: (n,) bool; rows, columns: (n,): the edge from pixel (column, row) to the next one down, or to the
    right. steps: (n,) in pixels, as the slope of a pixel is. variances: (n,), squared pixels. far: from one
    lit end of a shadow to the other; weights are inverse variances.
    """

    down: BoolArray
    rows: Int64Array
    columns: Int64Array
    steps: FloatArray
    variances: FloatArray
    far: FarEdges

    def images(self, rows: slice, columns: slice) -> tuple[Float32Array, Float32Array]:
        """Return steps and variances of a window's edges to the right, and down: (2, h, w), 0 elsewhere."""
        shape = (2, rows.stop - rows.start, columns.stop - columns.start)
        at = self.down.astype(np.int64), self.rows - rows.start, self.columns - columns.start
        inside = (np.min(at, axis=0) >= 0) & (at[1] < shape[1]) & (at[2] < shape[2])
        at = tuple(index[inside] for index in at)
        steps, variances = np.zeros((2, *shape), np.float32)
        steps[at], variances[at] = self.steps[inside], self.variances[inside]
        return steps, variances


def with_steps(edges: EdgeField, steps: Float32Array, variances: Float32Array) -> EdgeField:
    """Return the edges with known steps in their unit, each as uncertain as its slope and its step are."""
    weight = edges.weight / (1.0 + edges.weight * variances / np.float32(_UNIT_VARIANCE))
    return EdgeField(difference=edges.difference + steps, weight=weight)


def steps_from_shadows(
    normal_map: NormalMap,
    labels: VisibilityLabels,
    lamp_at: Callable[[int, Points2], FloatArray],
    deviations: Vector3,
    rays: RayField,
) -> DepthSteps | None:
    """Find the steps at the rims of what throws shadows; None where there are none.

    labels: (h, w), bit k set where lamp k arrives. lamp_at: returns unit vectors (n, 3) to lamp k at pixels
    (n, 2). deviations: (3,), the directions' standard deviations in radians, infinite for a lamp that is not
    known.
    """
    normals, mask = np.asarray(normal_map.normals_in_camera, np.float32), normal_map.mask
    height, width = mask.shape
    middle = np.array([[0.5 * width - 0.5, 0.5 * height - 0.5]])
    perspective = np.float32(rays.depth_scales_ray)
    edges, steps, variances, ends, lengths = [], [], [], [], []
    for k, deviation in enumerate(deviations):
        if not np.isfinite(deviation):
            continue
        bit = np.uint8(1 << k)
        lamp = lamp_at(k, middle)[0].astype(np.float32)
        under = _cast_upon(labels, bit, normals, mask, lamp, rays.affine, perspective)
        rims = _rims(labels, bit, mask, under)
        lamps = lamp_at(k, rims[:, 1::-1].astype(np.float64)).astype(np.float32)
        step, variance, end, length = _steps(
            rims, lamps, labels, bit, under, normals, mask, np.float32(deviation), rays.affine, perspective
        )
        known = variance > 0.0
        first, last = np.minimum(rims[:, :2], rims[:, 2:]), np.maximum(rims[:, :2], rims[:, 2:])
        down = last[:, 0] > first[:, 0]
        edges.append(((down * height + first[:, 0]).astype(np.int64) * width + first[:, 1])[known])
        steps.append(step[known])
        variances.append(variance[known])
        ends.append(end[known])
        lengths.append(length[known])
    codes, place = np.unique(np.concatenate(edges or [np.zeros(0, np.int64)]), return_inverse=True)
    if not len(codes):
        return None
    weights, between = 1.0 / np.concatenate(variances), np.concatenate(ends).astype(np.int64)
    lit = between[:, 0] >= 0
    variance = 1.0 / np.bincount(place, weights)
    down, pixels = codes >= height * width, codes % (height * width)
    return DepthSteps(
        down=down,
        rows=pixels // width,
        columns=pixels % width,
        steps=np.bincount(place, weights * np.concatenate(steps)) * variance,
        variances=variance,
        far=FarEdges(
            first=between[lit, :2],
            last=between[lit, 2:],
            difference=np.concatenate(lengths)[lit],
            weight=weights[lit],
        ),
    )


@njit
def _cast_upon(
    labels: Any, bit: Any, normals: Any, mask: Any, lamp: Any, affine: Any, perspective: Any
) -> Any:
    """Return (h, w) bool: dark pixels that face the lamp, so that something else throws the shadow on them.

    Normals in the dark are poor, and each alone may be wrong. A shadow's far part, towards where it ends, is
    cast and its near part is where the surface turned from the lamp: every line towards the lamp is divided
    where most of its pixels agree. A pixel takes the answer of the first line that meets it.
    """
    h, w = mask.shape
    out, is_done = np.zeros((2, h, w), np.bool_)
    for v in range(h):
        for u in range(w):
            if is_done[v, u] or not _is_dark(labels, bit, mask, v, u):
                continue
            step_u, step_v, _, rise = _way(affine, perspective, lamp, v, u)
            if rise <= np.float32(0.0):
                continue
            first = 0
            while _is_dark(
                labels, bit, mask, _nearest(v + (first - 1) * step_v), _nearest(u + (first - 1) * step_u)
            ):
                first -= 1
            score, best, divide, i = 0, 0, first, first
            while True:
                y, x = _nearest(v + i * step_v), _nearest(u + i * step_u)
                if not _is_dark(labels, bit, mask, y, x):
                    break
                i += 1
                score += 1 if _cosine(normals, lamp, y, x) > _FACING else -1
                if score > best:
                    best, divide = score, i
            for k in range(first, i):
                y, x = _nearest(v + k * step_v), _nearest(u + k * step_u)
                if not is_done[y, x]:
                    out[y, x], is_done[y, x] = k < divide, True
    return out


@njit
def _rims(labels: Any, bit: Any, mask: Any, under: Any) -> Any:
    """Return (n, 4): row and column of pixels that a shadow is cast upon, and of neighbours where none is."""
    h, w = mask.shape
    found, count = np.empty((256, 4), np.int32), 0
    for v in range(h):
        for u in range(w):
            if not under[v, u]:
                continue
            for dv, du in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                y, x = v + dv, u + du
                if not _is_inside(mask, y, x) or under[y, x]:
                    continue
                if count == len(found):
                    found = np.concatenate((found, np.empty_like(found)))
                found[count, 0], found[count, 1], found[count, 2], found[count, 3] = v, u, y, x
                count += 1
    return found[:count]


@njit
def _steps(
    rims: Any, lamps: Any, labels: Any, bit: Any, under: Any, normals: Any, mask: Any,
    deviation: Any, affine: Any, perspective: Any,
) -> tuple[Any, Any, Any, Any]:  # fmt: skip
    """Return of n rims the steps along the edges right and down, their variances, 0 where nothing tells, the
    lit ends of the shadow (n, 4), −1 where it runs out of sight, and how depth changes from end to end.
    """
    steps, variances, lengths = np.zeros((3, len(rims)), np.float32)
    ends = np.full((len(rims), 4), -1, np.int32)
    for i in range(len(rims)):
        v, u, y, x = rims[i, 0], rims[i, 1], rims[i, 2], rims[i, 3]
        step, variances[i], lengths[i] = _step(
            labels, bit, under, normals, mask, lamps[i], deviation, affine, perspective, v, u, y, x, ends[i]
        )  # fmt: skip
        steps[i] = step if v < y or u < x else -step
    return steps, variances, ends, lengths


@njit(forceinline=True)
def _is_inside(mask: Any, v: int, u: int) -> Any:
    return 0 <= v < len(mask) and 0 <= u < mask.shape[1] and mask[v, u]


@njit(forceinline=True)
def _nearest(place: Any) -> Any:
    return int(np.floor(place + np.float32(0.5)))


@njit(forceinline=True)
def _cosine(normals: Any, lamp: Any, v: int, u: int) -> Any:
    return normals[v, u, 0] * lamp[0] + normals[v, u, 1] * lamp[1] + normals[v, u, 2] * lamp[2]


@njit(forceinline=True)
def _is_dark(labels: Any, bit: Any, mask: Any, v: int, u: int) -> Any:
    """Whether a place lies in the mask and in the lamp's shadow."""
    return _is_inside(mask, v, u) and not labels[v, u] & bit


@njit(forceinline=True)
def _is_lit(labels: Any, bit: Any, mask: Any, v: int, u: int) -> Any:
    """Whether a place lies in the mask and in the lamp's light."""
    return _is_inside(mask, v, u) and labels[v, u] & bit


@njit(forceinline=True)
def _way(affine: Any, perspective: Any, lamp: Any, v: int, u: int) -> tuple[Any, Any, Any, Any]:
    """Return the step towards the lamp, along u and v, of one column or row; its length in pixels; and by how
    much the ray to the lamp comes towards the camera per pixel, 0 where it does not cross the picture.
    """
    x = perspective * (affine[0] * np.float32(u) + affine[1] * np.float32(v) + affine[2])
    y = perspective * (affine[3] * np.float32(u) + affine[4] * np.float32(v) + affine[5])
    along_u, along_v = lamp[0] - x * lamp[2], lamp[1] - y * lamp[2]
    length = np.sqrt(along_u * along_u + along_v * along_v)
    if length < np.float32(1e-3):
        return np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
    most = max(abs(along_u), abs(along_v))
    return along_u / most, along_v / most, length / most, max(-lamp[2] / length, np.float32(0.0))


@njit
def _step(
    labels: Any, bit: Any, under: Any, normals: Any, mask: Any, lamp: Any, deviation: Any,
    affine: Any, perspective: Any, v: int, u: int, y: int, x: int, ends: Any,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Return by how much depth changes from the pixel (u, v), shadowed, to its neighbour (x, y), the
    variance, and the change over the whole shadow; all 0 where nothing tells. Fill in its lit ends.
    """
    zero, half, one = np.float32(0.0), np.float32(0.5), np.float32(1.0)
    step_u, step_v, stride, rise = _way(affine, perspective, lamp, v, u)
    if rise <= zero:
        return zero, zero, zero
    if labels[y, x] & bit:
        along = _along_light(labels, bit, mask, v, u, y, x, step_u, step_v)
        if along <= zero or (along < _STRAIGHT and _cosine(normals, lamp, y, x) > _GRAZING):
            return zero, zero, zero
    # away from the lamp, to the end of the shadow; a normal that does not face the lamp there is wrong
    slopes, known, count, at_v, at_u = zero, zero, zero, v, u
    while _is_dark(labels, bit, mask, at_v, at_u) and under[at_v, at_u]:
        if _cosine(normals, lamp, at_v, at_u) > _FACING:
            slopes += _slope(normals, affine, perspective, at_v, at_u, step_u, step_v)
            known += one
        count += one
        at_v, at_u = _nearest(v - count * step_v), _nearest(u - count * step_u)
    if known == zero:
        return zero, zero, zero
    slopes *= count / known
    far_v, far_u = at_v, at_u
    is_seen = _is_lit(labels, bit, mask, far_v, far_u)
    if not is_seen:
        count -= half
    # towards the lamp, to where the light begins again: no part of it rises above the ray, one touches it
    best, ahead, at_v, at_u = -rise * stride * count - slopes, zero, y, x
    while _is_dark(labels, bit, mask, at_v, at_u):
        slopes += _slope(normals, affine, perspective, at_v, at_u, step_u, step_v)
        count += one
        ahead += one
        best = max(best, -rise * stride * count - slopes)
        at_v, at_u = _nearest(y + ahead * step_v), _nearest(x + ahead * step_u)
    turned = (one + rise * rise) * deviation * stride * count
    variance = (rise * _LENGTH_DEVIATION_PX) ** 2 + turned * turned
    if best >= zero or best * best < np.float32(4.0) * variance:
        return zero, zero, zero
    if is_seen and _is_lit(labels, bit, mask, at_v, at_u):
        ends[0], ends[1], ends[2], ends[3] = far_v, far_u, at_v, at_u
    return best, variance, -rise * stride * count


@njit
def _slope(
    normals: Any, affine: Any, perspective: Any, v: int, u: int, step_u: Any, step_v: Any
) -> Any:  # fmt: skip
    """Change of depth per step, in pixels."""
    x = perspective * (affine[0] * np.float32(u) + affine[1] * np.float32(v) + affine[2])
    y = perspective * (affine[3] * np.float32(u) + affine[4] * np.float32(v) + affine[5])
    n0, n1, n2 = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
    along = n0 * step_u + n1 * step_v
    facing = -(n0 * x + n1 * y + n2)
    return along / max(facing, abs(along) / _STEEPEST, np.float32(1e-6))


@njit
def _along_light(
    labels: Any, bit: Any, mask: Any, v: int, u: int, y: int, x: int, step_u: Any, step_v: Any
) -> Any:
    """Return the cosine between the way to the lamp and that to the light beside the edge of two pixels."""
    h, w = mask.shape
    total_u, total_v = np.float32(0.0), np.float32(0.0)
    above, beside = min(v, y, h - 1 - max(v, y), 2), min(u, x, w - 1 - max(u, x), 2)  # as far on either side
    for j in range(min(v, y) - above, max(v, y) + above + 1):
        for i in range(min(u, x) - beside, max(u, x) + beside + 1):
            if mask[j, i] and labels[j, i] & bit:
                total_u += np.float32(2 * i - u - x)
                total_v += np.float32(2 * j - v - y)
    lengths = np.sqrt((total_u * total_u + total_v * total_v) * (step_u * step_u + step_v * step_v))
    return (total_u * step_u + total_v * step_v) / max(lengths, np.float32(1e-6))
