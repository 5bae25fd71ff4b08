"""Does footage fit a rig? Swapped channels and a wrong transfer curve make the albedo uneven.

On a matte surface of one colour, equation 1 gives M⁻¹ (r − a) = albedo · n, whose length is the same
everywhere, whatever the shape. Read with red and blue exchanged or with the wrong curve it varies. A curve
also stretches or squeezes all values, so the variation is measured against that of the colours themselves.
"""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_same_size
from vntoolkit.io.decoding import EncodedFrame, linear_frame_from_encoded
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer

_CURVES = ("linear", "srgb", "bt709", "gamma:2.2")
# The other reading must leave this share of the variation before we say so. Measured on a grey ball, a
# plaster Buddha and a plaster cat: the right order of channels leaves 0.28, 0.72 and 0.76 of what the swapped
# one does; linear footage read as sRGB is undone at 0.65, 0.72, 0.72; sRGB read as linear at 0.51 on the
# ball, but at 0.94 and 0.99 on the statues: there it cannot be told from albedo.
_SWAP_MARGIN = 0.85
_CURVE_MARGIN = 0.8
_UNEVEN = 0.05  # share of the colour's variation; below it nothing is wrong
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
    as_read = albedo_variation(frame, rig, transfer, mask)
    if not as_read > _UNEVEN:
        return []
    swapped = albedo_variation(frame, rig, transfer, mask, swap=True)
    if swapped < _SWAP_MARGIN * as_read:
        return [
            f"red and blue look exchanged: as read, albedo has to explain {as_read:.0%} of the colours' "
            f"variation, with the channels swapped {swapped:.0%}"
        ]
    if frame.values.dtype == np.float32:
        return []
    curves = {text: Transfer.from_text(text) for text in _CURVES if text != transfer.to_text()}
    left = {text: albedo_variation(frame, rig, curve, mask) for text, curve in curves.items()}
    best = min(left, key=lambda text: left[text])
    if left[best] < _CURVE_MARGIN * as_read:
        return [
            f"the transfer curve looks like {best}, not {transfer.to_text()}: albedo has to explain "
            f"{left[best]:.0%} instead of {as_read:.0%} of the colours' variation; give --transfer {best}"
        ]
    return []


def albedo_variation(
    frame: EncodedFrame, rig: Rig, transfer: Transfer, mask: Mask | None = None, *, swap: bool = False
) -> float:
    """Return the spread of |M⁻¹ (r − a)| over that of the channels, on lit, unclipped pixels of `mask`.

    A spread is half the distance between the 16th and 84th percentile, over the median: robust against
    highlights and against pixels that not all three lights reach. NaN where there are too few pixels.
    """
    linear = linear_frame_from_encoded(frame, transfer)
    used = ~linear.clipped & (linear.rgb.min(axis=2) > _DARKEST)
    if mask is not None:
        require_same_size(mask, "mask", used, frame.name)
        used &= mask
    rgb: FloatArray = linear.rgb[used].astype(np.float64)
    rgb = rgb[:: max(1, len(rgb) // _LARGEST_SAMPLE)]
    if len(rgb) < _FEWEST_PIXELS:
        return float("nan")
    if swap:
        rgb = rgb[:, ::-1]
    scaled_normals = (rgb - rig.response.ambient) @ rig.response.inverse.T
    of_channels = sum(_spread(rgb[:, channel]) for channel in range(3)) / 3.0
    return _spread(np.linalg.norm(scaled_normals, axis=1)) / max(of_channels, 1e-6)


def _spread(values: FloatArray) -> float:
    low, median, high = np.percentile(values, [16, 50, 84])
    return float((high - low) / 2 / median)
