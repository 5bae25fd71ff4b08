"""Whether footage fits a rig: swapped channels, a wrong transfer curve, changed gains.

On a matte surface of one colour, equation 1 gives M⁻¹ (r − a) = albedo · n, whose length is the same
everywhere, and whose slopes have no curl, whatever the shape. Read with red and blue exchanged or with the
wrong curve, the length varies and the slopes curl. Where the lights stand symmetrically a swap only mirrors
the normals: then curl alone tells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.optimize import minimize

from vntoolkit.arrays import FloatArray, LinearImage, Mask
from vntoolkit.checks import require_same_size
from vntoolkit.diagnosis.consistency import albedo_variation, curl_share
from vntoolkit.io.footage.decoding import EncodedFrame, linear_frame_from_encoded
from vntoolkit.photometry.lambertian import scaled_normals_from_rgb
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer

_CURVES = ("linear", "srgb", "bt709", "gamma:2.2")
# The other reading must leave this share of the misfit before we say so. Measured on a grey ball, a plaster
# Buddha and a plaster cat: undoing a swap leaves 0.36, 0.34, 0.38; undoing sRGB that was read as linear 0.53,
# 0.71, 0.65; the reverse 1.00 (not seen), 0.65, 0.67. Two faces of uneven skin stay above 0.92.
_MARGIN = 0.75
_WORST_WITHOUT_MASK = 0.06  # of a mended misfit: a backdrop of another material leaves 0.1 and more
_UNEVEN = 0.004  # a misfit below it is noise: a clean rendering leaves 0.0007, sRGB read as linear 0.008
_ALBEDO_FLOOR = 0.05  # where both readings give an even albedo, curl alone decides
_FEWEST_PIXELS = 100
_ENOUGH_PIXELS = 200_000
_DARKEST = 0.02  # of full scale; below it noise decides
_SIDE_PX = 200  # larger pictures are averaged down: sixty evaluations then take a tenth of a second
_FLOOR = 0.05
_LARGEST_LOG_GAIN = 0.7
_NOTED_LOG_GAIN = 0.05
_GAIN_MARGIN = 0.5  # gains must leave this share of the misfit: two free numbers always mend a little


def findings_from_rig(
    frame: EncodedFrame,
    rig: Rig,
    transfer: Transfer,
    mask: Mask | None = None,
    background: LinearImage | None = None,
) -> list[str]:
    """Return a line for one of: other size, red and blue exchanged, another transfer curve, other gains.

    background: linear (h, w, 3), subtracted from the footage, or None.
    """
    height, width = frame.values.shape[:2]
    if (width, height) != (rig.camera.width, rig.camera.height):
        return [
            f"the frames are {width}×{height}, the rig's camera is {rig.camera.width}×{rig.camera.height}: "
            "calibrate with footage of this size"
        ]
    picture = _thinned(frame, mask, background)
    as_read = _misfit(picture, rig, transfer)
    if not as_read > _UNEVEN:
        return []
    swapped = _misfit(picture, rig, transfer, swap=True)
    if swapped < _MARGIN * as_read:
        return [
            f"red and blue look exchanged: with the channels swapped the rig's misfit is {swapped:.3f}, "
            f"as read {as_read:.3f}"
        ]
    return _findings_from_curves(picture, rig, transfer, as_read)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Picture:
    """Some of a frame's pixels as a smaller image; positions_px (h, w, 2): where in the frame they are."""

    frame: EncodedFrame
    mask: Mask | None
    background: LinearImage | None
    positions_px: FloatArray


def _thinned(frame: EncodedFrame, mask: Mask | None, background: LinearImage | None) -> _Picture:
    """Keep every k-th row and column: enough pixels to tell, few enough to try five readings of them."""
    if mask is not None:
        require_same_size(mask, "mask", frame.values, frame.name)
    height, width = frame.values.shape[:2]
    step = max(1, math.isqrt(height * width // _ENOUGH_PIXELS))
    every = (slice(None, None, step), slice(None, None, step))
    v, u = np.mgrid[:height:step, :width:step]
    return _Picture(
        frame=replace(frame, values=frame.values[every]),
        mask=None if mask is None else mask[every],
        background=None if background is None else background[every],
        positions_px=np.stack([u, v], axis=-1).astype(np.float64),
    )


def _findings_from_curves(picture: _Picture, rig: Rig, transfer: Transfer, as_read: float) -> list[str]:
    """Name the curve, or the gains of the channels, that mends more of the misfit."""
    left = {transfer.to_text(): as_read}
    if picture.frame.values.dtype != np.float32:
        curves = {text: Transfer.from_text(text) for text in _CURVES if text != transfer.to_text()}
        left |= {text: _misfit(picture, rig, curve) for text, curve in curves.items()}
    best = min(left, key=lambda text: left[text])
    gains, mended, unmended = fit_gains(*_light(picture, transfer), rig.response, picture.positions_px)
    text = text_of_gains(gains, mended / unmended)
    if text and mended / unmended < left[best] / as_read:
        return [text]
    explains = picture.mask is not None or left[best] < _WORST_WITHOUT_MASK
    if left[best] < _MARGIN * as_read and explains:
        return [
            f"the transfer curve looks like {best}, not {transfer.to_text()}: the rig's misfit is then "
            f"{left[best]:.3f} instead of {as_read:.3f}; give --transfer {best}"
        ]
    return []


def _misfit(picture: _Picture, rig: Rig, transfer: Transfer, *, swap: bool = False) -> float:
    """Return (albedo variation + floor) × curl share on lit, unclipped pixels; NaN where there are few."""
    rgb, used = _light(picture, transfer)
    if int(used.sum()) < _FEWEST_PIXELS:
        return float("nan")
    rgb = rgb[..., ::-1] if swap else rgb
    scaled_normals = scaled_normals_from_rgb(rgb.astype(np.float64), rig.response, picture.positions_px)
    variation = albedo_variation(rgb[used], scaled_normals[used])
    return (variation + _ALBEDO_FLOOR) * curl_share(scaled_normals, used)


def _light(picture: _Picture, transfer: Transfer) -> tuple[LinearImage, Mask]:
    """Return linear light (h, w, 3) and where it is bright enough, unclipped and of the surface."""
    linear = linear_frame_from_encoded(picture.frame, transfer, picture.background)
    used: Mask = ~linear.clipped & (linear.rgb.min(axis=2) > _DARKEST)
    if picture.mask is not None:
        used &= picture.mask
    return linear.rgb, used


# Gains: whether the channels' relative exposure changed between calibration and capture.


def fit_gains(
    rgb: FloatArray, used: Mask, response: LightResponse, positions_px: FloatArray
) -> tuple[FloatArray, float, float]:
    """Return the capture's gains (3,) against calibration, green's 1, and the misfit with and without.

    Where the surface is so scattered that no averaged pixel is wholly of it: ones, NaN and NaN.

    rgb: (h, w, 3) linear. used: (h, w) lit and unclipped pixels of the surface. positions_px: (h, w, 2),
    where a response that varies over the image is asked.
    """
    factor = min(1.0, _SIDE_PX / max(used.shape))
    size = tuple(max(1, round(n * factor)) for n in used.shape[::-1])
    averaged = cv2.resize(np.asarray(rgb, dtype=np.float64), size, interpolation=cv2.INTER_AREA)
    small = np.asarray(averaged, dtype=np.float64)
    inside: Mask = cv2.resize(used.astype(np.float64), size, interpolation=cv2.INTER_AREA) > 0.999
    positions_px = np.asarray(cv2.resize(positions_px, size, interpolation=cv2.INTER_AREA))
    if not inside.any():
        return np.ones(3), float("nan"), float("nan")

    def misfit(logs: FloatArray) -> float:
        undone = small * np.exp([-logs[0], 0.0, -logs[1]])
        normals = scaled_normals_from_rgb(undone, response, positions_px)
        variation = albedo_variation(undone[inside], normals[inside])
        beyond = max(0.0, float(np.abs(logs).max()) - _LARGEST_LOG_GAIN)
        return (variation + _FLOOR) * curl_share(normals, inside) + beyond

    start = np.zeros(2)
    simplex = [[0, 0], [0.15, 0], [0, 0.15]]
    limits = {"maxfev": 80, "xatol": 0.003, "fatol": 1e-5, "initial_simplex": simplex}
    found = minimize(misfit, start, method="Nelder-Mead", options=limits)
    gains = np.exp([found.x[0], 0.0, found.x[1]])
    return gains, float(found.fun), misfit(start)


def text_of_gains(gains: FloatArray, left: float) -> str:
    """Return the warning for gains that leave this share of the misfit; empty where they mean nothing."""
    if not left < _GAIN_MARGIN or float(np.abs(np.log(gains)).max()) < _NOTED_LOG_GAIN:
        return ""
    red, blue = (f"{100 * (gain - 1):+.0f} %" for gain in gains[[0, 2]])
    return (
        f"the white balance looks changed since calibration: red by {red} and blue by {blue} against green; "
        "lock it, and film or calibrate again; on a subject of another colour, calibrate on that colour"
    )
