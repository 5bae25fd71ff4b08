"""A backdrop that counts as subject: a region at the picture's border whose normals have far larger bounds.

A dim wall behind a subject is lit like one, but says little: its normals' expected errors lie apart from the
subject's. The threshold between two classes of expected error is the one of `otsu1979`. What lies below it
and hangs together is the subject, with what it encloses; a mask of it is what the user needs first.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import ByteArray, Mask
from vntoolkit.diagnosis.finding import Finding
from vntoolkit.geometry.maps import NormalMap

LARGE_ERROR_DEG = 20.0  # in the median, as of pixels that one light hardly reaches
_APART = 2.0  # times the subject's: bounds that are wide all over part at any threshold
_WORSE = 1.05  # times the subject's median is that of all: less, and a region is too small to matter
_SMOOTHING_PX = 5
_KERNEL = np.ones((9, 9), np.uint8)  # closes gaps, and opens strips, narrower than this
MASK_NAME = "mask_suggested.png"


@dataclass(frozen=True, kw_only=True, eq=False)
class Backdrop:
    """subject: (h, w) suggested mask. share: of the valid pixels, in the region beside it. subject_deg,
    region_deg: expected errors, medians.
    """

    subject: Mask
    share: float
    subject_deg: float
    region_deg: float

    @property
    def finding(self) -> Finding:
        """What is said of it."""
        return Finding.of(
            "backdrop",
            share=self.share,
            region_deg=self.region_deg,
            subject_deg=self.subject_deg,
            mask=MASK_NAME,
        )


def backdrop_in(normal_map: NormalMap) -> Backdrop | None:
    """Find a region beside the subject that counts as subject; None where there is none."""
    mask = np.asarray(normal_map.mask)
    if normal_map.error_deg is None or not mask.any():
        return None
    errors = np.where(mask, np.clip(normal_map.error_deg, 0, 180), 180).astype(np.uint8)
    smooth = cv2.medianBlur(errors, _SMOOTHING_PX)
    threshold, _ = cv2.threshold(smooth[mask].reshape(-1, 1), 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    subject = _largest(_closed(mask & (smooth <= threshold)))
    beside = mask & ~subject
    # an outline's rim joins no hair to the border
    poor = cv2.morphologyEx(_closed(beside & (smooth > threshold)), cv2.MORPH_OPEN, _KERNEL)
    region = _largest(poor) & beside
    if not _at_border(region) or not (subject & mask).any():
        return None
    inside, outside = (float(np.median(normal_map.error_deg[part & mask])) for part in (subject, region))
    over_all = float(np.median(normal_map.error_deg[mask]))
    if outside <= max(LARGE_ERROR_DEG, _APART * inside) or over_all <= _WORSE * inside:
        return None
    share = float(beside.sum() / mask.sum())
    return Backdrop(subject=subject, share=share, subject_deg=inside, region_deg=outside)


def spread_deg(normal_map: NormalMap, subject: Mask) -> float:
    """Return the degrees from their mean that nine of ten normals of the subject (h, w) stay within."""
    normals = np.asarray(normal_map.normals_in_camera)[normal_map.mask & subject]
    cosines = normals @ normals.mean(axis=0) / max(float(np.linalg.norm(normals.mean(axis=0))), 1e-9)
    return float(np.degrees(np.arccos(np.clip(np.percentile(cosines, 10), -1.0, 1.0))))


def _closed(part: Mask) -> ByteArray:
    return np.asarray(cv2.morphologyEx(part.astype(np.uint8), cv2.MORPH_CLOSE, _KERNEL), np.uint8)


def _largest(part: ByteArray) -> Mask:
    """Return the largest connected part, holes filled."""
    contours, _ = cv2.findContours(part, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros(part.shape, np.uint8)
    if contours:
        cv2.drawContours(filled, [max(contours, key=cv2.contourArea)], -1, 1, cv2.FILLED)
    return filled > 0


def _at_border(part: Mask) -> bool:
    return bool(part[0].any() or part[-1].any() or part[:, 0].any() or part[:, -1].any())
