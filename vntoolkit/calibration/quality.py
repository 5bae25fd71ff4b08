"""How well a light response is determined: residual, condition number, cone of normals."""

from __future__ import annotations

import logging

import numpy as np

from vntoolkit.arrays import Points, Points2
from vntoolkit.photometry.lambertian import scaled_normals_from_rgb
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality

logger = logging.getLogger(__name__)

_NARROW_CONE_DEG = 20.0  # half-angle: narrower, a percent of noise in the colours tilts M by degrees
_LARGE_CONDITION_NUMBER = 30.0
_SHARE_IN_CONE = 95.0


def fit_quality(
    normals: Points, rgb: Points, response: LightResponse, method: str, positions_px: Points2 | None = None
) -> FitQuality:
    """Measure a fit on the pairs it used, normals and colours (n, 3), at pixels (n, 2) where it varies."""
    recovered = scaled_normals_from_rgb(rgb, response, positions_px)
    return FitQuality(
        method=method,
        residual_deg=float(np.median(angles_deg(recovered, normals))),
        condition_number=response.condition_number,
        samples=len(normals),
        cone_deg=cone_of_normals_deg(normals),
    )


def angles_deg(first: Points, second: Points) -> Points:
    """Angle in degrees between corresponding vectors of any length, (n, 3) each; exact near 0."""
    cross = np.linalg.norm(np.cross(first, second), axis=-1)
    return np.rad2deg(np.arctan2(cross, np.sum(first * second, axis=-1)))


def cone_of_normals_deg(normals: Points) -> float:
    """Half-angle of the narrowest cone about the mean direction that holds 95 % of the normals (n, 3)."""
    axis = normals.mean(axis=0)
    return float(np.percentile(angles_deg(normals, np.broadcast_to(axis, normals.shape)), _SHARE_IN_CONE))


def warn_of_weak_fit(quality: FitQuality) -> None:
    """Log a warning where the normals span too narrow a cone or M is badly conditioned."""
    if quality.cone_deg < _NARROW_CONE_DEG:
        logger.warning(
            "the normals seen lie within %.0f degrees of their mean: the light response beyond that is a "
            "guess; tilt the target further (at least %.0f degrees)",
            quality.cone_deg,
            _NARROW_CONE_DEG,
        )
    if quality.condition_number > _LARGE_CONDITION_NUMBER:
        logger.warning(
            "M has condition number %.0f: noise is amplified as much; move the lights further apart or make "
            "their colours purer (below 10 is good)",
            quality.condition_number,
        )
