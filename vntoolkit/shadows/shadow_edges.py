"""Where a cast shadow ends: at the pixel that less than half of the light reaches.

Blur carries light across the edge of a shadow, so that the pixels just inside it are far brighter than a
shadow is. The edge lies where half of what arrives outside is left. That holds where something else blocks
the light; where the surface itself turns from it, light fades on both sides and the half means nothing.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Matrix3, VisibilityLabels
from vntoolkit.photometry.frame import ALL_LIT, labels_from_lit, lit_from_labels

Lit = npt.NDArray[np.bool_]
_OUTWARDS_PX = 1.5  # radius over which the way to the outline is averaged

# The edge of a cast shadow; cosines are 1 where a surface faces the light.
_CAST_PART = (
    0.45  # below this part of the largest cosine nearby a pixel beside the shadow joins it: half, less noise
)
_CAST_REACH_PX = 2  # how far nearby is: a blur of 0.9 pixels is over by then
_CAST_FACING = 0.2  # predicted cosine from which a shadow counts as cast
_CAST_FAINTEST = 0.22  # largest cosine nearby from which there is an edge to judge

# Half-shadow.
_PENUMBRA_PART = 0.75  # below this part of the largest cosine nearby the light arrives in part
_PENUMBRA_REACH_PX = 2  # how far nearby is
_PENUMBRA_FAINTEST = 0.4  # with less nearby the surface turns from the light, and less arrives on both sides

# The outline.
_RIM_PX = 2.5  # pixels this close to the outline are judged …
_NEAR_PX, _FAR_PX = 3.0, 5.0  # … by the surface between these distances from it
_LEAST_TURN = 0.01  # fall of n_z² per pixel outwards from which the surface turns out of sight
_AWAY = 0.05  # cosine to the light below which the continued surface has turned from it
_BRIGHTEST = 0.1  # a larger cosine is never called shadow


def lit_beyond_half(lit: Lit, cosines: FloatArray, predicted: FloatArray, mask: Mask) -> Lit:
    """Return `lit` (h, w, 3) without the pixels beside a cast shadow that less than half the light reaches.

    cosines, predicted: (h, w, 3), measured and to be expected where the light arrives.
    """
    out = lit.copy()
    for k in range(3):
        cast = mask & ~lit[..., k] & (predicted[..., k] > _CAST_FACING)
        out[..., k] &= ~partly_lit(
            lit[..., k] & mask, cast, cosines[..., k], _CAST_PART, _CAST_REACH_PX, _CAST_FAINTEST
        )
    return out


# Half-shadow: lit pixels at the edge of a cast shadow that a light reaches only in part.


def labels_without_penumbra(labels: VisibilityLabels, relative: FloatArray, mask: Mask) -> VisibilityLabels:
    """Count each light as missing where it arrives in part.

    labels: (h, w), bit k set where light k arrives. relative: (h, w, 3), contributions over the albedo.
    Returns labels (h, w), 7 outside `mask`.
    """
    whole = lit_from_labels(labels) | ~mask[..., None]
    for k in range(3):
        lit = whole[..., k].copy()
        whole[..., k] &= ~partly_lit(
            lit & mask, ~lit, relative[..., k], _PENUMBRA_PART, _PENUMBRA_REACH_PX, _PENUMBRA_FAINTEST
        )
    return np.where(mask, labels_from_lit(whole), ALL_LIT).astype(np.uint8)


def partly_lit(
    lit: Mask, shadow: Mask, cosine: FloatArray, part: float, reach_px: int, faintest: float
) -> Mask:
    """Return (h, w): pixels of `lit` beside `shadow` with less than `part` of the largest cosine nearby.

    cosine: (h, w), what comes back of one light over the albedo. reach_px: how far nearby is. faintest: the
    largest cosine nearby must be more than this.
    """
    beside = cv2.dilate(shadow.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    cosine = np.where(lit, cosine, 0.0).astype(np.float32)
    brightest = cv2.dilate(cosine, np.ones((2 * reach_px + 1,) * 2, np.uint8))
    return np.asarray(lit & beside & (brightest > faintest) & (cosine < part * brightest))


# The last pixels before a figure's outline, where the surface turns out of sight within a pixel or two.


def turned_from_lights(
    normals: FloatArray, cosines: FloatArray, directions: Matrix3, mask: Mask, scale: float = 1.0
) -> npt.NDArray[np.bool_]:
    """Return (h, w, 3): True beside the outline of `mask` where the surface turns from the light.

    normals: (h, w, 3), predicted. cosines: (h, w, 3), measured. directions: (3, 3), one unit row per light.
    scale: pixels of this image per pixel of the one that the normals were found on.
    """
    turned = np.zeros((*mask.shape, 3), dtype=np.bool_)
    inset: FloatArray = np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5), np.float32)
    v, u = np.nonzero(mask & (inset < _RIM_PX))
    if not len(v) or mask.all():
        return turned
    near, far = scale * _NEAR_PX, scale * _FAR_PX
    inwards = _inwards(inset, v, u)
    first = _unit(_sampled(normals, v, u, inwards, near - inset[v, u]))
    second = _unit(_sampled(normals, v, u, inwards, far - inset[v, u]))
    turn = (second[:, 2] ** 2 - first[:, 2] ** 2) / (far - near)
    facing = np.clip(first[:, 2] ** 2 - turn * (near - inset[v, u]), 0.0, 1.0)
    sideways = _unit(first[:, :2]) * np.sqrt(1.0 - facing)[:, None]
    continued = np.concatenate([sideways, -np.sqrt(facing)[:, None]], axis=1)
    away = (continued @ directions.T < _AWAY) & (turn > _LEAST_TURN)[:, None]
    turned[v, u] = away & (cosines[v, u] < _BRIGHTEST)
    return turned


def _inwards(inset: FloatArray, v: npt.NDArray[np.intp], u: npt.NDArray[np.intp]) -> FloatArray:
    """(n, 2) unit steps (u, v) away from the outline."""
    smooth = cv2.GaussianBlur(inset, (0, 0), _OUTWARDS_PX)
    along = [cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)]
    return _unit(np.stack([image[v, u] for image in along], axis=1))


def _sampled(
    image: FloatArray,
    v: npt.NDArray[np.intp],
    u: npt.NDArray[np.intp],
    inwards: FloatArray,
    distance: FloatArray,
) -> FloatArray:
    """(n, c) values at `distance` (n,) from the pixels (v, u) along `inwards` (n, 2)."""
    columns = np.clip(u + inwards[:, 0] * distance, 0, image.shape[1] - 1)
    rows = np.clip(v + inwards[:, 1] * distance, 0, image.shape[0] - 1)
    column, row = np.floor(columns).astype(np.intp), np.floor(rows).astype(np.intp)
    right, below = np.minimum(column + 1, image.shape[1] - 1), np.minimum(row + 1, image.shape[0] - 1)
    x, y = (columns - column)[:, None], (rows - row)[:, None]
    above = (1 - x) * image[row, column] + x * image[row, right]
    return (1 - y) * above + y * ((1 - x) * image[below, column] + x * image[below, right])


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-6)
