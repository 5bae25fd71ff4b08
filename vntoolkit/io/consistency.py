"""Two things that hold for a matte surface of one colour, whatever its shape: see `rig_match`.

M⁻¹ (r − a) has the same length everywhere, and the slopes of its direction have no curl.
"""

from __future__ import annotations

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask

_SMOOTHING_PX = 5
_STEEPEST = 0.2  # least |n_z| of a slope that counts
_LARGEST_SAMPLE = 200_000


def albedo_variation(rgb: FloatArray, scaled_normals: FloatArray) -> float:
    """Return the spread of the lengths of (n, 3) albedo-scaled normals over that of the channels (n, 3).

    A spread is half the distance between the 16th and 84th percentile, over the median: robust against
    highlights and against pixels that not all three lights reach.
    """
    of_channels = sum(_spread(rgb[:, channel]) for channel in range(3)) / 3.0
    return _spread(np.linalg.norm(scaled_normals, axis=1)) / max(of_channels, 1e-6)


def curl_share(scaled_normals: FloatArray, used: Mask) -> float:
    """Return |∂p/∂v − ∂q/∂u| over |∂p/∂v| + |∂q/∂u|, each summed over the inside of `used`; 0 to 1.

    p and q are the slopes of the smoothed (h, w, 3) normals; a surface that exists has the share 0. NaN
    where nothing is inside, or all of it is flat.
    """
    normals = cv2.blur(scaled_normals, (_SMOOTHING_PX, _SMOOTHING_PX))
    normals = normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
    side = 2 * _SMOOTHING_PX - 1
    eroded = cv2.erode(used.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=0) > 0
    inside: Mask = np.asarray(eroded & (normals[..., 2] < -_STEEPEST))
    if not inside.any():
        return float("nan")
    slopes = normals[..., :2] / np.minimum(normals[..., 2:], -_STEEPEST)
    p_along_v = np.gradient(slopes[..., 0], axis=0)[inside]
    q_along_u = np.gradient(slopes[..., 1], axis=1)[inside]
    total = float((np.abs(p_along_v) + np.abs(q_along_u)).sum())
    return float(np.abs(p_along_v - q_along_u).sum()) / total if total > 0 else float("nan")


def _spread(values: FloatArray) -> float:
    low, median, high = np.percentile(values[:: max(1, len(values) // _LARGEST_SAMPLE)], [16, 50, 84])
    return float((high - low) / 2 / median)
