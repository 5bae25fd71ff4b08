"""Where a cast shadow ends: at the pixel that less than half of the light reaches.

Blur carries light across the edge of a shadow, so that the pixels just inside it are far brighter than a
shadow is. The edge lies where half of what arrives outside is left. That holds where something else blocks
the light; where the surface itself turns from it, light fades on both sides and the half means nothing.
"""

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, FloatArray, IntArray, Mask, Matrix3

_REACH_PX = 2  # how far nearby is: a blur of 0.9 pixels is over by then
_CAST_FACING = 0.2  # predicted cosine from which a shadow counts as cast
_CAST_PART = (
    0.45  # of the largest cosine nearby, below which a pixel beside the shadow joins it: half, less noise
)
_CAST_FAINTEST = 0.22  # largest cosine nearby from which there is an edge to judge

# The outline.
_OUTWARDS_PX = 1.5  # radius over which the way to it is averaged
_RIM_PX = 2.5  # pixels this close to the outline are judged …
_NEAR_PX, _FAR_PX = 3.0, 5.0  # … by the surface between these distances from it
_LEAST_TURN = 0.01  # fall of n_z² per pixel outwards from which the surface turns out of sight
_AWAY = 0.05  # cosine to the light below which the continued surface has turned from it
_BRIGHTEST = 0.1  # a larger cosine is never called shadow

_SHARPENING = 1.2  # part of the difference to the blurred image that is added
_BLUR_PX = 0.87  # standard deviation, about that of a lens with a Bayer pattern


def lit_beyond_half(lit: BoolArray, cosines: FloatArray, predicted: FloatArray, mask: Mask) -> BoolArray:
    """Return (h, w, 3), the lights of which more than half arrives beside a cast shadow.

    lit: (h, w, 3), lights that arrive anyhow. cosines, predicted: (h, w, 3), measured, and of the surface.
    """
    beside, nearby = np.ones((3, 3), np.uint8), np.ones((2 * _REACH_PX + 1,) * 2, np.uint8)
    inside = mask[..., None]
    cast = (~lit & inside & (predicted > _CAST_FACING)).astype(np.uint8)
    brightest = cv2.dilate(np.where(lit & inside, cosines, np.float32(0.0)), nearby)
    below = (cosines < _CAST_PART * brightest) & (brightest > _CAST_FAINTEST)
    return lit & ~(below & (cv2.dilate(cast, beside) > 0) & inside)


def sharpened(cosines: FloatArray, mask: Mask) -> FloatArray:
    """Return cosines (h, w, 3) with blur undone in part, but for the backdrop's beside the outline.

    The median of nine takes the noise back out.
    """
    size = 2 * round(3.0 * _BLUR_PX) + 1
    blurred = cv2.GaussianBlur(cosines, (size, size), _BLUR_PX)
    sharp = cv2.medianBlur(cosines + np.float32(_SHARPENING) * (cosines - blurred), 3)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    return np.where(inner[..., None], sharp, cosines)


# The last pixels before a figure's outline, where the surface turns out of sight within a pixel or two.


def turned_from_lights(
    normals: FloatArray, cosines: FloatArray, directions: Matrix3, mask: Mask
) -> BoolArray:
    """Return (h, w, 3), where the surface turns from a light beside the outline.

    normals: (h', w', 3), predicted, on the same or a smaller image of the field. cosines: (h, w, 3),
    measured. directions: (3, 3), one unit row per light. mask: (h, w), whose border inside is the outline.
    """
    inset: FloatArray = np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5), np.float32)
    turned: BoolArray = np.zeros((*inset.shape, 3), np.bool_)
    v, u = np.nonzero((inset > 0.0) & (inset < _RIM_PX))
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
    turned[v, u] = away & (cosines[v, u] < _BRIGHTEST)
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
    places = columns[:, None].astype(np.float32), rows[:, None].astype(np.float32)
    found = cv2.remap(image, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found[:, 0], np.float32)


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-6)
