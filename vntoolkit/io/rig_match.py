"""Does footage fit a rig? Swapped channels and a wrong transfer curve give a surface that cannot be.

On a matte surface of one colour, equation 1 gives M⁻¹ (r − a) = albedo · n, whose length is the same
everywhere, and whose slopes have no curl, whatever the shape. Read with red and blue exchanged or with the
wrong curve, the length varies and the slopes curl. Where the lights stand symmetrically a swap only mirrors
the normals: then curl alone tells.
"""

from __future__ import annotations

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_same_size
from vntoolkit.io.decoding import EncodedFrame, linear_frame_from_encoded
from vntoolkit.photometry.lambertian import scaled_normals_from_rgb
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer

_CURVES = ("linear", "srgb", "bt709", "gamma:2.2")
# The other reading must leave this share of the misfit before we say so. Measured on a grey ball, a plaster
# Buddha and a plaster cat: undoing a swap leaves 0.36, 0.34, 0.38; undoing sRGB that was read as linear 0.53,
# 0.71, 0.65; the reverse 1.00 (not seen), 0.65, 0.67. Two faces of uneven skin stay above 0.92.
_MARGIN = 0.75
_UNEVEN = 0.004  # a misfit below it is noise: a clean rendering leaves 0.0007, sRGB read as linear 0.008
_ALBEDO_FLOOR = 0.05  # where both readings give an even albedo, curl alone decides
_SMOOTHING_PX = 5
_STEEPEST = 0.2  # least |n_z| of a slope that counts
_LARGEST_SAMPLE = 200_000
_FEWEST_PIXELS = 100
_DARKEST = 0.02  # of full scale; below it noise decides


def findings_from_rig(
    frame: EncodedFrame, rig: Rig, transfer: Transfer, mask: Mask | None = None
) -> list[str]:
    """Return a line for each of: other size, red and blue exchanged, another transfer curve."""
    height, width = frame.values.shape[:2]
    if (width, height) != (rig.camera.width, rig.camera.height):
        return [
            f"the frames are {width}×{height}, the rig's camera is {rig.camera.width}×{rig.camera.height}: "
            "calibrate with footage of this size"
        ]
    as_read = misfit(frame, rig, transfer, mask)
    if not as_read > _UNEVEN:
        return []
    swapped = misfit(frame, rig, transfer, mask, swap=True)
    if swapped < _MARGIN * as_read:
        return [
            f"red and blue look exchanged: with the channels swapped the rig's misfit is {swapped:.3f}, "
            f"as read {as_read:.3f}"
        ]
    if frame.values.dtype == np.float32:
        return []
    curves = {text: Transfer.from_text(text) for text in _CURVES if text != transfer.to_text()}
    left = {text: misfit(frame, rig, curve, mask) for text, curve in curves.items()}
    best = min(left, key=lambda text: left[text])
    if left[best] < _MARGIN * as_read:
        return [
            f"the transfer curve looks like {best}, not {transfer.to_text()}: the rig's misfit is then "
            f"{left[best]:.3f} instead of {as_read:.3f}; give --transfer {best}"
        ]
    return []


def misfit(
    frame: EncodedFrame, rig: Rig, transfer: Transfer, mask: Mask | None = None, *, swap: bool = False
) -> float:
    """Return (albedo variation + floor) × curl share on lit, unclipped pixels; NaN where there are few."""
    linear = linear_frame_from_encoded(frame, transfer)
    used: Mask = ~linear.clipped & (linear.rgb.min(axis=2) > _DARKEST)
    if mask is not None:
        require_same_size(mask, "mask", used, frame.name)
        used &= mask
    if int(used.sum()) < _FEWEST_PIXELS:
        return float("nan")
    rgb = linear.rgb[..., ::-1] if swap else linear.rgb
    scaled_normals = scaled_normals_from_rgb(rgb.astype(np.float64), rig.response)
    variation = albedo_variation(rgb[used], scaled_normals[used])
    return (variation + _ALBEDO_FLOOR) * curl_share(scaled_normals, used)


def albedo_variation(rgb: FloatArray, scaled_normals: FloatArray) -> float:
    """Return the spread of the lengths of (n, 3) albedo-scaled normals over that of the channels (n, 3).

    A spread is half the distance between the 16th and 84th percentile, over the median: robust against
    highlights and against pixels that not all three lights reach.
    """
    of_channels = sum(_spread(rgb[:, channel]) for channel in range(3)) / 3.0
    return _spread(np.linalg.norm(scaled_normals, axis=1)) / max(of_channels, 1e-6)


def curl_share(scaled_normals: FloatArray, used: Mask) -> float:
    """Return |∂p/∂v − ∂q/∂u| over |∂p/∂v| + |∂q/∂u|, each summed over the inside of `used`; 0 to 1.

    p and q are the slopes of the smoothed (h, w, 3) normals; a surface that exists has the share 0.
    """
    normals = cv2.blur(scaled_normals, (_SMOOTHING_PX, _SMOOTHING_PX))
    normals = normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
    side = 2 * _SMOOTHING_PX - 1
    eroded = cv2.erode(used.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=0) > 0
    inside: Mask = np.asarray(eroded & (normals[..., 2] < -_STEEPEST))
    slopes = normals[..., :2] / np.minimum(normals[..., 2:], -_STEEPEST)
    p_along_v = np.gradient(slopes[..., 0], axis=0)[inside]
    q_along_u = np.gradient(slopes[..., 1], axis=1)[inside]
    total = float((np.abs(p_along_v) + np.abs(q_along_u)).sum())
    return float(np.abs(p_along_v - q_along_u).sum()) / total if total > 0 else float("nan")


def _spread(values: FloatArray) -> float:
    low, median, high = np.percentile(values[:: max(1, len(values) // _LARGEST_SAMPLE)], [16, 50, 84])
    return float((high - low) / 2 / median)
