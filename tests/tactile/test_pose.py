"""The pose of what touches a gel: drums with letters, a thread or nothing on them, rolled and turned."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import ndimage

from tests.drawn_objects import Radius, cylinder, letters, normals_of, pose_of, pressed, screw
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.tactile.pose import ObjectPose, TrackedPose

PIXEL_MM, SHAPE = 0.1, (120, 160)
CAMERA = Camera.orthographic(width=160, height=120, pixels_per_unit=1000 / PIXEL_MM)
THERE_AND_BACK = np.concatenate([np.arange(0, 91, 3), np.arange(87, -1, -3)]) - 45.0


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """What `ObjectPose` needs of a touch."""

    normals: np.ndarray
    depth_mm: np.ndarray
    contact: np.ndarray
    error_mm: np.ndarray


def touch_of(rng: np.random.Generator, depth_mm: np.ndarray) -> Drawn:
    """Normals with 2 degrees of noise, depth with 0.02 mm that bend slowly."""
    noise = ndimage.gaussian_filter(rng.normal(size=(*SHAPE, 3)), (0.8, 0.8, 0))
    normals = normals_of(depth_mm, PIXEL_MM) + np.radians(2.0) * noise / noise.std()
    low = ndimage.gaussian_filter(rng.normal(size=SHAPE), 20)
    return Drawn(
        normals=(normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32),
        depth_mm=depth_mm + 0.02 * low / low.std(),
        contact=depth_mm < depth_mm.min() / 3,
        error_mm=np.full(SHAPE, 0.04),
    )


def tracked(radius: Radius, poses: list[RigidTransform]) -> list[TrackedPose]:
    tracker, rng = ObjectPose(CAMERA), np.random.default_rng(8)
    return [tracker(touch_of(rng, pressed(radius, pose, SHAPE, PIXEL_MM))) for pose in poses]


def errors_of(told: list[TrackedPose], poses: list[RigidTransform]) -> tuple[np.ndarray, np.ndarray]:
    """Degrees and mm (of the material now in the picture's middle) that each pose is off."""
    turns, shifts = [], []
    for pose, own in zip(poses, told, strict=True):
        true = pose @ poses[0].inverse()
        middle = true.inverse().apply(np.zeros(3))
        off = own.now_from_first.inverse() @ true
        turns.append(np.degrees(np.linalg.norm(off.rotation_vector)))
        shifts.append(np.linalg.norm(own.now_from_first.apply(middle)))
    return np.array(turns), np.array(shifts)


@pytest.mark.slow
def test_a_drum_with_letters_rolls_by_90_degrees_and_back() -> None:
    poses = [pose_of(10, roll) for roll in THERE_AND_BACK]
    told = tracked(letters, poses)
    turns, shifts = errors_of(told, poses)
    assert not any(pose.lost for pose in told)
    assert max(len(pose.unobservable) for pose in told) == 0
    assert turns.max() < 2.5
    assert shifts.max() < 0.3
    assert turns[-1] < 0.5  # its way back meets its own keyframes
    assert len({pose.keyframe for pose in told}) > 2
    assert 0 < told[len(told) // 2].error_deg < 2.5
    assert 0 < told[1].error_mm < 0.1


@pytest.mark.parametrize(("radius", "unseen"), [(cylinder, 2), (screw, 1)])
def test_what_an_axis_cannot_tell_is_reported_and_the_axis_is_right(radius: Radius, unseen: int) -> None:
    poses = [pose_of(turn, 0) for turn in THERE_AND_BACK[::2]]
    told = tracked(radius, poses)
    assert {len(pose.unobservable) for pose in told[1:]} == {unseen}
    axis, middle = poses[0].rotation[:, 0], poses[0].translation
    for pose, own in zip(poses, told, strict=True):
        along = own.now_from_first.rotate(axis)
        assert np.degrees(np.arccos(min(1.0, along @ pose.rotation[:, 0]))) < 2.5
        off = own.now_from_first.apply(middle) - pose.translation
        assert np.linalg.norm(off - along * (off @ along)) < 0.3


def test_a_ball_does_not_tell_how_it_turns() -> None:
    v, u = np.indices(SHAPE)
    told, rng, tracker = [], np.random.default_rng(1), ObjectPose(CAMERA)
    for k in range(4):
        away = np.hypot((u - 70 - 3 * k) * PIXEL_MM, (v - 60) * PIXEL_MM)
        depth = np.minimum(3.2 - np.sqrt(np.maximum(16.0 - away**2, 0.0)), 0.0)
        told.append(tracker(touch_of(rng, depth)))
    assert {len(pose.unobservable) for pose in told[1:]} == {3}
    centre = np.array([(70 - 79.5) * PIXEL_MM, (60 - 59.5) * PIXEL_MM, 3.2])
    np.testing.assert_allclose(told[-1].now_from_first.apply(centre) - centre, (0.9, 0, 0), atol=0.1)


def test_an_object_that_jumps_by_more_than_half_its_contact_is_lost() -> None:
    v, u = np.indices(SHAPE)
    rng, tracker, told = np.random.default_rng(1), ObjectPose(CAMERA), []
    for middle in (50, 50, 66, 66, 110, 110):
        away = np.hypot((u - middle) * PIXEL_MM, (v - 60) * PIXEL_MM)
        depth = np.minimum(3.5 - np.sqrt(np.maximum(16.0 - away**2, 0.0)), 0.0)
        told.append(tracker(touch_of(rng, depth)))
    assert told[4].lost
    assert [pose.contact for pose in told[:2]] == [1, 1]
    assert told[5].contact == told[4].contact > told[1].contact
    assert not told[5].lost


def test_a_contact_that_is_too_small_is_lost_and_the_next_is_another() -> None:
    rng, tracker = np.random.default_rng(1), ObjectPose(CAMERA)
    touched = touch_of(rng, pressed(letters, pose_of(), SHAPE, PIXEL_MM))
    nothing = Drawn(
        normals=np.broadcast_to(np.float32([0, 0, -1]), (*SHAPE, 3)),
        depth_mm=np.zeros(SHAPE),
        contact=np.zeros(SHAPE, bool),
        error_mm=np.zeros(SHAPE),
    )
    told = [tracker(each) for each in (nothing, touched, touched, nothing, touched)]
    assert [pose.lost for pose in told] == [True, False, False, True, False]
    assert [pose.contact for pose in told] == [0, 1, 1, 1, 2]
    assert np.isinf(told[0].error_deg)
    np.testing.assert_allclose(told[2].now_from_first.matrix, np.eye(4), atol=1e-3)
