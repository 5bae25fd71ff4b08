"""The light response from known lights, and M split into its lights by single-light photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Matrix3, Points, Vector3
from vntoolkit.calibration.fit import warn_of_weak_fit
from vntoolkit.checks import require_finite, require_positive, require_same_size, require_shape
from vntoolkit.errors import BadCalibration, BadRig
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality

_LIT_SHARE = 0.3  # of the brightest: darker pixels carry more noise and stray light than colour
_MOST_ALIKE = 20.0  # condition number of the three unit colours
_PASSES = 4
_NAMES = ("red", "green", "blue")


class LightColours(Enum):
    """Which colours the lights have."""

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


def fit_light_colours(frames: Sequence[LinearFrame], mask: Mask | None = None) -> Matrix3:
    """Unit colour of each light, one row per frame, from three photographs of one material.

    Under one light every pixel is a multiple of that light's colour as the material returns it: its direction
    in colour space is the first singular vector of the lit pixels that lie along their median direction.
    Raises `BadCalibration` for another number of frames, a dark one, or lights of nearly one colour.
    """
    if len(frames) != 3:
        raise BadCalibration(f"light colours: expected three photographs, one per light, got {len(frames)}")
    colours = np.array([_line_colour(f, mask, name) for f, name in zip(frames, _NAMES, strict=True)])
    condition = float(np.linalg.cond(colours))
    if not condition < _MOST_ALIKE:
        raise BadCalibration(
            f"light colours: two of the lights have nearly the same colour (condition number "
            f"{condition:.0f}); is each photograph lit by another light?"
        )
    return colours


def with_light_colours(response: LightResponse, unit_colours: Matrix3) -> LightResponse:
    """Return the response with M split as Σ c_k l_kᵀ: c_k parallel to `unit_colours`, |l_k| = 1."""
    lights = np.linalg.solve(np.asarray(unit_colours, dtype=np.float64).T, response.matrix)
    strengths = np.linalg.norm(lights, axis=1)
    return replace(response, light_colours=strengths[:, None] * unit_colours)


def _line_colour(frame: LinearFrame, mask: Mask | None, name: str) -> Vector3:
    inside = ~frame.clipped
    if mask is not None:
        require_same_size(mask, "mask", frame.rgb, f"photograph of the {name} light")
        inside = inside & mask
    pixels = frame.rgb[inside].astype(np.float64)
    lengths = np.linalg.norm(pixels, axis=1)
    top = float(np.percentile(lengths, 99)) if len(lengths) else 0.0
    if not top > 1e-3:
        raise BadCalibration(f"light colours: the photograph of the {name} light is black or clipped")
    pixels = pixels[lengths > _LIT_SHARE * top]
    colour = np.median(pixels / np.linalg.norm(pixels, axis=1, keepdims=True), axis=0)  # gloss is a minority
    colour /= np.linalg.norm(colour)
    for _ in range(_PASSES):
        off = np.linalg.norm(pixels - np.outer(pixels @ colour, colour), axis=1)
        off /= np.linalg.norm(pixels, axis=1)
        colour = _first_direction(pixels[off <= 3 * max(float(np.median(off)), 1e-9)])
    return colour


def _first_direction(pixels: Points) -> Vector3:
    direction = np.linalg.eigh(pixels.T @ pixels)[1][:, -1]
    return direction * np.sign(direction.sum())
