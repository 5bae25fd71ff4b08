"""Are both axes reversed? The outline tells: slopes cannot tell convex from concave.

Where a closed surface ends before a darker backdrop it turns away from the camera, so that its normals lean
outwards. The mean of their outward part along the outline is 0.3 to 0.95 on bodies, heads and statues, and
near 0 at the border of a sheet, which says nothing. Both axes of M reversed make it negative.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.evidence import (
    Evidence,
    brightest_channel,
    jackknife_error,
    lengths_of,
    scaled_normals,
    silhouette,
)
from vntoolkit.diagnosis.finding import CLEAR_Z, Finding, Level

_RIM_PX = (1.5, 4.0)  # of averaged pixels inside the outline
_BORDER_PX = 6  # an outline made by the picture's border is none
_FEWEST_PIXELS = 100
_TURNED_INWARDS = -0.3
_FATAL = -0.45


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
        for i, j in np.ndindex(2, 2):
            products[:, i, j] += np.bincount(where, outwards[:, i] * normals[:, j], blocks)
    if counts.sum() < _FEWEST_PIXELS * len(evidence.light):
        return None
    return Outline(products=products[counts > 0], counts=counts[counts > 0])
