"""The surface from the best of several starts.

Where two lights arrive the energy has two minima, since the quadratic of `roots_from_two_lights` has two
roots. A smooth continuation of the lit surroundings leads to one of them, and the roots chosen by continuity
lead to the other. The surface that the labels came from competes with both. Every shadow keeps the one that
costs least: that returns the light that is seen, by a depth that hangs together. Roots must be held until
depth has found where it steps, as from a chin to the neck. A depth that holds together everywhere would turn
them over.
"""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import BoolArray, ByteArray, Float64Array, FloatArray, Mask, Normals, VisibilityLabels
from vntoolkit.geometry.slope_grid import FLATTEST_Z
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame, count_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.contributions import contributions_from_frame, flat, lengths_of
from vntoolkit.shadows.surface import ALBEDO_SPREAD, LabelledImage, Surface, SurfaceOptions

_MEDIAN_TO_DEVIATION = 1.4826
_FEWEST_LOOPS = 100
_FEWEST_PAIRS = 60  # of rows, whose noise stands for the frame's
_OUTLINE = np.ones((5, 5), np.uint8)  # beside it blur mixes the light with what lies behind
_AROUND = (7, 7)  # a square of 7 pixels has the standard deviation of `surface`'s surroundings, 2 pixels
_PAIRS = ((1, 2, 6), (0, 2, 5), (0, 1, 3))  # the two lights that remain, and the label that says so
# Of a pixel that 0 … 3 lights reach: one alone hangs on the albedo; few pixels under two must hold against
# many around.
TRUST_BY_LIGHTS = (1.0, 0.2, 2.0, 1.0)
_NOISE_PER_SLOPE = 1.7  # noise of a cosine per noise of a slope, on cleaner frames
_LEAST_NOISE = 0.01  # of a cosine
_LEAST_SPREAD, _DARKEST = 0.01, 1e-3  # of the albedo, of which no pixel is darker
_FARTHER = 2.0  # an albedo 16 pixels off is known 1.0 to 1.5 times less well, most shadows lie farther off
_START_PIXELS = 15_000  # frames are halved until they are not larger; there the starts are compared
_FEW_ITERATIONS = 4  # steps there of a surface that is given, and of one that was merged
_MIDDLE_ITERATIONS, _LARGE_ITERATIONS = 4, 3  # steps at every larger size, and at the largest, …
_SETTLED_ITERATIONS = 2  # … of which the last ones settle
_HELD = 3  # iterations that keep the roots, while depth finds its steps
_BORDER = np.ones((5, 5), np.uint8)  # around a shadow, whose steps of depth count with it


def solve_from_best_initialisation(
    image: LabelledImage, options: SurfaceOptions, start: Surface | None = None
) -> Surface:
    """Solve the surface of a frame on its working size, coarse to fine.

    start: the surface that the labels came from, or None. It competes with what a smaller image prefers.
    """
    image = _trusted(image)
    found = _better_than(start, image, options)
    large = replace(options, iterations=_LARGE_ITERATIONS, settled=_SETTLED_ITERATIONS)
    if found is None:
        surface = image.solve(large, start)
    else:
        held = replace(large, iterations=_HELD + _LARGE_ITERATIONS, held=_HELD)
        surface = image.solve(held, found)
        if start is not None:
            own = image.solve(large, start)
            better = _better_regions(image.energy(surface, options), image.energy(own, options), image.shadow)
            surface = _merged(surface, own, better, image.shadow)
    return replace(surface, normals=_turned_to_light(surface.normals, image, options.spread))


def _trusted(labelled: LabelledImage) -> LabelledImage:
    """Return the image with the trust in its colours by the number of lights that arrive."""
    by_lights = np.asarray(TRUST_BY_LIGHTS, dtype=np.float32)[count_lit(labelled.labels)]
    return replace(labelled, trust=(labelled.image.light.trust * by_lights).astype(np.float32))


def _better_than(start: Surface | None, image: LabelledImage, options: SurfaceOptions) -> Surface | None:
    """Return a surface to go on from, found on a smaller image; None where `start` is as good."""
    mask = image.image.mask
    if mask.size <= _START_PIXELS:
        return _best_of_starts(start, image, options)
    small = image.halved()
    found = _better_than(None if start is None else start.shrunk(mask, 2), small, options)
    if found is None:
        return None
    if small.image.mask.size > _START_PIXELS:  # the smallest is solved already
        found = small.solve(replace(options, iterations=_MIDDLE_ITERATIONS), found)
    return found.enlarged(mask.shape, 2)


def options_of_frame(slope: float | None, spread: float) -> SurfaceOptions:
    """Return what recovery asks of a surface. slope: the noise of slopes, None where it is not known."""
    options = SurfaceOptions(spread=spread)
    if slope is None:
        return options
    return replace(options, noise=min(options.noise, max(_NOISE_PER_SLOPE * slope, _LEAST_NOISE)))


def _best_of_starts(start: Surface | None, image: LabelledImage, options: SurfaceOptions) -> Surface | None:
    """Solve from the roots, from a smooth continuation and from `start`; every shadow takes the best of them.

    None where `start` is the best in all of them.
    """
    shadow = image.shadow
    if start is not None and not shadow.any():
        return None
    smooth = image.solve(options)
    if not shadow.any():
        return smooth
    light = image.image.light
    roots, decided = continue_with_two_lights(
        light.normals, light.relative_to(image.albedo), image.labels, light.lights, image.image.mask
    )
    rooted = image.solve(replace(options, held=_HELD), first_normals=roots, guessed=decided)
    few = replace(options, iterations=_FEW_ITERATIONS)
    if start is None:
        best, others = smooth, [rooted]
    else:
        best, others = image.solve(few, start), [smooth, rooted]
    energy, changed = image.energy(best, options), False
    for other in others:
        cost = image.energy(other, options)
        better = _better_regions(cost, energy, shadow)
        best, energy = _merged(other, best, better, shadow), np.where(better, cost, energy)
        changed = changed or bool(better.any())
    if changed:
        return image.solve(few, best)
    return smooth if start is None else None


def _better_regions(first: FloatArray, second: FloatArray, shadow: Mask) -> Mask:
    """Connected regions of `shadow` in and around which `first` is less than `second` in sum."""
    _, region = cv2.connectedComponents(shadow.astype(np.uint8), connectivity=4)
    around = np.where(shadow, region, cv2.dilate(region.astype(np.float32), _BORDER)).astype(region.dtype)
    gain = np.bincount(around.ravel(), weights=(second - first).ravel())
    return np.asarray(shadow & (gain[region] > 0.0))


def _merged(first: Surface, second: Surface, better: Mask, shadow: Mask) -> Surface:
    """Return a surface with the first one's normals where it is better, the second one's elsewhere.

    Its depth is that of the one that most of the shadow takes.
    """
    base = first if 2 * np.count_nonzero(better) > np.count_nonzero(shadow) else second
    return replace(base, normals=np.where(better[..., None], first.normals, second.normals))


def _turned_to_light(normals: Normals, image: LabelledImage, spread: float) -> Normals:
    """Turn normals under two lights towards the nearer of those that the light leaves (`onn1990`).

    A depth that holds together bends where it steps in truth, and with it the normals around. Then neighbours
    are turned alike; noise turns each another way. With d the turn of one pixel, the part of it that is no
    noise is |mean d|² over the mean of |d|² (Wiener's filter). An albedo that is off turns them alike, too:
    that part counts by the share of the variance that slopes started from beyond the frame's own `spread`².
    """
    inner = cv2.erode(image.image.mask.astype(np.uint8), _OUTLINE)
    light, planes = image.image.light, np.zeros((8, 4, 3))
    for i, j, label in _PAIRS:
        pair = light.lights[[i, j]]
        across = np.cross(*pair)
        planes[label, :3, [i, j]] = np.linalg.pinv(pair).T
        planes[label, 3] = across / np.linalg.norm(across)
    turns, count = np.zeros((*inner.shape, 4), np.float32), np.zeros(inner.shape, np.float32)
    _turns_kernel(
        flat(image.cosines), image.labels, inner, flat(normals), planes.astype(np.float32), turns, count
    )
    share = np.float32(1.0 - min(spread / ALBEDO_SPREAD, 1.0) ** 2)
    out = np.array(normals)
    _turn_kernel(turns, cv2.blur(turns, _AROUND), cv2.blur(count, _AROUND), count, share, flat(out))
    return out


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _turns_kernel(
    cosines: FloatArray, labels: VisibilityLabels, inner: ByteArray, normals: FloatArray, planes: FloatArray,
    turns: FloatArray, count: FloatArray,
) -> None:  # fmt: skip
    """Fill turns (h, w, 4), from normals to the nearer root, with the square; count (h, w), 1 where known.

    planes: (8, 4, 3) by label, what makes the part of a normal in the two lights' plane of the light, and the
    unit normal of that plane.
    """
    h, w = labels.shape
    for v in prange(h):
        for u in range(w):
            plane = planes[labels[v, u]]
            if not inner[v, u] or plane[3, 0] ** 2 + plane[3, 1] ** 2 + plane[3, 2] ** 2 == np.float32(0.0):
                continue
            a, b, c = cosines[v, 3 * u], cosines[v, 3 * u + 1], cosines[v, 3 * u + 2]
            n0, n1, n2 = normals[v, 3 * u], normals[v, 3 * u + 1], normals[v, 3 * u + 2]
            x = plane[0, 0] * a + plane[0, 1] * b + plane[0, 2] * c
            y = plane[1, 0] * a + plane[1, 1] * b + plane[1, 2] * c
            z = plane[2, 0] * a + plane[2, 1] * b + plane[2, 2] * c
            reach = np.sqrt(max(np.float32(1.0) - x * x - y * y - z * z, np.float32(0.0)))
            reach = reach if n0 * plane[3, 0] + n1 * plane[3, 1] + n2 * plane[3, 2] > 0 else -reach
            x, y, z = x + reach * plane[3, 0], y + reach * plane[3, 1], z + reach * plane[3, 2]
            over = np.float32(1.0) / max(np.sqrt(x * x + y * y + z * z), np.float32(1e-6))
            x, y, z = x * over - n0, y * over - n1, z * over - n2
            turns[v, u, 0], turns[v, u, 1], turns[v, u, 2] = x, y, z
            turns[v, u, 3] = x * x + y * y + z * z
            count[v, u] = np.float32(1.0)


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _turn_kernel(
    turns: FloatArray, mean: FloatArray, known: FloatArray, count: FloatArray, share: Any, normals: FloatArray
) -> None:
    """Turn normals (h, 3 w) in place. mean, known: means of `turns` and `count` around each pixel."""
    h, w = count.shape
    for v in prange(h):
        for u in range(w):
            if count[v, u] == np.float32(0.0):
                continue
            x, y, z, square = mean[v, u, 0], mean[v, u, 1], mean[v, u, 2], mean[v, u, 3]
            alike = share * (x * x + y * y + z * z) / max(known[v, u] * square, np.float32(1e-9))
            x, y, z = (
                normals[v, 3 * u] + alike * turns[v, u, 0],
                normals[v, 3 * u + 1] + alike * turns[v, u, 1],
                normals[v, 3 * u + 2] + alike * turns[v, u, 2],
            )
            over = np.float32(1.0) / max(np.sqrt(x * x + y * y + z * z), np.float32(1e-6))
            normals[v, 3 * u], normals[v, 3 * u + 1], normals[v, 3 * u + 2] = x * over, y * over, z * over


def spread_of_albedo(image: LabelledImage) -> float:
    """Return the relative standard deviation of a shadow's albedo, as its surroundings tell it.

    Told by the root of the mean squared difference of logs where all lights arrive.
    """
    lit = cv2.erode((image.image.mask & ~image.shadow).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if not lit.any():
        return ALBEDO_SPREAD
    ratio = np.maximum(image.image.light.length[lit], _DARKEST) / np.maximum(image.albedo[lit], _DARKEST)
    spread = _FARTHER * np.sqrt(np.mean(np.log(ratio) ** 2))
    return float(max(spread, _LEAST_SPREAD))


# How noisy the normals of one frame are: as far as no surface has them.


def noise_of_frame(rgb: FloatArray, response: LightResponse, known: Mask) -> float | None:
    """Return the standard deviation of a facing normal's slope, or None with too few `known` pixels.

    rgb: (h, w, 3), of which pairs of rows are read. A slope's noise grows with 1 / n_z², which is taken out.
    The median makes steps in depth, where loops do not close either, count for little.
    """
    pairs = max(len(known) // _FEWEST_PAIRS, 2)
    last = len(known) - len(known) % pairs

    def rows(first: int) -> tuple[FloatArray, Mask]:
        part = np.ascontiguousarray(rgb[first:last:pairs])
        frame = LinearFrame(rgb=part, clipped=np.zeros(part.shape[:2], np.bool_))
        return contributions_from_frame(frame, response).normals, known[first:last:pairs]

    return _noise_between(*rows(0), *rows(1))


def _noise_between(upper: FloatArray, known: Mask, lower: FloatArray, also: Mask) -> float | None:
    """upper, lower: (n, w, 3), normals of rows and of the rows below them."""

    def slopes(normals: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        facing = np.maximum(-normals[..., 2], FLATTEST_Z)
        return normals[..., 0] / facing, normals[..., 1] / facing, facing

    (p, q, facing), (p_below, q_below, _) = slopes(upper), slopes(lower)
    along_u = 0.5 * (p[:, :-1] + p[:, 1:] - p_below[:, :-1] - p_below[:, 1:])
    along_v = 0.5 * (q[:, 1:] + q_below[:, 1:] - q_below[:, :-1] - q[:, :-1])
    loops = known[:, :-1] & known[:, 1:] & also[:, :-1] & also[:, 1:]
    if np.count_nonzero(loops) < _FEWEST_LOOPS:
        return None
    sums = np.abs((along_u + along_v) * facing[:, :-1] ** 2)[loops]
    return float(_MEDIAN_TO_DEVIATION * np.median(sums) / np.sqrt(2.0))  # of 8 slopes, a half each


# Normals from two lights under a known albedo: the quadratic of Onn and Bruckstein (onn1990).


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
    normals: Float64Array,
    roots: Float64Array,
    two: BoolArray,
    decided: BoolArray,
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
def _beside(decided: BoolArray, v: int, u: int) -> bool:
    h, w = decided.shape
    for i in range(max(v - 1, 0), min(v + 2, h)):
        for j in range(max(u - 1, 0), min(u + 2, w)):
            if decided[i, j]:
                return True
    return False


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(lengths_of(vectors), 1e-12)
