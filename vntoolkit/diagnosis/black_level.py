"""Does light that is none of the lamps' reach every pixel: a black level, daylight, flare of the lens?

Light is never negative, so that a constant on top of a channel is at most the channel's darkest value in the
picture. Whether the darkest values are such a constant, or a backdrop that the lamps light, the subject
tells: a constant adds to the lengths |M⁻¹(r − a)| in a way that M foretells. The log lengths are regressed on
what the darkest values foretell: the slope is 0 where these are the backdrop's alone, and 1 where all of them
lies on the subject too.

Video in the wrong range is told in the same way: where limited range is read as full, black is 16 of 255;
where full range is read as limited, all that was darker than 16 is 0, and contrast is too high.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.evidence import Evidence, brightest_channel, lengths_of
from vntoolkit.diagnosis.finding import Finding, Level, certainty_from_z
from vntoolkit.diagnosis.surface_pixels import SurfacePixels, regress_lengths, surface_pixels
from vntoolkit.photometry.transfer import encoded_from_linear, linear_from_encoded

_DARKEST_PERCENT = 1.0  # of the picture: single pixels are noise's
_FEWEST_PIXELS = 400
_ROUNDS = 4
_Z = 4.0
_SLOPES = (0.5, 1.6)  # above it the subject has more of it than the darkest place
# A black backdrop proves no stretch. Its size is known: statues with deep folds have 1.4 ± 0.2 to 4.0 ± 0.3.
_SLOPES_OF_STRETCH, _Z_OF_STRETCH = (0.8, 1.2), 8.0
_NOTED_TURN_DEG = 1.0
# A file of limited range holds black as 16 of 255 and white as 235.
_BLACK, _WHITE, _BESIDE = 16 / 255, 235 / 255, 1 / 255


def check_black_level(evidence: Evidence) -> list[Finding]:
    """Find light on every pixel that is none of the lamps', and video read in another range than it has."""
    darkest = np.percentile(evidence.light.reshape(-1, 3), _DARKEST_PERCENT, axis=0)
    pixels = surface_pixels(evidence, lambda k, _: evidence.surface[k])
    if len(pixels) < _FEWEST_PIXELS:
        return []
    for problem, remedy, undo, slopes, z in _readings(evidence, darkest):
        found = _undoing(pixels, undo)
        if found is not None and max(slopes[0], z * found.error) < found.slope < slopes[1]:
            return [_finding(problem, remedy, darkest, found)]
    return []


_Undo = Callable[[FloatArray], FloatArray]


def _readings(
    evidence: Evidence, darkest: FloatArray
) -> Iterator[tuple[str, str, _Undo, tuple[float, float], float]]:
    """Yield what the darkest places, (3,), may come of.

    The problem, its remedy, what undoes it, between which slopes, and by how many errors from 0, it is told.
    """
    transfer = evidence.transfer
    black = encoded_from_linear(darkest, transfer)
    white = encoded_from_linear(np.array([brightest_channel(evidence.light).max()]), transfer)[0]
    stretch = _WHITE - _BLACK

    def in_codes(change: _Undo) -> _Undo:
        return lambda light: linear_from_encoded(
            np.clip(change(encoded_from_linear(np.maximum(light, 0.0), transfer)), 0.0, 1.0), transfer
        )

    if np.all(np.abs(black - _BLACK) < _BESIDE) and white < _WHITE + _BESIDE:
        yield (
            "the footage looks of limited range, read as full",
            "convert it with ffmpeg -vf scale=in_range=limited:out_range=full",
            in_codes(lambda codes: (codes - _BLACK) / stretch),
            _SLOPES,
            _Z,
        )
    if np.all(black < 0.5 * _BESIDE):
        yield (
            "the footage looks of full range, read as limited",
            "mark the file as of full range (ffmpeg -c copy -color_range pc, or a re-encoding with "
            "scale=in_range=full)",
            in_codes(lambda codes: codes * stretch + _BLACK),
            _SLOPES_OF_STRETCH,
            _Z_OF_STRETCH,
        )
    constant = np.maximum(darkest - evidence.rig.response.ambient, 0.0)
    if constant.any():
        yield (
            "light that is none of the lamps' lies on the whole picture, the subject too",
            "darken the room and shade the lens, or film once with the lamps off and give that picture with "
            "--background",
            lambda light: light - constant,
            _SLOPES,
            _Z,
        )


def _finding(problem: str, remedy: str, darkest: FloatArray, found: _Undone) -> Finding:
    red, green, blue = (f"{value:.1%}" for value in darkest)
    return Finding(
        check="black-level",
        level=Level.WARNING,
        problem=problem,
        measured=f"{red} red, {green} green, {blue} blue in the darkest places, {found.slope:.2f} ± "
        f"{found.error:.2f} times what they foretell on the subject: normals turn by {found.turn_deg:.1f} "
        "degrees",
        expected="0 times",
        remedy=remedy,
        certainty=certainty_from_z(found.slope / max(found.error, 1e-6)),
    )


@dataclass(frozen=True, kw_only=True)
class _Undone:
    """slope ± error: of log lengths on what undoing foretells. turn_deg: of normals by it, in the median."""

    slope: float
    error: float
    turn_deg: float


def _undoing(pixels: SurfacePixels, undo: _Undo) -> _Undone | None:
    """Return what tells that light (n, 3) must be undone; None where nothing does, or normals hardly turn."""
    scaled, undone = pixels.scaled_normals(pixels.rgb), pixels.scaled_normals(undo(pixels.rgb))
    lengths = np.maximum(lengths_of(scaled), 1e-12)
    cosines = (scaled * undone).sum(axis=1) / (lengths * np.maximum(lengths_of(undone), 1e-12))
    turn_deg = math.degrees(float(np.median(np.arccos(np.clip(cosines, -1.0, 1.0)))))
    if turn_deg < _NOTED_TURN_DEG:
        return None
    # of the directions alone: dark paint is no light that is missing
    colours = pixels.colours(scaled * (np.median(lengths) / lengths)[:, None])
    foretold = -np.log(np.maximum(lengths_of(pixels.scaled_normals(undo(colours))), 1e-12))
    found = regress_lengths(foretold[:, None], np.log(lengths), pixels, _ROUNDS)
    if found is None:
        return None
    slope, error = float(found.slopes[0]), float(found.errors[0])
    return _Undone(slope=slope, error=error, turn_deg=turn_deg)
