"""How well a light response is determined: the angle that it leaves, the cone of normals, its condition."""

import logging

import numpy as np

from vntoolkit.arrays import FloatArray, Points, Vectors
from vntoolkit.photometry.rig import FitQuality

logger = logging.getLogger(__name__)
NARROW_CONE_DEG = 20.0  # half-angle: narrower, a percent of noise in the colours tilts M by degrees
LARGE_CONDITION_NUMBER = 30.0  # noise of one grey level turns a normal by some ten degrees
_SHARE_IN_CONE = 95.0


def angles_deg(first: Vectors, second: Vectors) -> FloatArray:
    """Angle in degrees between corresponding vectors of any length, (..., 3) each; exact near 0.

    90 where one of them is 0, as a normal is that was not found.
    """
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    across, along = np.linalg.norm(np.cross(first, second), axis=-1), np.sum(first * second, axis=-1)
    return np.where((across == 0) & (along == 0), 90.0, np.rad2deg(np.arctan2(across, along)))


def cone_of_normals_deg(normals: Points) -> float:
    """Half-angle of the narrowest cone about the mean direction that holds 95 % of the normals (n, 3)."""
    axis = normals.mean(axis=0)
    return float(np.percentile(angles_deg(normals, np.broadcast_to(axis, normals.shape)), _SHARE_IN_CONE))


def warn_of_weak_fit(quality: FitQuality) -> None:
    """Log a warning where the normals span too narrow a cone or M is badly conditioned."""
    if quality.cone_deg < NARROW_CONE_DEG:
        logger.warning(
            "the normals seen lie within %.0f degrees of their mean: the light response beyond that is a "
            "guess; tilt the target further (at least %.0f degrees)",
            quality.cone_deg,
            NARROW_CONE_DEG,
        )
    if quality.condition_number > LARGE_CONDITION_NUMBER:
        logger.warning(
            "M has condition number %.0f: noise is amplified as much; move the lights further apart or make "
            "their colours purer (below 10 is good)",
            quality.condition_number,
        )
