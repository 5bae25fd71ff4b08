"""Paint, as registration reads it: how brightly the surface reflects, apart from how it is turned.

r − a = ρ M n: the length of M⁻¹ (r − a) is the reflectance ρ, which the normal leaves out. Freckles, hair and
prints tell where a surface is that has no relief. Under any motion a point keeps its paint: nothing is turned
with the surface, as slopes are, and what spreads over many pixels stays with the surface, too.

Pixel by pixel that length takes all noise for paint, and M⁻¹ makes much of it where a surface turns away. Nor
is noise all: a mosaic has fewer red and blue pixels than strands of hair have lights, and what it makes of
them wanders along the strands by pixels while they move by tenths. So n is that of the colours around, and ρ
the least-squares one of a pixel's colour, by M n: it reads brightness, which a mosaic leaves as it is.
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

_AROUND_PX = 2.5  # of the Gaussian: it is the one that bands are made with, so that they hold what it leaves
_TAPS = 15  # to 3 sigma
_LEAST_SQUARE = np.float32(1e-12)  # of a colour that is divided by


def paint_of_frame(
    linear: LinearFrame, response: LightResponse, labels: VisibilityLabels | None = None
) -> Paint:
    """Return (h, w) the reflectance ρ, beside that of the material that M holds for.

    0 where a channel is clipped, and where labels (h, w) say that a light is missing.
    """
    level = linear if response.variation is None else leveller_of(response, linear.shape).frame(linear)
    central = response.central
    rgb = level.rgb - central.ambient.astype(np.float32)
    around = np.asarray(cv2.GaussianBlur(rgb, (_TAPS, _TAPS), _AROUND_PX), np.float32)
    paint = _reflectances(rgb, around, central.inverse.astype(np.float32))
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
def _reflectances(rgb, around, inverse):  # type: ignore[no-untyped-def]
    """(h, w) ρ of colours and of those around (h, w, 3): |M⁻¹ r̄| (r · r̄) / |r̄|²."""
    h, w = rgb.shape[:2]
    out = np.empty((h, w), dtype=np.float32)
    for v in range(h):
        for u in range(w):
            length = along = square = np.float32(0.0)
            for k in range(3):
                n = np.float32(0.0)
                for c in range(3):
                    n += inverse[k, c] * around[v, u, c]
                length += n * n
                along += rgb[v, u, k] * around[v, u, k]
                square += around[v, u, k] * around[v, u, k]
            out[v, u] = np.sqrt(length) * along / max(square, _LEAST_SQUARE)
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
