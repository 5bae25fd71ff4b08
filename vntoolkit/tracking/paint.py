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

Gains of pixels, too, stay where they are while the surface moves: the fixed pattern of the sensor, about 1 %.
Slopes then hold a fixed relief of some tenths of a degree. On a smooth surface it is the strongest there is,
and a mesh registered by it stands still. A surface's slopes have no curl. White noise of both slopes has as
much curl as gradient along either axis. Noise of the frames' own has nothing in common at a pixel, the
pattern has its curl. Where a painted surface is at rest in all frames its paint has curl in common too. But
the pattern is as white as noise: of its power little is left at half the resolution, and of paint's a third
and more. Paint itself is a scalar and has no curl: there the gradients along both axes stand for it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Normals, VisibilityLabels
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.levelling import leveller_of
from vntoolkit.photometry.response import LightResponse
from vntoolkit.tracking.slopes import GRAZING, Relief, Slopes, gradient_bands

Power = npt.NDArray[np.float32]  # (h, w): of gradients along either axis
Paint = npt.NDArray[np.float32]  # (h, w): ρ, 0 where it is not known
PaintImage = npt.NDArray[np.float32]  # (h, w, 2): w ρ and w

_AROUND_PX = 2.5  # of the Gaussian: it is the one that bands are made with, so that they hold what it leaves
_TAPS = 15  # to 3 sigma
_LEAST_SQUARE = np.float32(1e-12)  # of a colour that is divided by
FRAMES_COMPARED = 8  # so many tell the pattern's power to a hundredth of the noise's
_FEWEST_FRAMES = 4
_POWER_AROUND_PX = 33  # of the band: side of the window that the power is averaged over
_WHITE = (1.0, 1 / 12.4, 1 / 180.0)  # powers of bands, of white noise; measured
_OF_PAINT = 3.0  # power of paint over that in the next band, at most


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
    around = np.asarray(cv2.GaussianBlur(normals, (_TAPS, _TAPS), _AROUND_PX), np.float32)
    matrix, ambient = np.float32(central.matrix), np.float32(central.ambient)
    paint = _reflectances(level.rgb, around, matrix, ambient)
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
def _reflectances(rgb, normals, matrix, ambient):  # type: ignore[no-untyped-def]
    """(h, w) ρ of colours r + a and the normals n around them (h, w, 3): |n| (r · M n) / |M n|²."""
    h, w = rgb.shape[:2]
    out = np.empty((h, w), dtype=np.float32)
    for v in range(h):
        for u in range(w):
            length = along = square = np.float32(0.0)
            for k in range(3):
                light = np.float32(0.0)
                for c in range(3):
                    light += matrix[k, c] * normals[v, u, c]
                length += normals[v, u, k] * normals[v, u, k]
                along += (rgb[v, u, k] - ambient[k]) * light
                square += light * light
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


def fixed_pattern(frames: Iterable[Slopes | PaintImage]) -> tuple[Power, ...]:
    """Return, for each band, (h, w) the power of gradients along either axis that the pattern makes.

    frames: (h, w, 3) slopes, or (h, w, 2) paint, of frames from all over a video. Empty for fewer than four.
    """
    sums: list[npt.NDArray[np.float32]] = []
    count = 0
    for image in frames:
        bands = gradient_bands(image[..., :-1], image[..., -1])
        for k, (_, gradients, weight) in enumerate(itertools.islice(bands, 2)):
            common = gradients if gradients.shape[2] == 2 else gradients[..., 2:3] - gradients[..., 1:2]
            weighted = np.dstack([weight[..., None] * common, weight])
            if k == len(sums):
                sums.append(np.zeros((2, *weighted.shape), np.float32))
            sums[k] += np.stack([weighted, weighted * weighted])
        count += 1
    if count < _FEWEST_FRAMES or len(sums) < 2:
        return ()
    fine, coarse = (_common_power(*each) for each in sums)
    paint = _OF_PAINT * np.asarray(cv2.resize(coarse, fine.shape[::-1]))
    white = np.asarray(np.maximum(fine - paint, 0.0) / (1.0 - _OF_PAINT * _WHITE[1]), np.float32)
    return tuple(np.float32(share) * white[:: 2**k, :: 2**k] for k, share in enumerate(_WHITE))


def _common_power(total: Power, squares: Power) -> Power:
    """Return (h, w) the mean product of two frames' values around every pixel, at least 0.

    total, squares: (h, w, k + 1), sums over frames of weighted values, weights last; and of their squares.
    """
    products = cv2.blur(total * total - squares, (_POWER_AROUND_PX, _POWER_AROUND_PX))
    power = np.maximum(products[..., :-1].sum(axis=-1), 0.0) / np.maximum(products[..., -1], 1e-3)
    return np.asarray(power, np.float32)
