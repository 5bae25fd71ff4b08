"""Initial poses and points from tracks: factorisation under scaled orthography (tomasi1992).

The tracks that cross a window of frames give a matrix of rank three. Frames and points around it are added
by alternating weighted least squares. The affine solution becomes metric where both image axes of every frame
are at right angles and of one length.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import BoolArray, FloatArray, IntArray, Points
from vntoolkit.calibration.head.tracks import Tracks
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rigid import RigidTransform

_SEED_TRACKS = 80  # complete tracks that a window of frames needs
_WIDEST_SEED = 21  # frames
_LEAST_SHARED = 12  # points that a frame must share with the model to be added
_RESIDUAL_PX = 1.5  # scale of the Cauchy weights: perspective and drift stay below a few
_SWEEPS = 30
_FLATTEST = 1e-4  # smallest over largest eigenvalue that still determines a point, or the metric
InitialPoses = tuple[list[RigidTransform | None], Points, BoolArray]


def factorised_poses(tracks: Tracks, camera: Camera) -> InitialPoses:
    """Return camera_from_head per frame (None where not placed), points (n, 3) and which are known (n,)."""
    affine = fit_affine_model(tracks)
    both = [metric_poses(affine, camera, mirrored=mirrored) for mirrored in (False, True)]
    poses, points = max(both, key=lambda each: _seen_in_front(tracks, affine.known, *each))
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


def fit_affine_model(tracks: Tracks) -> AffineModel:
    """Factorise a window of frames in the middle; add frames to both sides and even out the whole."""
    window = _seed_window(tracks)
    points, known = _factorised_points(tracks, *window)
    first, last = window
    sweeps = 0
    while sweeps < _SWEEPS:
        near = (tracks.frame >= first) & (tracks.frame <= last)
        rows, offsets, placed = _fit_frames(tracks, points, known, near)
        points, known = _fit_points(tracks, rows, offsets, placed, points, known)
        if first > 0 or last < tracks.frame_count - 1:
            first, last = max(first - 1, 0), min(last + 1, tracks.frame_count - 1)
        else:
            sweeps += 1
    return AffineModel(rows=rows, offsets=offsets, points=points, placed=placed, known=known)


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


def _factorised_points(tracks: Tracks, first: int, last: int) -> tuple[Points, BoolArray]:
    """Factorise the tracks that cross the window: rank three after the frames' means are removed."""
    inside = (tracks.frame >= first) & (tracks.frame <= last)
    count = np.bincount(tracks.point[inside], minlength=tracks.point_count)
    complete = np.flatnonzero(count == last - first + 1)
    chosen = inside & np.isin(tracks.point, complete)
    by_point = tracks.positions_px[chosen].reshape(len(complete), last - first + 1, 2)
    measured = by_point.transpose(1, 2, 0).reshape(-1, len(complete))
    kept = np.ones(len(complete), np.bool_)
    for _ in range(5):
        offsets = measured[:, kept].mean(axis=1, keepdims=True)
        left, singular, _ = np.linalg.svd(measured[:, kept] - offsets, full_matrices=False)
        motion = left[:, :3] * np.sqrt(singular[:3])
        shape = np.linalg.lstsq(motion, measured - offsets, rcond=None)[0]
        worst = np.abs(measured - offsets - motion @ shape).max(axis=0)
        kept = worst <= 3.0 * np.median(worst)
    _require_depth(bool(singular[2] > _FLATTEST * singular[0]))
    points, known = np.zeros((tracks.point_count, 3)), np.zeros(tracks.point_count, np.bool_)
    points[complete], known[complete] = shape.T, kept
    return points, known


def _fit_frames(
    tracks: Tracks, points: Points, known: BoolArray, near: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Fit the affine cameras of frames that show enough known points, robustly, to some observations (m,)."""
    used = np.flatnonzero(known[tracks.point] & near)
    frame, seen = tracks.frame[used], tracks.positions_px[used]
    placed = np.bincount(frame, minlength=tracks.frame_count) >= _LEAST_SHARED
    design = np.column_stack([points[tracks.point[used]], np.ones(len(used))])
    weight = np.ones(len(used))
    solution = np.zeros((tracks.frame_count, 4, 2))
    for _ in range(5):
        normal = _sum_by(frame, np.einsum("m,mi,mj->mij", weight, design, design), tracks.frame_count)
        right = _sum_by(frame, np.einsum("m,mi,ma->mia", weight, design, seen), tracks.frame_count)
        solution[placed] = np.linalg.solve(normal[placed], right[placed])
        error = np.linalg.norm(np.einsum("mi,mia->ma", design, solution[frame]) - seen, axis=1)
        weight = 1.0 / (1.0 + np.square(error / _RESIDUAL_PX))
    return solution[:, :3].transpose(0, 2, 1), solution[:, 3], placed


def _fit_points(
    tracks: Tracks, rows: FloatArray, offsets: FloatArray, placed: BoolArray, points: Points, known: BoolArray
) -> tuple[Points, BoolArray]:
    """Fit every point seen by at least three placed frames; errors from where it was weigh observations."""
    used = placed[tracks.frame]
    point, frame, seen = tracks.point[used], tracks.frame[used], tracks.positions_px[used]
    own = rows[frame]
    error = np.linalg.norm(np.einsum("mai,mi->ma", own, points[point]) + offsets[frame] - seen, axis=1)
    weight = np.where(known[point], 1.0 / (1.0 + np.square(error / _RESIDUAL_PX)), 1.0)
    normal = _sum_by(point, np.einsum("m,mai,maj->mij", weight, own, own), tracks.point_count)
    right = _sum_by(point, np.einsum("m,mai,ma->mi", weight, own, seen - offsets[frame]), tracks.point_count)
    values = np.linalg.eigvalsh(normal)
    sound = np.bincount(point, minlength=tracks.point_count) >= 3
    sound &= values[:, 0] > _FLATTEST * values[:, 2]
    moved = points.copy()
    moved[sound] = np.linalg.solve(normal[sound], right[sound][..., None])[..., 0]
    return moved, known | sound


def _sum_by(index: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Sum values (m, …) that share an index (m,) into (count, …)."""
    columns = values.reshape(len(values), -1).T
    total: FloatArray = np.stack([np.bincount(index, column, count) for column in columns], axis=1)
    return total.reshape(count, *values.shape[1:])


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
    _require_depth(bool(values[0] > _FLATTEST * values[2]))
    return np.asarray(vectors * np.sqrt(values))


def _require_depth(determined: bool) -> None:
    if not determined:
        raise BadCalibration(
            "poses: the tracks do not tell how far the head turns; turn it further, 60 degrees to both "
            "sides, with a fixed expression"
        )


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
