"""What no surface does from frame to frame: exposure that drifts, lamps that flicker, a subject that jumps.

Drift is measured on the static part of the picture. What surrounds the subject and does not move must look
the same in every frame. Pixels whose three channels change by one common factor, the same pixels in every
frame, are that part; where the subject fills the picture, or the surroundings are black, there is none, and
nothing is said.

Flicker: on one material |M⁻¹(r − a)| is the albedo, whatever the pose, so that its median over the subject
is the same in every frame unless light or exposure change. A lamp on the mains beats with the shutter: the
median goes up and down from frame to frame, which shows in how far a frame lies from the mean of its two
neighbours. Where the shutter rolls from row to row, other rows are bright in every frame: bands.

A subject that moves farther than flow can follow is one whose pixels do not come back: forwards along the
flow and backwards along the reverse flow ends elsewhere.
"""

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np

from vntoolkit.arrays import Float32Array, FloatArray, Int64Array, Mask
from vntoolkit.diagnosis import evidence as evidences
from vntoolkit.diagnosis.finding import CLEAR_Z, Finding, certainty_from_z
from vntoolkit.diagnosis.white_balance import changes_with_gains
from vntoolkit.photometry.frame import LinearFrame

# Drift.
_BLUR_PX = 5  # one level of 8 bits in the dark is more than the window below
_DARKEST = 0.02  # of full scale, linear; below it noise decides
_WINDOW = 0.02  # in log light: pixels this close to the common factor belong to the static part
_SEARCH = 0.7  # in log light: half of the range of factors looked at
_BIN = 0.005
_ROUNDS = 6
_LEAST_SHARE = 0.03  # of the picture
_LEAST_OF_BORDER = 0.3  # the static part surrounds the subject; a plane that tilts does not
_SAME_COLOUR = 0.01

# Flicker and jumps.
_STRIPES, _ROUNDS_A_STRIPE = 24, 3
_SPREAD_OF_GAINS, _INDEPENDENT = 0.05, 20  # of a stripe's pixels: neighbours share their errors
_LARGEST_BANDS = 0.012  # clean footage of what moves has up to 1 %, and as much in columns
_ROWS_OVER_COLUMNS = 2.0
FRAMES_IN_A_ROW = 5
_LIT = 0.15  # of the brightest hundredth
_RETURN_PX = 1.5
_RETURN_SHARE = 0.1  # of the motion
_LOST = 0.5  # of the subject
_FOLLOWED = 0.1  # … where less is lost between most frames: ripples all over are lost everywhere
_LEAST_SUBJECT = 0.005  # of the picture


def findings_from_drift(frames: Sequence[LinearFrame]) -> list[Finding]:
    """Find exposure or white balance that changes, against the first frame; at least one frame."""
    small = [_reduced(frame) for frame in frames]
    reference, static = small[0]
    gains: list[FloatArray] = []
    for light, usable in small[1:]:
        both = static & usable & (evidences.brightest_channel(np.abs(light - reference)) < _SEARCH)
        change = light - reference
        factor = _common_factor(change[both])
        static = both & (evidences.brightest_channel(np.abs(change - factor)) < _WINDOW)
        gains.append(change)
    if not gains or not _surrounds(static):
        return []
    medians = np.array([np.median(change[static], axis=0) for change in gains])
    worst = int(np.abs(medians).max(axis=1).argmax())
    if np.abs(medians[worst]).max() < evidences.LARGEST_CHANGE:
        return []
    first, last = frames[0].number, frames[worst + 1].number
    red, green, blue = 100 * np.expm1(medians[worst])
    what = "exposure" if np.ptp(medians[worst]) < _SAME_COLOUR else "white balance"
    return [Finding.of("drift", what=what, first=first, last=last, red=red, green=green, blue=blue)]


def _reduced(frame: LinearFrame) -> tuple[FloatArray, Mask]:
    """Return log light (h, w, 3), averaged down, and where all that went into a pixel can be trusted."""
    small = evidences.averaged_down(frame)
    rgb = cv2.blur(np.asarray(small.rgb), (_BLUR_PX, _BLUR_PX))
    clipped = cv2.blur(small.clipped.astype(np.float32), (_BLUR_PX, _BLUR_PX))
    usable: Mask = np.asarray((evidences.darkest_channel(rgb) > _DARKEST) & (clipped == 0))
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
        near = evidences.brightest_channel(np.abs(change - centre)) < _WINDOW
        if not near.any():
            break
        centre = np.median(change[near], axis=0)
    return np.asarray(centre)


def _surrounds(static: Mask) -> bool:
    border = np.concatenate([static[0], static[-1], static[:, 0], static[:, -1]])
    return bool(static.mean() > _LEAST_SHARE and border.mean() > _LEAST_OF_BORDER)


def check_flicker(evidence: evidences.Evidence) -> list[Finding]:
    """Find light that goes up and down from frame to frame. evidence: of consecutive frames."""
    if len(evidence.light) < 3:
        return []
    seen = evidence.surface.all(axis=0)
    if int(seen.sum()) < evidences.FEWEST_PIXELS:
        return []
    beats = _beats(np.stack([evidences.scaled_normals(evidence, light)[seen] for light in evidence.light]))
    medians = np.median(beats, axis=1)
    error = _largest_error(beats, medians, evidence.blocks[seen])
    largest = float(np.abs(medians).max())
    if not largest >= max(evidences.LARGEST_CHANGE, CLEAR_Z * error):  # NaN tells nothing
        return []
    sure = certainty_from_z(largest / max(error, 1e-6))
    return [Finding.of("flicker", certainty=sure, change=largest, error=error)]


def check_bands(evidence: evidences.Evidence) -> list[Finding]:
    """Find bands, which a rolling shutter makes of flicker. evidence: of consecutive frames.

    Gains of the channels are fitted to what lengths do in every stripe of rows, and then of columns. What a
    subject that moves changes depends on columns as on rows; what the shutter makes depends on rows alone.
    """
    seen = evidence.surface.all(axis=0)
    if len(evidence.light) < 3 or int(seen.sum()) < evidences.FEWEST_PIXELS:
        return []
    scaled = np.stack([evidences.scaled_normals(evidence, light)[seen] for light in evidence.light])
    beats = _beats(scaled)
    inverse = evidence.inverse if evidence.inverse.ndim == 2 else evidence.inverse[seen]
    follow = np.stack([changes_with_gains(inverse, each) for each in scaled[1:-1]])
    change = []
    for places in np.nonzero(seen):  # rows, then columns on what rows leave: a subject couples the two
        stripes = np.array_split(np.argsort(places, kind="stable"), _STRIPES)
        gains: FloatArray = np.zeros((len(beats), _STRIPES, 3))
        for k, stripe in np.ndindex(gains.shape[:2]):
            part = stripes[stripe]
            gains[k, stripe] = _gains_of_stripe(follow[k][part], beats[k][part])
            beats[k][part] -= follow[k][part] @ gains[k, stripe]
        gains -= gains.mean(axis=1, keepdims=True)
        change.append(np.sqrt(np.mean(gains**2, axis=1)).max(axis=1))
    by_rows, by_columns = float(change[0].min()), float(change[1].max())
    if by_rows < _LARGEST_BANDS or by_rows < _ROWS_OVER_COLUMNS * by_columns:
        return []
    return [Finding.of("flicker/bands", rows=by_rows, columns=by_columns)]


def _beats(scaled: Float32Array) -> Float32Array:
    """Return (k - 2, n) log lengths of (k, n, 3) against the mean of the frames before and after.

    What moves over a pixel in one direction cancels.
    """
    logs = np.log(np.maximum(evidences.lengths_of(scaled), 1e-9))
    return np.asarray(logs[1:-1] - 0.5 * (logs[:-2] + logs[2:]))


def _gains_of_stripe(follow: FloatArray, beats: FloatArray) -> FloatArray:
    """Return log gains (3,) of a stripe whose log lengths (n,) beat, robustly; 0 where none tells."""
    gains: FloatArray = np.zeros(3)
    for _ in range(_ROUNDS_A_STRIPE):
        left = np.abs(beats - follow @ gains)
        scale = 1.5 * float(np.median(left)) + 1e-4
        weighted = follow / (1.0 + (left / (2 * scale)) ** 2)[:, None]
        spread = (scale / _SPREAD_OF_GAINS) ** 2 * len(beats) / _INDEPENDENT
        gains = np.linalg.solve(weighted.T @ follow + spread * np.eye(3), weighted.T @ beats)
    return gains


def _largest_error(beats: FloatArray, medians: FloatArray, blocks: Int64Array) -> float:
    """Return the standard error of the medians: how those of the blocks scatter about them."""
    names = np.unique(blocks)
    if len(names) < 2:
        return 1.0
    scattered = np.array([np.median(beats[:, blocks == name], axis=1) - medians for name in names])
    return float(1.48 * np.median(np.abs(scattered), axis=0).max() / np.sqrt(len(names)))


def findings_from_motion(frames: Sequence[LinearFrame], mask: Mask | None = None) -> list[Finding]:
    """Find a subject that jumps. frames: consecutive ones. mask: (h, w) where the subject is, or None."""
    if min(frames[0].shape) < evidences.NARROWEST_PX:
        return []  # OpenCV ends the process on strips of 12 pixels
    pictures = [_picture(frame) for frame in frames]
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    shares: list[float] = []
    for now, then in pairwise(pictures):
        subject = now > _LIT * np.percentile(now, 99)
        if mask is not None:
            size = (now.shape[1], now.shape[0])
            subject &= cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_AREA) > 0
        seen = subject.mean() >= _LEAST_SUBJECT
        shares.append(_lost_share(flow, now, then, subject) if seen else 0.0)
    where = int(np.argmax(shares))
    worst = shares[where]
    others = shares[:where] + shares[where + 1 :]
    if worst < _LOST or len(others) < 2 or np.median(others) > _FOLLOWED:
        return []
    first, second = frames[where].number, frames[where + 1].number
    return [Finding.of("jump", first=first, second=second, share=worst)]


def _lost_share(flow: cv2.DISOpticalFlow, now: Float32Array, then: Float32Array, subject: Mask) -> float:
    top = 255.0 / max(float(np.percentile(now, 99.5)), float(np.percentile(then, 99.5)), 1e-6)
    first, second = (np.clip(top * picture, 0, 255).astype(np.uint8) for picture in (now, then))
    onwards = np.asarray(flow.calc(first, second, None))  # type: ignore[call-overload]
    back = np.asarray(flow.calc(second, first, None))  # type: ignore[call-overload]
    height, width = now.shape
    u, v = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    to_u, to_v = u + onwards[..., 0], v + onwards[..., 1]
    returned = cv2.remap(back, to_u, to_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    missed = evidences.lengths_of(onwards + returned)
    allowed = _RETURN_PX + _RETURN_SHARE * evidences.lengths_of(onwards)
    return float((missed > allowed)[subject].mean())


def _picture(frame: LinearFrame) -> Float32Array:
    """Return one brightness, (h, w), averaged down; roots even out what is lit well and what is not."""
    light = np.asarray(evidences.averaged_down(frame).rgb)
    return np.sqrt(np.maximum(light.mean(axis=2), 0)).astype(np.float32)
