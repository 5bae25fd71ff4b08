"""Tracks of skin points: corners followed by pyramidal Lucas–Kanade with a forward-backward check."""

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, ByteArray, IntArray, LinearImage, Mask, Points2, read_only
from vntoolkit.errors import BadCalibration
from vntoolkit.options.head import HeadSteps

_CORNER_QUALITY = 0.003  # the weakest corner as a share of the strongest
_THERE_AND_BACK_PX = 0.5  # a point that is followed to the next frame and back lands within this, or is lost
LEAST_FRAMES = 4  # shorter tracks are dropped


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracks:
    """Observations of points, sorted by point, then frame.

    point: (m,) which point, counted from 0. frame: (m,) which frame, counted from 0 over the frames used.
    positions_px: (m, 2). frame_count: frames that were offered.
    """

    point: IntArray
    frame: IntArray
    positions_px: Points2
    frame_count: int

    def __post_init__(self) -> None:
        for name in ("point", "frame", "positions_px"):
            object.__setattr__(self, name, read_only(np.asarray(getattr(self, name))))

    @property
    def point_count(self) -> int:
        """How many points."""
        return int(self.point[-1]) + 1 if len(self.point) else 0

    def of_points(self, chosen: BoolArray) -> "Tracks":
        """Keep the points chosen (point_count,), renumbered."""
        kept = chosen[self.point]
        number = np.cumsum(chosen) - 1
        return Tracks(
            point=number[self.point[kept]],
            frame=self.frame[kept],
            positions_px=self.positions_px[kept],
            frame_count=self.frame_count,
        )


@dataclass(kw_only=True, eq=False)
class TrackBuilder:
    """Follows points frame by frame; holds one frame's image and every observation."""

    steps: HeadSteps
    _previous: ByteArray | None = None
    _positions: Points2 = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    _points: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    _next_point: int = 0
    _frame: int = 0
    _seen: list[tuple[IntArray, int, Points2]] = field(default_factory=list)

    def add(self, contrast: ByteArray, mask: Mask) -> None:
        """Follow all points into the next frame and seed new corners.

        contrast: (h, w) `local_contrast`. mask: (h, w) the silhouette.
        """
        allowed = self._allowed(mask)
        if self._previous is not None and len(self._positions):
            self._follow(self._previous, contrast, allowed)
        self._seed(contrast, allowed)
        self._seen.append((self._points, self._frame, self._positions))
        self._previous = contrast
        self._frame += 1

    def finish(self) -> Tracks:
        """Return the tracks that are long enough."""
        point = np.concatenate([points for points, _, _ in self._seen] or [np.zeros(0, np.int64)])
        frame = np.concatenate(
            [np.full(len(points), k) for points, k, _ in self._seen] or [np.zeros(0, np.int64)]
        )
        positions = np.concatenate([px for _, _, px in self._seen] or [np.zeros((0, 2))]).astype(np.float64)
        order = np.lexsort((frame, point))
        tracks = Tracks(
            point=point[order],
            frame=frame[order],
            positions_px=positions[order],
            frame_count=self._frame,
        )
        lengths = np.bincount(tracks.point, minlength=self._next_point)
        return tracks.of_points(lengths >= LEAST_FRAMES)

    def _allowed(self, mask: Mask) -> ByteArray:
        """Erode the silhouette, where texture is seen at a slant and its border moves; edges count too."""
        side = 2 * self.steps.margin_px + 1
        inner = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        return np.asarray(cv2.erode(inner, kernel)[1:-1, 1:-1], dtype=np.uint8)

    def _follow(self, previous: ByteArray, image: ByteArray, allowed: ByteArray) -> None:
        start = self._positions.astype(np.float32).reshape(-1, 1, 2)
        there, found = _flow(previous, image, start, self.steps.window_px)
        back, returned = _flow(image, previous, there, self.steps.window_px)
        there = there.reshape(-1, 2)
        gap = np.linalg.norm(back.reshape(-1, 2) - self._positions, axis=1)
        column, row = np.round(there).astype(int).T
        height, width = allowed.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        inside[inside] = allowed[row[inside], column[inside]] > 0
        kept = inside & (found.ravel() > 0) & (returned.ravel() > 0) & (gap < _THERE_AND_BACK_PX)
        self._positions, self._points = there[kept], self._points[kept]

    def _seed(self, image: ByteArray, allowed: ByteArray) -> None:
        missing = self.steps.corners - len(self._positions)
        if missing <= 0:
            return
        free = allowed.copy()
        for u, v in np.round(self._positions).astype(int).tolist():
            cv2.circle(free, (u, v), round(self.steps.corner_spacing_px), 0, -1)
        corners = cv2.goodFeaturesToTrack(
            image, missing, _CORNER_QUALITY, self.steps.corner_spacing_px, mask=free
        )
        if corners is None:
            return
        corners = corners.reshape(-1, 2)
        self._positions = np.concatenate([self._positions, corners])
        self._points = np.concatenate([self._points, self._next_point + np.arange(len(corners))])
        self._next_point += len(corners)


def _flow(source: Any, target: Any, start: Any, window_px: int) -> tuple[Any, Any]:
    no_start: Any = None  # OpenCV's stubs do not allow that there is none
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        source, target, start, no_start, winSize=(window_px, window_px), maxLevel=3
    )
    return there, found


_LEAST_FOLLOWED = 0.25  # of the usual number of points: fewer means a cut, even where some match by chance


def require_tracks(tracks: Tracks) -> None:
    """Raise `BadCalibration` if the tracks end half-way or are too few."""
    shared = shared_with_next(tracks)
    weakest = int(np.argmin(shared)) if len(shared) else 0
    if not len(shared) or np.median(shared) < 60:
        raise BadCalibration(
            f"tracks: only {int(np.median(shared)) if len(shared) else 0} points of the skin can be followed "
            "from frame to frame, 60 are needed; film sharper, closer, slower, in more light, without makeup"
        )
    if shared[weakest] < max(20, _LEAST_FOLLOWED * np.median(shared)):
        raise BadCalibration(
            f"tracks: lost between frames {weakest} and {weakest + 1} of those used (only "
            f"{int(shared[weakest])} points followed); film the turn in one shot, without cuts or covered "
            "face, at most 4 degrees from frame to frame"
        )
    _require_motion(tracks)


_LEAST_MOTION = 0.08  # of the head's diagonal in the picture, over a whole track


def _require_motion(tracks: Tracks) -> None:
    """Raise `BadCalibration` if nothing moves: a still head or an empty room."""
    low = np.full((tracks.point_count, 2), np.inf)
    high = -low
    np.minimum.at(low, tracks.point, tracks.positions_px)
    np.maximum.at(high, tracks.point, tracks.positions_px)
    moved = float(np.percentile(np.linalg.norm(high - low, axis=1), 90))
    extent = float(np.linalg.norm(np.ptp(tracks.positions_px, axis=0)))
    if moved < _LEAST_MOTION * extent:
        raise BadCalibration(
            f"tracks: the head hardly turns (its skin moves by {moved:.0f} px); film it turning all the way "
            "to the left and to the right, 60 degrees each, before a still camera"
        )


def shared_with_next(tracks: Tracks) -> IntArray:
    """How many points each frame shares with the next, (frame_count − 1,)."""
    key = tracks.point.astype(np.int64) * (tracks.frame_count + 1) + tracks.frame
    both = np.isin(key + 1, key) & (tracks.frame + 1 < tracks.frame_count)
    return np.bincount(tracks.frame[both], minlength=tracks.frame_count)[: tracks.frame_count - 1]


# Local contrast: an image that keeps the texture of the skin and removes the moving shading.

_CONTRAST_PX = 6.0  # standard deviation of the window whose mean and spread are divided out
_CONTRAST_FLOOR = 3.5  # spread, in levels of 255, that is taken for noise and not amplified
_BLACK_TO_WHITE = 8.0  # range of the contrast in 8 bits


def local_contrast(rgb: LinearImage) -> ByteArray:
    """Return (x − mean) / (spread + floor) of the channels' mean x (h, w, 3); (h, w), 127 where it is 0.

    Multiplying the light by a smooth factor changes it little, so that a moving shading does not pull what
    is followed in it. The mean of the channels is taken since compressed colour is coarse (4:2:0).
    """
    grey = 255.0 * np.asarray(rgb, dtype=np.float32).mean(axis=2)
    deviation = grey - cv2.GaussianBlur(grey, (0, 0), _CONTRAST_PX)
    spread = np.sqrt(cv2.GaussianBlur(deviation * deviation, (0, 0), _CONTRAST_PX))
    contrast = deviation / (spread + np.float32(_CONTRAST_FLOOR))
    return np.clip(127.5 + 255.0 / _BLACK_TO_WHITE * contrast, 0, 255).astype(np.uint8)
