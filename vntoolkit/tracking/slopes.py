"""Normals as the slopes that registration reads, and the metric that they give the image.

With the surface X(u) = Z(u) r(u), r the ray of pixel u, the normal n gives the gradient of log Z:
a_i = −(n · r_i) / (n · r), r_i = ∂r/∂u_i. Under any warp of the image it transforms as a gradient, and the
metric of the surface, in pixels, is G_ij = r_i·r_j + a_i r_j·r + a_j r_i·r + a_i a_j r·r, up to Z². For an
orthographic camera a is the slope and G = I + a aᵀ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Points2, VisibilityLabels, Weight
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.native import njit

_STEEPEST = 0.15  # cosine to the viewing ray below which a slope is clamped, 81°
GRAZING = 0.3  # cosine below which a slope weighs less, 73°: there it is mostly noise

_EDGE_REACH_PX = 2  # of an edge that is off by a pixel, in a picture that is blurred by one
_LEAST_DIVISOR = np.float32(1e-3)  # of what a weight is divided by
LEAST_WEIGHT = 0.01  # of a pixel that counts
SIGMA_PX = 2.5  # of the Gaussian that is taken off a band
TAPS = 15  # to 3 sigma
_TIMES = 3  # that it is: relief up to 16 px long passes, of a fold of 60 px a ten-thousandth is left
_MOST_HALVINGS = 2
_JUMP_SMOOTHING_PX = 1.5
_JUMP_WINDOW_PX = 5
_JUMP_RATIO = 1.8  # of the greatest weight in the window to the least
_DARK = 0.05  # added to both: below it all weights mean the same
_RELIEF_PX, _AROUND_PX = 9, 17  # windows: what counts as relief, and over how far it is averaged
_STRONG_RELIEF = 0.1  # root mean square, in units of the normal: a knit has 0.12 to 0.17, skin 0.03 to 0.1

Slopes = npt.NDArray[np.float32]  # (h, w, 3): w a_u, w a_v, w
Relief = npt.NDArray[np.float32]  # (h, w, 4): the same, and the distance from an occluding contour in pixels


def slopes_from_normals(normal_map: NormalMap, camera: Camera) -> Slopes:
    """Return (h, w, 3) float32: w a_u, w a_v, w, with a in focal lengths and w the pixel's weight.

    w: mask, normal map's weight beside its median (`beside_the_usual`), less at grazing angles.
    Premultiplied, so that smoothing mixes only what is valid; smoothed over 3×3 pixels, so that interpolation
    blurs no more at half pixels than at whole ones.
    """
    share = normal_map.mask.astype(np.float32)
    if normal_map.weight is not None:
        share *= beside_the_usual(normal_map.weight, normal_map.mask)
    h, w = normal_map.shape
    per_u, per_v, centre_u, centre_v = _ray_terms(camera)
    x = np.asarray(per_u * (np.arange(w) - centre_u), np.float32)
    y = np.asarray(per_v * (np.arange(h)[:, None] - centre_v), np.float32)
    n0, n1, n2 = np.moveaxis(normal_map.normals_in_camera, -1, 0)
    facing = np.maximum(-(n0 * x + n1 * y + n2), np.float32(_STEEPEST))
    share *= np.minimum(np.square(facing / np.float32(GRAZING)), 1)
    slopes = cv2.merge([share * n0 / facing, share * n1 / facing, share])
    return np.asarray(cv2.GaussianBlur(slopes, (3, 3), 0.7))


def relief_slopes(
    slopes: Slopes,
    normal_map: NormalMap,
    labels: VisibilityLabels | None = None,
    from_contour_px: FloatArray | None = None,
    contours: Mask | None = None,
) -> Relief:
    """Return the slopes of a normal map without weight around the edges of shadows and around contours.

    A shadow ends where labels (h, w) change, or else the weight jumps. Lengths and facing hold there; relief
    does not. from_contour_px: (h, w) distance from the nearest occluding contour on the outline; None for
    none. contours: (h, w), those within the figure.
    """
    if from_contour_px is None:
        from_contour_px = np.full(normal_map.shape, np.inf, dtype=np.float32)
    out = np.asarray(cv2.merge([*cv2.split(slopes), from_contour_px]), dtype=np.float32)
    if labels is not None:
        out[label_edges(labels, normal_map.mask), :3] = 0.0
    elif normal_map.weight is not None:
        weight = beside_the_usual(normal_map.weight, normal_map.mask)
        out[jump_pixels(replace(normal_map, weight=weight)), :3] = 0.0
    if contours is not None and contours.any():
        window = np.ones((2 * _EDGE_REACH_PX + 1,) * 2, dtype=np.uint8)
        out[cv2.dilate(contours.astype(np.uint8), window) > 0, :3] = 0.0
    return out


def metric_sums(
    slopes: Slopes,
    camera: Camera,
    positions_px: Points2,
    scale: FloatArray,
    node: npt.NDArray[np.int32],
    count: int,
) -> npt.NDArray[np.float64]:
    """Return (count, 6) sums over nodes of w G_uu, w G_uv, w G_vv, w a_u, w a_v and w at positions (n, 2).

    G is in pixels, unit where the surface faces the axis at the distance that the scale (n,) is 1 for.
    """
    h, w = slopes.shape[:2]
    p, q, weight = sample_image(slopes, positions_px).T
    p, q = p / np.maximum(weight, 0.02), q / np.maximum(weight, 0.02)
    u, v = np.clip(positions_px, 0.0, (w - 1.0, h - 1.0)).T
    per_u, per_v, centre_u, centre_v = _ray_terms(camera)
    x, y = (u - centre_u) * per_u, (v - centre_v) * per_v
    square = 1.0 + x * x + y * y
    share = weight * scale**2
    terms = (
        share * (1.0 + 2.0 * p * x + p * p * square),
        share * (p * y + q * x + p * q * square),
        share * (1.0 + 2.0 * q * y + q * q * square),
        weight * p,
        weight * q,
        weight,
    )
    return np.stack([np.bincount(node, term, count) for term in terms], axis=1)


def gradient_bands(
    values: npt.NDArray[np.float32], weight: npt.NDArray[np.float32]
) -> Iterator[tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]]]:
    """Yield, at full resolution and at halvings, values less their Gaussian mean, gradients and weight.

    values: (h, w, k) slopes, or another quantity, times weight (h, w). Yields (h, w, k), (h, w, 2 k) all ∂/∂u
    and then all ∂/∂v per pixel of full resolution, and (h, w), 0 where a neighbour is missing.
    """
    values, weight = values.copy(), weight.copy()
    for halvings in range(_MOST_HALVINGS + 1):
        if halvings > 0 and min(weight.shape) < 8:
            return
        smaller = np.asarray(cv2.pyrDown(weight), np.float32)
        coarser = np.asarray(cv2.pyrDown(values), np.float32).reshape(*smaller.shape, -1)
        _high_pass(values, weight)
        yield values, *gradients(values, weight, np.float32(0.5 / 2.0**halvings))
        values, weight = coarser, smaller


def sample_image(image: FloatArray, positions_px: Points2) -> npt.NDArray[np.float64]:
    """Return (n, k) bilinear values of an image (h, w, k) at positions (n, 2), clamped to its border."""
    return _sample(np.ascontiguousarray(image), np.ascontiguousarray(positions_px, dtype=np.float64))


def sample_depth(depth: FloatArray, mask: Mask, positions_px: Points2) -> tuple[FloatArray, Mask]:
    """Return the depth (n,) at positions (n, 2), and where it is valid (n,).

    Bilinear over the valid ones of the four pixels around, whose weights are scaled up to sum to 1; invalid
    where those share less than half of the weight, or the position is not in the image.
    """
    h, w = mask.shape
    inside = np.all((positions_px > -0.5) & (positions_px < [w - 0.5, h - 0.5]), axis=1)
    total, weight = sample_image(np.dstack([np.where(mask, depth, 0.0), mask]), positions_px).T
    valid = inside & (weight >= 0.5)
    return np.where(valid, total / np.maximum(weight, 0.5), 0.0), valid


def beside_the_usual(weight: Weight, mask: Mask) -> Weight:
    """Return (h, w) weights that are 1 where a normal map's weight is at least its median.

    A normal's weight is 1 / (1 + (error / 12°)²). An error that all share, as of another rig's M, moves with
    the surface and is no harm here: only what a square exceeds that of the median by counts.
    """
    if not mask.any():
        return weight
    inverse = 1.0 / np.maximum(weight, _LEAST_DIVISOR)
    excess = np.maximum(inverse - np.median(inverse[mask]), 0.0)
    return np.asarray(1.0 / (1.0 + excess), dtype=np.float32)


def label_edges(labels: VisibilityLabels, mask: Mask) -> Mask:
    """Return (h, w) True within reach of pixels where a light ends.

    The edge of a shadow moves with what casts it. Pixels so near mix its two sides; the relief of either side
    holds.
    """
    window = np.ones((2 * _EDGE_REACH_PX + 1,) * 2, dtype=np.uint8)
    edges = np.zeros_like(mask)
    for light in range(3):
        lit = mask & ((labels >> light) & 1 > 0)
        ends = [cv2.dilate(side.astype(np.uint8), window) > 0 for side in (lit, mask & ~lit)]
        edges |= ends[0] & ends[1]
    return np.asarray(edges & mask)


def jump_pixels(normal_map: NormalMap) -> Mask:
    """Return (h, w) True around jumps of the weight; nowhere for a map without weights.

    The weight tells how well a colour fits the material under all three lights. Where a shadow or a gloss
    ends it jumps, and with it the normals, by tens of degrees: the strongest feature of a smooth neck is the
    edge of the chin's shadow, which moves with the chin. Where the surface around has strong relief of its
    own, such as a knit, a jump is left in: it is the edge of a fold as often as that of a shadow.
    """
    mask = normal_map.mask
    if normal_map.weight is None:
        return np.zeros_like(mask)
    inside = mask.astype(np.float32)
    size = (0, 0)
    total = cv2.GaussianBlur(normal_map.weight.astype(np.float32) * inside, size, _JUMP_SMOOTHING_PX)
    weight = _DARK + total / np.maximum(cv2.GaussianBlur(inside, size, _JUMP_SMOOTHING_PX), 1e-3)
    window = np.ones((_JUMP_WINDOW_PX, _JUMP_WINDOW_PX), dtype=np.uint8)
    greatest = cv2.dilate(np.where(mask, weight, np.float32(0)), window)
    least = cv2.erode(np.where(mask, weight, weight.max()), window)
    jumps = np.asarray(mask & (greatest > _JUMP_RATIO * least))
    return jumps & ~_strong_relief(normal_map, mask & ~jumps)


def _strong_relief(normal_map: NormalMap, even: Mask) -> Mask:
    """Where the surface around, as far as its weight is `even`, has relief enough to be registered by."""
    inside = even.astype(np.float32)
    normals = normal_map.normals_in_camera * inside[..., None]
    share = np.maximum(_mean(inside, _RELIEF_PX), 1e-3)
    relief = np.square(normals - (_mean(normals, _RELIEF_PX) / share[..., None]) * inside[..., None]).sum(
        axis=2
    )
    power = _mean(relief, _AROUND_PX) / np.maximum(_mean(inside, _AROUND_PX), 1e-3)
    return np.asarray(power > _STRONG_RELIEF**2)


def _mean(image: FloatArray, window_px: int) -> FloatArray:
    return np.asarray(cv2.blur(image, (window_px, window_px)))


def _ray_terms(camera: Camera) -> npt.NDArray[np.float64]:
    """1 / focal length in u and v (0 for an orthographic camera), and the principal point."""
    k = camera.matrix
    scale = (1 / k[0, 0], 1 / k[1, 1]) if camera.is_perspective else (0.0, 0.0)
    return np.array([*scale, k[0, 2], k[1, 2]], dtype=np.float64)


@njit
def _sample(image, positions):  # type: ignore[no-untyped-def]
    h, w, channels = image.shape
    out = np.empty((positions.shape[0], channels))
    for i in range(positions.shape[0]):
        x = min(max(positions[i, 0], 0.0), w - 1.0)
        y = min(max(positions[i, 1], 0.0), h - 1.0)
        u, v = min(int(x), max(w - 2, 0)), min(int(y), max(h - 2, 0))
        right, below = min(u + 1, w - 1), min(v + 1, h - 1)
        a, b = x - u, y - v
        for c in range(channels):
            top = (1 - a) * image[v, u, c] + a * image[v, right, c]
            bottom = (1 - a) * image[below, u, c] + a * image[below, right, c]
            out[i, c] = (1 - b) * top + b * bottom
    return out


def _high_pass(values: npt.NDArray[np.float32], weight: npt.NDArray[np.float32]) -> None:
    """Take the Gaussian mean off values (h, w, k) premultiplied by weight (h, w), thrice; divide by it."""
    around = cv2.GaussianBlur(weight, (TAPS, TAPS), SIGMA_PX)
    share = np.where(weight > 0, weight / np.maximum(around, _LEAST_DIVISOR), np.float32(0.0))[..., None]
    for _ in range(_TIMES):
        values -= share * cv2.GaussianBlur(values, (TAPS, TAPS), SIGMA_PX).reshape(values.shape)
    values /= np.maximum(weight, _LEAST_DIVISOR)[..., None]


@njit
def gradients(values, weight, scale):  # type: ignore[no-untyped-def]
    """Central differences (h, w, 2 k), and the weight where all four neighbours are there."""
    h, w = weight.shape
    k = values.shape[2]
    out = np.zeros((h, w, 2 * k), dtype=np.float32)
    kept = np.zeros((h, w), dtype=np.float32)
    for v in range(1, h - 1):
        for u in range(1, w - 1):
            least = min(weight[v, u], weight[v, u - 1], weight[v, u + 1], weight[v - 1, u], weight[v + 1, u])
            if least > LEAST_WEIGHT:
                kept[v, u] = least
                for c in range(k):
                    out[v, u, c] = scale * (values[v, u + 1, c] - values[v, u - 1, c])
                    out[v, u, k + c] = scale * (values[v + 1, u, c] - values[v - 1, u, c])
    return out, kept
