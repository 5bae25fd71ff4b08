"""M taken apart into light colours and directions, from photographs under one light at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vntoolkit.arrays import Mask, Matrix3, Points, Vector3
from vntoolkit.checks import require_same_size
from vntoolkit.errors import BadCalibration
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

_LIT_SHARE = 0.3  # of the brightest: darker pixels carry more noise and stray light than colour
_MOST_ALIKE = 20.0  # condition number of the three unit colours
_PASSES = 4

_NAMES = ("red", "green", "blue")


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
    """Return the response with M = Σ c_k l_kᵀ taken apart: c_k along `unit_colours`, so that |l_k| = 1."""
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
