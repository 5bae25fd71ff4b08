"""Calibration on a planar pattern with a hole that holds the sample (Section III-A, brostow2011).

Every frame gives one normal (the pattern's pose) and one colour (the sample in the hole); the camera's
intrinsics come from the same footage unless given.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from vntoolkit.arrays import Points
from vntoolkit.calibration.board_camera import IntrinsicsOptions, fit_camera
from vntoolkit.calibration.board_detection import BoardSighting
from vntoolkit.calibration.fit import FitOptions, ResponseFit, ResponseModel, fit_response
from vntoolkit.calibration.quality import fit_quality
from vntoolkit.calibration.varying import VariationOptions, fit_varying_response
from vntoolkit.checks import require_in_range, require_positive
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.board_layout import NORMAL_IN_BOARD, BoardLayout
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.photometry.lambertian import rgb_from_normals
from vntoolkit.photometry.variation import HIGHEST_DEGREE

logger = logging.getLogger(__name__)

_FEWEST_POSES = 8


@dataclass(frozen=True, kw_only=True)
class BoardOptions:
    """How a board calibrates.

    largest_error_px: a frame whose corners miss their projection by more than this root mean square is left
    out. degree: degree of the polynomials by which M varies over the image, as near lights make it, 0 (one M
    for the whole image) to 3; more than 0 needs a board that was carried through the whole field. intrinsics:
    how the camera is fitted where none is given. fit: how M is fitted.
    """

    largest_error_px: float = 1.0
    degree: int = 0
    intrinsics: IntrinsicsOptions = field(default_factory=IntrinsicsOptions)
    fit: FitOptions = field(default_factory=FitOptions)

    def __post_init__(self) -> None:
        require_positive(self.largest_error_px, "board: largest error in pixels")
        require_in_range(self.degree, 0, HIGHEST_DEGREE, "board: degree of the variation")


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardPose:
    """Pose of the board (millimetres) in one frame, and the error of its corners, root mean square."""

    number: int
    camera_from_board: RigidTransform
    error_px: float


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardCalibration:
    """fit: M and its quality. camera: given or fitted. poses: one per frame used in the fit, in its order."""

    fit: ResponseFit
    camera: Camera
    poses: tuple[BoardPose, ...]


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
    camera = camera or fit_camera(sightings, layout, size, options.intrinsics)
    seen = [s for s in sightings if s.rgb is not None]
    if not seen:
        raise BadCalibration(
            "calibrate board: the sample in the hole is clipped or outside the image in every frame; lower "
            "the exposure until no channel of it reaches full scale"
        )
    poses = [board_pose(s, layout, camera) for s in seen]
    kept = [(s, p) for s, p in zip(seen, poses, strict=True) if p and p.error_px <= options.largest_error_px]
    if len(kept) < _FEWEST_POSES:
        raise BadCalibration(
            f"calibrate board: {len(kept)} of {len(sightings)} frames that show the board give a pose to "
            f"{options.largest_error_px:g} px; at least {_FEWEST_POSES} are needed; does the camera belong "
            "to this footage, is the board flat?"
        )
    rgb = np.array([s.rgb for s, _ in kept])
    normals = np.array([p.camera_from_board.rotate(np.array(NORMAL_IN_BOARD)) for _, p in kept])
    fit = fit_response(normals, rgb, options.fit, verb="board", rng=rng)
    if options.degree:
        fit = _varying(fit, rgb, normals, [p for _, p in kept], layout, size, camera, options)
    else:
        _log_misfit(rgb, normals, fit)
    return BoardCalibration(fit=fit, camera=camera, poses=tuple(p for _, p in kept))


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
    """Let M vary with the pixel at which the sample's middle was seen, in the image without distortion.

    All poses that the three lights reach count, since one M for all places made outliers of good ones.
    """
    middle_mm = np.append(layout.hole_mm.mean(axis=0), 0.0)
    middles = np.array([pose.camera_from_board.apply(middle_mm) for pose in poses])
    shares = normals @ fit.response.matrix.T
    lit = (shares > options.fit.shadow_share * shares.max(axis=0)).all(axis=1)
    positions_px = camera.without_distortion().project(middles[lit])
    response = fit_varying_response(
        normals[lit],
        rgb[lit],
        positions_px,
        size,
        fit.response,
        VariationOptions(degree=options.degree),
        fit_ambient=options.fit.model is ResponseModel.AMBIENT,
    )
    quality = fit_quality(normals[lit], rgb[lit], response, fit.quality.method, positions_px)
    return ResponseFit(response=response, quality=quality, inliers=lit)


def board_pose(sighting: BoardSighting, layout: BoardLayout, camera: Camera) -> BoardPose | None:
    """Pose of the board from its corners (n ≥ 6), or None where it does not exist."""
    if camera.model is CameraModel.ORTHOGRAPHIC:
        raise BadCalibration("calibrate board: needs a perspective camera, got an orthographic one")
    points = np.zeros((len(sighting.corner_ids), 3))
    points[:, :2] = layout.corners_mm[sighting.corner_ids]
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
    """Say so where a good part of the poses does not obey M: sample not matte, lights too near."""
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
