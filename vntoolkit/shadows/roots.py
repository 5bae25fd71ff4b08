"""The normal where a light is missing: two roots a pixel, one decision for all that hang together.

Two lights under a known albedo leave two normals, mirror images in the plane of both lights (Onn and
Bruckstein 1990, `onn1990`): the *facing* root leans towards the missing light, and something else must block
it; the *averted* root leans away from it. One energy decides and then smooths: the difference d between the
normals of two neighbours costs log(1 + d² / s²), Cauchy's negative log likelihood, whose scale s the fully
lit neighbours of the same frame tell. So a surface continues across the edge of a cast shadow and across a
terminator, and it may step where one part hides another. A minimum cut finds the roots (`boykov2001`). Under
one light, or none, normals are continued from around.
"""

from typing import Any

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import BoolArray, ByteArray, FloatArray, Mask, VisibilityLabels
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, count_lit
from vntoolkit.shadows.albedo import fill_smoothly
from vntoolkit.shadows.contributions import LightContributions, flat, lengths_of
from vntoolkit.shadows.graph_cut import lit_by_cut

_PAIRS = ((1, 2, 6), (0, 2, 5), (0, 1, 3))  # the two lights that remain, and the label that says so
_NEIGHBOURS = np.ones((3, 3), np.uint8)
_OCCLUDER_PRICE = 0.003  # nats a pixel: a shadow that is cast needs something that throws it
_STEPS = 0.3  # share of neighbours at a shadow with a step of depth between, where any normal is as likely
_LAG_PX = 2  # between normals that are compared: blur makes a step look smooth nearer by
_SWEEPS = 6  # more change nothing by half a degree
_LEAST_SPREAD, _DARKEST = 0.01, 1e-3  # of the albedo, of which no pixel is darker
_FARTHER = 2.0  # an albedo 16 pixels off is known 1.0 to 1.5 times less well, most shadows lie farther off
_UNKNOWN_SPREAD = 0.15  # of the albedo, where no pixel is lit
_MOST_PAIRS = 50_000  # of neighbours that tell the scale
_LEAST_SCALE = 1e-3  # of a difference of normals
_EDGE_ON = -1e-3  # n_z of a normal that would face away
_UNKNOWN, _LIT, _TWO = 0, 1, 2


def normals_from_labels(
    light: LightContributions,
    albedo: FloatArray,
    labels: VisibilityLabels,
    mask: Mask,
    sweeps: int = _SWEEPS,
) -> FloatArray:
    """Return unit normals (h, w, 3), 0 outside `mask`; plain inversion's where all lights arrive.

    albedo: (h, w), that of the lit surroundings. labels: (h, w), bit k set where light k arrives. sweeps:
    rounds of smoothing; 0 for the bare roots.
    """
    normals, lit = light.normals, mask & (labels == ALL_LIT)
    if (mask & ~lit).any():
        roots = Roots(light, albedo, _widened(labels, mask), mask)
        normals = np.where(lit[..., None], normals, roots.normals(sweeps))
        known = lit | (roots.kinds != _UNKNOWN)
        if (mask & ~known).any():
            filled = fill_smoothly(normals, known.astype(np.float32))
            normals = np.where(known[..., None], normals, filled)
    normals = np.array(normals)
    normals[..., 2] = np.minimum(normals[..., 2], _EDGE_ON)
    return np.where(mask[..., None], normals / lengths_of(normals), 0.0).astype(np.float32)


def _widened(labels: VisibilityLabels, mask: Mask) -> VisibilityLabels:
    """Return labels whose shadows reach a pixel farther, as long as two lights remain.

    On a shadow's edge a light arrives in part. The other two tell the normal there, whatever that part is.
    """
    wide = np.where(mask, labels, ALL_LIT).astype(np.uint8)
    missing = ALL_LIT - wide
    for k in range(3):
        bit = np.uint8(1 << k)
        wide[(cv2.dilate(missing & bit, _NEIGHBOURS) > 0) & mask] &= np.uint8(ALL_LIT - bit)
    kept = (count_lit(labels) == 2) & (count_lit(wide) < 2)
    return np.where(kept, labels, wide).astype(np.uint8)


class Roots:
    """The roots of one frame: n = cos(tilt) base ± sin(tilt) across, the first towards the missing light.

    kinds: (h, w), whether a pixel's normal is unknown, its colour's, or one of two roots. along: (h, w),
    length of a normal's part in the plane of two lights, as measured. base: (h, w, 3), the direction of that
    part, or the colour's normal. across: (8, 3) by label, unit normal of it. variance: (h, w), of along
    by noise and the albedo's `spread`; doubt: (h, w), of the tilt. squared, squared_afar: median
    squared difference of lit normals that are neighbours, and that lie `_LAG_PX` apart.
    """

    def __init__(
        self, light: LightContributions, albedo: FloatArray, labels: VisibilityLabels, mask: Mask
    ) -> None:
        """labels: (h, w), bit k set where light k arrives."""
        table = np.array([_UNKNOWN, _UNKNOWN, _TWO, _LIT], np.uint8)
        self.kinds: ByteArray = np.where(mask, table[count_lit(labels)], _UNKNOWN).astype(np.uint8)
        lit = self.kinds == _LIT
        self.spread = spread_of_albedo(light.length, albedo, lit)
        self.squared = _squared_difference(light.normals, lit, 1)
        self.squared_afar = _squared_difference(light.normals, lit, _LAG_PX)
        self.labels = labels
        self.across, planes = np.zeros((8, 3), np.float32), np.zeros((8, 3, 3), np.float32)
        for i, j, label in _PAIRS:
            pair, missing = light.lights[[i, j]], light.lights[3 - i - j]
            normal = np.cross(*pair)
            self.across[label] = normal / np.linalg.norm(normal) * np.sign(normal @ missing)
            planes[label][:, [i, j]] = np.linalg.pinv(pair)
        self.base, self.along = np.array(light.normals), np.zeros(mask.shape, np.float32)
        relative = flat(light.relative_to(albedo))
        _base_kernel(relative, labels, self.kinds, planes, flat(self.base), self.along)
        cosine = np.where(self.kinds == _TWO, np.minimum(self.along, 1.0), 1.0)
        self.tilt: FloatArray = np.arccos(cosine).astype(np.float32)
        self.variance = self.along**2 * np.float32(self.spread**2) + np.float32(0.25 * self.squared)
        doubt = self.variance / np.maximum(1.0 - cosine**2, np.sqrt(self.variance))
        self.doubt = np.where(self.kinds == _TWO, doubt, 0.0).astype(np.float32)

    def faces(self) -> BoolArray:
        """Return (h, w), True where the root that leans towards the missing light costs less."""
        shape = self.kinds.shape
        evidence, east, south = (np.zeros(shape, np.float32) for _ in range(3))
        _costs_kernel(
            flat(self.base), self.tilt, self.across, self.labels, self.kinds, self.doubt,
            np.float32(self.squared_afar), np.float32(0.5 * _STEPS), evidence, east, south,
        )  # fmt: skip
        two: Mask = self.kinds == _TWO
        return lit_by_cut(evidence - np.float32(_OCCLUDER_PRICE), lambda _: (east, south), two, np.inf) & two

    def normals(self, sweeps: int) -> FloatArray:
        """Return normals (h, w, 3) of the cheaper roots, smoothed as far as the albedo is not known."""
        tilt = np.where(self.faces(), self.tilt, -self.tilt)
        cosine, sine = np.cos(tilt)[..., None], np.sin(tilt)[..., None]
        out: FloatArray = cosine * self.base + sine * self.across[self.labels]
        for i in range(sweeps):
            _sweep_kernel(
                flat(self.base), self.along, self.variance, self.across, self.labels, self.kinds, self.doubt,
                np.float32(self.squared), i % 2 == 0, tilt, flat(out),
            )  # fmt: skip
        return out


def spread_of_albedo(length: FloatArray, albedo: FloatArray, lit: Mask) -> float:
    """Return the relative standard deviation of a shadow's albedo, as its surroundings tell it.

    Told by the root of the mean squared difference of logs where all lights arrive.
    """
    inner = cv2.erode(lit.astype(np.uint8), _NEIGHBOURS) > 0
    if not inner.any():
        return _UNKNOWN_SPREAD
    ratio = np.maximum(length[inner], _DARKEST) / np.maximum(albedo[inner], _DARKEST)
    return max(_FARTHER * float(np.sqrt(np.mean(np.log(ratio) ** 2))), _LEAST_SPREAD)


def _squared_difference(normals: FloatArray, lit: Mask, lag: int) -> float:
    """Return the median squared difference of lit normals `lag` pixels apart in a row; not 0."""
    if lit.shape[1] <= lag:
        return _UNKNOWN_SPREAD**2
    pairs = np.flatnonzero(lit[:, :-lag] & lit[:, lag:])
    v, u = np.divmod(pairs[:: 1 + len(pairs) // _MOST_PAIRS], lit.shape[1] - lag)
    if not len(v):
        return _UNKNOWN_SPREAD**2
    apart = np.sum((normals[v, u] - normals[v, u + lag]) ** 2, axis=1)
    return max(float(np.median(apart)), _LEAST_SCALE**2)


@njit(cache=True, parallel=True, error_model="numpy")
def _base_kernel(
    relative: FloatArray, labels: VisibilityLabels, kinds: ByteArray, planes: FloatArray, base: FloatArray,
    along: FloatArray,
) -> None:  # fmt: skip
    """Fill base (h, 3 w) and along (h, w). planes: (8, 3, 3), a normal's part in two lights' plane."""
    h, w = labels.shape
    for v in prange(h):
        for u in range(w):
            if kinds[v, u] != _TWO:
                continue
            plane, i = planes[labels[v, u]], 3 * u
            a, b, c = relative[v, i], relative[v, i + 1], relative[v, i + 2]
            x = plane[0, 0] * a + plane[0, 1] * b + plane[0, 2] * c
            y = plane[1, 0] * a + plane[1, 1] * b + plane[1, 2] * c
            z = plane[2, 0] * a + plane[2, 1] * b + plane[2, 2] * c
            length = np.sqrt(x * x + y * y + z * z)
            along[v, u] = length
            if length > np.float32(0.0):
                base[v, i], base[v, i + 1], base[v, i + 2] = x / length, y / length, z / length


@njit(cache=True, forceinline=True, error_model="numpy")
def _root(base: FloatArray, v: int, u: int, tilt: Any, axis: FloatArray) -> tuple[Any, Any, Any]:
    cosine, sine = np.cos(tilt), np.sin(tilt)
    i = 3 * u
    return (
        cosine * base[v, i] + sine * axis[0], cosine * base[v, i + 1] + sine * axis[1],
        cosine * base[v, i + 2] + sine * axis[2],
    )  # fmt: skip


@njit(cache=True, forceinline=True, error_model="numpy")
def _apart(one: tuple[Any, Any, Any], other: tuple[Any, Any, Any]) -> Any:
    return (one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2 + (one[2] - other[2]) ** 2


@njit(cache=True, forceinline=True, error_model="numpy")
def _likelihood(one: tuple[Any, Any, Any], other: tuple[Any, Any, Any], scale: Any, step: Any) -> Any:
    """Return how likely two neighbours' normals are: alike on one surface, anything across a step."""
    wide = scale + _apart(one, other)
    return scale / (wide * wide) + step


@njit(cache=True, parallel=True, error_model="numpy")
def _costs_kernel(
    base: FloatArray, tilt: FloatArray, across: FloatArray, labels: VisibilityLabels, kinds: ByteArray,
    doubt: FloatArray, squared: Any, step: Any, evidence: FloatArray, east: FloatArray, south: FloatArray,
) -> None:  # fmt: skip
    """Fill (h, w): what lit pixels say for the facing root, and the price of a change to the next pixel.

    The normals compared lie `_LAG_PX` apart, where there are such: blur makes a step look smooth, nearer by.
    """
    h, w = labels.shape
    half, zero = np.float32(0.5), np.float32(0.0)
    for v in prange(h):
        for u in range(w):
            if kinds[v, u] != _TWO:
                continue
            axis = across[labels[v, u]]
            facing = _root(base, v, u, tilt[v, u], axis)
            averted = _root(base, v, u, -tilt[v, u], axis)
            for way in range(4):  # east, south, west, north
                dv, du = (way == 1) - (way == 3), (way == 0) - (way == 2)
                y, x = v + dv, u + du
                if y < 0 or x < 0 or y >= h or x >= w or kinds[y, x] == _UNKNOWN:
                    continue
                kind = kinds[y, x]
                if kind == _TWO and way > 1:
                    continue
                reach = 1
                while reach < _LAG_PX and _is_kind(kinds, v + (reach + 1) * dv, u + (reach + 1) * du, kind):
                    reach += 1
                y, x = v + reach * dv, u + reach * du
                beyond, scale = across[labels[y, x]], squared + doubt[v, u] + doubt[y, x]
                to, back = _root(base, y, x, tilt[y, x], beyond), _root(base, y, x, -tilt[y, x], beyond)
                both, one = _likelihood(facing, to, scale, step), _likelihood(facing, back, scale, step)
                neither, other = (
                    _likelihood(averted, back, scale, step),
                    _likelihood(averted, to, scale, step),
                )
                if kind == _LIT:
                    evidence[v, u] += np.log(both / neither)
                elif way == 0:
                    east[v, u] = max(half * np.log(both * neither / (one * other)), zero)
                else:
                    south[v, u] = max(half * np.log(both * neither / (one * other)), zero)


@njit(cache=True, forceinline=True, error_model="numpy")
def _is_kind(kinds: ByteArray, v: int, u: int, kind: int) -> Any:
    return 0 <= v < kinds.shape[0] and 0 <= u < kinds.shape[1] and kinds[v, u] == kind


@njit(cache=True, error_model="numpy")
def _sweep_kernel(
    base: FloatArray, along: FloatArray, variance: FloatArray, across: FloatArray, labels: VisibilityLabels,
    kinds: ByteArray, doubt: FloatArray, squared: Any, forward: bool, tilt: FloatArray, normals: FloatArray,
) -> None:  # fmt: skip
    """Turn tilts, and normals (h, 3 w), to where the energy is least: a Gauss–Newton step a pixel.

    The energy here knows that the albedo is uncertain. A neighbour that is farther off counts less, as
    Cauchy's likelihood says.
    """
    h, w = labels.shape
    steepest = np.float32(0.5 * np.pi)
    for row in range(h):
        v = row if forward else h - 1 - row
        for column in range(w):
            u = column if forward else w - 1 - column
            if kinds[v, u] != _TWO:
                continue
            axis, i = across[labels[v, u]], 3 * u
            own = (normals[v, i], normals[v, i + 1], normals[v, i + 2])
            lean, level, total = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for way in range(4):
                y, x = v + (way == 1) - (way == 3), u + (way == 0) - (way == 2)
                if y < 0 or x < 0 or y >= h or x >= w or kinds[y, x] == _UNKNOWN:
                    continue
                a, b, c = normals[y, 3 * x], normals[y, 3 * x + 1], normals[y, 3 * x + 2]
                scale = squared + doubt[v, u] + doubt[y, x]
                weight = scale / (squared * (scale + _apart(own, (a, b, c))))
                lean += weight * (a * axis[0] + b * axis[1] + c * axis[2])
                level += weight * (a * base[v, i] + b * base[v, i + 1] + c * base[v, i + 2])
                total += weight
            if total == np.float32(0.0):
                continue
            angle, seen = tilt[v, u], along[v, u]
            sine, trust = np.sin(angle), np.float32(1.0) / variance[v, u]
            turn = total * (np.arctan2(lean, level) - angle)
            angle += (sine * (np.cos(angle) - seen) * trust + turn) / (sine * sine * trust + total)
            tilt[v, u] = min(max(angle, -steepest), steepest)
            normals[v, i], normals[v, i + 1], normals[v, i + 2] = _root(base, v, u, tilt[v, u], axis)
