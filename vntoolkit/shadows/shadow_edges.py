"""Where a cast shadow ends: at the pixel that less than half of the light reaches.

Blur carries light across the edge of a shadow, so that the pixels just inside it are far brighter than a
shadow is. The edge lies where half of what arrives outside is left. That holds where something else blocks
the light; where the surface itself turns from it, light fades on both sides and the half means nothing.
"""

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import ByteArray, FloatArray, IntArray, Mask, Matrix3, VisibilityLabels
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, labels_from_lit

_OUTWARDS_PX = 1.5  # radius over which the way to the outline is averaged

# The edge of a cast shadow; cosines are 1 where a surface faces the light.
_CAST_PART = (
    0.45  # below this part of the largest cosine nearby a pixel beside the shadow joins it: half, less noise
)
_CAST_REACH_PX = 2  # how far nearby is: a blur of 0.9 pixels is over by then
_CAST_FAINTEST = 0.22  # largest cosine nearby from which there is an edge to judge

# The outline.
_RIM_PX = 2.5  # pixels this close to the outline are judged …
_NEAR_PX, _FAR_PX = 3.0, 5.0  # … by the surface between these distances from it
_LEAST_TURN = 0.01  # fall of n_z² per pixel outwards from which the surface turns out of sight
_AWAY = 0.05  # cosine to the light below which the continued surface has turned from it
_BRIGHTEST = 0.1  # a larger cosine is never called shadow


def labels_beyond_half(
    labels: VisibilityLabels,
    cosines: FloatArray,
    facing: ByteArray,
    mask: Mask,
    near: Mask | None = None,
) -> VisibilityLabels:
    """Return labels (h, w) without the lights of which less than half arrives beside a cast shadow.

    cosines: (h, w, 3), measured. facing: (h, w), bit k set where the surface faces light k, so that its
    shadow is cast. near: (h, w), holds all shadows of `mask` and the pixels around them.
    """
    out: VisibilityLabels = np.array(labels, dtype=np.uint8)
    shadow = (~labels & ALL_LIT & facing).astype(np.uint8) * mask
    _part_kernel(
        np.asarray(labels), shadow, np.asarray(cosines, np.float32), np.asarray(mask),
        np.asarray(mask if near is None else near), _CAST_PART, _CAST_REACH_PX, _CAST_FAINTEST, out,
    )  # fmt: skip
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def _part_kernel(
    labels: VisibilityLabels, shadow: ByteArray, cosines: FloatArray, mask: Mask, near: Mask,
    part: float, reach: int, faintest: float, out: VisibilityLabels,
) -> None:  # fmt: skip
    """shadow: (h, w), bit k set where a shadow of light k counts, 0 outside the mask; reach: in pixels."""
    h, w = mask.shape
    for v in prange(h):
        above, below, column = max(v - 1, 0), min(v + 1, h - 1), np.zeros(w + 2, np.uint8)
        for u in range(w):
            column[u + 1] = shadow[above, u] | shadow[v, u] | shadow[below, u]
        for u in range(w):
            beside = (column[u] | column[u + 1] | column[u + 2]) & labels[v, u]
            if beside == 0 or not near[v, u] or not mask[v, u]:
                continue
            for k in range(3):
                if (beside >> k) & 1 == 0:
                    continue
                brightest = np.float32(0.0)
                for y in range(max(v - reach, 0), min(v + reach + 1, h)):
                    for x in range(max(u - reach, 0), min(u + reach + 1, w)):
                        if mask[y, x] and (labels[y, x] >> k) & 1 == 1:
                            brightest = max(brightest, cosines[y, x, k])
                if brightest > faintest and cosines[v, u, k] < part * brightest:
                    out[v, u] &= np.uint8(7 - (1 << k))


# The last pixels before a figure's outline, where the surface turns out of sight within a pixel or two.


def turned_from_lights(
    normals: FloatArray, cosines: FloatArray, directions: Matrix3, inset: FloatArray, near: Mask
) -> VisibilityLabels:
    """Return (h, w), bit k set beside the outline where the surface turns from light k.

    normals: (h', w', 3), predicted, on the same or a smaller image of the field. cosines: (h, w, 3),
    measured. directions: (3, 3), one unit row per light. inset: (h, w), distance in pixels from the outline
    inwards, 0 outside. near: (h, w), pixels that are asked.
    """
    turned: VisibilityLabels = np.zeros(inset.shape, np.uint8)
    v, u = np.nonzero((inset > 0.0) & (inset < _RIM_PX) & near)
    if not len(v):
        return turned
    scale = inset.shape[0] / normals.shape[0]
    near_px, far = scale * _NEAR_PX, scale * _FAR_PX
    inwards = _inwards(inset, v, u)
    first = _unit(_sampled(normals, v, u, inwards, near_px - inset[v, u], inset.shape))
    second = _unit(_sampled(normals, v, u, inwards, far - inset[v, u], inset.shape))
    turn = (second[:, 2] ** 2 - first[:, 2] ** 2) / (far - near_px)
    facing = np.clip(first[:, 2] ** 2 - turn * (near_px - inset[v, u]), 0.0, 1.0)
    sideways = _unit(first[:, :2]) * np.sqrt(1.0 - facing)[:, None]
    continued = np.concatenate([sideways, -np.sqrt(facing)[:, None]], axis=1)
    away = (continued @ directions.T < _AWAY) & (turn > _LEAST_TURN)[:, None]
    turned[v, u] = labels_from_lit(away & (cosines[v, u] < _BRIGHTEST))
    return turned


def _inwards(inset: FloatArray, v: IntArray, u: IntArray) -> FloatArray:
    """(n, 2) unit steps (u, v) away from the outline."""
    smooth = cv2.GaussianBlur(inset, (0, 0), _OUTWARDS_PX)
    along = [cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)]
    return _unit(np.stack([image[v, u] for image in along], axis=1))


def _sampled(
    image: FloatArray, v: IntArray, u: IntArray, inwards: FloatArray,
    distance: FloatArray, shape: tuple[int, ...],
) -> FloatArray:  # fmt: skip
    """(n, c) values at `distance` (n,) from the pixels (v, u) of (h, w) = shape along `inwards` (n, 2)."""
    height, width = image.shape[:2]
    columns = (u + inwards[:, 0] * distance + 0.5) * (width / shape[1]) - 0.5
    rows = (v + inwards[:, 1] * distance + 0.5) * (height / shape[0]) - 0.5
    columns, rows = np.clip(columns, 0, width - 1), np.clip(rows, 0, height - 1)
    column, row = np.floor(columns).astype(np.intp), np.floor(rows).astype(np.intp)
    right, below = np.minimum(column + 1, width - 1), np.minimum(row + 1, height - 1)
    x, y = (columns - column)[:, None], (rows - row)[:, None]
    above = (1 - x) * image[row, column] + x * image[row, right]
    return (1 - y) * above + y * ((1 - x) * image[below, column] + x * image[below, right])


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-6)
