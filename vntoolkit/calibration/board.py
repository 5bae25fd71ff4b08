"""Calibration on a board with a hole that shows the subject's material (brostow2011, Section III-A).

Every frame gives one normal (the pattern's pose) and one colour (the sample in the hole); the camera's
intrinsics come from the same footage unless given.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Matrix3, Points
from vntoolkit.calibration.board_detection import BoardSighting
from vntoolkit.calibration.fit import (
    SHADOW_SHARE,
    Design,
    ResponseFit,
    fit_by_trimming,
    fit_quality,
    fit_response,
)
from vntoolkit.calibration.lights import line_colour, three_lamps
from vntoolkit.calibration.varying import fit_varying_response
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.board_layout import NORMAL_IN_BOARD, BoardLayout
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.native import one_opencv_thread
from vntoolkit.options.calibration import BoardOptions, ResponseModel
from vntoolkit.photometry.fit_quality import cone_of_normals_deg
from vntoolkit.photometry.response import rgb_from_normals

logger = logging.getLogger(__name__)
_FEWEST_POSES = 8
_FEWEST_VIEWS = 5
_FEWEST_CORNERS = 16
_MOST_VIEWS = 40  # for the camera: more views that differ less add time and no knowledge
_LARGEST_FIT_ERROR_PX = 1.0  # root mean square: corners are found to some tenths of a pixel
_LARGEST_FOCAL_DEVIATION = 0.05  # relative standard deviation
_DARK_SAMPLE = 0.05  # of the usual colour: no lamp is on
_CONTRADICTS = 0.25  # of a colour: how far it is from M n where lamps are missing
_MOST_OF = 0.8  # of the poses
_NARROWEST_CONE_DEG = 8.0  # half-angle of the views: with less, focal length and distance are one unknown


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardPose:
    """Pose of the board (millimetres) in one frame, and the error of its corners, root mean square."""

    number: int
    camera_from_board: RigidTransform
    error_px: float


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardCalibration:
    """fit: M and its quality. camera: given or fitted. poses: one per frame used in the fit, in its order.

    light_colours: (3, 3), unit colour of each lamp, where frames show every lamp alone, else None.
    """

    fit: ResponseFit
    camera: Camera
    poses: tuple[BoardPose, ...]
    light_colours: Matrix3 | None = None


def fit_response_to_board(
    sightings: Sequence[BoardSighting],
    layout: BoardLayout,
    size: tuple[int, int],
    camera: Camera | None = None,
    options: BoardOptions | None = None,
    rng: np.random.Generator | None = None,
) -> BoardCalibration:
    """Fit the camera (unless given) and M to what a `BoardDetector` saw.

    size: (width, height) of the frames in pixels. rng: for MSAC. Raises `BadCalibration` where the board
    was seen too rarely, the sample was dark or clipped, or M is not determined.
    """
    options = options or BoardOptions()
    if not sightings:
        raise BadCalibration(
            "calibrate board: the board is not seen in any frame; is it whole in the picture, sharp, and "
            "printed with the same number of squares?"
        )
    camera = camera or fit_camera(sightings, layout, size, options.radial_terms)
    seen = [s for s in sightings if s.rgb is not None]
    if not seen:
        raise BadCalibration(
            "calibrate board: the sample in the hole is clipped or outside the image in every frame; lower "
            "the exposure until no channel of it reaches full scale"
        )
    poses = [board_pose(s, layout, camera) for s in seen]
    kept = [(s, p) for s, p in zip(seen, poses, strict=True) if p and p.error_px <= _LARGEST_FIT_ERROR_PX]
    if len(kept) < _FEWEST_POSES:
        raise BadCalibration(
            f"calibrate board: {len(kept)} of {len(sightings)} frames that show the board give a pose to "
            f"{_LARGEST_FIT_ERROR_PX:g} px; at least {_FEWEST_POSES} are needed; does the camera belong "
            "to this footage, is the board flat?"
        )
    rgb = np.array([s.rgb for s, _ in kept])
    normals = np.array([p.camera_from_board.rotate(np.array(NORMAL_IN_BOARD)) for _, p in kept])
    lamps = _lamps_alone(normals, rgb, options)
    colours = None
    if lamps is not None:
        colours = np.array([line_colour(rgb[lamps == k]) for k in range(3)])
        kept = [pair for pair, lamp in zip(kept, lamps, strict=True) if lamp < 0]
        rgb, normals = rgb[lamps < 0], normals[lamps < 0]
    fit = fit_response(normals, rgb, options.fit, verb="board", rng=rng)
    if options.degree:
        fit = _varying(fit, rgb, normals, [p for _, p in kept], layout, size, camera, options)
    else:
        _log_misfit(rgb, normals, fit)
    return BoardCalibration(
        fit=fit,
        camera=camera,
        poses=tuple(p for _, p in kept),
        light_colours=colours,
    )


def _lamps_alone(normals: Points, rgb: Points, options: BoardOptions) -> IntArray | None:
    """(n,) the lamp that lights a pose alone, −1 where all do; None where no pose is lit so."""
    lengths = np.linalg.norm(rgb, axis=1)
    seen = lengths > _DARK_SAMPLE * float(np.median(lengths))
    found = three_lamps(rgb[seen] / lengths[seen, None])
    if found is None:
        return None
    lamps = np.full(len(rgb), -1)
    lamps[seen] = found
    others = lamps < 0
    if others.sum() < _FEWEST_POSES:
        return None
    design = Design.from_pairs(normals, rgb, with_ambient=options.fit.model is ResponseModel.AMBIENT)
    try:
        unknowns, _ = fit_by_trimming(design, others)
    except BadCalibration:
        return None
    contradicts = design.residuals(unknowns) > _CONTRADICTS * lengths
    return lamps if all(contradicts[lamps == k].mean() > _MOST_OF for k in range(3)) else None


def _varying(
    fit: ResponseFit,
    rgb: Points,
    normals: Points,
    poses: Sequence[BoardPose],
    layout: BoardLayout,
    size: tuple[int, int],
    camera: Camera,
    options: BoardOptions,
) -> ResponseFit:
    """Fit M as polynomials of the undistorted pixel at which each sample's centre was seen, by all poses."""
    middle_mm = np.append(layout.hole_mm.mean(axis=0), 0.0)
    middles = np.array([pose.camera_from_board.apply(middle_mm) for pose in poses])
    shares = normals @ fit.response.matrix.T
    lit = (shares > SHADOW_SHARE * shares.max(axis=0)).all(axis=1)
    positions_px = camera.without_distortion().project(middles[lit])
    response = fit_varying_response(
        normals[lit],
        rgb[lit],
        positions_px,
        size,
        options.degree,
        options.fit,
    )
    quality = fit_quality(normals[lit], rgb[lit], response, fit.quality.method, positions_px)
    return ResponseFit(response=response, quality=quality, inliers=lit, normals=normals, rgb=rgb)


def board_pose(sighting: BoardSighting, layout: BoardLayout, camera: Camera) -> BoardPose | None:
    """Pose of the board from its corners (n ≥ 6), or None where it does not exist."""
    if camera.model is CameraModel.ORTHOGRAPHIC:
        raise BadCalibration("calibrate board: needs a perspective camera, got an orthographic one")
    points = _in_plane(layout.corners_mm[sighting.corner_ids])
    found, rotation, translation = cv2.solvePnP(
        points, sighting.corners_px, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    if not found or not np.isfinite(rotation).all():
        return None
    rotation, translation = cv2.solvePnPRefineLM(
        points, sighting.corners_px, camera.matrix, camera.distortion, rotation, translation
    )
    pose = RigidTransform.from_rotation_vector(rotation.ravel(), translation.ravel())
    if pose.rotate(np.array(NORMAL_IN_BOARD))[2] >= 0:
        return None  # seen from behind: a mistaken pose
    error = camera.project(pose.apply(points)) - sighting.corners_px
    rms = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
    return BoardPose(number=sighting.number, camera_from_board=pose, error_px=rms)


def _log_misfit(rgb: Points, normals: Points, fit: ResponseFit) -> None:
    """Log a warning if many poses do not fit M: the sample is not matte, or the lights are too near."""
    left_out = 1.0 - float(fit.inliers.mean())
    error = np.linalg.norm(rgb - rgb_from_normals(normals, fit.response), axis=1)
    relative = float(np.median(error[fit.inliers]) / np.median(np.linalg.norm(rgb[fit.inliers], axis=1)))
    if left_out > 0.4 or relative > 0.1:
        logger.warning(
            "%.0f %% of the poses were left out and the others miss their colour by %.0f %%: is the sample "
            "matte and in the plane of the board, are the lights far away?",
            100 * left_out,
            100 * relative,
        )


# Camera intrinsics by Zhang's method (OpenCV), from the views that differ most.


def fit_camera(
    sightings: Sequence[BoardSighting],
    layout: BoardLayout,
    size: tuple[int, int],
    radial_terms: int = 1,
) -> Camera:
    """Fit K and distortion to the corners of many views. size: (width, height).

    Zhang, A flexible new technique for camera calibration, 2000 (zhang2000). Raises `BadCalibration` where
    the views are too few or too much alike.
    """
    usable = [s for s in sightings if _spans_plane(layout.corners_mm[s.corner_ids])]
    if len(usable) < _FEWEST_VIEWS:
        raise BadCalibration(
            f"calibrate board: {len(usable)} frames show the board well enough for the camera's intrinsics, "
            f"at least {_FEWEST_VIEWS} are needed; film longer, or give the camera with --camera"
        )
    views = [usable[i] for i in _most_different(_descriptors(usable, layout), _MOST_VIEWS)]
    points = [_in_plane(layout.corners_mm[s.corner_ids]).astype(np.float32) for s in views]
    images = [s.corners_px.astype(np.float32) for s in views]
    calibrate: Any = cv2.calibrateCameraExtended  # its stubs forbid the None that its manual asks for
    with one_opencv_thread():  # several sum in any order: the last digits would change from run to run
        error, matrix, distortion, rotations, _, deviations, _, _ = calibrate(
            points,
            images,
            size,
            None,
            None,
            flags=_flags(radial_terms),
        )
    focal_deviation = float(deviations[:2].max()) / float(matrix[0, 0])
    tilts = np.array([cv2.Rodrigues(r)[0][:, 2] for r in rotations])
    cone = cone_of_normals_deg(tilts)
    fits = np.isfinite(error) and error <= _LARGEST_FIT_ERROR_PX
    if not (fits and focal_deviation < _LARGEST_FOCAL_DEVIATION and cone > _NARROWEST_CONE_DEG):
        raise BadCalibration(
            f"calibrate board: the camera fit misses the corners by {error:.2f} px with a focal length "
            f"uncertain by {100 * focal_deviation:.0f} %, from views within {cone:.0f} degrees; tilt the "
            "board by 30 degrees and more in all directions, or give the camera with --camera"
        )
    k1, k2, p1, p2 = np.ravel(distortion)[:4]
    model = CameraModel.OPENCV if radial_terms else CameraModel.PINHOLE
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


def _flags(radial_terms: int) -> int:
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    if radial_terms < 2:
        flags |= cv2.CALIB_FIX_K2
    if radial_terms < 1:
        flags |= cv2.CALIB_FIX_K1
    return int(flags)


def _in_plane(corners_mm: FloatArray) -> FloatArray:
    """Return (n, 3), at z = 0."""
    return np.pad(corners_mm, ((0, 0), (0, 1)))


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
