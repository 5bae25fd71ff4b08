"""The light response from known lights, and M split into its lights by frames that one lamp lights alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Mask, Matrix3, Points, Vector3
from vntoolkit.calibration.fit import warn_of_weak_fit
from vntoolkit.checks import require_finite, require_positive, require_same_size, require_shape
from vntoolkit.errors import BadCalibration, BadRig
from vntoolkit.options.calibration import LightColours
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality

_LIT_SHARE = 0.3  # of the brightest: darker pixels carry more noise and stray light than colour
_MOST_ALIKE = 20.0  # condition number of the three unit colours
_PASSES = 4
_NAMES = ("red", "green", "blue")
_LEAST_FACING = 0.03  # share of the strongest lamp's light that any lamp sends to a surface facing the camera
_MOST_PIXELS = 20_000  # of a frame whose colours are looked at
_LEAST_STRENGTH = 0.05  # of the brightest frame's: darker ones tell no colour
_LEAST_SPREAD = 0.3  # of the colours of all frames together: below it a frame's colours lie on a line
_SAME_DEG = 2.0  # between colours of one lamp in two frames
_STEADY = 0.1  # change of strength while a lamp is on; a lamp that comes or goes changes more
_DARK = 0.2  # of the weakest lamp's strength: no lamp is on
_MOST_CLUSTERS = 12
_MOST_FRAMES = 1000  # whose colours are compared with each other


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
    colours = np.array([_colour_of_photograph(f, mask, name) for f, name in zip(frames, _NAMES, strict=True)])
    condition = float(np.linalg.cond(colours))
    if not condition < _MOST_ALIKE:
        raise BadCalibration(
            f"light colours: two of the lights have nearly the same colour (condition number "
            f"{condition:.0f}); is each photograph lit by another light?"
        )
    return colours


def with_light_colours(response: LightResponse, unit_colours: Matrix3) -> LightResponse:
    """Return the response with M split as Σ c_k l_kᵀ: c_k parallel to `unit_colours`, |l_k| = 1.

    Raises `BadCalibration` where a lamp then would not light a surface that faces the camera.
    """
    lights = np.linalg.solve(np.asarray(unit_colours, dtype=np.float64).T, response.matrix)
    facing = -lights[:, 2]
    if not (facing > _LEAST_FACING * facing.max()).all():
        raise BadCalibration(
            f"light colours: split by them, M has a {_NAMES[int(facing.argmin())]} lamp that does not light "
            "what faces the camera; is each photograph lit by one lamp alone, the same lamps as M's?"
        )
    strengths = np.linalg.norm(lights, axis=1)
    return replace(response, light_colours=strengths[:, None] * unit_colours)


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameColour:
    """The colours of one frame. moments: (3, 3), mean of r rᵀ over its pixels that are not clipped."""

    number: int
    moments: Matrix3


@dataclass(frozen=True, kw_only=True)
class SwitchedLamps:
    """Numbers of the frames that the red, the green and the blue lamp light alone, and that none lights."""

    alone: tuple[list[int], list[int], list[int]]
    dark: list[int]


def colour_of_frame(frame: LinearFrame, mask: Mask | None = None) -> FrameColour:
    """Return what `find_switched_lamps` needs of a frame. mask: (h, w) of the object."""
    inside = ~frame.clipped if mask is None else mask & ~frame.clipped
    pixels = frame.rgb[inside]
    pixels = pixels[:: max(1, len(pixels) // _MOST_PIXELS)].astype(np.float64)
    return FrameColour(number=frame.number, moments=pixels.T @ pixels / max(len(pixels), 1))


def find_switched_lamps(colours: Sequence[FrameColour]) -> SwitchedLamps | None:
    """Find the frames of one object that are lit by one lamp alone, None where there are none.

    Under one lamp all colours of a frame are multiples of one. The object shows many normals, so that under
    several lamps they are not. Raises `BadCalibration` where single lamps are seen, but not three.
    """
    moments = np.array([colour.moments for colour in colours])
    values, vectors = np.linalg.eigh(moments)
    strengths = np.sqrt(np.maximum(values.sum(axis=1), 0.0))
    lit = strengths > _LEAST_STRENGTH * strengths.max()
    spreads = np.sqrt(np.maximum(values[:, 1], 0.0) / np.maximum(values[:, 2], 1e-12))
    together = np.linalg.eigvalsh(moments.sum(axis=0))
    alone = lit & (spreads < _LEAST_SPREAD * np.sqrt(max(together[1], 0.0) / max(together[2], 1e-12)))
    if not alone.any():
        return None
    directions = vectors[:, :, 2] * np.sign(vectors[:, :, 2].sum(axis=1, keepdims=True))
    lamps = three_lamps(directions[alone])
    if lamps is None:
        raise BadCalibration(
            f"light colours: in {int(alone.sum())} of {len(colours)} frames one lamp is on alone, but not "
            "each of the three; show every lamp alone for a moment, or leave these frames out with --frames"
        )
    numbers = np.array([colour.number for colour in colours])
    found, weakest = [], np.inf
    for k in range(3):
        mine = np.flatnonzero(alone)[lamps == k]
        usual = float(np.median(strengths[mine]))
        weakest = min(weakest, usual)
        found.append(numbers[mine[np.abs(strengths[mine] / usual - 1.0) <= _STEADY]].tolist())
    dark = numbers[strengths < _DARK * weakest].tolist()
    return SwitchedLamps(alone=(found[0], found[1], found[2]), dark=dark)


def three_lamps(directions: Points) -> IntArray | None:
    """(n,) number of the lamp, red, green, blue, of each unit colour (n, 3), −1 of none; None without three.

    Colours under several lamps are mixtures of those under one. So the lamps are the three colours, of those
    that many frames share, that span the largest triangle of all.
    """
    some = directions[:: 1 + len(directions) // _MOST_FRAMES]
    near = some @ some.T > np.cos(np.radians(_SAME_DEG))
    free = np.ones(len(some), np.bool_)
    centres: list[Vector3] = []
    while free.any() and len(centres) < _MOST_CLUSTERS:
        first = int(np.argmax((near & free).sum(axis=1) * free))
        if (near[first] & free).sum() < 1 + len(some) // 50:
            break
        centre = np.median(some[near[first] & free], axis=0)
        centres.append(centre / centre.sum())
        free &= ~near[first]
    best = max(combinations(centres, 3), key=lambda c: abs(np.linalg.det(c)), default=None)
    if best is None:
        return None
    order = max(permutations(best), key=lambda c: float(np.trace(np.array(c))))
    units = np.array(order) / np.linalg.norm(order, axis=1, keepdims=True)
    if not np.linalg.cond(units) < _MOST_ALIKE:
        return None
    closeness = directions @ units.T
    return np.where(
        closeness.max(axis=1) > np.cos(np.radians(_SAME_DEG)), closeness.argmax(axis=1), -1
    ).astype(np.int64)


def _colour_of_photograph(frame: LinearFrame, mask: Mask | None, name: str) -> Vector3:
    inside = ~frame.clipped
    if mask is not None:
        require_same_size(mask, "mask", frame.rgb, f"photograph of the {name} light")
        inside = inside & mask
    pixels = frame.rgb[inside].astype(np.float64)
    lengths = np.linalg.norm(pixels, axis=1)
    top = float(np.percentile(lengths, 99)) if len(lengths) else 0.0
    if not top > 1e-3:
        raise BadCalibration(f"light colours: the photograph of the {name} light is black or clipped")
    return line_colour(pixels[lengths > _LIT_SHARE * top])


def line_colour(pixels: Points) -> Vector3:
    """Unit colour that pixels (n, 3) under one lamp are multiples of; those off the line are left out."""
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
