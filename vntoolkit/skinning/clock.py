"""A common clock for the capture and the motion, which have different frame rates."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, IntArray, Points
from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import MeshSequence
from vntoolkit.geometry.motion import Motion
from vntoolkit.options.dressing import ClockOptions, Loop

_ON_A_FRAME = 1e-6  # frames: as near as this is on it, for seconds times a rate do not come out even


@dataclass(frozen=True, kw_only=True)
class Clock:
    """The instants of the result. motion_s, cloth_s: (frames,) seconds into either recording."""

    motion_s: FloatArray
    cloth_s: FloatArray
    frame_rate_hz: float

    def __len__(self) -> int:
        return len(self.motion_s)


def clock_from_recordings(cloth: MeshSequence, motion: Motion, options: ClockOptions) -> Clock:
    """Return the instants of the result's frames; raises `BadInput` if the recordings do not overlap."""
    stop = motion.duration_s if options.stop is None else min(options.stop, motion.duration_s)
    if stop < options.start:
        raise BadInput(
            f"the motion lasts {motion.duration_s:.3g} s: nothing lies between start {options.start:g} s "
            f"and stop {stop:.3g} s"
        )
    rate = options.frame_rate_hz or cloth.frame_rate_hz
    cloth_length = float(cloth.instants_s[-1])
    duration = (stop - options.start) / options.speed
    if options.loop is Loop.NONE:
        duration = min(duration, cloth_length)
    t = np.arange(int(np.floor(duration * rate + 1e-9)) + 1) / rate
    return Clock(
        motion_s=np.minimum(options.start + t * options.speed, motion.duration_s),
        cloth_s=_looped(t, cloth_length, cloth.frame_rate_hz, options.loop),
        frame_rate_hz=rate,
    )


def _looped(t: FloatArray, length: float, rate: float, loop: Loop) -> FloatArray:
    if loop is Loop.NONE or length == 0:
        return np.minimum(t, length)
    if loop is Loop.REPEAT:
        round_s = length + 1 / rate  # the last frame lasts one frame, then the first follows
        phase = np.mod(t, round_s)
        phase = np.where(phase > round_s - _ON_A_FRAME / rate, 0.0, phase)
        return np.minimum(phase, length)
    return length - np.abs(np.mod(t, 2 * length) - length)


def resampled_motion(motion: Motion, times_s: FloatArray, frame_rate_hz: float) -> Motion:
    """Return the motion at the instants `times_s` (frames,): slerp between frames, positions linear."""
    first, second, share = _neighbours(times_s * motion.frame_rate_hz, len(motion))
    positions = motion.root_positions
    return replace(
        motion,
        rotations=_slerp(motion.rotations[first], motion.rotations[second], share[:, None, None]),
        root_positions=(1 - share[:, None]) * positions[first] + share[:, None] * positions[second],
        frame_rate_hz=frame_rate_hz,
    )


def resampled_vertices(cloth: MeshSequence, times_s: FloatArray) -> Iterator[Points]:
    """Yield the cloth's vertices (n, 3) at each instant, linear between frames, one frame in memory."""
    positions = np.interp(times_s, cloth.instants_s, np.arange(len(cloth)))
    for a, b, s in zip(*_neighbours(positions, len(cloth)), strict=True):
        here = np.array(cloth.vertices[a], dtype=np.float64)
        yield here if s == 0 else (1 - s) * here + s * np.asarray(cloth.vertices[b], dtype=np.float64)


def _neighbours(position: FloatArray, count: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the frames before and after each position, and the share of the second, 0 on a frame."""
    nearest = np.round(position)
    position = np.where(np.abs(position - nearest) < _ON_A_FRAME, nearest, position)
    first = np.clip(np.floor(position).astype(np.int64), 0, count - 1)
    share = np.clip(position - first, 0, 1)
    return first, np.minimum(first + 1, count - 1), share


def _slerp(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    """Interpolate unit quaternions (…, 4) along the shorter arc."""
    first, way = Rotation.from_quat(a), Rotation.from_quat(a).inv() * Rotation.from_quat(b)
    return np.asarray((first * Rotation.from_rotvec(share * way.as_rotvec())).as_quat())
