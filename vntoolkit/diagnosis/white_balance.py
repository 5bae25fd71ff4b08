"""Did the gains of the channels change between calibration and capture?

Gains on red and blue against green change the length of M⁻¹(r − a) with direction in a way that M foretells.
The gains that make the lengths of one material equal are found by least squares on their logarithms, step by
step, from the best of a coarse grid: skin under a rig of grey cloth turns normals so far that the steps from
gains of 1 end elsewhere. They are named where they differ from 1 clearly and even out the lengths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.evidence import Evidence, lengths_of
from vntoolkit.diagnosis.finding import Finding, Level, certainty_from_z
from vntoolkit.diagnosis.surface_match import agreement_of
from vntoolkit.diagnosis.surface_pixels import SurfacePixels, surface_pixels

_FEWEST_PIXELS = 400
_STARTS = np.array([(red, blue) for red in np.linspace(-0.6, 0.6, 7) for blue in np.linspace(-0.6, 0.6, 7)])
_PIXELS_A_START = 1000
_APART = 0.2
_STEPS = 10
_LONGEST_STEP = 0.15
_LARGEST_LOG_GAIN = 0.7
_NOTED_LOG_GAIN = 0.07  # 7 % turn a normal by about a degree and a half
_LEFT = 0.6  # of the spread of the lengths that gains must not leave: two free numbers always mend a little
_Z = 7.0  # a backdrop without a mask, of one colour and flat, reaches 6.5


def check_white_balance(evidence: Evidence) -> list[Finding]:
    """Find gains of the channels that differ from those at calibration."""
    found = fit_gains(evidence)
    if found is None or not found.is_clear:
        return []
    red, blue = (f"{100 * (math.exp(log) - 1):+.0f} %" for log in found.logs)
    return [
        Finding(
            check="white-balance",
            level=Level.WARNING,
            problem="the white balance looks changed since calibration, or the subject has another colour: "
            f"normals turn by {found.turn_deg:.0f} degrees in the median",
            measured=f"red by {red} and blue by {blue} against green, which leaves {found.left:.0%} of the "
            "spread of lengths",
            expected="0 %",
            remedy="lock it, and film or calibrate again; on a subject of another colour, calibrate on that "
            "colour",
            certainty=certainty_from_z(found.z),
        )
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Gains:
    """logs: (2,) of red's and blue's gain against green's. z: of the larger. left: share of spread left.

    turn_deg: by how much the gains turn normals, in the median.
    """

    logs: FloatArray
    z: float
    left: float
    turn_deg: float

    @property
    def is_clear(self) -> bool:
        """True where the gains are more than chance, more than a degree's worth, and explain the lengths."""
        largest = float(np.abs(self.logs).max())
        return _NOTED_LOG_GAIN < largest < _LARGEST_LOG_GAIN and self.z > _Z and self.left < _LEFT


@lru_cache(maxsize=2)
def fit_gains(evidence: Evidence) -> Gains | None:
    """Fit the gains; None where too little of the surface is in sight."""
    pixels = surface_pixels(evidence, lambda k, length: evidence.surface[k])
    if len(pixels) < _FEWEST_PIXELS:
        return None
    as_read = pixels.scaled_normals(pixels.rgb)
    logs, error, spread = _refined(pixels, np.zeros(2))
    few = pixels.of(slice(None, None, max(1, len(pixels) // _PIXELS_A_START)))
    start = _STARTS[int(np.argmin([spread_of_lengths(_with_gains(few, logs)) for logs in _STARTS]))]
    if np.abs(start - logs).max() > _APART:
        farther = _refined(pixels, start)
        # A backdrop of another colour can be as long as the subject under some gains, but is no surface then.
        if farther[2] < _LEFT * spread and _agreement(evidence, farther[0]) > _agreement(evidence, logs):
            logs, error, spread = farther
    with_gains = _with_gains(pixels, logs)
    lengths = lengths_of(with_gains) * lengths_of(as_read)
    cosines = (with_gains * as_read).sum(axis=1) / np.maximum(lengths, 1e-12)
    return Gains(
        logs=logs,
        z=float(np.max(np.abs(logs) / error)),
        left=spread_of_lengths(with_gains) / max(spread_of_lengths(as_read), 1e-9),
        turn_deg=float(np.degrees(np.median(np.arccos(np.clip(cosines, -1.0, 1.0))))),
    )


def _agreement(evidence: Evidence, logs: FloatArray) -> float:
    """Return the agreement of the mixed derivatives where the gains are undone."""
    return agreement_of(evidence, np.diag(np.exp([-logs[0], 0.0, -logs[1]])))


def _with_gains(pixels: SurfacePixels, logs: FloatArray) -> FloatArray:
    """Return M⁻¹(r / gains − a), (n, 3), for log gains of red and blue."""
    return pixels.scaled_normals(pixels.rgb * np.exp([-logs[0], 0.0, -logs[1]]))


def _refined(pixels: SurfacePixels, logs: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return the log gains that even the lengths out, their errors (2,), and the spread that is left."""
    matrix = np.linalg.inv(pixels.inverse)
    error: FloatArray = np.ones(2)
    spread = 0.0
    for _ in range(_STEPS):
        scaled = _with_gains(pixels, logs)
        length = np.maximum(lengths_of(scaled), 1e-12)
        direction = scaled / length[:, None]
        colour = np.einsum("...ij,...j->...i", matrix, direction)
        # n · M⁻¹ E_k M n: how the log length follows channel k's log gain
        follow = np.einsum("...i,...ij->...j", direction, pixels.inverse) * colour
        change, error, spread = _regress(follow[:, [0, 2]], np.log(length), pixels.blocks)
        logs = np.clip(logs + np.clip(change, -_LONGEST_STEP, _LONGEST_STEP), -1.0, 1.0)
    return logs, error, spread


def spread_of_lengths(scaled: FloatArray) -> float:
    """Return the median departure of log lengths from their median; of those that face away the largest."""
    logs = np.log(np.maximum(lengths_of(scaled), 1e-12))
    departure = np.abs(logs - np.median(logs))
    departure[scaled[:, 2] > 0] = np.inf
    return float(np.median(departure))


def _regress(
    x: FloatArray, y: FloatArray, blocks: npt.NDArray[np.int64]
) -> tuple[FloatArray, FloatArray, float]:
    """Fit y = x · slopes + constant, outliers weighed down.

    Returns the slopes (2,), their errors (2,) from leaving out blocks, and the median departure of y from its
    median.
    """
    design = np.column_stack([x, np.ones(len(x))])
    departure = np.abs(y - np.median(y))
    weight = 1.0 / (1.0 + (departure / (3.0 * np.median(departure) + 1e-6)) ** 2)
    count = int(blocks.max()) + 1
    normal, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for i in range(3):
        right[:, i] = np.bincount(blocks, weight * design[:, i] * y, count)
        for j in range(3):
            normal[:, i, j] = np.bincount(blocks, weight * design[:, i] * design[:, j], count)
    kept = normal[:, 2, 2] > 0
    normal, right = normal[kept], right[kept]
    ridge = 1e-9 * np.eye(3) * len(x)
    slopes = np.linalg.solve(normal.sum(axis=0) + ridge, right.sum(axis=0))
    left_out = np.linalg.solve(normal.sum(axis=0) - normal + ridge, (right.sum(axis=0) - right)[..., None])[
        ..., 0
    ]
    size = len(left_out)
    error = np.sqrt((size - 1) / size * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))
    return slopes[:2], np.maximum(error[:2], 0.005), float(np.median(departure))
