"""Do the normals turn outwards at the subject's outline? Tells convex from concave, which slopes cannot.

Where a closed surface ends before a darker backdrop it turns away from the camera, so that its normals lean
outwards. The mean of their outward part along the outline is 0.3 to 0.95 on bodies, heads and statues, and
near 0 at the border of a sheet, which says nothing. Both axes of M reversed make it negative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.evidence import Evidence, scaled_normals
from vntoolkit.diagnosis.finding import Finding, Level, certainty_from_z

_LIT = 0.1  # of the brightest hundredth: the subject and what is lit like it
_CLOSING_PX = 5
_RIM_PX = (1.5, 4.0)  # of averaged pixels inside the outline
_BORDER_PX = 6  # an outline made by the picture's border is none
_FEWEST_PIXELS = 100
_TURNED_INWARDS = -0.3
_FATAL = -0.45
_Z = 4.0


def check_outline(evidence: Evidence) -> list[Finding]:
    """Find normals that turn inwards along the outline: both axes of M reversed, or convex for concave."""
    seen = outline(evidence)
    if seen is None:
        return []
    outward, error = seen.outward(np.eye(2))
    if outward > _TURNED_INWARDS or -outward < _Z * error:
        return []
    return [
        Finding(
            check="outline",
            level=Level.FATAL if outward < _FATAL else Level.WARNING,
            problem="the normals turn inwards along the subject's outline, as if it were hollow",
            measured=f"a mean outward part of {outward:.2f} ± {error:.2f}",
            expected="0 to 1",
            remedy="x and y of M both look reversed (lamps turned by 180 degrees): give lamps and normals "
            "with x right, y down, z forward in rig.json, or calibrate again",
            certainty=certainty_from_z(outward / error),
        )
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Outline:
    """products: (b, 2, 2) sums of outward direction times normal (x, y) over blocks. counts: (b,)."""

    products: FloatArray
    counts: FloatArray

    def outward(self, change: FloatArray) -> tuple[float, float]:
        """Return the mean outward part of normals with (x, y) changed by (2, 2), and its standard error."""
        sums = np.einsum("bij,ij->b", self.products, change)
        total, count = sums.sum(), self.counts.sum()
        left_out = (total - sums) / np.maximum(count - self.counts, 1.0)
        size = len(sums)
        error = math.sqrt((size - 1) / size * float(((left_out - left_out.mean()) ** 2).sum()))
        return float(total / count), max(error, 0.01)


@lru_cache(maxsize=2)
def outline(evidence: Evidence) -> Outline | None:
    """Measure the normals along the outline; None where there is too little of it in the picture."""
    blocks = int(evidence.blocks.max()) + 1
    products, counts = np.zeros((blocks, 2, 2)), np.zeros(blocks)
    kernel = np.ones((_CLOSING_PX, _CLOSING_PX), np.uint8)
    for k, light in enumerate(evidence.light):
        brightest = light.max(axis=2)
        subject = ((brightest > _LIT * np.percentile(brightest, 99)) & evidence.inside[k]).astype(np.uint8)
        for operation in (cv2.MORPH_CLOSE, cv2.MORPH_OPEN):
            subject = np.asarray(cv2.morphologyEx(subject, operation, kernel), np.uint8)
        depth = cv2.distanceTransform(subject, cv2.DIST_L2, 5)
        fall_v, fall_u = np.gradient(-cv2.GaussianBlur(subject.astype(np.float32), (0, 0), 2.0))
        rim = (depth > _RIM_PX[0]) & (depth < _RIM_PX[1]) & ~evidence.clipped[k]
        rim[:_BORDER_PX] = rim[-_BORDER_PX:] = False
        rim[:, :_BORDER_PX] = rim[:, -_BORDER_PX:] = False
        outwards = np.stack([fall_u, fall_v], axis=-1)[rim]
        outwards /= np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9)
        normals = scaled_normals(evidence, light)[rim]
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        where = evidence.blocks[rim]
        counts += np.bincount(where, minlength=blocks)
        for i in range(2):
            for j in range(2):
                products[:, i, j] += np.bincount(where, outwards[:, i] * normals[:, j], blocks)
    if counts.sum() < _FEWEST_PIXELS * len(evidence.light):
        return None
    return Outline(products=products[counts > 0], counts=counts[counts > 0])
