"""Did the gains of the channels change between calibration and capture, or while filming?

Gains on red and blue against green change the length of M⁻¹(r − a) with direction in a way that M foretells.
The gains that make the lengths of one material equal are found by least squares on their logarithms, step by
step, from the best of a coarse grid: skin under a rig of grey cloth turns normals so far that the steps from
gains of 1 end elsewhere. They are named where they differ from 1 clearly and even out the lengths.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from vntoolkit.arrays import Array, FloatArray, Int64Array
from vntoolkit.diagnosis.evidence import FEWEST_PIXELS, LARGEST_CHANGE, Evidence, lengths_of
from vntoolkit.diagnosis.finding import CLEAR_Z, Finding
from vntoolkit.diagnosis.lamp_nearness import changes_with_nearness
from vntoolkit.diagnosis.surface_match import agreement_of
from vntoolkit.diagnosis.surface_pixels import (
    SurfacePixels,
    regress_lengths,
    spread_of_lengths,
    surface_pixels,
)
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.response import LightResponse

_STARTS = np.array([(red, blue) for red in np.linspace(-0.6, 0.6, 7) for blue in np.linspace(-0.6, 0.6, 7)])
_PIXELS_A_START = 1000
_APART = 0.2
_STEPS = 10
_LONGEST_STEP = 0.15
_LARGEST_LOG_GAIN = 0.7
_NOTED_LOG_GAIN = 0.07  # 7 % turn a normal by about a degree and a half
_LEFT = 0.6  # of the spread of the lengths that gains must not leave: two free numbers always mend a little
_LEAST_ERROR_OF_CHANGE = 0.001
_Z = 7.0  # a backdrop without a mask, of one colour and flat, reaches 6.5


def check_white_balance(evidence: Evidence) -> list[Finding]:
    """Find gains of the channels that differ from those at calibration."""
    found = fit_gains(evidence)
    if found is None or not found.is_clear:
        return []
    red, blue = 100 * np.expm1(found.logs)
    turn_deg, left = found.turn_deg, found.left
    return [Finding.of("white-balance", turn_deg=turn_deg, red=red, blue=blue, left=left)]


def check_changing_gains(evidence: Evidence) -> list[Finding]:
    """Find gains of the channels, or lamps, that change from the first frame to others."""
    pixels = surface_pixels(evidence)
    seen = np.unique(pixels.frames)
    if len(seen) < 2 or len(pixels) < FEWEST_PIXELS * len(seen):
        return []
    changes = _changes(pixels, seen, evidence.rig.response)
    if changes is None:
        return []
    logs, errors = changes
    sure = np.where(np.abs(logs) > CLEAR_Z * errors, np.abs(logs), 0.0).max(axis=1)
    worst = int(sure.argmax())
    if sure[worst] < LARGEST_CHANGE:
        return []
    first, last = evidence.numbers[seen[0]], evidence.numbers[seen[worst + 1]]
    red, blue = (
        f"{100 * math.expm1(log):+.1f} ± {100 * error:.1f} %"
        for log, error in zip(logs[worst], errors[worst], strict=True)
    )
    return [Finding.of("drift/subject", first=first, last=last, red=red, blue=blue)]


def _changes(
    pixels: SurfacePixels, seen: Int64Array, response: LightResponse
) -> tuple[FloatArray, FloatArray] | None:
    """Return log gains of red and blue in later frames against the first, and their errors, (frames - 1, 2).

    What else makes lengths depend on direction and place is shared by all frames: faults of M, near lamps,
    vignetting. A subject that moves under near lamps changes its lengths too, and some of it looks like
    gains. So the change is estimated with ever more that is shared, and last with lamps that are as near as
    each frame says; by how much the five differ counts as an error.
    """
    x, y, _ = pixels.normals.T
    u, v = pixels.positions.T
    gains = changes_with_gains(pixels.inverse, pixels.scaled)[:, [0, 2]].T
    near = changes_with_nearness(pixels, response)
    in_frame = [pixels.frames == frame for frame in seen]
    changed = [gain * there for there in in_frame[1:] for gain in gains]
    wrong_m, uneven = [x, y, *pixels.of_wrong_m], pixels.of_uneven_light
    both = [u * x, u * y, v * x, v * y]
    moving = [value * there for there in in_frame[1:] for value in (u, v, *near)]
    found = []
    for shared in ([], wrong_m, wrong_m + uneven, wrong_m + uneven + both, wrong_m + uneven + near + moving):
        columns = np.column_stack(changed + shared)
        fit = regress_lengths(columns, pixels.log_lengths, pixels)
        if fit is None:
            return None
        found.append((fit.slopes[: len(changed)], fit.errors[: len(changed)]))
    slopes, errors = (np.stack(parts) for parts in zip(*found, strict=True))
    error = np.hypot(np.maximum(errors.max(axis=0), _LEAST_ERROR_OF_CHANGE), np.ptp(slopes, axis=0) / 2)
    return slopes.mean(axis=0).reshape(-1, 2), error.reshape(-1, 2)


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
    pixels = surface_pixels(evidence)
    if len(pixels) < FEWEST_PIXELS:
        return None
    logs, error, spread = _refined(pixels, np.zeros(2))
    few = pixels.of(slice(None, None, max(1, len(pixels) // _PIXELS_A_START)))
    start = _STARTS[int(np.argmin([_spread(few, logs) for logs in _STARTS]))]
    if np.abs(start - logs).max() > _APART:
        farther = _refined(pixels, start)
        # A backdrop of another colour can be as long as the subject under some gains, but is no surface then.
        if farther[2] < _LEFT * spread and _agreement(evidence, farther[0]) > _agreement(evidence, logs):
            logs, error, spread = farther
    return Gains(
        logs=logs,
        z=float(np.max(np.abs(logs) / error)),
        left=_spread(pixels, logs) / max(spread_of_lengths(pixels.scaled, pixels.frames), 1e-9),
        turn_deg=float(np.median(angles_deg(_with_gains(pixels, logs), pixels.scaled))),
    )


def _agreement(evidence: Evidence, logs: FloatArray) -> float:
    """Return the agreement of the mixed derivatives where the gains are undone."""
    return agreement_of(evidence, np.diag(np.exp([-logs[0], 0.0, -logs[1]])))


def _with_gains(pixels: SurfacePixels, logs: FloatArray) -> FloatArray:
    """Return M⁻¹(r / gains − a), (n, 3), for log gains of red and blue."""
    return pixels.scaled_normals(pixels.rgb * np.exp([-logs[0], 0.0, -logs[1]]))


def _spread(pixels: SurfacePixels, logs: FloatArray) -> float:
    return spread_of_lengths(_with_gains(pixels, logs), pixels.frames)


def _refined(pixels: SurfacePixels, logs: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return the log gains that even the lengths out, their errors (2,), and the spread that is left."""
    error: FloatArray = np.ones(2)
    for _ in range(_STEPS):
        scaled = _with_gains(pixels, logs)
        found = regress_lengths(
            changes_with_gains(pixels.inverse, scaled)[:, [0, 2]],
            np.log(np.maximum(lengths_of(scaled), 1e-12)),
            pixels,
            rounds=1,
        )
        if found is None:
            break
        error = np.maximum(found.errors, 0.005)
        logs = np.clip(logs + np.clip(found.slopes, -_LONGEST_STEP, _LONGEST_STEP), -1.0, 1.0)
    return logs, error, _spread(pixels, logs)


def changes_with_gains(inverse: Array, scaled: Array) -> FloatArray:
    """Return how log lengths follow the channels' log gains, (n, 3): n · M⁻¹ E_k M n.

    inverse: M⁻¹, (3, 3) or (n, 3, 3). scaled: M⁻¹(r − a), (n, 3).
    """
    direction = scaled / np.maximum(lengths_of(scaled), 1e-12)[:, None]
    colour = np.einsum("...ij,...j->...i", np.linalg.inv(inverse), direction)
    return np.asarray(np.einsum("...i,...ij->...j", direction, inverse) * colour, np.float64)
