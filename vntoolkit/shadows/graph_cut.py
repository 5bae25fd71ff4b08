"""One binary label per pixel, smooth over the image, by a minimum cut (boykov2001)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask

_WEAKEST_BOND = 0.05  # share of the full price that a change of label across a sharp edge still costs
_DARK_SHARE = 0.03  # added to a share before its logarithm: noise is no edge


def lit_by_cut(
    evidence: FloatArray, bonds: tuple[FloatArray, FloatArray], mask: Mask
) -> npt.NDArray[np.bool_]:
    """Minimise Σ |evidence| over pixels labelled against it plus the bonds cut.

    evidence: (h, w), positive speaks for light, negative for shadow. bonds: to the east and to the south
    neighbour, (h, w) each, the price of a change there. Returns (h, w), True where lit (and outside `mask`).
    """
    import maxflow

    speaks = np.where(mask, evidence, 0.0).astype(np.float64)
    if not (speaks < 0).any():
        return np.ones(mask.shape, dtype=np.bool_)
    if not (speaks > 0).any():
        return ~mask
    graph = maxflow.GraphFloat()
    nodes = graph.add_grid_nodes(mask.shape)
    east, south = np.zeros((3, 3)), np.zeros((3, 3))
    east[1, 2] = south[2, 1] = 1
    graph.add_grid_edges(nodes, weights=bonds[0], structure=east, symmetric=True)
    graph.add_grid_edges(nodes, weights=bonds[1], structure=south, symmetric=True)
    graph.add_grid_tedges(nodes, np.maximum(speaks, 0.0), np.maximum(-speaks, 0.0))
    graph.maxflow()
    return ~graph.get_grid_segments(nodes) | ~mask


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
