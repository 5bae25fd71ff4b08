"""One look at the board: which corners are where, and what colour the sample in the hole has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, IntArray, Points2, Vector3
from vntoolkit.geometry.board_layout import MARKER_DICTIONARY, BoardLayout
from vntoolkit.photometry.frame import LinearFrame

_FEWEST_CORNERS = 12
_HOMOGRAPHY_TOLERANCE_PX = 3.0  # beyond lens distortion over the board, within a mistaken corner
_SAMPLE_SHARE = 0.7  # of the hole's side: its edge casts shadow and may not be cut straight
_FEWEST_SAMPLE_PIXELS = 25
_LARGEST_CLIPPED_SHARE = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardSighting:
    """The board in one frame.

    number: of the frame. corner_ids: (n,), of the layout. corners_px: (n, 2). rgb: (3,) linear colour of the
    sample, the median over the hole's middle; None where too few pixels of it are seen or too many clipped.
    """

    number: int
    corner_ids: IntArray
    corners_px: Points2
    rgb: Vector3 | None


class BoardDetector:
    """Finds one layout's board in frame after frame."""

    def __init__(self, layout: BoardLayout) -> None:
        self.layout = layout
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, MARKER_DICTIONARY))
        board = cv2.aruco.CharucoBoard(
            (layout.columns, layout.rows), layout.square_mm, layout.marker_mm, dictionary
        )
        parameters = cv2.aruco.CharucoParameters()
        parameters.minMarkers = 1  # around the hole a corner has one marker only
        self._detector = cv2.aruco.CharucoDetector(board, parameters)

    def sight(self, frame: LinearFrame) -> BoardSighting | None:
        """Return the board in a frame, or None where fewer than a dozen corners agree with it."""
        corners, ids, _, _ = self._detector.detectBoard(_grey(frame.rgb))
        if ids is None or corners is None:
            return None
        ids, corners = ids.ravel(), corners.reshape(-1, 2).astype(np.float64)
        sound = np.isin(ids, self.layout.sound_corner_ids)
        ids, corners = ids[sound], corners[sound]
        if len(ids) < _FEWEST_CORNERS:
            return None
        homography, agrees = cv2.findHomography(
            self.layout.corners_mm[ids], corners, cv2.RANSAC, _HOMOGRAPHY_TOLERANCE_PX
        )
        agrees = np.zeros(0) if agrees is None else agrees.ravel().astype(bool)
        if homography is None or agrees.sum() < _FEWEST_CORNERS:
            return None
        return BoardSighting(
            number=frame.number,
            corner_ids=ids[agrees],
            corners_px=corners[agrees],
            rgb=_sample_colour(frame, homography, self.layout),
        )


def _grey(rgb: FloatArray) -> npt.NDArray[np.uint8]:
    """All three lights together, stretched and with a gamma, as the detector knows photographs."""
    total = np.clip(rgb, 0.0, None).sum(axis=2)
    white = max(float(np.percentile(total, 99.5)), 1e-6)
    return (255.0 * np.sqrt(np.minimum(total / white, 1.0))).astype(np.uint8)


def _sample_colour(frame: LinearFrame, homography: npt.NDArray[Any], layout: BoardLayout) -> Vector3 | None:
    hole = layout.hole_mm
    polygon = hole.mean(axis=0) + _SAMPLE_SHARE * (hole - hole.mean(axis=0))
    outline: Any = cv2.perspectiveTransform(polygon[None], homography)[0]
    height, width = frame.shape
    if (outline < 0).any() or (outline > [width - 1, height - 1]).any():
        return None
    inside = np.zeros(frame.shape, np.uint8)
    cv2.fillConvexPoly(inside, np.round(outline).astype(np.int32), 1)
    chosen = inside.astype(bool)
    if np.count_nonzero(chosen) < _FEWEST_SAMPLE_PIXELS:
        return None
    if frame.clipped[chosen].mean() > _LARGEST_CLIPPED_SHARE:
        return None
    return np.median(frame.rgb[chosen].astype(np.float64), axis=0)
