"""Light beyond what a matte surface returns of the lamps: a black level, daylight, flare, highlights.

Light is never negative, so that a constant on top of a channel is at most the channel's darkest value in the
picture. Whether the darkest values are such a constant, or a backdrop that the lamps light, the subject
tells: a constant adds to the lengths |M⁻¹(r − a)| in a way that M foretells. The log lengths are regressed on
what the darkest values foretell: the slope is 0 where these are the backdrop's alone, and 1 where all of them
lies on the subject too.

Video in the wrong range is told in the same way: where limited range is read as full, black is 16 of 255;
where full range is read as limited, all that was darker than 16 is 0, and contrast is too high.

Gloss: a highlight adds the lamp's colour where the normal is nearly halfway between the directions to the
lamp and to the camera, and pulls normals towards the lamp. Lengths grow there in a way that M, the lamps and
the width of the lobe foretell. The log lengths are regressed on it, beside all that depends on the direction
or the place slowly: faults of M, light from elsewhere, vignetting. The slope is how strong the lobe is, as a
share of the matte light.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.evidence import FEWEST_PIXELS, Evidence, brightest_channel, lengths_of
from vntoolkit.diagnosis.finding import CLEAR_Z, Finding, Level
from vntoolkit.diagnosis.surface_pixels import (
    SurfacePixels,
    regress_lengths,
    spread_of_lengths,
    surface_pixels,
)
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.transfer import encoded_from_linear, linear_from_encoded

_DARKEST_PERCENT = 1.0  # of the picture: single pixels are noise's
_SLOPES = (0.5, 1.6)  # above it the subject has more of it than the darkest place
# A black backdrop proves no stretch. Its size is known: statues with deep folds have 1.4 ± 0.2 to 4.0 ± 0.3.
_SLOPES_OF_STRETCH = (0.8, 1.2)
_NOTED_TURN_DEG = 1.0
# A file of limited range holds black as 16 of 255 and white as 235.
_BLACK, _WHITE, _BESIDE = 16 / 255, 235 / 255, 1 / 255
_EXPONENT = 30  # of the lobe: exponents of 8 to 100 are found with it
# Of stretch and gloss: photographs of plaster and faces, whose parts light each other, reach 6.9 of gloss.
_SURE_Z = 8.0
_LEAST = 0.03  # of the matte light; matte renderings reach 0.015
_PAINTED = 0.12  # spread of log lengths: the glossiest renderings have 0.05, a tartan 0.2
_TAIL, _NOTED_DEG = 95.0, 2.0


def check_black_level(evidence: Evidence) -> list[Finding]:
    """Find light on every pixel that is none of the lamps', and video read in another range than it has."""
    darkest = np.percentile(evidence.light.reshape(-1, 3), _DARKEST_PERCENT, axis=0)
    pixels = surface_pixels(evidence)
    if len(pixels) < FEWEST_PIXELS:
        return []
    for name, undo, slopes, z in _readings(evidence, darkest):
        found = _undoing(pixels, undo)
        if found is not None and max(slopes[0], z * found.error) < found.slope < slopes[1]:
            red, green, blue = (f"{value:.1%}" for value in darkest)
            measured = (
                f"{red} red, {green} green, {blue} blue in the darkest places, {found.slope:.2f} ± "
                f"{found.error:.2f} times what they foretell on the subject: normals turn by "
                f"{found.turn_deg:.1f} degrees"
            )
            return [Finding.of(name, measured=measured)]
    return []


_Undo = Callable[[FloatArray], FloatArray]


def _readings(
    evidence: Evidence, darkest: FloatArray
) -> Iterator[tuple[str, _Undo, tuple[float, float], float]]:
    """Yield the finding, what undoes it, range of slopes and errors from 0, of darkest places (3,)."""
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
            "black-level/limited",
            in_codes(lambda codes: (codes - _BLACK) / stretch),
            _SLOPES,
            CLEAR_Z,
        )
    if np.all(black < 0.5 * _BESIDE):
        yield (
            "black-level/full",
            in_codes(lambda codes: codes * stretch + _BLACK),
            _SLOPES_OF_STRETCH,
            _SURE_Z,
        )
    constant = np.maximum(darkest - evidence.rig.response.ambient, 0.0)
    if constant.any():
        yield "black-level", lambda light: light - constant, _SLOPES, CLEAR_Z


@dataclass(frozen=True, kw_only=True)
class _Undone:
    """slope ± error: of log lengths on what undoing foretells. turn_deg: of normals by it, in the median."""

    slope: float
    error: float
    turn_deg: float


def _undoing(pixels: SurfacePixels, undo: _Undo) -> _Undone | None:
    """Return what tells that light (n, 3) must be undone; None where nothing does, or normals hardly turn."""
    undone = pixels.scaled_normals(undo(pixels.rgb))
    turn_deg = float(np.median(angles_deg(pixels.scaled, undone)))
    if turn_deg < _NOTED_TURN_DEG:
        return None
    # of the directions alone: dark paint is no light that is missing
    colours = pixels.colours(pixels.normals * math.exp(np.median(pixels.log_lengths)))
    foretold = -np.log(np.maximum(lengths_of(pixels.scaled_normals(undo(colours))), 1e-12))
    found = regress_lengths(foretold[:, None], pixels.log_lengths, pixels)
    if found is None:
        return None
    slope, error = float(found.slopes[0]), float(found.errors[0])
    return _Undone(slope=slope, error=error, turn_deg=turn_deg)


def check_gloss(evidence: Evidence) -> list[Finding]:
    """Find highlights of the lamps on the subject."""
    pixels = surface_pixels(evidence)
    if len(pixels) < FEWEST_PIXELS or spread_of_lengths(pixels.scaled, pixels.frames) > _PAINTED:
        return []
    normals = pixels.normals
    added = _highlights(evidence, pixels, normals)
    longer = (added * normals).sum(axis=1)
    slowly = [*normals.T[:2], *pixels.of_wrong_m, *pixels.of_uneven_light]
    found = regress_lengths(np.column_stack([longer, *slowly]), pixels.log_lengths, pixels)
    if found is None:
        return []
    strength, error = float(found.slopes[0]), max(float(found.errors[0]), 1e-3)
    if strength < max(_LEAST, _SURE_Z * error):
        return []
    turns = strength * lengths_of(added - longer[:, None] * normals)
    turn_deg = float(np.degrees(np.percentile(turns, _TAIL)))
    level = Level.WARNING if turn_deg > _NOTED_DEG else Level.NOTE
    return [Finding.of("gloss", level=level, turn_deg=turn_deg, strength=strength, error=error)]


def _highlights(evidence: Evidence, pixels: SurfacePixels, normals: FloatArray) -> FloatArray:
    """Return what lobes of strength 1 add to M⁻¹(r − a) over the albedo, (n, 3)."""
    response, camera = evidence.rig.response, evidence.rig.camera
    view = np.tile([0.0, 0.0, -1.0], (len(normals), 1))
    if camera.is_perspective:
        half = max(camera.width, camera.height) / 2
        view[:, :2] = -pixels.positions * half / camera.matrix[[0, 1], [0, 1]]
        view /= lengths_of(view)[:, None]
    halfway = response.light_directions + view[:, None]  # (n, 3 lamps, 3)
    cosines = np.einsum("ni,nki->nk", normals, halfway) / np.linalg.norm(halfway, axis=2)
    lobes = np.maximum(cosines, 0.0) ** _EXPONENT
    strengths = np.linalg.norm(response.lights, axis=1)
    return np.asarray((lobes * strengths) @ np.linalg.inv(response.lights).T)
