"""A textured ball of points that turns before a camera, for the tests of tracks and poses."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.calibration.head.tracks import Tracks
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rigid import RigidTransform


def turning_ball(
    camera: Camera, distance: float, frames: int = 25, widest_deg: float = 60.0, points: int = 400
) -> tuple[np.ndarray, list[RigidTransform]]:
    """Return points (n, 3) on an uneven ball of radius about 0.1 and camera_from_ball per frame."""
    rng = np.random.default_rng(5)
    points_in_ball = rng.standard_normal((points, 3))
    points_in_ball /= np.linalg.norm(points_in_ball, axis=1, keepdims=True)
    points_in_ball *= 0.1 * (1.0 + 0.2 * np.sin(3.0 * points_in_ball[:, :1]))
    angles = np.deg2rad(np.linspace(-widest_deg, widest_deg, frames))
    poses = [
        RigidTransform(
            rotation=Rotation.from_rotvec([0.05 * np.sin(3 * a), a, 0.03]).as_matrix(),
            translation=np.array([0.02 * a, 0.01, distance]),
        )
        for a in angles
    ]
    return points_in_ball, poses


def tracks_of(
    points_in_ball: np.ndarray, poses: list[RigidTransform], camera: Camera, noise_px: float
) -> Tracks:
    """Project the points whose outside faces the camera, with noise."""
    rng = np.random.default_rng(6)
    rows = []
    for k, pose in enumerate(poses):
        outward = pose.rotate(points_in_ball)
        for n in np.flatnonzero(outward[:, 2] < -0.03):
            rows.append((n, k))
    point, frame = np.array(sorted(rows)).T
    where = np.stack([camera.project(pose.apply(points_in_ball)) for pose in poses])
    seen = where[frame, point] + noise_px * rng.standard_normal((len(point), 2))
    tracks = Tracks(point=point, frame=frame, positions_px=seen, frame_count=len(poses))
    return tracks.of_points(np.bincount(point, minlength=len(points_in_ball)) >= 4)
