"""The head's pose in every frame from tracks of its skin: a static camera and a turning head."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from vntoolkit.arrays import BoolArray, Int64Array, IntArray, Points, read_only
from vntoolkit.calibration.head import colmap
from vntoolkit.calibration.head.factorisation import factorised_poses
from vntoolkit.calibration.head.mapping import map_tracks
from vntoolkit.calibration.head.tracks import Tracks
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.garment_fit import fit_similarity
from vntoolkit.geometry.rigid import RigidTransform, Similarity
from vntoolkit.options.head import Features, HeadSteps

logger = logging.getLogger(__name__)
_FULL_TURN_DEG = 90.0  # below it, M gets worse: on scanned heads 0.3 % at 130, 1.1 at 68, 1.4 to 3.7 at 43
_LEAST_PLACED = 0.7  # of the frames
_LARGEST_ERROR_PX = 0.9  # mean, after everything beyond 1 px was dropped: then what is left is chance
_LEAST_TRACKS = 60
_LEAST_KEPT = 0.3  # of the tracks drawn: fewer means that no rigid motion explains them


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadMotion:
    """How the head moves; lengths in units of its distance from the camera in the reference frame.

    camera: the camera, focal length refined where it was not known. camera_from_head: per frame; the head
    frame has the camera's axes in the reference frame and its origin amid the points. interpolated: (f,)
    frames that the tracks did not place. reference: number of the frame amid the turn. points_in_head: (n, 3)
    sparse points of the skin. point: (n,) their tracks. offered: the tracks that the solution drew. turn_deg:
    largest turn between two frames. error_px: mean reprojection error over so many observations.
    """

    camera: Camera
    camera_from_head: tuple[RigidTransform, ...]
    interpolated: BoolArray
    reference: int
    points_in_head: Points
    point: Int64Array
    offered: Int64Array
    turn_deg: float
    error_px: float
    observations: int

    def __post_init__(self) -> None:
        for name in ("interpolated", "points_in_head", "point", "offered"):
            object.__setattr__(self, name, read_only(np.asarray(getattr(self, name))))


def solve_head_motion(
    tracks: Tracks,
    camera: Camera,
    steps: HeadSteps,
    rng: np.random.Generator,
    *,
    refine_focal: bool = False,
    features: Features = Features.TRACKS,
) -> HeadMotion:
    """Solve all poses: robust bundle adjustment from initial poses.

    Long tracks over close frames are factorised, features of frames far apart mapped frame by frame.
    refine_focal: the camera's focal length is refined, too. Raises `BadCalibration` where head or footage
    do not carry poses.
    """
    if not camera.is_perspective:
        raise BadInput("poses: the turn is solved with a perspective camera; give --camera or --focal-px")
    drawn = np.zeros(tracks.point_count, np.bool_)
    drawn[rng.choice(tracks.point_count, min(steps.pose_tracks, tracks.point_count), replace=False)] = True
    kept = tracks.of_points(drawn)
    if features is Features.SIFT:
        poses, points, known = map_tracks(kept, camera, refine_focal=refine_focal)
    else:
        poses, points, known = factorised_poses(kept, camera)
    model = colmap.adjust_sparse_model(kept, camera, poses, points, known, refine_focal=refine_focal)
    _require_rigid(model, kept)
    motion = _head_motion(model, np.flatnonzero(drawn))
    if motion.turn_deg < steps.least_turn_deg:
        raise BadCalibration(
            f"poses: the head turns by only {motion.turn_deg:.0f} degrees in all, "
            f"{steps.least_turn_deg:.0f} are needed; film it turning all the way to both "
            "sides (60 degrees each)"
        )
    if motion.turn_deg < _FULL_TURN_DEG:
        logger.warning(
            "the head turns by only %.0f degrees in all: M may be off by several percent (4 %% at 42, "
            "below 1 %% at 130); film it turning all the way to both sides (60 degrees each)",
            motion.turn_deg,
        )
    return motion


def adjust_head_motion(
    motion: HeadMotion, tracks: Tracks, points: Points, track: IntArray, *, refine_focal: bool = False
) -> tuple[HeadMotion, Similarity]:
    """Adjust poses and points to tracks of other points, from where they are (bundle adjustment).

    points: (t, 3) on the head, initial. track: (t,) their numbers in `motion`. refine_focal: the focal length
    is refined, too. Returns the motion, and what takes the old head frame to its own; the old motion where
    too little agrees.
    """
    model = colmap.adjust_sparse_model(
        tracks,
        motion.camera,
        motion.camera_from_head,
        points,
        np.ones(len(points), np.bool_),
        refine_focal=refine_focal,
    )
    placed = np.array([pose is not None for pose in model.camera_from_head])
    enough = len(model.point) >= max(_LEAST_TRACKS, _LEAST_KEPT * len(motion.point))
    if not enough or placed.mean() < np.mean(~motion.interpolated):
        return motion, Similarity(scale=1.0, rigid=RigidTransform())
    adjusted = _head_motion(model, motion.point[track])
    moved = fit_similarity(points[model.point], adjusted.points_in_head)
    return replace(adjusted, offered=motion.offered), moved


def _require_rigid(model: colmap.SparseModel, tracks: Tracks) -> None:
    placed = np.array([pose is not None for pose in model.camera_from_head])
    if len(model.point) < max(_LEAST_TRACKS, _LEAST_KEPT * tracks.point_count):
        raise BadCalibration(
            f"poses: only {len(model.point)} of {tracks.point_count} tracks move as one rigid head; keep the "
            "expression fixed, cover neck and shoulders in black, and film more sharply"
        )
    if placed.mean() < _LEAST_PLACED:
        gap = int(np.flatnonzero(~placed)[0])
        raise BadCalibration(
            f"poses: {np.count_nonzero(~placed)} of {len(placed)} frames cannot be placed, from "
            f"frame {gap} of those used on; film the turn in one shot, evenly, without a covered face"
        )
    if model.error_px > _LARGEST_ERROR_PX:
        raise BadCalibration(
            f"poses: the tracks disagree with a rigid head by {model.error_px:.2f} px on average; keep the "
            "expression fixed, and check the focal length"
        )


def _head_motion(model: colmap.SparseModel, offered: Int64Array) -> HeadMotion:
    """Interpolate what is missing and move the head frame to the reference frame's axes."""
    placed = [k for k, pose in enumerate(model.camera_from_head) if pose is not None]
    known = [pose for pose in model.camera_from_head if pose is not None]
    turns = Rotation.from_matrix([pose.rotation for pose in known])
    apart = np.rad2deg([(turns.inv() * turn).magnitude() for turn in turns])
    reference = int(np.argmin(apart.max(axis=1)))
    centre = np.median(model.points_in_head, axis=0)
    at = known[reference]
    unit = float(at.apply(centre)[2])
    head_from_model = RigidTransform(rotation=at.rotation, translation=-at.rotation @ centre)
    full = _interpolated(placed, known, len(model.camera_from_head))
    moved = [pose @ head_from_model.inverse() for pose in full]
    return HeadMotion(
        camera=model.camera,
        camera_from_head=tuple(
            RigidTransform(rotation=pose.rotation, translation=pose.translation / unit) for pose in moved
        ),
        interpolated=~np.isin(np.arange(len(full)), placed),
        reference=placed[reference],
        points_in_head=head_from_model.apply(model.points_in_head) / unit,
        point=offered[model.point],
        offered=offered,
        turn_deg=float(apart.max()),
        error_px=model.error_px,
        observations=model.observations,
    )


def _interpolated(placed: Sequence[int], poses: Sequence[RigidTransform], count: int) -> list[RigidTransform]:
    """Return a pose for every frame: turned evenly between the nearest placed ones, held at the ends."""
    at = np.clip(np.arange(count), placed[0], placed[-1])
    if len(placed) == 1:
        return [poses[0]] * count
    rotations = Slerp(placed, Rotation.from_matrix([pose.rotation for pose in poses]))(at).as_matrix()
    moves = np.stack([pose.translation for pose in poses])
    translations = np.stack([np.interp(at, placed, axis) for axis in moves.T], axis=1)
    return [RigidTransform(rotation=r, translation=t) for r, t in zip(rotations, translations, strict=True)]
