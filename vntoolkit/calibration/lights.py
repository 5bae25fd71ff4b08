"""The light response of a rig whose lights are known: nothing is fitted."""

from __future__ import annotations

from enum import Enum

import numpy as np

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.calibration.quality import warn_of_weak_fit
from vntoolkit.checks import require_finite, require_positive, require_shape
from vntoolkit.errors import BadCalibration, BadRig
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality


class LightColours(Enum):
    """What colour the lights have."""

    GIVEN = "given"  # each row of intensities is the light's red, green and blue
    CHANNELS = "channels"  # light k alone is seen by channel k: three photographs stacked as one


def response_from_lights(
    directions: Points, intensities: Points | None, colours: LightColours, albedo: float = 1.0
) -> tuple[LightResponse, FitQuality]:
    """M = albedo Σ c_k l_kᵀ from three directions (3, 3), camera frame, and intensities (3, 3) RGB or None.

    Under `CHANNELS` the strength of light k is its intensity in channel k. The quality carries M's
    condition number; samples = 0 says that nothing was fitted. Raises `BadCalibration` where M is singular.
    """
    require_positive(albedo, "calibrate lights: albedo")
    directions = np.asarray(directions, dtype=np.float64)
    require_shape(directions, (3, 3), "light directions")
    require_finite(directions, "light directions")
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    if not (lengths > 0).all():
        raise BadCalibration("calibrate lights: a light direction has length 0")
    light_colours = _colours(intensities, colours) * albedo
    try:
        response = LightResponse(matrix=light_colours.T @ (directions / lengths), light_colours=light_colours)
    except (BadRig, np.linalg.LinAlgError) as error:
        raise BadCalibration(f"calibrate lights: {error}") from error
    quality = FitQuality(
        method="lights",
        residual_deg=0.0,
        condition_number=response.condition_number,
        samples=0,
        cone_deg=90.0,
    )
    warn_of_weak_fit(quality)
    return response, quality


def _colours(intensities: Points | None, colours: LightColours) -> FloatArray:
    if intensities is None:
        if colours is LightColours.GIVEN:
            raise BadCalibration(
                "calibrate lights: no intensities were given; add them (red, green, blue per light) or say "
                "that channel k sees light k alone with --light-colours channels"
            )
        return np.eye(3)
    intensities = np.asarray(intensities, dtype=np.float64)
    require_shape(intensities, (3, 3), "light intensities")
    require_finite(intensities, "light intensities")
    if not ((intensities >= 0).all() and (intensities.max(axis=1) > 0).all()):
        raise BadCalibration("calibrate lights: intensities must not be negative, nor all 0 for a light")
    return np.diag(np.diag(intensities)) if colours is LightColours.CHANNELS else intensities
