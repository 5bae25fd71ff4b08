"""The head's pose in every frame from tracks of its skin: a static camera and a turning head."""

import logging
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation, Slerp

from vntoolkit.arrays import BoolArray, FloatArray, Int64Array, IntArray, Points, read_only
from vntoolkit.calibration.head import colmap
from vntoolkit.calibration.head.tracks import Tracks
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.garment_fit import fit_similarity
from vntoolkit.geometry.rigid import RigidTransform, Similarity
from vntoolkit.options.head import LEAST_TRACKS, PoseOptions, PoseStart

logger = logging.getLogger(__name__)
_FULL_TURN_DEG = 90.0  # below it, M gets worse: on scanned heads 0.3 % at 130, 1.1 at 68, 1.4 to 3.7 at 43
_LEAST_PLACED = 0.7  # of the frames
_LARGEST_ERROR_PX = 0.9  # mean, after everything beyond 1 px was dropped: then what is left is chance
_LEAST_KEPT = 0.3  # of the tracks drawn: fewer means that no rigid motion explains them
_SEED_TRACKS = 80  # complete tracks that a window of frames needs
_WIDEST_SEED = 21  # frames
_LEAST_SHARED = 12  # points that a frame must share with the model to be added
_RESIDUAL_PX = 1.5  # scale of the Cauchy weights: perspective and drift stay below a few
_SWEEPS = 30
_ALL_PAIRS, _APART = 40, 20  # of so many frames all pairs count, of more those at most so far apart
_START_ANGLE_DEG, _START_INLIERS = 8.0, 40  # of the first pair
_ERROR_PX, _PLACING_ERROR_PX = 2.0, 4.0
Guess = tuple[list[RigidTransform | None], Points, BoolArray]
_LEAST_SHARED_TRACKS = 15  # tracks of a pair of frames
_LEAST_INLIERS = 8  # points that place a frame


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
    options: PoseOptions,
    rng: np.random.Generator,
    *,
    refine_focal: bool = False,
    start: PoseStart = PoseStart.FACTORISATION,
) -> HeadMotion:
    """Solve all poses: a first guess by `start`, robust bundle adjustment for the rest.

    refine_focal: the camera's focal length is a guess. Raises `BadCalibration` where head or footage do not
    carry poses.
    """
    if not camera.is_perspective:
        raise BadInput("poses: the turn is solved with a perspective camera; give --camera or --focal-px")
    drawn = np.zeros(tracks.point_count, np.bool_)
    drawn[rng.choice(tracks.point_count, min(options.pose_tracks, tracks.point_count), replace=False)] = True
    kept = tracks.of_points(drawn)
    if start is PoseStart.MAPPING:
        poses, points, known = map_tracks(kept, camera, refine_focal=refine_focal)
    else:
        poses, points, known = _factorised(kept, camera)
    model = colmap.adjust_sparse_model(kept, camera, poses, points, known, refine_focal=refine_focal)
    _require_rigid(model, kept)
    motion = _head_motion(model, np.flatnonzero(drawn))
    if motion.turn_deg < options.least_turn_deg:
        raise BadCalibration(
            f"poses: the head turns by only {motion.turn_deg:.0f} degrees in all, "
            f"{options.least_turn_deg:.0f} are needed; film it turning all the way to both "
            "sides (60 degrees each)"
        )
    if motion.turn_deg < _FULL_TURN_DEG:
        logger.warning(
            "the head turns by only %.0f degrees in all: M may be off by several percent (4 %% at 42, "
            "below 1 %% at 130); film it turning all the way to both sides (60 degrees each)",
            motion.turn_deg,
        )
    return motion


def settle_head_motion(
    motion: HeadMotion, tracks: Tracks, points: Points, track: IntArray, *, refine_focal: bool = False
) -> tuple[HeadMotion, Similarity]:
    """Adjust poses and points to tracks of other points, from where they are (bundle adjustment).

    points: (t, 3) on the head, first guess. track: (t,) their numbers in `motion`. refine_focal: the focal
    length is a guess. Returns the motion, and what takes the old head frame to its own; the old motion where
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
    enough = len(model.point) >= max(LEAST_TRACKS, _LEAST_KEPT * len(motion.point))
    if not enough or placed.mean() < np.mean(~motion.interpolated):
        return motion, Similarity(scale=1.0, rigid=RigidTransform())
    settled = _head_motion(model, motion.point[track])
    moved = fit_similarity(points[model.point], settled.points_in_head)
    return replace(settled, offered=motion.offered), moved


def _factorised(tracks: Tracks, camera: Camera) -> Guess:
    affine = fit_affine_model(tracks)
    guesses = [metric_poses(affine, camera, mirrored=mirrored) for mirrored in (False, True)]
    poses, points = max(guesses, key=lambda guess: _seen_in_front(tracks, affine.known, *guess))
    return poses, points, affine.known


def _seen_in_front(
    tracks: Tracks, known: BoolArray, poses: Sequence[RigidTransform | None], points: Points
) -> float:
    """Return how much nearer the visible points are than all points; negative for the mirrored solution."""
    nearer = 0.0
    for k, pose in enumerate(poses):
        seen = tracks.point[tracks.frame == k]
        seen = seen[known[seen]]
        if pose is not None and len(seen):
            z = pose.apply(points)[:, 2]
            nearer += float(np.median(z[known]) - np.median(z[seen]))
    return nearer


def _require_rigid(model: colmap.SparseModel, tracks: Tracks) -> None:
    placed = np.array([pose is not None for pose in model.camera_from_head])
    if len(model.point) < max(LEAST_TRACKS, _LEAST_KEPT * tracks.point_count):
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


@dataclass(frozen=True, kw_only=True, eq=False)
class AffineModel:
    """x_px = rows[k] @ X + offsets[k], up to one affine change of X.

    rows: (f, 2, 3). offsets: (f, 2). points: (n, 3) for every track. placed: (f,) and known: (n,), what is
    determined.
    """

    rows: FloatArray
    offsets: FloatArray
    points: Points
    placed: BoolArray
    known: BoolArray


# Initialisation of shape and motion: factorisation under scaled orthography, or COLMAP's mapping.


def fit_affine_model(tracks: Tracks) -> AffineModel:
    """Factorise a window of frames in the middle, then add frames to both sides and even out the whole."""
    first, last = _seed_window(tracks)
    fit = _AffineFit(tracks)
    fit.start(first, last)
    order = [k for d in range(1, tracks.frame_count) for k in (first - d, last + d)]
    for step, k in enumerate(k for k in order if 0 <= k < tracks.frame_count):
        if fit.add_frame(k) and step % 2:
            fit.solve_points()
            fit.solve_cameras()
    for _ in range(_SWEEPS):
        fit.reweight()
        fit.solve_points()
        fit.solve_cameras()
    return fit.model()


def metric_poses(
    model: AffineModel, camera: Camera, *, mirrored: bool
) -> tuple[list[RigidTransform | None], Points]:
    """Return camera_from_head per frame and the points (n, 3), about one camera distance = 1.

    Scaled orthography cannot tell a shape from its mirror image in depth: `mirrored` chooses.
    """
    upgrade = _metric_upgrade(model)
    if mirrored:
        upgrade = upgrade @ np.diag([1.0, 1.0, -1.0])
    rows = model.rows @ upgrade
    points = model.points @ np.linalg.inv(upgrade).T
    scales = np.linalg.norm(rows, axis=2).mean(axis=1)
    unit = np.median(scales[model.placed]) / camera.matrix[0, 0]
    poses: list[RigidTransform | None] = []
    for k in range(len(rows)):
        if not model.placed[k]:
            poses.append(None)
            continue
        left, _, right = np.linalg.svd(rows[k] / scales[k], full_matrices=False)
        axes = left @ right
        rotation = np.stack([axes[0], axes[1], np.cross(axes[0], axes[1])])
        distance = camera.matrix[0, 0] / scales[k] * unit
        centre = camera.unproject(model.offsets[k], np.asarray(distance))
        poses.append(RigidTransform(rotation=rotation, translation=centre))
    return poses, points * unit


def _metric_upgrade(model: AffineModel) -> FloatArray:
    """Return A (3, 3) so that both rows of every frame, times A, are orthogonal and of one length."""
    rows = model.rows[model.placed]
    a, b = rows[:, 0], rows[:, 1]
    equations = np.concatenate([_products(a, a) - _products(b, b), _products(a, b)])
    size = np.concatenate([np.square(rows).sum(axis=(1, 2))] * 2)
    _, _, right = np.linalg.svd(equations / size[:, None])
    q = right[-1]
    metric = np.array([[q[0], q[1], q[2]], [q[1], q[3], q[4]], [q[2], q[4], q[5]]])
    values, vectors = np.linalg.eigh(metric * np.sign(np.trace(metric)))
    if not values[0] > 1e-4 * values[2]:
        raise BadCalibration(
            "poses: the tracks do not tell how far the head turns; turn it further, 60 degrees to both "
            "sides, with a fixed expression"
        )
    return np.asarray(vectors * np.sqrt(values))


def _products(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the coefficients (n, 6) of aᵀ Q b in the entries of a symmetric Q."""
    return np.stack(
        [
            a[:, 0] * b[:, 0],
            a[:, 0] * b[:, 1] + a[:, 1] * b[:, 0],
            a[:, 0] * b[:, 2] + a[:, 2] * b[:, 0],
            a[:, 1] * b[:, 1],
            a[:, 1] * b[:, 2] + a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 2],
        ],
        axis=1,
    )


def _seed_window(tracks: Tracks) -> tuple[int, int]:
    """Return the widest window (first, last) of frames that enough tracks cross without a gap."""
    seen = np.zeros((tracks.frame_count + 1, tracks.point_count), np.int32)
    seen[tracks.frame + 1, tracks.point] = 1
    up_to = seen.cumsum(axis=0)
    for width in range(min(_WIDEST_SEED, tracks.frame_count), 2, -1):
        firsts = np.arange(tracks.frame_count - width + 1)
        crossing = np.count_nonzero(up_to[width:] - up_to[: len(firsts)] == width, axis=1)
        enough = firsts[crossing >= _SEED_TRACKS]
        if len(enough):
            middle = (tracks.frame_count - width) / 2
            first = int(enough[np.argmin(np.abs(enough - middle))])
            return first, first + width - 1
    raise BadCalibration(
        f"poses: fewer than {_SEED_TRACKS} points can be followed over three frames; film more sharply, "
        "closer and slower"
    )


class _AffineFit:
    """Alternating weighted least squares for affine cameras and points."""

    def __init__(self, tracks: Tracks) -> None:
        self.tracks = tracks
        self.rows = np.zeros((tracks.frame_count, 2, 3))
        self.offsets = np.zeros((tracks.frame_count, 2))
        self.points = np.zeros((tracks.point_count, 3))
        self.placed = np.zeros(tracks.frame_count, np.bool_)
        self.known = np.zeros(tracks.point_count, np.bool_)
        self.weight = np.ones(len(tracks.point))

    def start(self, first: int, last: int) -> None:
        """Factorise the tracks that cross the window: rank three after the frames' means are removed."""
        t = self.tracks
        inside = (t.frame >= first) & (t.frame <= last)
        count = np.bincount(t.point[inside], minlength=t.point_count)
        complete = np.flatnonzero(count == last - first + 1)
        rows = inside & np.isin(t.point, complete)
        by_point = t.positions_px[rows].reshape(len(complete), last - first + 1, 2)
        measured = by_point.transpose(1, 2, 0).reshape(-1, len(complete))
        kept = np.ones(len(complete), np.bool_)
        for _ in range(5):
            offsets = measured[:, kept].mean(axis=1, keepdims=True)
            left, singular, _ = np.linalg.svd(measured[:, kept] - offsets, full_matrices=False)
            motion = left[:, :3] * np.sqrt(singular[:3])
            shape = np.linalg.lstsq(motion, measured - offsets, rcond=None)[0]
            worst = np.abs(measured - offsets - motion @ shape).max(axis=0)
            kept = worst <= 3.0 * np.median(worst)
        self.rows[first : last + 1] = motion.reshape(-1, 2, 3)
        self.offsets[first : last + 1] = offsets.reshape(-1, 2)
        self.placed[first : last + 1] = True
        self.points[complete], self.known[complete] = shape.T, kept
        self.reweight()
        self.solve_points()

    def add_frame(self, k: int) -> bool:
        """Place frame k by the points it shares with the model; False where they are too few."""
        own = np.flatnonzero((self.tracks.frame == k) & self.known[self.tracks.point])
        if len(own) < _LEAST_SHARED:
            return False
        design = np.column_stack([self.points[self.tracks.point[own]], np.ones(len(own))])
        seen = self.tracks.positions_px[own]
        weight = np.ones(len(own))
        for _ in range(10):
            solution = np.linalg.lstsq(design * weight[:, None], seen * weight[:, None], rcond=None)[0]
            error = np.linalg.norm(design @ solution - seen, axis=1)
            weight = 1.0 / np.sqrt(1.0 + np.square(error / _RESIDUAL_PX))
        self.rows[k], self.offsets[k], self.placed[k] = solution[:3].T, solution[3], True
        self.solve_points(only_new=True)
        return True

    def reweight(self) -> None:
        """Set Cauchy weights from the residuals; unknown observations count fully once they are known."""
        error = np.linalg.norm(self._predicted() - self.tracks.positions_px, axis=1)
        valid = self.placed[self.tracks.frame] & self.known[self.tracks.point]
        self.weight = np.where(valid, 1.0 / (1.0 + np.square(error / _RESIDUAL_PX)), 1.0)

    def solve_points(self, *, only_new: bool = False) -> None:
        """Solve every point seen by at least three placed frames from those frames."""
        t = self.tracks
        use = self.placed[t.frame]
        if only_new:
            use = use & ~self.known[t.point]
        point, w = t.point[use], self.weight[use]
        rows = self.rows[t.frame[use]]
        normal = np.einsum("m,mai,maj->mij", w, rows, rows)
        right = np.einsum("m,mai,ma->mi", w, rows, t.positions_px[use] - self.offsets[t.frame[use]])
        a, b = _sum_by(point, normal, t.point_count), _sum_by(point, right, t.point_count)
        enough = np.bincount(point, minlength=t.point_count) >= 3
        values = np.linalg.eigvalsh(a[enough])
        enough[enough] = values[:, 0] > 1e-4 * values[:, 2]
        self.points[enough] = np.linalg.solve(a[enough], b[enough][..., None])[..., 0]
        self.known |= enough

    def solve_cameras(self) -> None:
        """Solve every placed frame from the known points."""
        t = self.tracks
        use = self.known[t.point] & self.placed[t.frame]
        frame, w = t.frame[use], self.weight[use]
        design = np.column_stack([self.points[t.point[use]], np.ones(len(frame))])
        normal = _sum_by(frame, np.einsum("m,mi,mj->mij", w, design, design), t.frame_count)
        right = _sum_by(frame, np.einsum("m,mi,ma->mia", w, design, t.positions_px[use]), t.frame_count)
        solved = np.linalg.solve(normal[self.placed], right[self.placed])
        self.rows[self.placed] = solved[:, :3].transpose(0, 2, 1)
        self.offsets[self.placed] = solved[:, 3]

    def model(self) -> AffineModel:
        return AffineModel(
            rows=self.rows, offsets=self.offsets, points=self.points, placed=self.placed, known=self.known
        )

    def _predicted(self) -> FloatArray:
        t = self.tracks
        return np.einsum("mai,mi->ma", self.rows[t.frame], self.points[t.point]) + self.offsets[t.frame]


def _sum_by(index: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Sum values (m, …) that share an index (m,) into (count, …)."""
    flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
    total = np.empty((count, flat.shape[1]))
    for place, column in enumerate(flat.T):
        total[:, place] = np.bincount(index, column, minlength=count)
    return total.reshape(count, *values.shape[1:])


def map_tracks(tracks: Tracks, camera: Camera, *, refine_focal: bool) -> Guess:
    """Return camera_from_head per frame (None where not placed), points (n, 3) and which are known (n,).

    Raises `BadCalibration` where nothing rigid comes out.
    """
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value  # what fails is raised below
    rows = [np.flatnonzero(tracks.frame == k) for k in range(tracks.frame_count)]
    with tempfile.TemporaryDirectory(prefix="vntoolkit-") as folder:
        path = Path(folder) / "tracks.db"
        _write_database(path, tracks, rows, camera)
        models = pycolmap.incremental_mapping(path, folder, folder, _pipeline(refine_focal))
    if not models:
        raise BadCalibration(
            "poses: no two frames of the features fit a rigid turning head; film at most 20 degrees from "
            "frame to frame, sharply, with a fixed expression"
        )
    model = max(models.values(), key=lambda each: int(each.num_reg_images()))
    poses: list[RigidTransform | None] = [None] * tracks.frame_count
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        poses[int(image.name)] = RigidTransform.from_matrix(image.cam_from_world().matrix())
    points, known = np.zeros((tracks.point_count, 3)), np.zeros(tracks.point_count, np.bool_)
    for each in model.points3D.values():
        element = each.track.elements[0]
        own = rows[int(model.image(element.image_id).name)][element.point2D_idx]
        points[tracks.point[own]], known[tracks.point[own]] = each.xyz, True
    return poses, points, known


def _pipeline(refine_focal: bool) -> Any:
    import pycolmap

    pipeline = pycolmap.IncrementalPipelineOptions()
    pipeline.multiple_models = False
    pipeline.extract_colors = False
    pipeline.random_seed = 0
    pipeline.num_threads = 1  # the same footage gives the same poses
    pipeline.min_model_size = 3
    pipeline.min_num_matches = _LEAST_SHARED_TRACKS
    pipeline.ba_refine_focal_length = refine_focal
    pipeline.ba_refine_extra_params = False
    pipeline.mapper.init_min_num_inliers = _START_INLIERS
    pipeline.mapper.init_min_tri_angle = _START_ANGLE_DEG
    pipeline.mapper.init_max_error = _ERROR_PX
    pipeline.mapper.abs_pose_max_error = _PLACING_ERROR_PX
    pipeline.mapper.abs_pose_min_num_inliers = _LEAST_INLIERS
    pipeline.mapper.abs_pose_min_inlier_ratio = 0.1
    pipeline.mapper.abs_pose_refine_focal_length = False
    pipeline.mapper.abs_pose_refine_extra_params = False
    pipeline.mapper.filter_max_reproj_error = _ERROR_PX
    return pipeline


def _write_database(path: Path, tracks: Tracks, rows: list[Int64Array], camera: Camera) -> None:
    import pycolmap

    with pycolmap.Database.open(path) as database:
        camera_id = database.write_camera(colmap.camera_for_colmap(camera))
        sensor = pycolmap.sensor_t(type=pycolmap.SensorType.CAMERA, id=camera_id)
        rig = pycolmap.Rig()
        rig.add_ref_sensor(sensor)
        rig_id = database.write_rig(rig)
        images = []
        for k, own in enumerate(rows):
            images.append(database.write_image(pycolmap.Image(name=f"{k:06d}", camera_id=camera_id)))
            frame = pycolmap.Frame()
            frame.rig_id = rig_id
            frame.add_data_id(pycolmap.data_t(sensor_id=sensor, id=images[-1]))
            database.write_frame(frame)
            database.write_keypoints(
                images[-1], colmap.colmap_from_pixels(tracks.positions_px[own]).astype("f4")
            )
        for i, j in _pairs_of(tracks):
            _, a, b = np.intersect1d(tracks.point[rows[i]], tracks.point[rows[j]], return_indices=True)
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            geometry.inlier_matches = np.column_stack([a, b]).astype(np.uint32)
            database.write_two_view_geometry(images[i], images[j], geometry)


def _pairs_of(tracks: Tracks) -> list[tuple[int, int]]:
    """Return the pairs of frames that share enough tracks."""
    seen = sparse.csr_array(
        (np.ones(len(tracks.point), np.int32), (tracks.frame, tracks.point)),
        shape=(tracks.frame_count, tracks.point_count),
    )
    shared = (seen @ seen.T).toarray()
    furthest = tracks.frame_count if tracks.frame_count <= _ALL_PAIRS else _APART
    first, second = np.nonzero(np.triu(shared >= _LEAST_SHARED_TRACKS, 1))
    return [(int(i), int(j)) for i, j in zip(first, second, strict=True) if j - i <= furthest]
