"""Light that changes slowly over a subject, which no paint does.

Lamps are near: their light changes from one side of the subject to the other, and falls with its depth. To
first order log light changes along rows and columns for each lamp alone, and with the depth, on a body
about a square of the place, for all lamps together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.materials.regions import Regions
from vntoolkit.materials.split_frame import SplitFrame

CHANGES = 9  # numbers that tell it
# Standard deviation of each: of log light from the middle of the subject to its edge. Lamps stand a few
# subjects away.
UNEVEN = 0.1


def changes_of_light(regions: Regions, split: SplitFrame, frames: int) -> FloatArray:
    """Return (n, CHANGES, 3), how log s of each region changes with each number.

    split: so many frames of one size, below each other. Places count from the middle of the subject, in units
    of half its size: the root of three standard deviations, as on a square.
    """
    v, u = np.nonzero(regions.plain)
    of_region = regions.labels[v, u]
    v = v % (split.lit.shape[0] / frames)
    sizes = np.maximum(np.bincount(of_region, minlength=regions.count), 1)
    half = np.sqrt(3.0) * max(u.std(), v.std(), 1.0)
    x, y = (np.bincount(of_region, at - at.mean(), regions.count) / sizes / half for at in (u, v))
    along = np.stack([x, y], axis=1)
    own = np.einsum("np,kl->npkl", along, np.eye(3)).reshape(-1, 6, 3)
    common = np.stack([x * x, x * y, y * y], axis=1)
    return np.concatenate([own, np.repeat(common[..., None], 3, axis=2)], axis=1)


def levelled(regions: Regions, change: FloatArray) -> Regions:
    """Return regions as they would be in even light. change: (n, 3), of log s."""
    share = np.exp(-change)
    planes = regions.planes.copy()
    planes[:, :3] *= share[..., None]
    return replace(regions, samples=regions.samples * share[:, None], planes=planes)
