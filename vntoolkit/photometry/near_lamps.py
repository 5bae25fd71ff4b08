"""How M changes over the picture where lamps stand near: directions turn, and light falls off with distance.

A lamp in the direction l, at the distance d from the surface at the picture's centre, has at a place δ beside
it, to first order in δ / d, the direction times strength l + (3 l (l·δ) − δ) / d.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.photometry.response import LightResponse, ResponseVariation, powers_to_degree


def changes_of_near_lamps(response: LightResponse) -> FloatArray:
    """Return how M changes a step to the right and a step down, for each lamp, (2, 3, 3, 3).

    A step as long as the lamp is far. Element [axis, lamp] is (3, 3), a change of M.
    """
    directions = response.light_directions
    strengths = np.linalg.norm(response.lights, axis=1)[:, None]
    changes = strengths * (3 * directions.T[:2, :, None] * directions - np.eye(3)[:2, None])  # (2, lamp, 3)
    return np.einsum("ik,akj->akij", np.linalg.inv(response.contributions_from_rgb), changes)


def with_near_lamps(response: LightResponse, nearness: float, size: tuple[int, int]) -> LightResponse:
    """Return the response of the picture's centre with the change over the picture that near lamps make.

    nearness: half of the picture's larger side, at the surface, over the lamps' distance. size: width and
    height of the picture in pixels.
    """
    matrices = nearness * changes_of_near_lamps(response).sum(axis=1)
    variation = ResponseVariation(
        powers=powers_to_degree(1),
        matrices=matrices,
        ambients=np.zeros((2, 3)),
        centre_px=(np.array(size) - 1) / 2,
        scale_px=max(size) / 2,
    )
    return replace(response, variation=variation)
