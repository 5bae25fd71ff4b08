"""What the whole surface may do beside the prior of its edges: stretch, shear and turn.

The prior alone would need hundreds of fits to follow a turn: it reads surface and surroundings where they
were.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray

# Standard deviation of stretch and shear, where none is measured: cloth has 0.03 to 0.1, skin up to 0.3.
STRAIN = 0.07
_TURN = 0.1  # the same of a turn in one step of the fit, radians


def modes_of_the_whole(
    steps: FloatArray, middles: FloatArray
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return what the whole may do beside the prior: (edges, 2, k) by unit, (k,) inverse variances of it.

    It stretches and shears, and turns in the image. steps: (edges, 2) as foreseen. middles: (edges, 2) of the
    edges, pixels.
    """
    strains, turns = uniform_strains(steps), slow_turns(steps, middles)
    precision = np.repeat([STRAIN**-2, _TURN**-2], [strains.shape[2], turns.shape[2]])
    return np.concatenate([strains, turns], axis=2), precision


def uniform_strains(steps: FloatArray) -> npt.NDArray[np.float64]:
    """Return (edges, 2, 3) what stretch along u, along v, and shear of the whole add to steps (edges, 2)."""
    x, y = steps.T
    none = np.zeros_like(x)
    return np.stack([np.stack(mode, axis=1) for mode in ((x, none), (none, y), (y, x))], axis=2)


def slow_turns(steps: FloatArray, centres: FloatArray) -> npt.NDArray[np.float64]:
    """Return (edges, 2, k): what slow turns of 1 radian, one a monomial, add to steps (edges, 2).

    centres: (edges, 2), middles of the edges in pixels.
    """
    if len(steps) == 0:
        return np.zeros((0, 2, 0))
    across = np.stack([-steps[:, 1], steps[:, 0]], axis=1)
    return across[:, :, None] * slow_monomials(centres)[:, None, :]


def slow_monomials(places: FloatArray) -> npt.NDArray[np.float64]:
    """Return (m, 6) the monomials of places (m, 2) that vary slowly over the figure, up to squares."""
    x, y = ((places - places.mean(axis=0)) / np.maximum(places.std(axis=0), 1.0)).T
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
