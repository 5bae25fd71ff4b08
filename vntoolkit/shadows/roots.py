"""The normal where a light is missing: two roots a pixel, one decision for all that hang together.

Two lights under a known albedo leave two normals, mirror images in the plane of both lights (Onn and
Bruckstein 1990, `onn1990`): the *facing* root leans towards the missing light, and something else must block
it; the *averted* root leans away from it. The difference d between the normals of two neighbours has Cauchy's
likelihood s² / (s + d²)², whose scale s the fully lit neighbours of the same frame tell. So a surface
continues across the edge of a cast shadow and across a terminator, and it may step where one part hides
another. A minimum cut finds the roots of all pixels at once (`boykov2001`).
"""

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.special import expit

from vntoolkit.arrays import ByteArray, FloatArray, Int32Array, Mask, VisibilityLabels
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, count_lit
from vntoolkit.shadows.contributions import LightContributions, flat, lengths_of
from vntoolkit.shadows.graph_cut import lit_by_cut

_PAIRS = ((1, 2, 6), (0, 2, 5), (0, 1, 3))  # the two lights that remain, and the label that says so
_NEIGHBOURS = np.ones((3, 3), np.uint8)
_OCCLUDER_PRICE = 0.003  # nats a pixel times pixels from the edge: farther in, what throws it is higher
_STEPS = 0.3  # share of neighbours at a shadow with a step of depth between, where any normal is as likely
_LAG_PX = 2  # between normals that are compared: blur makes a step look smooth nearer by
_LEAST_SPREAD, _DARKEST = 0.01, 1e-3  # of the albedo, of which no pixel is darker
_FARTHER = 2.0  # an albedo 16 pixels off is known 1.0 to 1.5 times less well, most shadows lie farther off
_MOST_PAIRS = 50_000  # of neighbours that tell the scale
_UNKNOWN_SCALE, _LEAST_SCALE = 0.15, 1e-3  # of a difference of normals
_SHORTEST = np.float32(1e-9)  # of a normal's part in the plane of two lights
_CERTAIN = 3.0  # standard deviations
_UNLIKELY = 0.1  # probability of the other root below which depth may not turn a normal to it
_UNKNOWN, _LIT, _TWO = 0, 1, 2


class Roots(NamedTuple):
    """Of each pixel the root that the cut took.

    normals: (h, w, 3), those of the colours where all lights arrive. known: (h, w), where two lights arrive,
    or all three. variance: (h, w), of the angle to the plane of two lights, radians². mirror_probability:
    (h, w), how likely the other root is; 1/2 where nothing tells.
    """

    normals: FloatArray
    known: Mask
    variance: FloatArray
    mirror_probability: FloatArray


def roots_of_labels(
    light: LightContributions, albedo: FloatArray, labels: VisibilityLabels, mask: Mask, spread: float
) -> Roots:
    """Choose the root of every pixel that two lights reach.

    albedo: (h, w), that of the lit surroundings. labels: (h, w), bit k set where light k arrives. spread: the
    albedo's relative standard deviation.
    """
    wide = _widened(labels, mask)
    table = np.array([_UNKNOWN, _UNKNOWN, _TWO, _LIT], np.uint8)
    kinds: ByteArray = np.where(mask, table[count_lit(wide)], _UNKNOWN).astype(np.uint8)
    lit, two = kinds == _LIT, kinds == _TWO
    across, planes = _across(light), np.zeros((8, 3, 3), np.float32)
    for i, j, label in _PAIRS:
        planes[label][:, [i, j]] = np.linalg.pinv(light.lights[[i, j]])
    base, along = np.array(light.normals), np.zeros(mask.shape, np.float32)
    within = np.einsum("nij,nj->ni", planes[wide[two]], light.relative_to(albedo)[two])
    along[two] = lengths_of(within)[:, 0]
    base[two] = within / np.maximum(lengths_of(within), _SHORTEST)
    cosine = np.where(two, np.minimum(along, 1.0), 1.0)
    tilt: FloatArray = np.arccos(cosine).astype(np.float32)
    near, afar = (_squared_difference(light.normals, lit, lag) for lag in (1, _LAG_PX))
    of_cosine = along**2 * np.float32(spread**2) + np.float32(0.25 * near)
    of_angle = of_cosine / np.maximum(1.0 - cosine**2, np.sqrt(of_cosine))
    variance = np.where(two, of_angle, 0.0).astype(np.float32)
    log_odds, east, south = (np.zeros(mask.shape, np.float32) for _ in range(3))
    _costs_kernel(
        flat(base), tilt, across, wide, kinds, variance, np.float32(afar), np.float32(0.5 * _STEPS), log_odds,
        east, south,
    )  # fmt: skip
    occluder = np.float32(_OCCLUDER_PRICE) * cv2.distanceTransform(two.astype(np.uint8), cv2.DIST_L2, 5)
    facing = lit_by_cut(log_odds - occluder, lambda _: (east, south), two, np.inf)
    sine = np.sin(np.where(facing, tilt, -tilt))[..., None]
    roots = np.where(two[..., None], np.cos(tilt)[..., None] * base + sine * across[wide], light.normals)
    known = mask & ((labels == ALL_LIT) | two)
    normals = np.where((labels == ALL_LIT)[..., None], light.normals, roots).astype(np.float32)
    mirror = mirror_probability(log_odds, facing, two, east, south)
    return Roots(normals=normals, known=known, variance=variance, mirror_probability=mirror)


def mirror_probability(
    log_odds: FloatArray, facing: Mask, two: Mask, east: FloatArray, south: FloatArray
) -> FloatArray:
    """Return how likely the other root is by the lit pixels around a patch of one root; 1/2 where none are.

    All (h, w). log_odds: of facing, by lit neighbours, 0 without. facing: whether that root is taken. two:
    where two lights arrive. Neighbours along a border see the same surface: together they say no more than
    one of them in the mean. They vouch only for pixels that a change of root is unlikely to part from them.
    """
    odds: FloatArray = np.zeros(two.shape, np.float32)
    for sign, side in ((1.0, facing), (-1.0, ~facing)):
        count, patches = _patches(two & side, east, south)
        said = np.bincount(patches.ravel(), sign * log_odds.ravel(), count)
        mean = said / np.maximum(np.bincount(patches.ravel(), log_odds.ravel() != 0.0, count), 1)
        mean[0] = 0.0  # the rest of the image
        odds += mean[patches].astype(np.float32)
    return np.asarray(expit(-odds), np.float32)


def _patches(inside: Mask, east: FloatArray, south: FloatArray) -> tuple[int, Int32Array]:
    """Number the patches (h, w) of pixels linked where a change of root is unlikely; 0 is the rest.

    inside: (h, w). east, south: (h, w), prices of a change to the next pixel, nats.
    """
    height, width = inside.shape
    price = math.log(1.0 / _UNLIKELY - 1.0)
    grid = np.zeros((2 * height - 1, 2 * width - 1), np.uint8)  # a link lies between its two pixels
    grid[::2, ::2] = inside
    grid[::2, 1::2] = inside[:, :-1] & inside[:, 1:] & (east[:, :-1] > price)
    grid[1::2, ::2] = inside[:-1] & inside[1:] & (south[:-1] > price)
    count, patches = cv2.connectedComponents(grid, connectivity=4)
    return count, np.asarray(patches[::2, ::2], np.int32)


def with_sides_of_roots(
    normals: FloatArray, roots: Roots, labels: VisibilityLabels, light: LightContributions
) -> FloatArray:
    """Return a surface's normals (h, w, 3), and the roots where it leads to neither of the two.

    Depth may turn a normal over to the other side of the plane of its lights. It is kept where the lit
    surroundings leave the side in doubt and it lies at the other root, which explains the light as well.
    """
    across = _across(light)[labels]
    sine, start = np.sum(normals * across, axis=-1), np.sum(roots.normals * across, axis=-1)
    far = (sine + start) ** 2 > _CERTAIN**2 * roots.variance
    lost = (sine * start < 0.0) & (far | (roots.mirror_probability < _UNLIKELY))
    return np.where(lost[..., None], roots.normals, normals)


def _across(light: LightContributions) -> FloatArray:
    """Return (8, 3) by label, the unit normal of the plane of two lights, towards the third; 0 for others."""
    across = np.zeros((8, 3), np.float32)
    for i, j, label in _PAIRS:
        normal = np.cross(light.lights[i], light.lights[j])
        across[label] = normal / np.linalg.norm(normal) * np.sign(normal @ light.lights[3 - i - j])
    return across


def _widened(labels: VisibilityLabels, mask: Mask) -> VisibilityLabels:
    """Return labels whose shadows reach a pixel farther, as long as two lights remain.

    On a shadow's edge a light arrives in part. The other two tell the normal there, whatever that part is.
    """
    wide = np.where(mask, labels, ALL_LIT).astype(np.uint8)
    missing = ALL_LIT - wide
    for k in range(3):
        bit = np.uint8(1 << k)
        wide[(cv2.dilate(missing & bit, _NEIGHBOURS) > 0) & mask] &= np.uint8(ALL_LIT - bit)
    kept = (count_lit(labels) >= 2) & (count_lit(wide) < 2)
    return np.where(kept, labels, wide).astype(np.uint8)


def spread_of_albedo(length: FloatArray, albedo: FloatArray, lit: Mask) -> float | None:
    """Return the relative standard deviation of a shadow's albedo, as its surroundings tell it, or None.

    length, albedo: (h, w), each pixel's own and that of its surroundings. Told by the root of the mean
    squared difference of their logs where all lights arrive, `lit`; None where they do nowhere.
    """
    inner = cv2.erode(lit.astype(np.uint8), _NEIGHBOURS) > 0
    if not inner.any():
        return None
    ratio = np.maximum(length[inner], _DARKEST) / np.maximum(albedo[inner], _DARKEST)
    return max(_FARTHER * float(np.sqrt(np.mean(np.log(ratio) ** 2))), _LEAST_SPREAD)


def _squared_difference(normals: FloatArray, lit: Mask, lag: int) -> float:
    """Return the median squared difference of lit normals `lag` pixels apart in a row; not 0."""
    if lit.shape[1] <= lag:
        return _UNKNOWN_SCALE**2
    pairs = np.flatnonzero(lit[:, :-lag] & lit[:, lag:])
    v, u = np.divmod(pairs[:: 1 + len(pairs) // _MOST_PAIRS], lit.shape[1] - lag)
    if not len(v):
        return _UNKNOWN_SCALE**2
    apart = np.sum((normals[v, u] - normals[v, u + lag]) ** 2, axis=1)
    return max(float(np.median(apart)), _LEAST_SCALE**2)


@njit(forceinline=True)
def _root(base: FloatArray, v: int, u: int, tilt: Any, axis: FloatArray) -> tuple[Any, Any, Any]:
    cosine, sine = np.cos(tilt), np.sin(tilt)
    i = 3 * u
    return (
        cosine * base[v, i] + sine * axis[0], cosine * base[v, i + 1] + sine * axis[1],
        cosine * base[v, i + 2] + sine * axis[2],
    )  # fmt: skip


@njit(forceinline=True)
def _apart(one: tuple[Any, Any, Any], other: tuple[Any, Any, Any]) -> Any:
    return (one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2 + (one[2] - other[2]) ** 2


@njit(forceinline=True)
def _likelihood(one: tuple[Any, Any, Any], other: tuple[Any, Any, Any], scale: Any, step: Any) -> Any:
    """Return how likely two neighbours' normals are: alike on one surface, anything across a step."""
    wide = scale + _apart(one, other)
    return scale / (wide * wide) + step


@njit
def _costs_kernel(
    base: FloatArray, tilt: FloatArray, across: FloatArray, labels: VisibilityLabels, kinds: ByteArray,
    variance: FloatArray, squared: Any, step: Any, log_odds: FloatArray, east: FloatArray, south: FloatArray,
) -> None:  # fmt: skip
    """Fill (h, w): what lit pixels say for the facing root, and the price of a change to the next pixel.

    The normals compared lie `_LAG_PX` apart, where there are such: blur makes a step look smooth, nearer by.
    """
    h, w = labels.shape
    half, zero = np.float32(0.5), np.float32(0.0)
    for v in range(h):
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
                beyond, scale = across[labels[y, x]], squared + variance[v, u] + variance[y, x]
                to, back = _root(base, y, x, tilt[y, x], beyond), _root(base, y, x, -tilt[y, x], beyond)
                both, one = _likelihood(facing, to, scale, step), _likelihood(facing, back, scale, step)
                neither, other = (
                    _likelihood(averted, back, scale, step),
                    _likelihood(averted, to, scale, step),
                )
                if kind == _LIT:
                    log_odds[v, u] += np.log(both / neither)
                elif way == 0:
                    east[v, u] = max(half * np.log(both * neither / (one * other)), zero)
                else:
                    south[v, u] = max(half * np.log(both * neither / (one * other)), zero)


@njit(forceinline=True)
def _is_kind(kinds: ByteArray, v: int, u: int, kind: int) -> Any:
    return 0 <= v < kinds.shape[0] and 0 <= u < kinds.shape[1] and kinds[v, u] == kind
