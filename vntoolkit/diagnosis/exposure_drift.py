"""Drift of exposure or white balance during a capture, measured on the static part of the picture.

What surrounds the subject and does not move must look the same in every frame. Pixels whose three channels
change by one common factor, the same pixels in every frame, are that part; where the subject fills the
picture, or the surroundings are black, there is none, and nothing is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.diagnosis.finding import Finding, Level
from vntoolkit.photometry.frame import LinearFrame

_LARGEST_SIDE_PX = 240  # frames are averaged down to it: less noise, less work
_BLUR_PX = 5  # one level of 8 bits in the dark is more than the window below
_DARKEST = 0.02  # of full scale, linear; below it noise decides
_WINDOW = 0.02  # in log light: pixels this close to the common factor belong to the static part
_SEARCH = 0.7  # in log light: half of the range of factors looked at
_BIN = 0.005
_ROUNDS = 6
_LEAST_SHARE = 0.03  # of the picture
_LEAST_OF_BORDER = 0.3  # the static part surrounds the subject; a plane that tilts does not
_LARGEST_DRIFT = 0.02  # 2 % in one channel turn a normal by about half a degree
_SAME_COLOUR = 0.01


@dataclass(frozen=True, kw_only=True)
class Drift:
    """The static part's gain (red, green, blue) in the frame where it differs most from the first one."""

    first: int
    worst: int
    gain: tuple[float, float, float]

    @property
    def is_exposure(self) -> bool:
        """True where the three channels changed alike."""
        return bool(np.ptp(np.log(self.gain)) < _SAME_COLOUR)

    def to_finding(self) -> Finding:
        """Return the warning with its remedy."""
        red, green, blue = (f"{100 * (gain - 1):+.0f} %" for gain in self.gain)
        what = "exposure" if self.is_exposure else "white balance"
        return Finding(
            check="drift",
            level=Level.WARNING,
            problem=f"the camera's {what} drifts from frame {self.first} to {self.worst}: what does not move "
            "changes",
            measured=f"{red} red, {green} green, {blue} blue",
            expected=f"less than {_LARGEST_DRIFT:.0%}",
            remedy="lock exposure and white balance, and film again",
        )


def drift_of_static_part(frames: Sequence[LinearFrame]) -> Drift | None:
    """Compare each frame with the first one; None where nothing drifts by 2 %, or nothing is static."""
    small = [_reduced(frame) for frame in frames]
    reference, static = small[0]
    gains: list[FloatArray] = []
    for light, usable in small[1:]:
        both = static & usable & (np.abs(light - reference).max(axis=2) < _SEARCH)
        change = light - reference
        factor = _common_factor(change[both])
        static = both & (np.abs(change - factor).max(axis=2) < _WINDOW)
        gains.append(change)
    if not gains or not _surrounds(static):
        return None
    medians = np.array([np.median(change[static], axis=0) for change in gains])
    worst = int(np.abs(medians).max(axis=1).argmax())
    if np.abs(medians[worst]).max() < _LARGEST_DRIFT:
        return None
    red, green, blue = np.exp(medians[worst]).tolist()
    return Drift(first=frames[0].number, worst=frames[worst + 1].number, gain=(red, green, blue))


def _reduced(frame: LinearFrame) -> tuple[FloatArray, Mask]:
    """Return log light (h, w, 3), averaged down, and where all that went into a pixel can be trusted."""
    factor = min(1.0, _LARGEST_SIDE_PX / max(frame.shape))
    size = tuple(max(1, round(n * factor)) for n in frame.shape[::-1])
    rgb = cv2.blur(cv2.resize(np.array(frame.rgb), size, interpolation=cv2.INTER_AREA), (_BLUR_PX, _BLUR_PX))
    clipped = cv2.resize(frame.clipped.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    clipped = cv2.blur(clipped, (_BLUR_PX, _BLUR_PX))
    usable: Mask = np.asarray((rgb.min(axis=2) > _DARKEST) & (clipped == 0))
    return np.log(np.maximum(rgb, 1e-6)).astype(np.float64), usable


def _common_factor(change: FloatArray) -> FloatArray:
    """Return the log factor (3,) that most of the changes (n, 3) share, by histogram, then by medians."""
    edges = np.arange(-_SEARCH, _SEARCH + _BIN, _BIN)
    if not len(change):
        return np.zeros(3)
    counts = np.convolve(np.histogram(change[:, 1], edges)[0], np.ones(5), mode="same")
    near = np.abs(change[:, 1] - (edges[int(counts.argmax())] + _BIN / 2)) < _WINDOW
    centre = np.median(change[near], axis=0) if near.any() else np.zeros(3)
    for _ in range(_ROUNDS):
        near = np.abs(change - centre).max(axis=1) < _WINDOW
        if not near.any():
            break
        centre = np.median(change[near], axis=0)
    return np.asarray(centre)


def _surrounds(static: Mask) -> bool:
    border = np.concatenate([static[0], static[-1], static[:, 0], static[:, -1]])
    return bool(static.mean() > _LEAST_SHARE and border.mean() > _LEAST_OF_BORDER)
