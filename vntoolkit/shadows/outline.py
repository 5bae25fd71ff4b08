"""The last pixels before a figure's outline, where the surface turns out of sight within a pixel or two.

A lens's blur and a Bayer pattern lend those pixels light from further in, so that what is measured there says
little of a light that only just fails to reach them. The surface further in says more: along the way out to
an outline the square of a round surface's n_z falls linearly, and its direction in the image stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Matrix3
from vntoolkit.checks import require_in_range
from vntoolkit.errors import BadInput

_OUTWARDS_PX = 1.5  # radius over which the way to the outline is averaged


@dataclass(frozen=True, kw_only=True)
class OutlineOptions:
    """Which pixels count as turned from a light.

    reach_px: pixels this close to the outline are judged, 0 for none. near_px, far_px: distances from the
    outline between which the surface is read. least_turn: fall of n_z² per pixel towards the outline from
    which the surface counts as turning out of sight. away: cosine to the light below which the continued
    surface counts as turned from it. brightest: a larger share of the light is never called shadow.
    """

    reach_px: float = 2.5
    near_px: float = 3.0
    far_px: float = 5.0
    least_turn: float = 0.01
    away: float = 0.05
    brightest: float = 0.1

    def __post_init__(self) -> None:
        require_in_range(self.reach_px, 0.0, 100.0, "outline: reach in pixels")
        require_in_range(self.least_turn, 0.0, 1.0, "outline: least turn")
        require_in_range(self.away, -1.0, 1.0, "outline: away")
        require_in_range(self.brightest, -1.0, 1.0, "outline: brightest")
        if not np.inf > self.far_px > self.near_px > 0:
            raise BadInput("outline: far_px must be larger than near_px, near_px larger than 0")


def turned_from_lights(
    normals: FloatArray,
    shares: FloatArray,
    directions: Matrix3,
    mask: Mask,
    scale: float = 1.0,
    options: OutlineOptions | None = None,
) -> npt.NDArray[np.bool_]:
    """Return (h, w, 3): True beside the outline of `mask` where the surface turns from the light.

    normals: (h, w, 3), predicted. shares: (h, w, 3), measured. directions: (3, 3), one unit row per light.
    scale: pixels of this image per pixel of the one that the normals were found on.
    """
    options = options or OutlineOptions()
    turned = np.zeros((*mask.shape, 3), dtype=np.bool_)
    inset: FloatArray = np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5), np.float32)
    v, u = np.nonzero(mask & (inset < options.reach_px))
    if not len(v) or mask.all():
        return turned
    near, far = scale * options.near_px, scale * options.far_px
    inwards = _inwards(inset, v, u)
    first = _unit(_sampled(normals, v, u, inwards, near - inset[v, u]))
    second = _unit(_sampled(normals, v, u, inwards, far - inset[v, u]))
    turn = (second[:, 2] ** 2 - first[:, 2] ** 2) / (far - near)
    facing = np.clip(first[:, 2] ** 2 - turn * (near - inset[v, u]), 0.0, 1.0)
    sideways = _unit(first[:, :2]) * np.sqrt(1.0 - facing)[:, None]
    continued = np.concatenate([sideways, -np.sqrt(facing)[:, None]], axis=1)
    away = (continued @ directions.T < options.away) & (turn > options.least_turn)[:, None]
    turned[v, u] = away & (shares[v, u] < options.brightest)
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
