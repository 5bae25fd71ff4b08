"""Are axes reversed? The outline tells of both, the curl of slopes of one.

Slopes cannot tell convex from concave.

Where a closed surface ends before a darker backdrop it turns away from the camera, so that its normals lean
outwards. The mean of their outward part along the outline is 0.3 to 0.95 on bodies, heads and statues, and
near 0 at the border of a sheet, which says nothing. Both axes of M reversed make it negative.
"""

import logging
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.diagnosis.evidence import (
    FEWEST_PIXELS,
    Evidence,
    brightest_channel,
    jackknife_error,
    lengths_of,
    scaled_normals,
    silhouette,
)
from vntoolkit.diagnosis.finding import CLEAR_Z, Finding, Level
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.options.export import NormalConvention

logger = logging.getLogger(__name__)
_RIM_PX = (1.5, 4.0)  # of averaged pixels inside the outline
_BORDER_PX = 6  # an outline made by the picture's border is none
_FEWEST_PIXELS = 100
_TURNED_INWARDS = -0.3
_FATAL = -0.45
# The green axis of an imported normal map: a surface that exists has slopes without curl.
_SMOOTHING_PX = 5
_STEEPEST = 0.2  # least |n_z| of a slope that counts
_MARGIN = 0.6  # the other reading must leave this share of the curl
_WORST_AS_FLIPPED = 0.5  # and be nearly free of curl itself: noise has 0.6 either way


def check_outline(evidence: Evidence) -> list[Finding]:
    """Find normals that turn inwards along the outline: both axes of M reversed, or convex for concave."""
    seen = outline(evidence)
    if seen is None:
        return []
    outward, error = seen.outward(np.eye(2))
    if outward > _TURNED_INWARDS or -outward < CLEAR_Z * error:
        return []
    level = Level.FATAL if outward < _FATAL else Level.WARNING
    return [Finding.of("outline", level=level, outward=outward, error=error)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Outline:
    """products: (b, 2, 2) sums, over blocks, of the way outwards in the picture times the normal's (x, y).

    counts: (b,) of their pixels.
    """

    products: FloatArray
    counts: FloatArray

    def outward(self, change: FloatArray) -> tuple[float, float]:
        """Return the mean product with the rig's (x, y) changed by (2, 2), and its standard error."""
        sums = np.einsum("bij,ij->b", self.products, change)
        total, count = sums.sum(), self.counts.sum()
        left_out = (total - sums) / np.maximum(count - self.counts, 1.0)
        return float(total / count), max(float(jackknife_error(left_out)), 0.01)


@lru_cache(maxsize=2)
def outline(evidence: Evidence) -> Outline | None:
    """Measure the normals along the outline; None where there is too little of it in the picture."""
    blocks = int(evidence.blocks.max()) + 1
    products, counts = np.zeros((blocks, 2, 2)), np.zeros(blocks)
    for k, light in enumerate(evidence.light):
        subject = silhouette(brightest_channel(light), evidence.inside[k])
        depth = cv2.distanceTransform(subject, cv2.DIST_L2, 5)
        fall_v, fall_u = np.gradient(-cv2.GaussianBlur(subject.astype(np.float32), (0, 0), 2.0))
        rim = (depth > _RIM_PX[0]) & (depth < _RIM_PX[1]) & ~evidence.clipped[k]
        rim[:_BORDER_PX] = rim[-_BORDER_PX:] = False
        rim[:, :_BORDER_PX] = rim[:, -_BORDER_PX:] = False
        outwards = np.stack([fall_u, fall_v], axis=-1)[rim]
        outwards /= np.maximum(lengths_of(outwards)[:, None], 1e-9)
        normals = scaled_normals(evidence, light)[rim]
        normals = normals / np.maximum(lengths_of(normals)[:, None], 1e-9)
        where = evidence.blocks[rim]
        counts += np.bincount(where, minlength=blocks)
        for i in range(2):
            for j in range(2):
                products[:, i, j] += np.bincount(where, outwards[:, i] * normals[:, j], blocks)
    if counts.sum() < _FEWEST_PIXELS * len(evidence.light):
        return None
    return Outline(products=products[counts > 0], counts=counts[counts > 0])


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
    if finding := finding_from_axes(normal_map):
        logger.warning("%s: %s", path, finding)


def finding_from_axes(normal_map: NormalMap) -> str | None:
    """Return a line where the map makes a surface only with its y axis flipped, else None."""
    if int(normal_map.mask.sum()) < FEWEST_PIXELS:
        return None
    normals = np.asarray(normal_map.normals_in_camera, dtype=np.float64)
    as_read = curl_share(normals, normal_map.mask)
    flipped = curl_share(normals * np.array([1.0, -1.0, 1.0]), normal_map.mask)
    if not flipped < min(_MARGIN * as_read, _WORST_AS_FLIPPED):
        return None
    return (
        f"the green axis looks flipped: as read the slopes contradict each other (curl share {as_read:.2f}), "
        f"flipped they fit ({flipped:.2f}); read it with the other convention, opengl or directx"
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
    if abs(upwards) > -_TURNED_INWARDS:
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
