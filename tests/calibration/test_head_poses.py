import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.calibration.turning_points import tracks_of, turning_ball
from vntoolkit.calibration.head.colmap import camera_for_colmap, camera_from_colmap, colmap_from_pixels
from vntoolkit.calibration.head.factorisation import fit_affine_model, metric_poses
from vntoolkit.calibration.head.poses import solve_head_motion
from vntoolkit.calibration.head.tracks import Tracks
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.head import HeadSteps

FAR = Camera.pinhole(width=640, height=480, focal_px=8000.0)
NEAR = Camera.pinhole(width=640, height=480, focal_px=900.0)


def rotation_errors_deg(found, true):
    """Angles per frame after the one constant rotation between the two object frames."""
    relative = Rotation.from_matrix([t.rotation.T @ f.rotation for f, t in zip(found, true, strict=True)])
    constant = relative.mean()
    return np.rad2deg((constant.inv() * relative).magnitude())


@pytest.mark.parametrize(("camera", "distance"), [(FAR, 5.0), (NEAR, 0.6)], ids=["far", "near"])
def test_exact_tracks_give_exact_poses_and_points(camera, distance):
    points, poses = turning_ball(camera, distance)
    tracks = tracks_of(points, poses, camera, noise_px=0.0)
    motion = solve_head_motion(tracks, camera, HeadSteps(), np.random.default_rng(0))
    assert rotation_errors_deg(motion.camera_from_head, poses).max() < 0.01
    assert motion.error_px < 0.01
    assert not motion.interpolated.any()
    # the reference frame's axes are the camera's, and lengths are in units of the distance
    reference = motion.camera_from_head[motion.reference]
    np.testing.assert_allclose(reference.rotation, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(reference.translation[2], 1.0, atol=1e-9)
    # pixel centres at integers on the way in and out: the model projects onto the tracks
    place = {p: n for n, p in enumerate(motion.point.tolist())}
    rows = np.flatnonzero((tracks.frame == 3) & np.isin(tracks.point, motion.point))
    own = motion.points_in_head[[place[p] for p in tracks.point[rows].tolist()]]
    seen = motion.camera.project(motion.camera_from_head[3].apply(own))
    np.testing.assert_allclose(seen, tracks.positions_px[rows], atol=0.05)


def test_pixel_centres_move_by_half_a_pixel_to_colmap_and_back():
    points = np.array([[0.01, 0.02, 0.6], [-0.05, 0.03, 0.7]])
    colmaps = camera_for_colmap(NEAR).img_from_cam(points)
    np.testing.assert_allclose(colmaps, NEAR.project(points) + 0.5, atol=1e-9)
    np.testing.assert_allclose(colmap_from_pixels(NEAR.project(points)), colmaps, atol=1e-9)
    back = camera_from_colmap(camera_for_colmap(NEAR), NEAR)
    np.testing.assert_allclose(back.matrix, NEAR.matrix, atol=1e-9)


def test_noise_gives_as_much_error_as_it_must():
    points, poses = turning_ball(FAR, 5.0)
    tracks = tracks_of(points, poses, FAR, noise_px=0.3)
    motion = solve_head_motion(tracks, FAR, HeadSteps(), np.random.default_rng(0))
    errors = rotation_errors_deg(motion.camera_from_head, poses)
    # 0.3 px on a radius of 160 px is 0.1 degrees a point; some 150 points a frame average it
    assert 0.003 < errors.mean() < 0.1
    assert 0.25 < motion.error_px < 0.45  # the mean length of two-dimensional noise of 0.3 px is 0.376


def test_a_guessed_focal_length_leaves_pixels_square():
    """A turn about the vertical alone does not tell height from distance: one focal length has to."""
    points, poses = turning_ball(FAR, 5.0)
    upright = [
        RigidTransform(
            rotation=Rotation.from_euler("y", 5.0 * k - 60.0, degrees=True).as_matrix(),
            translation=pose.translation,
        )
        for k, pose in enumerate(poses)
    ]
    tracks = tracks_of(points, upright, FAR, noise_px=0.3)
    guess = Camera.pinhole(width=640, height=480, focal_px=0.9 * 8000.0)
    motion = solve_head_motion(tracks, guess, HeadSteps(), np.random.default_rng(0), refine_focal=True)
    assert motion.camera.matrix[0, 0] == motion.camera.matrix[1, 1]
    found = np.ptp(motion.points_in_head, axis=0)
    assert found[1] / found[0] == pytest.approx(
        np.ptp(points, axis=0)[1] / np.ptp(points, axis=0)[0], rel=0.1
    )


def test_wrong_tracks_are_rejected():
    points, poses = turning_ball(FAR, 5.0)
    tracks = tracks_of(points, poses, FAR, noise_px=0.1)
    rng = np.random.default_rng(1)
    wrong = rng.random(tracks.point_count) < 0.2
    drift = 1.5 * (tracks.frame - 12)[:, None] * wrong[tracks.point, None] * [1.0, 0.5]
    moved = Tracks(
        point=tracks.point,
        frame=tracks.frame,
        positions_px=tracks.positions_px + drift,
        frame_count=tracks.frame_count,
    )
    motion = solve_head_motion(moved, FAR, HeadSteps(), np.random.default_rng(0))
    assert rotation_errors_deg(motion.camera_from_head, poses).mean() < 0.1


def test_scaled_orthography_knows_the_turn_but_for_its_mirror_image():
    points, poses = turning_ball(FAR, 5.0)
    tracks = tracks_of(points, poses, FAR, noise_px=0.0)
    model = fit_affine_model(tracks)
    errors = [
        rotation_errors_deg(metric_poses(model, FAR, mirrored=mirrored)[0], poses).mean()
        for mirrored in (False, True)
    ]
    assert min(errors) < 5.0
    assert max(errors) > 30.0


def test_unplaced_frames_are_interpolated_and_marked():
    points, poses = turning_ball(FAR, 5.0)
    tracks = tracks_of(points, poses, FAR, noise_px=0.0)
    kept = tracks.frame != 10
    kept |= np.arange(len(kept)) % 50 == 0
    fewer = Tracks(
        point=tracks.point[kept],
        frame=tracks.frame[kept],
        positions_px=tracks.positions_px[kept],
        frame_count=tracks.frame_count,
    )
    motion = solve_head_motion(fewer, FAR, HeadSteps(), np.random.default_rng(0))
    assert motion.interpolated.nonzero()[0].tolist() == [10]
    assert rotation_errors_deg(motion.camera_from_head, poses)[10] < 0.3


def test_a_narrow_turn_is_warned_of(caplog):
    points, poses = turning_ball(FAR, 5.0, widest_deg=25.0)
    solve_head_motion(tracks_of(points, poses, FAR, noise_px=0.0), FAR, HeadSteps(), np.random.default_rng(0))
    assert "the head turns by only 50 degrees in all" in caplog.text
    assert "60 degrees each" in caplog.text


def test_refusals():
    points, poses = turning_ball(FAR, 5.0, widest_deg=12.0)
    tracks = tracks_of(points, poses, FAR, noise_px=0.05)
    with pytest.raises(BadCalibration, match=r"poses: the head turns by only 2\d degrees"):
        solve_head_motion(tracks, FAR, HeadSteps(), np.random.default_rng(0))
    camera = Camera.orthographic(width=640, height=480)
    with pytest.raises(BadInput, match="perspective"):
        solve_head_motion(tracks, camera, HeadSteps(), np.random.default_rng(0))
