"""Is this picture of the gel one of the session that the rig was calibrated in, and in the same channels?

Near lamps light the untouched gel unevenly, each channel in its own way. The gel's colour over the place is
thus a sensor's own mark: exchanged channels fit it badly, and so does another sensor or another light.
"""

from itertools import permutations

import numpy as np

from vntoolkit.arrays import FloatArray, LinearImage, Mask

_BLOCKS = 12  # by side; their medians do not see dots
_LEAST_KNOWN = 0.5  # of a block's pixels
_DARKEST = 1e-4  # of full scale: a ratio to less is noise


def colours_by_place(rgb: LinearImage, usable: Mask) -> FloatArray:
    """Median colours (12, 12, 3) of a picture's blocks; NaN where half of one is not usable."""
    rows, columns = (np.array_split(np.arange(length), _BLOCKS) for length in usable.shape)
    colours = np.full((_BLOCKS, _BLOCKS, 3), np.nan)
    for i, row in enumerate(rows):
        for k, column in enumerate(columns):
            block = np.ix_(row, column)
            if usable[block].mean() > _LEAST_KNOWN:
                colours[i, k] = np.median(rgb[block][usable[block]], axis=0)
    return colours


def untouched_terms(background: LinearImage, usable: Mask) -> FloatArray:
    """The untouched gel's colour as a quadratic of the place, (6, 3): of 1, x, y, x², x y, y² by channel."""
    colours = colours_by_place(background, usable).reshape(-1, 3)
    known = np.isfinite(colours).all(axis=1)
    return np.linalg.lstsq(_terms()[known], colours[known], rcond=None)[0]


def colours_of_terms(terms: FloatArray) -> FloatArray:
    """The colours (12, 12, 3) that `untouched_terms` tell."""
    return (_terms() @ terms).reshape(_BLOCKS, _BLOCKS, 3)


def _terms() -> FloatArray:
    """(144, 6): x and y run from −1 to 1 over the picture."""
    at = (2.0 * np.arange(_BLOCKS) + 1.0) / _BLOCKS - 1.0
    x, y = (each.ravel() for each in np.meshgrid(at, at))
    return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])


def channel_order(colours: FloatArray, reference: FloatArray) -> tuple[int, ...]:
    """The order of channels in which colours (12, 12, 3) fit a reference best: (0, 1, 2) for their own."""
    ratios = {order: _log_ratios(colours[..., order], reference) for order in permutations(range(3))}
    return min(ratios, key=lambda order: _middle_distance(ratios[order]))


def difference_of_light(colours: FloatArray, reference: FloatArray) -> float:
    """Median difference of colours (12, 12, 3) from a reference, as a share, in the worst channel."""
    ratios = _log_ratios(colours, reference)
    return float(np.median(np.abs(ratios), axis=0).max()) if len(ratios) else 0.0


def _log_ratios(colours: FloatArray, reference: FloatArray) -> FloatArray:
    known = np.isfinite(colours).all(axis=-1) & np.isfinite(reference).all(axis=-1)
    both = [np.log(np.maximum(each[known], _DARKEST)) for each in (colours, reference)]
    return np.asarray(both[0] - both[1])


def _middle_distance(ratios: FloatArray) -> float:
    """Median distance of log ratios (n, 3) from their median, which exposure changes."""
    return float(np.median(np.abs(ratios - np.median(ratios)))) if len(ratios) else 0.0
