"""What a face does at one moment, and the performances of the two head scenes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class Expression:
    """Strengths from 0 to 1, except where said.

    jaw: opening. smile, grimace, pucker: of the mouth. lips_apart: upper and lower lip part with the jaw at
    rest. brows: raised (+1) or knit (-1). lids: 1 open, 0 shut, a little above 1 staring.
    gaze_deg: (right in the image, up).
    """

    jaw: float = 0.0
    smile: float = 0.0
    grimace: float = 0.0
    pucker: float = 0.0
    lips_apart: float = 0.0
    brows: float = 0.0
    lids: float = 1.0
    gaze_deg: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class HeadPose:
    """How the head is held, degrees about the neck's pivot: turned to the image's right, nodding, tilted."""

    turn_deg: float = 0.0
    nod_deg: float = 0.0
    tilt_deg: float = 0.0


# what happens when, in seconds of a 16.7 s performance; it repeats
_PERIOD_S = 1000 / 60
_SMILES = ((1.2, 3.0, 0.9), (12.6, 14.2, 0.6))
_GRIMACES = ((4.0, 5.4, 1.0), (15.0, 15.9, 0.7))
_SPEECH = (6.2, 11.8)
_BLINKS = (0.7, 3.4, 5.8, 8.3, 10.9, 14.6, 16.2)
_BROWS = ((2.0, 2.9, 0.6), (4.0, 5.4, -0.9), (7.0, 7.6, 0.7), (9.4, 10.0, 0.6), (13.0, 13.8, 0.9))
_SYLLABLE_HZ = 2.6


def performance_at(time_s: float, phases: FloatArray) -> Expression:
    """Return smiling, grimacing, speaking and blinking at a time; phases: (8,) radians vary the speech."""
    time = time_s % _PERIOD_S
    speaking = _window(time, *_SPEECH, ramp=0.35)
    beat = 2.0 * np.pi * _SYLLABLE_HZ * time
    syllable = 0.5 + 0.5 * np.sin(beat + 0.6 * np.sin(0.31 * beat + phases[0]))
    stress = 0.65 + 0.35 * np.sin(0.23 * beat + phases[1])
    rounding = np.clip(np.sin(0.47 * beat + phases[2]), 0.0, 1.0)
    blink = max(_bell((time - at) / 0.085) for at in _BLINKS)
    smile = sum(size * _window(time, a, b, ramp=0.5) for a, b, size in _SMILES)
    grimace = sum(size * _window(time, a, b, ramp=0.4) for a, b, size in _GRIMACES)
    return Expression(
        jaw=float(0.75 * speaking * syllable * stress + 0.10 * smile),
        smile=float(smile + 0.15 * speaking * (1.0 - rounding)),
        grimace=float(grimace),
        pucker=float(0.85 * speaking * rounding),
        lips_apart=float(0.35 * speaking + 0.5 * smile + 0.8 * grimace),
        brows=float(sum(size * _window(time, a, b, ramp=0.3) for a, b, size in _BROWS)),
        lids=float((1.0 - 0.22 * smile - 0.35 * grimace) * (1.0 - blink)),
        gaze_deg=(float(4.0 * np.sin(0.9 * time + phases[3])), float(2.0 * np.sin(0.7 * time + phases[4]))),
    )


def performance_pose(time_s: float, phases: FloatArray) -> HeadPose:
    """Return the small movements of a head that talks."""
    w = 2.0 * np.pi * time_s
    return HeadPose(
        turn_deg=float(6.0 * np.sin(0.21 * w + phases[5]) + 1.5 * np.sin(0.55 * w + phases[6])),
        nod_deg=float(2.5 * np.sin(0.33 * w + phases[7])),
        tilt_deg=float(2.5 * np.sin(0.17 * w + phases[6])),
    )


def turning_pose(share: float, widest_deg: float) -> HeadPose:
    """Return the pose at a share (0 to 1) of a turn from the left end to the right end, at rest at both."""
    return HeadPose(turn_deg=float(-widest_deg * np.cos(np.pi * share)))


def _window(time: float, start: float, end: float, ramp: float) -> float:
    """Return 1 between start and end, smoothly 0 outside, `ramp` seconds for each flank."""
    share = np.clip(min(time - start, end - time) / ramp, 0.0, 1.0)
    return float(share * share * (3.0 - 2.0 * share))


def _bell(x: float) -> float:
    return float(np.exp(-0.5 * x * x))
