"""Do the lamps flicker? The lengths of M⁻¹(r − a) tell, from frame to frame and from row to row.

On one material |M⁻¹(r − a)| is the albedo, whatever the pose, so that its median over the subject
is the same in every frame unless light or exposure change. A lamp on the mains beats with the shutter: the
median goes up and down from frame to frame, which shows in how far a frame lies from the mean of its two
neighbours. Where the shutter rolls from row to row, other rows are bright in every frame: bands.
"""

import numpy as np

from vntoolkit.arrays import Float32Array, FloatArray, Int64Array
from vntoolkit.diagnosis import evidence as evidences
from vntoolkit.diagnosis.finding import CLEAR_Z, Finding
from vntoolkit.diagnosis.white_balance import changes_with_gains
from vntoolkit.spread import MEDIAN_TO_DEVIATION

_STRIPES, _ROUNDS_A_STRIPE = 24, 3
_SPREAD_OF_GAINS, _INDEPENDENT = 0.05, 20  # of a stripe's pixels: neighbours share their errors
_LARGEST_BANDS = 0.012  # clean footage of what moves has up to 1 %, and as much in columns
FRAMES_IN_A_ROW = 5


def check_flicker(evidence: evidences.Evidence) -> list[Finding]:
    """Find light that goes up and down from frame to frame, and bands. evidence: of consecutive frames."""
    seen = evidence.surface.all(axis=0)
    if len(evidence.light) < 3 or int(seen.sum()) < evidences.FEWEST_PIXELS:
        return []
    scaled = np.stack([evidences.scaled_normals(evidence, light)[seen] for light in evidence.light])
    beats = _beats(scaled)
    medians = np.median(beats, axis=1)
    error = _largest_error(beats, medians, evidence.blocks[seen])
    largest = float(np.abs(medians).max())
    if largest >= max(evidences.LARGEST_CHANGE, CLEAR_Z * error):  # NaN tells nothing
        return [Finding.of("flicker", change=largest, error=error)]
    inverse = evidence.inverse if evidence.inverse.ndim == 2 else evidence.inverse[seen]
    follow = np.stack([changes_with_gains(inverse, each) for each in scaled[1:-1]])
    return _findings_of_bands(beats, follow, np.nonzero(seen))


def _findings_of_bands(
    beats: Float32Array, follow: FloatArray, places: tuple[Int64Array, ...]
) -> list[Finding]:
    """Find bands, which a rolling shutter makes of flicker.

    Gains of the channels are fitted to what lengths do in every stripe of rows, and then of columns. What a
    subject that moves changes depends on columns as on rows; what the shutter makes depends on rows alone.
    beats: (k, n). follow: (k, n, 3), how they follow the gains. places: rows and columns, (n,) each.
    """
    change = []
    for lines in places:  # rows, then columns on what rows leave: a subject couples the two
        stripes = np.array_split(np.argsort(lines, kind="stable"), _STRIPES)
        gains: FloatArray = np.zeros((len(beats), _STRIPES, 3))
        for k, stripe in np.ndindex(gains.shape[:2]):
            part = stripes[stripe]
            gains[k, stripe] = _gains_of_stripe(follow[k][part], beats[k][part])
            beats[k][part] -= follow[k][part] @ gains[k, stripe]
        gains -= gains.mean(axis=1, keepdims=True)
        change.append(np.sqrt(np.mean(gains**2, axis=1)).max(axis=1))
    by_rows, by_columns = float(change[0].min()), float(change[1].max())
    if by_rows < _LARGEST_BANDS or by_rows < 2.0 * by_columns:
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
    return float(MEDIAN_TO_DEVIATION * np.median(np.abs(scattered), axis=0).max() / np.sqrt(len(names)))
