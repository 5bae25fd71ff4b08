"""One binary label per pixel, smooth over the image, by a minimum cut (boykov2001)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.shadows.sure_labels import sure_labels

_WEAKEST_BOND = 0.05  # share of the full price that a change of label across a sharp edge still costs
_DARK_SHARE = 0.03  # added to a share before its logarithm: noise is no edge


def lit_by_cut(
    evidence: FloatArray, bonds: tuple[FloatArray, FloatArray], mask: Mask
) -> npt.NDArray[np.bool_]:
    """Minimise Σ |evidence| over pixels labelled against it plus the bonds cut.

    evidence: (h, w), positive speaks for light, negative for shadow. bonds: to the east and to the south
    neighbour, (h, w) each, the price of a change there. Returns (h, w), True where lit (and outside `mask`).
    """
    pull = np.where(mask, evidence, 0.0).astype(np.float32)
    if not (pull < 0).any():
        return np.ones(mask.shape, dtype=np.bool_)
    if not (pull > 0).any():
        return ~mask
    east, south = (np.ascontiguousarray(bond, dtype=np.float32) for bond in bonds)
    signs, pull = sure_labels(pull, east, south)
    lit = signs > 0
    left = signs == 0
    if left.any():
        lit[left] = _lit_of_undecided(left, pull, east, south)
    return lit | ~mask


def _lit_of_undecided(
    left: Mask, pull: FloatArray, east: FloatArray, south: FloatArray
) -> npt.NDArray[np.bool_]:
    """Cut the graph of the pixels of `left` alone; return their labels, row by row."""
    import maxflow

    graph = maxflow.GraphFloat()
    number = np.full(left.shape, -1, dtype=np.int64)
    number[left] = graph.add_nodes(int(np.count_nonzero(left)))
    for bond, axis in ((east, 1), (south, 0)):
        first, second = (slice(None), slice(-1)), (slice(None), slice(1, None))
        if axis == 0:
            first, second = first[::-1], second[::-1]
        both = left[first] & left[second]
        price = bond[first][both]
        graph.add_edges(number[first][both], number[second][both], price, price)
    own = pull[left]
    graph.add_grid_tedges(number[left], np.maximum(own, 0.0), np.maximum(-own, 0.0))
    graph.maxflow()
    segments: npt.NDArray[np.bool_] = ~graph.get_grid_segments(number[left])
    return segments


def bonds_of_light(
    shares: FloatArray, light: int, mask: Mask, strength: float, contrast: float
) -> tuple[FloatArray, FloatArray]:
    """Bonds that give way where this light alone changes: paint and folds change the other lights too.

    shares: (h, w, 3). strength: full price. contrast: difference of log shares, between this light and the
    more similar of the other two, at which a bond falls to 1/e.
    """
    logarithm = np.log(np.maximum(shares, 0.0) + _DARK_SHARE)
    others = [k for k in range(3) if k != light]
    bonds = []
    for axis in (1, 0):
        change = np.diff(logarithm, axis=axis)
        own = change[..., light]
        alone = np.minimum(np.abs(own - change[..., others[0]]), np.abs(own - change[..., others[1]]))
        bond = strength * (_WEAKEST_BOND + (1 - _WEAKEST_BOND) * np.exp(-((alone / contrast) ** 2)))
        inside = mask[:, 1:] & mask[:, :-1] if axis == 1 else mask[1:] & mask[:-1]
        bonds.append(np.pad(bond * inside, ((0, 0), (0, 1)) if axis == 1 else ((0, 1), (0, 0))))
    return bonds[0], bonds[1]
