"""SIFT features (lowe2004) matched between frames by COLMAP: the alternative to tracks of the skin.

Far slower than following, but at home with ten and twenty degrees between photographs of a turntable.
"""

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from vntoolkit.arrays import ByteArray, Float64Array, FloatArray, IntArray, Mask, Points2
from vntoolkit.calibration.head.colmap import camera_for_colmap, colmap_from_pixels, pixels_from_colmap
from vntoolkit.calibration.head.silhouettes import box_of_mask
from vntoolkit.calibration.head.tracks import Tracks, shared_with_next
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.camera import Camera

_ALL_PAIRS = 40  # frames: of so many, every one is compared with every other
_APART = (1, 2, 3, 4, 6, 8, 12, 16)  # of more: those so many frames apart
_LEAST_TYPICAL, _LEAST_SHARED = 60, 20  # features of neighbouring frames: usually, and at the least
_LEAST_FRAMES = 3  # a track over two says nothing that could be wrong
_ESTIMATE_PX, _GUIDE_PX = 2.0, 1.5  # from the epipolar line: while it is sought, and once it is known
_PEAK = 0.003  # weakest contrast of a feature, 0 to 1: skin has little
_MOST_FEATURES = 3000  # of a frame
_RATIO = 0.8  # of the distance to the best match over that to the second best, at most; COLMAP's
_LEAST_MATCHES = 20  # of a pair of frames that agree on one epipolar geometry,
_LEAST_AGREEING = 0.4  # and their share of all matches
Features = tuple[Points2, FloatArray]  # positions (n, 2) and unit descriptors (n, 128)


@dataclass(kw_only=True, eq=False)
class SiftBuilder:
    """Finds features frame by frame, and matches them at the end; holds descriptors and positions."""

    camera: Camera
    _positions: list[Points2] = field(default_factory=list)
    _descriptors: list[FloatArray] = field(default_factory=list)
    _extractor: Any = None

    def add(self, contrast: ByteArray, mask: Mask) -> None:
        """Find a frame's features.

        contrast: (h, w) `local_contrast`. mask: (h, w) the silhouette.
        """
        if self._extractor is None:
            self._extractor = _extractor()
        if not mask.any():
            self._positions.append(np.zeros((0, 2)))
            self._descriptors.append(np.zeros((0, 128), np.float32))
            return
        rows, columns = box_of_mask(mask)
        own = np.ascontiguousarray(contrast[rows, columns])
        keypoints, found = self._extractor.extract_from_uint8_array(own)
        positions = np.array([[each.x, each.y] for each in keypoints]).reshape(-1, 2)
        positions = pixels_from_colmap(positions) + np.array([columns.start, rows.start])
        descriptors = np.asarray(found.data, dtype=np.float32).reshape(len(positions), -1)
        inside = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        column, row = np.round(positions).astype(int).T
        kept = np.flatnonzero(inside[row.clip(0, len(mask) - 1), column.clip(0, mask.shape[1] - 1)])
        kept = kept[:_MOST_FEATURES]
        length = np.maximum(np.linalg.norm(descriptors[kept], axis=1, keepdims=True), 1e-9)
        self._positions.append(positions[kept])
        self._descriptors.append(descriptors[kept] / length)

    def finish(self) -> Tracks:
        """Match the pairs of frames and join the matches into tracks over at least three frames."""
        colmap = camera_for_colmap(self.camera)
        starts = np.concatenate([[0], np.cumsum([len(each) for each in self._positions])])
        pairs = []
        for i, j in _pairs_of(len(self._positions)):
            first = self._positions[i], self._descriptors[i]
            found = match_two_views(colmap, first, (self._positions[j], self._descriptors[j]))
            pairs.append(found + starts[[i, j]])
        matches = np.concatenate([*pairs, np.zeros((0, 2), np.int64)])
        return joined_matches(matches, self._positions)


def require_features(tracks: Tracks) -> None:
    """Raise `BadCalibration` where neighbouring frames share too few features for poses."""
    shared = shared_with_next(tracks)
    typical = int(np.median(shared)) if len(shared) else 0
    if typical < _LEAST_TYPICAL:
        raise BadCalibration(
            f"features: a frame shares only {typical} with the next, {_LEAST_TYPICAL} are needed; film more "
            "sharply and closer, skin without makeup, at most 20 degrees from frame to frame"
        )
    weakest = int(np.argmin(shared))
    if shared[weakest] < _LEAST_SHARED:
        raise BadCalibration(
            f"features: lost between frames {weakest} and {weakest + 1} of those used (only "
            f"{int(shared[weakest])} shared); film the turn without cuts or a covered face, at most 20 "
            "degrees from frame to frame"
        )


def _pairs_of(count: int) -> list[tuple[int, int]]:
    apart = range(1, count) if count <= _ALL_PAIRS else _APART
    return [(i, i + d) for d in apart for i in range(count - d)]


def joined_matches(matches: IntArray, positions: list[Points2]) -> Tracks:
    """Join matches (m, 2) of features, counted over all frames, into tracks that show no frame twice.

    The first matches count most: one that would bring two places of a frame together is chance and left out.
    """
    frame = np.repeat(np.arange(len(positions)), [len(each) for each in positions])
    part = np.arange(len(frame))
    members = [[k] for k in range(len(frame))]
    frames = [{k} for k in frame.tolist()]
    for a, b in part[matches].tolist():
        kept, gone = int(part[a]), int(part[b])
        if kept == gone or frames[kept] & frames[gone]:
            continue
        part[members[gone]] = kept
        members[kept] += members[gone]
        frames[kept] |= frames[gone]
    feature = np.flatnonzero(np.bincount(part, minlength=len(part))[part] >= _LEAST_FRAMES)
    _, point = np.unique(part[feature], return_inverse=True)
    order = np.lexsort((frame[feature], point))
    every = np.concatenate([*positions, np.zeros((0, 2))])
    return Tracks(
        point=point[order],
        frame=frame[feature][order],
        positions_px=every[feature][order],
        frame_count=len(positions),
    )


def _extractor() -> Any:
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads = 1
    extraction.use_gpu = False
    extraction.sift.upright = True  # the head turns about an upright axis
    extraction.sift.peak_threshold = _PEAK
    extraction.sift.max_num_features = 2 * _MOST_FEATURES
    return pycolmap.FeatureExtractor.create(extraction, pycolmap.Device.cpu)


def match_two_views(camera: Any, first: Features, second: Features) -> IntArray:
    """Match, find the epipolar geometry by RANSAC, match again along its lines; (m, 2) numbers of features.

    camera: pycolmap's. None where too few agree: chance finds such pairs, too.
    """
    import pycolmap

    none = np.zeros((0, 2), np.int64)
    if min(len(first[0]), len(second[0])) < _LEAST_MATCHES:
        return none
    angles = np.arccos(np.clip(first[1] @ second[1].T, -1.0, 1.0))
    matches = _mutual(angles)
    if len(matches) < _LEAST_MATCHES:
        return none
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = _LEAST_MATCHES
    options.detect_watermark = False
    options.ransac.max_error = _ESTIMATE_PX
    options.ransac.random_seed = 0
    a, b = colmap_from_pixels(first[0]), colmap_from_pixels(second[0])
    found = pycolmap.estimate_calibrated_two_view_geometry(
        camera, a, camera, b, matches.astype(np.uint32), options
    )
    agreeing = len(found.inlier_matches)
    if found.F is None or agreeing < max(_LEAST_MATCHES, _LEAST_AGREEING * len(matches)):
        return none
    off = _distance_to_lines(np.asarray(found.F), a, b)
    return _mutual(np.where(off < _GUIDE_PX, angles, np.inf))


_LARGEST_ANGLE = 0.7  # between descriptors of one point, radians; COLMAP's


def _mutual(angles: FloatArray) -> IntArray:
    """Return pairs (m, 2) that are each other's nearest, clearly nearer than the second nearest."""
    rows = np.arange(len(angles))
    two = np.argpartition(angles, 1, axis=1)[:, :2]
    near = np.take_along_axis(angles, two, axis=1)
    best = two[rows, near.argmin(axis=1)]
    least, next_least = near.min(axis=1), near.max(axis=1)
    kept = (angles.argmin(axis=0)[best] == rows) & (least < _RATIO * next_least) & (least < _LARGEST_ANGLE)
    return np.column_stack([rows[kept], best[kept]])


def _distance_to_lines(fundamental: Float64Array, a: Points2, b: Points2) -> FloatArray:
    """Return (n, m) the distance in pixels of points b (m, 2) from the epipolar lines of points a (n, 2)."""
    lines = np.column_stack([a, np.ones(len(a))]) @ fundamental.T
    lines /= np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-12)
    return np.abs(lines @ np.column_stack([b, np.ones(len(b))]).T)
