"""Two recordings on one clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from recipes.walk_motion import walking_motion
from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.options.dressing import ClockOptions, Loop
from vntoolkit.skinning.clock import clock_from_recordings, resampled_motion, resampled_vertices


def cloth(frames: int, rate: float = 60.0) -> MeshSequence:
    """A triangle whose x is its time in seconds."""
    template = Mesh(vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 2]]))
    vertices = np.zeros((frames, 3, 3))
    vertices[..., 0] = np.arange(frames)[:, None] / rate
    return MeshSequence(template=template, vertices=vertices, frame_rate_hz=rate)


def test_capture_at_60_meets_motion_at_120() -> None:
    motion = walking_motion(strides=1, frame_rate_hz=120)
    clock = clock_from_recordings(cloth(31), motion, ClockOptions())
    assert clock.frame_rate_hz == 60
    assert len(clock) == 31
    resampled = resampled_motion(motion, clock.motion_s, clock.frame_rate_hz)
    np.testing.assert_array_equal(resampled.root_positions, motion.root_positions[:61:2])
    np.testing.assert_allclose(np.abs((resampled.rotations * motion.rotations[:61:2]).sum(-1)), 1, atol=1e-15)


def test_between_frames_rotations_follow_the_great_arc() -> None:
    motion = walking_motion(strides=1, frame_rate_hz=30)
    flipped = replace(
        motion, rotations=motion.rotations * np.where(np.arange(len(motion)) % 2, -1, 1)[:, None, None]
    )
    times = np.linspace(0, motion.duration_s, 173)
    resampled = resampled_motion(flipped, times, 100.0)
    for joint in range(len(motion.skeleton.names)):
        reference = Slerp(np.arange(len(motion)) / 30, Rotation.from_quat(motion.rotations[:, joint]))(times)
        error = (reference.inv() * Rotation.from_quat(resampled.rotations[:, joint])).magnitude()
        assert error.max() < 1e-7


def test_vertices_between_frames_are_linear_in_time() -> None:
    times = np.linspace(0, 29 / 60, 100)
    x = [vertices[0, 0] for vertices in resampled_vertices(cloth(30), times)]
    np.testing.assert_allclose(x, times, atol=1e-12)


def test_cloth_of_uneven_times_is_worn_at_the_times_it_was_filmed() -> None:
    filmed = np.array([0.0, 0.033, 0.233, 0.3])
    vertices = np.repeat(filmed[:, None, None], 3, axis=1) * [1.0, 0.0, 0.0]
    template = Mesh(vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 2]]))
    uneven = MeshSequence(template=template, vertices=vertices, frame_rate_hz=30.0, times_s=filmed + 7)
    clock = clock_from_recordings(uneven, walking_motion(), ClockOptions())
    assert len(clock) == 10
    x = [vertices[0, 0] for vertices in resampled_vertices(uneven, clock.cloth_s)]
    np.testing.assert_allclose(x, np.arange(10) / 30, atol=1e-9)


def test_trim_and_speed() -> None:
    motion = walking_motion()
    clock = clock_from_recordings(
        cloth(600), motion, ClockOptions(start=1.0, stop=3.0, speed=2.0, frame_rate_hz=50)
    )
    assert len(clock) == 51  # 2 s of motion at double speed are 1 s
    np.testing.assert_allclose(clock.motion_s, 1.0 + 2.0 * np.arange(51) / 50)


def test_loops() -> None:
    motion = walking_motion()  # 4.8 s
    ends = clock_from_recordings(cloth(61), motion, ClockOptions(loop=Loop.NONE))
    assert len(ends) == 61
    again = clock_from_recordings(cloth(61), motion, ClockOptions(loop=Loop.REPEAT))
    assert len(again) == 289
    np.testing.assert_allclose(again.cloth_s[[0, 60, 61, 122]], [0, 1, 0, 0], atol=1e-9)
    back = clock_from_recordings(cloth(61), motion, ClockOptions(loop=Loop.PING_PONG))
    np.testing.assert_allclose(back.cloth_s[[0, 60, 90, 120]], [0, 1, 0.5, 0], atol=1e-9)
    assert np.abs(np.diff(back.cloth_s)).max() < 1.0001 / 60  # nothing jumps


def test_refusals() -> None:
    motion = walking_motion()
    with pytest.raises(BadInput, match="nothing lies between start 9 s"):
        clock_from_recordings(cloth(10), motion, ClockOptions(start=9.0))


@pytest.mark.parametrize(("rate", "frames"), [(24.0, 8), (29.97, 10), (60.0, 17)])
def test_a_repeated_cloth_shows_every_frame_once_a_round(rate: float, frames: int) -> None:
    """Whole rounds in seconds do not come out even in floating point."""
    motion = walking_motion(strides=4, frame_rate_hz=rate)
    options = ClockOptions(loop=Loop.REPEAT)
    clock = clock_from_recordings(cloth(frames, rate), motion, options)
    expected = np.arange(len(clock)) % frames
    np.testing.assert_allclose(clock.cloth_s * rate, expected, atol=1e-6)
