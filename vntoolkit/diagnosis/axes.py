"""In which axes does a normal map make a surface? The curl of its slopes tells, and its outline.

Slopes cannot tell convex from concave.
"""

import logging
from pathlib import Path

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.options.export import NormalConvention

logger = logging.getLogger(__name__)
_SMOOTHING_PX = 5
_STEEPEST = 0.2  # least |n_z| of a slope that counts
_MARGIN = 0.6  # the other reading must leave this share of the curl
_WORST_AS_FLIPPED = 0.5  # and be nearly free of curl itself: noise has 0.6 either way
_FEWEST_PIXELS = 400
_LEANS_OUTWARDS = 0.3  # mean of the outward part along an outline: bodies, heads and statues have 0.3 to 0.95


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


def warn_of_flipped_axes(path: Path | str, normal_map: NormalMap) -> None:
    """Log a warning where the map read from `path` makes a surface only with its y axis flipped."""
    if int(normal_map.mask.sum()) < _FEWEST_PIXELS:
        return
    normals = np.asarray(normal_map.normals_in_camera, dtype=np.float64)
    as_read = curl_share(normals, normal_map.mask)
    flipped = curl_share(normals * np.array([1.0, -1.0, 1.0]), normal_map.mask)
    if flipped < min(_MARGIN * as_read, _WORST_AS_FLIPPED):
        logger.warning(
            "%s: the green axis looks flipped: as read the slopes contradict each other (curl share %.2f), "
            "flipped they fit (%.2f); read it with the other convention, opengl or directx",
            path,
            as_read,
            flipped,
        )


def likeliest_convention(stored: FloatArray, mask: Mask) -> tuple[NormalConvention, str]:
    """Return the axes in which stored vectors (h, w, 3) make a surface, and how that is told.

    z tells whether they point at the viewer. Slopes without curl tell the sign of y, and where the curl does
    not, the outline, where a closed surface leans outwards.
    """
    if np.mean(stored[mask][:, 2] > 0) < 0.5:
        return NormalConvention.OPENCV, "z points away from the viewer"
    readings = (NormalConvention.OPENGL, NormalConvention.DIRECTX)
    first, second = (
        curl_share(np.asarray(stored * np.array(each.signs, np.float32), np.float32), mask)
        for each in readings
    )
    if min(first, second) < _MARGIN * max(first, second):
        which = readings[int(second < first)]
        return (
            which,
            f"slopes have the least curl so: {min(first, second):.2f} against {max(first, second):.2f}",
        )
    upwards = _outward_y(stored, mask)
    if abs(upwards) > _LEANS_OUTWARDS:
        return readings[int(upwards < 0)], "the outline leans outwards so"
    return NormalConvention.OPENGL, "neither curl nor outline tells, so the usual one was taken"


def _outward_y(stored: FloatArray, mask: Mask) -> float:
    """Return the mean of y along the outline's upward direction, weighted by how far that is up or down."""
    inside = cv2.blur(
        mask.astype(np.float32), (_SMOOTHING_PX, _SMOOTHING_PX), borderType=cv2.BORDER_REPLICATE
    )
    upwards = np.gradient(inside, axis=0)  # more of the subject below: the outline faces up
    rim = mask & (np.abs(upwards) > 0)
    total = float(np.abs(upwards[rim]).sum())
    return float((stored[..., 1] * upwards)[rim].sum()) / total if total > 0 else 0.0
