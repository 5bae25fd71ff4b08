"""Camera intrinsics from the board: Zhang's method by OpenCV, over views that differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.calibration.board_detection import BoardSighting
from vntoolkit.calibration.quality import cone_of_normals_deg
from vntoolkit.checks import require_positive
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.native import one_opencv_thread

_FEWEST_VIEWS = 5
_FEWEST_CORNERS = 16
_LARGEST_FOCAL_DEVIATION = 0.05  # relative standard deviation
_NARROWEST_CONE_DEG = 8.0  # half-angle of the views: with less, focal length and distance are one unknown


@dataclass(frozen=True, kw_only=True)
class IntrinsicsOptions:
    """Which camera is fitted.

    radial_terms: coefficients of radial distortion, 0 to 2; higher ones follow noise where the corners
    do not reach the image's edge. tangential: number of tangential coefficients, 0 or 2. most_views: views
    used, picked so that they differ most. largest_error_px: root mean square above which the fit is refused.
    """

    radial_terms: int = 1
    tangential: int = 0
    most_views: int = 40
    largest_error_px: float = 1.0

    def __post_init__(self) -> None:
        if self.radial_terms not in (0, 1, 2) or self.tangential not in (0, 2):
            raise BadInput("intrinsics: expected 0 to 2 radial and 0 or 2 tangential terms")
        if self.most_views < _FEWEST_VIEWS:
            raise BadInput(f"intrinsics: expected at least {_FEWEST_VIEWS} views, got {self.most_views}")
        require_positive(self.largest_error_px, "intrinsics: largest error in pixels")


def fit_camera(
    sightings: Sequence[BoardSighting],
    layout: BoardLayout,
    size: tuple[int, int],
    options: IntrinsicsOptions | None = None,
) -> Camera:
    """Fit K and distortion to the corners of many views. size: (width, height).

    Zhang, A flexible new technique for camera calibration, 2000 (zhang2000). Raises `BadCalibration` where
    the views are too few or too much alike.
    """
    options = options or IntrinsicsOptions()
    usable = [s for s in sightings if _spans_plane(layout.corners_mm[s.corner_ids])]
    if len(usable) < _FEWEST_VIEWS:
        raise BadCalibration(
            f"calibrate board: {len(usable)} frames show the board well enough for the camera's intrinsics, "
            f"at least {_FEWEST_VIEWS} are needed; film longer, or give the camera with --camera"
        )
    views = [usable[i] for i in _most_different(_descriptors(usable, layout), options.most_views)]
    points = [_in_plane(layout.corners_mm[s.corner_ids]) for s in views]
    images = [s.corners_px.astype(np.float32) for s in views]
    calibrate: Any = cv2.calibrateCameraExtended  # its stubs forbid the None that its manual asks for
    with one_opencv_thread():  # several sum in any order: the last digits would change from run to run
        error, matrix, distortion, rotations, _, deviations, _, _ = calibrate(
            points,
            images,
            size,
            None,
            None,
            flags=_flags(options),
        )
    focal_deviation = float(deviations[:2].max()) / float(matrix[0, 0])
    tilts = np.array([cv2.Rodrigues(r)[0][:, 2] for r in rotations])
    cone = cone_of_normals_deg(tilts)
    fits = np.isfinite(error) and error <= options.largest_error_px
    if not (fits and focal_deviation < _LARGEST_FOCAL_DEVIATION and cone > _NARROWEST_CONE_DEG):
        raise BadCalibration(
            f"calibrate board: the camera fit misses the corners by {error:.2f} px with a focal length "
            f"uncertain by {100 * focal_deviation:.0f} %, from views within {cone:.0f} degrees; tilt the "
            "board by 30 degrees and more in all directions, or give the camera with --camera"
        )
    k1, k2, p1, p2 = np.ravel(distortion)[:4]
    model = CameraModel.OPENCV if options.radial_terms or options.tangential else CameraModel.PINHOLE
    return Camera(
        model=model,
        width=size[0],
        height=size[1],
        matrix=matrix,
        distortion=np.array([k1, k2, p1, p2]) if model is CameraModel.OPENCV else np.zeros(4),
    )


def _spans_plane(corners_mm: FloatArray) -> bool:
    """Whether corners (n, 2) are many, and not all in one row or column."""
    return len(corners_mm) >= _FEWEST_CORNERS and bool((np.ptp(corners_mm, axis=0) > 0).all())


def _flags(options: IntrinsicsOptions) -> int:
    flags = cv2.CALIB_FIX_K3
    if options.radial_terms < 2:
        flags |= cv2.CALIB_FIX_K2
    if options.radial_terms < 1:
        flags |= cv2.CALIB_FIX_K1
    if options.tangential == 0:
        flags |= cv2.CALIB_ZERO_TANGENT_DIST
    return int(flags)


def _in_plane(corners_mm: FloatArray) -> FloatArray:
    points = np.zeros((len(corners_mm), 3), np.float32)
    points[:, :2] = corners_mm
    return points


def _descriptors(sightings: Sequence[BoardSighting], layout: BoardLayout) -> FloatArray:
    """Where the board's four corners appear, in pixels, (n, 8): views of like pose have like ones."""
    w, h = layout.width_mm, layout.height_mm
    frame = np.array([[[0, 0], [w, 0], [w, h], [0, h]]])
    found = []
    for sighting in sightings:
        homography, _ = cv2.findHomography(layout.corners_mm[sighting.corner_ids], sighting.corners_px)
        found.append(cv2.perspectiveTransform(frame, homography).ravel())
    return np.array(found)


def _most_different(descriptors: FloatArray, count: int) -> list[int]:
    """Farthest-point sampling: each next view is the one least like those chosen; (n, d) to indices."""
    if len(descriptors) <= count:
        return list(range(len(descriptors)))
    start = np.linalg.norm(descriptors - np.median(descriptors, axis=0), axis=1).argmin()
    chosen = [int(start)]
    nearest = np.linalg.norm(descriptors - descriptors[start], axis=1)
    while len(chosen) < count:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(descriptors - descriptors[chosen[-1]], axis=1))
    return sorted(chosen)
