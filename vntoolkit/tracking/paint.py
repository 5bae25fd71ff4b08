"""Paint, as registration reads it: how brightly the surface reflects, apart from how it is turned.

r − a = ρ M n: the length of M⁻¹ (r − a) is the reflectance ρ, which the normal leaves out. Freckles, hair and
prints tell where a surface is that has no relief. Under any motion a point keeps its paint: nothing is turned
with the surface, as slopes are, and what spreads over many pixels stays with the surface, too.

Pixel by pixel that length takes all noise for paint, and M⁻¹ makes much of it where a surface turns away. Nor
is noise all: a mosaic has fewer red and blue pixels than strands of hair have lights, and what it makes of
them wanders along the strands by pixels while they move by tenths. So n is the mean of the normals around,
and ρ the least-squares one of a pixel's colour, by M n: it reads brightness, which a mosaic leaves as it is.
The mean of the colours around would do as well, but for the edges of shadows: there it mixes two hues, and
a bright rim would run along with the shadow.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Normals, VisibilityLabels
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.levelling import leveller_of
from vntoolkit.photometry.response import LightResponse
from vntoolkit.tracking.slopes import GRAZING, SIGMA_PX, TAPS, Relief

Paint = npt.NDArray[np.float32]  # (h, w): ρ, 0 where it is not known
PaintImage = npt.NDArray[np.float32]  # (h, w, 2): w ρ and w

_LEAST_SQUARE = np.float32(1e-12)  # of a colour that is divided by


def paint_of_frame(
    linear: LinearFrame,
    normals: Normals,
    response: LightResponse,
    labels: VisibilityLabels | None = None,
) -> Paint:
    """Return (h, w) the reflectance ρ, beside that of the material that M holds for.

    normals: (h, w, 3), 0 where none is known. ρ is 0 where a channel is clipped, and where labels (h, w) say
    that a light is missing.
    """
    level = linear if response.variation is None else leveller_of(response, linear.shape).frame(linear)
    central = response.central
    # by the Gaussian that is taken off a band, so that bands hold what it leaves
    around = np.asarray(cv2.GaussianBlur(normals, (TAPS, TAPS), SIGMA_PX), np.float32)
    light = around @ np.float32(central.matrix).T
    along = np.sum((level.rgb - np.float32(central.ambient)) * light, axis=-1)
    square = np.maximum(np.sum(light * light, axis=-1), _LEAST_SQUARE)
    known = ~linear.clipped if labels is None else ~linear.clipped & (labels & ALL_LIT == ALL_LIT)
    return np.asarray(known * np.linalg.norm(around, axis=-1) * along / square, np.float32)


def paint_image(paint: Paint, relief: Relief) -> PaintImage:
    """Return (h, w, 2) paint for registration; relief: (h, w, 4) of its frame, by `relief_slopes`.

    It weighs less at grazing angles, and nothing where relief weighs nothing: around the edges of shadows and
    around contours. Smoothed as slopes are.
    """
    p, q, weight = np.moveaxis(relief[..., :3], -1, 0)
    known = (paint > 0) & (weight > 0)
    facing = np.square(weight) / np.maximum(
        np.square(weight) + p * p + q * q, _LEAST_SQUARE
    )  # squared cosine
    share = known * np.minimum(np.float32(1.0), facing / np.float32(GRAZING**2))
    weighted = np.asarray(cv2.GaussianBlur(cv2.merge([share * paint, share]), (3, 3), 0.7), np.float32)
    weighted[weight <= 0] = 0.0
    return weighted
