"""Paint, as registration reads it: how brightly the surface reflects, apart from how it is turned.

r − a = ρ M n: the length of M⁻¹ (r − a) is the reflectance ρ, which the normal leaves out. Freckles, hair and
prints tell where a surface is that has no relief. Under any motion a point keeps its paint: nothing is turned
with the surface, as slopes are, and what spreads over many pixels stays with the surface, too.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import VisibilityLabels
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.levelling import leveller_of
from vntoolkit.photometry.response import LightResponse
from vntoolkit.tracking.slopes import GRAZING, Relief

Paint = npt.NDArray[np.float32]  # (h, w): ρ, 0 where it is not known
PaintImage = npt.NDArray[np.float32]  # (h, w, 2): w ρ and w


def paint_of_frame(
    linear: LinearFrame, response: LightResponse, labels: VisibilityLabels | None = None
) -> Paint:
    """Return (h, w) the reflectance ρ, beside that of the material that M holds for.

    0 where a channel is clipped, and where labels (h, w) say that a light is missing.
    """
    level = linear if response.variation is None else leveller_of(response, linear.shape).frame(linear)
    central = response.central
    paint = _lengths(level.rgb, central.ambient.astype(np.float32), central.inverse.astype(np.float32))
    known = ~linear.clipped if labels is None else ~linear.clipped & (labels & ALL_LIT == ALL_LIT)
    return np.asarray(paint * known, np.float32)


def paint_image(paint: Paint, relief: Relief) -> PaintImage:
    """Return (h, w, 2) paint for registration; relief: (h, w, 4) of its frame, by `relief_slopes`.

    It weighs less at grazing angles, and nothing where relief weighs nothing: around the edges of shadows and
    around contours. Smoothed as slopes are.
    """
    weighted = np.asarray(cv2.GaussianBlur(_weighted(paint, relief), (3, 3), 0.7), np.float32)
    _take_out(weighted, relief)
    return weighted


@njit(cache=True)
def _lengths(rgb, ambient, inverse):  # type: ignore[no-untyped-def]
    h, w = rgb.shape[:2]
    out = np.empty((h, w), dtype=np.float32)
    for v in range(h):
        for u in range(w):
            r, g, b = rgb[v, u, 0] - ambient[0], rgb[v, u, 1] - ambient[1], rgb[v, u, 2] - ambient[2]
            square = np.float32(0.0)
            for k in range(3):
                n = inverse[k, 0] * r + inverse[k, 1] * g + inverse[k, 2] * b
                square += n * n
            out[v, u] = np.sqrt(square)
    return out


@njit(cache=True)
def _take_out(weighted, relief):  # type: ignore[no-untyped-def]
    """Set to 0 where relief weighs nothing."""
    h, w = relief.shape[:2]
    for v in range(h):
        for u in range(w):
            if relief[v, u, 2] <= 0:
                weighted[v, u, 0] = weighted[v, u, 1] = 0.0


@njit(cache=True)
def _weighted(paint, relief):  # type: ignore[no-untyped-def]
    h, w = paint.shape
    out = np.zeros((h, w, 2), dtype=np.float32)
    for v in range(h):
        for u in range(w):
            p, q, weight = relief[v, u, 0], relief[v, u, 1], relief[v, u, 2]
            if paint[v, u] > 0 and weight > 0:
                facing = weight * weight / (weight * weight + p * p + q * q)  # squared cosine
                share = min(np.float32(1.0), facing / np.float32(GRAZING**2))
                out[v, u, 0], out[v, u, 1] = share * paint[v, u], share
    return out
