"""Detection of the board in one frame: its corners, and the colour of the sample in the hole."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from vntoolkit.arrays import Array, ByteArray, FloatArray, IntArray, Mask, Points2, Vector3
from vntoolkit.geometry.board_layout import MARKER_DICTIONARY, BoardLayout
from vntoolkit.photometry.frame import LinearFrame

_FEWEST_CORNERS = 12
_SMALLEST_TOLERANCE_PX = 0.5  # of a corner to the plane's homography
_TOLERANCE_MEDIANS = 4.0  # lens distortion bends all corners of a view, a mistaken corner stands out
_WINDOW_SHARE = 0.8  # of the gap between a corner and the next marker
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
        grey = _grey(frame.rgb)
        corners: Any
        ids: Any
        corners, ids, _, _ = self._detector.detectBoard(grey)
        if ids is None or corners is None:
            return None
        ids, corners = (
            np.asarray(ids).ravel().astype(np.int64),
            np.asarray(corners, np.float64).reshape(-1, 2),
        )
        sound = np.isin(ids, self.layout.sound_corner_ids)
        ids, corners = ids[sound], corners[sound]
        if len(ids) < _FEWEST_CORNERS:
            return None
        homography, _ = cv2.findHomography(self.layout.corners_mm[ids], corners, cv2.LMEDS)
        if homography is None:
            return None
        corners, agrees = _refine(grey, corners, self.layout.corners_mm[ids], homography, self.layout)
        if np.count_nonzero(agrees) < _FEWEST_CORNERS:
            return None
        return BoardSighting(
            number=frame.number,
            corner_ids=ids[agrees],
            corners_px=corners[agrees],
            rgb=_sample_colour(frame, homography, self.layout),
        )


def _refine(
    grey: ByteArray,
    corners: Points2,
    corners_mm: Points2,
    homography: Array,
    layout: BoardLayout,
) -> tuple[Points2, Mask]:
    """Refine the corners (n, 2) in a window that no marker reaches into (OpenCV's may); tell which agree."""
    predicted: Any = cv2.perspectiveTransform(corners_mm[None], homography)[0]
    residual = np.linalg.norm(predicted - corners, axis=1)
    tolerance = max(_SMALLEST_TOLERANCE_PX, _TOLERANCE_MEDIANS * float(np.median(residual)))
    start = np.where(residual[:, None] > tolerance, predicted, corners)
    start = np.clip(start, 0, np.array(grey.shape[::-1]) - 1).astype(np.float32)  # OpenCV takes no others
    gap_px = 0.5 * (layout.square_mm - layout.marker_mm) * _pixels_per_mm(homography, layout)
    window = max(2, int(_WINDOW_SHARE * gap_px))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.01)
    refined = cv2.cornerSubPix(grey, start[:, None].copy(), (window, window), (-1, -1), criteria)[:, 0]
    return refined.astype(np.float64), np.linalg.norm(refined - predicted, axis=1) <= tolerance


def _pixels_per_mm(homography: Array, layout: BoardLayout) -> float:
    """Scale of the image in the middle of the board, from the area of a square there."""
    corner, side = np.array([layout.width_mm, layout.height_mm]) / 2, layout.square_mm
    square = corner + side * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    image: Any = cv2.perspectiveTransform(square[None], homography)
    return float(np.sqrt(cv2.contourArea(image.astype(np.float32)))) / side


def _grey(rgb: FloatArray) -> ByteArray:
    """All three lights together, stretched and with a gamma, as the detector knows photographs."""
    red, green, blue = np.moveaxis(np.maximum(rgb, 0.0), 2, 0)
    total = red + green + blue  # a sum over so short an axis takes six times as long
    white = max(float(np.percentile(total, 99.5)), 1e-6)
    return (255.0 * np.sqrt(np.minimum(total / white, 1.0))).astype(np.uint8)


def _sample_colour(frame: LinearFrame, homography: Array, layout: BoardLayout) -> Vector3 | None:
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
