"""Points of an egg found again in all frames, and its poses settled by them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.calibration.turning_egg import CAMERA, DISTANCE, egg_surface, render_egg, turning_poses
from vntoolkit.calibration.head.hull import SilhouetteView
from vntoolkit.calibration.head.patches import detail_in_8_bits, find_again
from vntoolkit.calibration.head.poses import HeadMotion, adjust_head_motion
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.geometry.rays import RayScene, pixel_rays
from vntoolkit.geometry.rigid import RigidTransform

FRAMES = 17
METRES = turning_poses(FRAMES, 60.0)
POSES = [RigidTransform(rotation=pose.rotation, translation=pose.translation / DISTANCE) for pose in METRES]
IMAGES = [render_egg(pose) for pose in METRES]


def egg():
    points, faces = egg_surface(6000)
    points = points / DISTANCE
    return Mesh(vertices=points, faces=faces, normals=vertex_normals(points, faces))


def views_of(poses):
    masks = [image.max(axis=2) > 0.02 for image in IMAGES]
    return [
        SilhouetteView(camera=CAMERA, camera_from_head=pose, mask=mask)
        for pose, mask in zip(poses, masks, strict=True)
    ]


def drifted(widest_deg):
    """The true poses, turned about the vertical by an error that comes and goes along the turn."""
    turns = np.deg2rad(widest_deg) * np.sin(np.linspace(-9, 9, FRAMES))
    return [
        RigidTransform(
            rotation=Rotation.from_rotvec([0.0, turn, 0.0]).as_matrix() @ pose.rotation,
            translation=pose.translation,
        )
        for turn, pose in zip(turns, POSES, strict=True)
    ]


def found_with(poses):
    mesh, details = egg(), [detail_in_8_bits(image) for image in IMAGES]
    return find_again(views_of(poses), details, mesh, mesh.vertices[::6])


def motion_of(poses, points, offered, turn_deg):
    return HeadMotion(
        camera=CAMERA,
        camera_from_head=tuple(poses),
        interpolated=np.zeros(FRAMES, np.bool_),
        reference=FRAMES // 2,
        points_in_head=points,
        point=offered,
        offered=offered,
        turn_deg=turn_deg,
        error_px=0.3,
        observations=9000,
    )


def test_points_are_found_again_where_they_are_however_far_the_head_has_turned():
    poses = drifted(0.5)
    tracks, points, _ = found_with(poses)
    apart, off, expected = [], [], []
    for best in range(FRAMES):
        # points whose patch is this frame's: they are where their pixel's ray meets the egg
        placed = CAMERA.project(poses[best].apply(points))
        own = np.flatnonzero(
            (tracks.frame == best) & (np.abs(tracks.positions_px - placed[tracks.point]).max(axis=1) < 1e-6)
        )
        rays = np.concatenate(pixel_rays(CAMERA, tracks.positions_px[own]), axis=1)
        hits = RayScene((POSES[best].apply(egg().vertices), egg().faces)).first_hits(rays)
        true = np.full((tracks.point_count, 3), np.nan)
        seen = rays[hits.rays, 3:] * hits.distances[:, None]
        true[tracks.point[own[hits.rays]]] = POSES[best].inverse().apply(seen)
        for k in range(FRAMES):
            there = np.flatnonzero((tracks.frame == k) & np.isfinite(true[tracks.point, 0]) & (k != best))
            position = tracks.positions_px[there]
            off.append(
                np.linalg.norm(CAMERA.project(POSES[k].apply(true[tracks.point[there]])) - position, axis=1)
            )
            guess = CAMERA.project(poses[k].apply(points[tracks.point[there]]))
            expected.append(np.linalg.norm(guess - position, axis=1))
            apart.append(np.full(len(there), 120.0 / (FRAMES - 1) * abs(k - best)))
    apart, off, expected = (np.concatenate(each) for each in (apart, off, expected))
    assert len(off) > 3000
    assert np.percentile(apart, 90) > 40.0
    assert np.median(off) < 0.15
    assert np.median(off) < 0.4 * np.median(expected)


def test_poses_that_drifted_come_right():
    poses = drifted(0.5)
    tracks, points, track = found_with(poses)
    offered = np.arange(6000)[::6]
    motion = motion_of(poses, egg().vertices[::6], offered, 121.0)
    settled, moved = adjust_head_motion(motion, tracks, points, track)

    def waves_deg(found):  # of an egg as small, how far all of it turns is known to half a percent only
        pairs = zip(POSES, found, strict=True)
        turns = Rotation.from_matrix([pose.rotation @ true.rotation.T for true, pose in pairs])
        errors = np.rad2deg(turns.as_rotvec()[:, 1])
        return np.abs(errors - np.polyval(np.polyfit(np.arange(FRAMES), errors, 1), np.arange(FRAMES)))

    assert waves_deg(poses).mean() > 0.25
    assert waves_deg(settled.camera_from_head).mean() < 0.08
    assert np.isin(settled.point, offered).all()
    assert moved.apply(points[:1]) == pytest.approx(points[:1] - points.mean(axis=0), abs=0.2)


def test_too_few_patches_leave_the_motion_as_it_is():
    tracks, points, track = found_with(POSES)
    few = np.arange(tracks.point_count) < 20
    motion = motion_of(POSES, egg().vertices, np.arange(6000), 120.0)
    settled, moved = adjust_head_motion(motion, tracks.of_points(few), points[few], track[few])
    assert settled is motion
    assert moved.apply(points) == pytest.approx(points)
