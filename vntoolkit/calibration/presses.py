"""Calibration of a tactile sensor on presses of a ball of known radius into its gel.

The camera looks at the gel from behind, so the dent bulges towards it and inside the contact circle it is
the ball's own surface (Johnson and Adelson, Retrographic sensing for the measurement of surface texture
and shape, 2009, johnson2009). Of each frame, its change against the untouched gel is used, the drift of the
light removed: d = M (n − n0), n0 = the flat gel's normal.

M n0 is known, the colour of the untouched gel, so only M's columns of n_x and n_y are fitted. What the lamps'
nearness adds is a polynomial in M⁻¹ d and the place (`GelResponse`), fitted to all presses together. How
freely it may bend is chosen by cross-validation: the strength of its ridge is the one that predicts presses
left out of the fit best. A single press leaves M alone.

Labels may lie beside the dent by the same few pixels in every frame (a crop, another rectification), and
each by a few more (a hand, a circle fit). The middle of a dent is flat and has no change of colour, whatever
M is, so that an offset shows as a tilt. `LabelOffset.COMMON` fits the common one; then each circle moves to
where the response sees its ball, and the response is fitted again.
"""

import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import fft

from vntoolkit.arrays import (
    Array,
    BoolArray,
    FloatArray,
    Int64Array,
    LinearImage,
    Mask,
    Points,
    Points2,
    Vector3,
)
from vntoolkit.calibration import fit as fits
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadCalibration
from vntoolkit.options.calibration import LabelOffset, PressOptions
from vntoolkit.photometry import gel as gels
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality

_UNTOUCHED_RADII = 3.3  # of the labelled contact: beyond it the gel lies flat, by half a radius to spare
_FLAT_RADII = 2.8  # of the contact where it really is, which may be half a radius from its label
_DRAWN_RADII = 1.25  # of the labelled contact: room for labels that lie beside the dent
logger = logging.getLogger(__name__)
_ROUNDS = 30
_PAIRS = 24_000  # more refine nothing
_PAIRS_OF_OFFSET = 6_000
_OFFSET_ROUNDS = 20
_SETTLED_PX = 0.05
_FEWEST_OF_CENTRE = 20  # pixels of a contact, or its circle stays where it is
_FAR_OFF = 3.0  # times the median distance of dents from labels: a slip of the hand
_CENTRE_ROUNDS = 3  # fits of the response, each after the circles have moved; a fourth moves them no more
_LARGEST_OFFSET_RADII = 0.5  # of the median contact: beyond it the labels mean something else
_NOTABLE_PX = 1.0
_STRENGTHS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)  # of the ridge, as the share of one press's pairs
_FOLDS = 10
_SOFT = np.deg2rad(8.0) / 2  # in s, half an angle: pairs with a larger residual count less and less
_REWEIGHTINGS = 4
_ERROR_GROUPS = 12  # of held-back pairs, by tilt: some hundreds in each after ten presses
_REACH_PERCENTILE = 99.5  # of the lengths of m seen


@dataclass(frozen=True, kw_only=True)
class Press:
    """One press as labelled: centre (u, v) and radius of the contact circle, pixels."""

    u_px: float
    v_px: float
    radius_px: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PressSamples:
    """Pixels of one frame, at and around the contact and, far away, on the flat gel.

    rgb: (n, 3) change of colour against the untouched gel. untouched: (n, 3), the gel's own colour there.
    positions_px: (n, 2). press: as labelled.
    """

    rgb: Points
    untouched: Points
    positions_px: Points2
    press: Press

    def offsets_px(self, label_offset_px: FloatArray) -> Points2:
        """From the centre of the ball, (n, 2), where the label is off by `label_offset_px`, (2,)."""
        return self.positions_px - (self.press.u_px, self.press.v_px) - label_offset_px


@dataclass(frozen=True, kw_only=True, eq=False)
class PressPairs:
    """Pairs of normal and change of colour: normals, rgb (n, 3), positions_px (n, 2), touched (n,) bool.

    presses: (n,) number of the press that a pair is of.
    """

    normals: Points
    rgb: Points
    positions_px: Points2
    touched: BoolArray
    presses: Int64Array

    def thinned(self, count: int) -> "PressPairs":
        """Every k-th pair, so that about `count` are left."""
        step = max(1, -(-len(self.rgb) // count))
        return PressPairs(**{name: values[::step] for name, values in vars(self).items()})


def normals_of_press(press: Press, options: PressOptions, shape: tuple[int, int]) -> tuple[Points, Mask]:
    """Normals (h, w, 3), camera frame, and the mask of the contact. Raises where the contact is too wide."""
    v, u = np.indices(shape)
    offset_mm = np.stack([u - press.u_px, v - press.v_px], axis=-1) * options.pixel_mm
    distance = np.linalg.norm(offset_mm, axis=-1)
    contact_mm = press.radius_px * options.pixel_mm
    if contact_mm >= options.ball_radius_mm:
        raise BadCalibration(
            f"calibrate presses: a contact circle of {contact_mm:.2f} mm is not narrower than the ball of "
            f"{options.ball_radius_mm:g} mm radius; check --ball-radius-mm and --pixel-mm"
        )
    inside = distance < options.contact_share * contact_mm
    height = np.sqrt(np.maximum(options.ball_radius_mm**2 - distance**2, 0))
    normals = np.concatenate([offset_mm, -height[..., None]], axis=-1) / options.ball_radius_mm
    return normals, inside


def samples_from_press(
    change: LinearImage,
    background: LinearImage,
    usable: Mask,
    press: Press,
    options: PressOptions,
    rng: np.random.Generator,
) -> PressSamples:
    """Draw pixels of the contact and of the flat gel around it.

    change: (h, w, 3), the frame less the untouched gel, its drift removed. background: (h, w, 3), the
    untouched gel. usable: (h, w), pixels that count.
    """
    shape = usable.shape
    require_shape(change, (*shape, 3), "change of colour")
    require_shape(background, (*shape, 3), "background")
    normals_of_press(press, options, shape)  # refuses a contact that the ball cannot have
    v, u = np.indices(shape)
    distance = np.hypot(u - press.u_px, v - press.v_px)
    contact = _draw((distance < _DRAWN_RADII * press.radius_px) & usable, 2 * options.samples, rng)
    flat = (distance > _UNTOUCHED_RADII * press.radius_px) & usable
    chosen = np.concatenate([contact, _draw(flat, round(options.flat_share * options.samples), rng)])
    rows, columns = np.divmod(chosen, shape[1])
    return PressSamples(
        rgb=change[rows, columns].astype(np.float64),
        untouched=background[rows, columns].astype(np.float64),
        positions_px=np.column_stack([columns, rows]).astype(np.float64),
        press=press,
    )


def _draw(mask: Mask, count: int, rng: np.random.Generator) -> Int64Array:
    chosen = np.flatnonzero(mask)
    return rng.choice(chosen, count, replace=False) if len(chosen) > count else chosen


def pairs_from_samples(
    samples: Iterable[PressSamples], label_offset_px: FloatArray, options: PressOptions
) -> PressPairs:
    """Give every sample its normal; those in the crease around the contact are left out.

    label_offset_px: from label to dent, (2,) of all presses or (presses, 2) of each.
    """
    samples = list(samples)
    own = np.broadcast_to(label_offset_px, (len(samples), 2))
    parts: list[tuple[Array, ...]] = []
    for number, part in enumerate(samples):
        offsets = part.offsets_px(own[number])
        distance = np.linalg.norm(offsets, axis=1)
        touched = distance < options.contact_share * part.press.radius_px
        xy = np.where(touched[:, None], offsets * options.pixel_mm / options.ball_radius_mm, 0.0)
        normals = np.column_stack([xy, -np.sqrt(np.maximum(1.0 - (xy**2).sum(axis=1), 0.0))])
        used = touched | (distance > _FLAT_RADII * part.press.radius_px)
        presses = np.full(int(used.sum()), number, dtype=np.int64)
        parts.append((normals[used], part.rgb[used], part.positions_px[used], touched[used], presses))
    if not any(touched.any() for *_, touched, _ in parts):
        raise BadCalibration(
            "calibrate presses: no press with a label, or every contact lies outside the gel"
        )
    normals, rgb, positions_px, touched, presses = (
        np.concatenate(group) for group in zip(*parts, strict=True)
    )
    return PressPairs(normals=normals, rgb=rgb, positions_px=positions_px, touched=touched, presses=presses)


# The fit: the gel's response from the samples of many presses, and the common offset of their labels.


@dataclass(frozen=True, kw_only=True, eq=False)
class GelFit:
    """A gel's response fitted to presses.

    response: M, with M n0 taken off by its ambient term. gel: what corrects it. quality: on the pairs used.
    held_back_deg: median angle on presses that a fit did not see, from the cross-validation; NaN for a single
    press. label_offset_px: (2,), from label to dent, common to all. label_scatter_px: median distance of the
    dents from the labels so moved. normals, rgb: (n, 3), the pairs inside contacts.
    """

    response: LightResponse
    gel: gels.GelResponse
    quality: FitQuality
    held_back_deg: float
    label_offset_px: FloatArray
    label_scatter_px: float
    normals: Points
    rgb: Points


def fit_gel_to_presses(
    samples: Iterable[PressSamples], level: Vector3, size: tuple[int, int], options: PressOptions
) -> GelFit:
    """Fit M and its correction to the changes of colour of presses.

    level: (3,) colour of the untouched gel. size: (width, height) of the frames. Raises `BadCalibration`
    where no press has a label, or the contacts do not determine M.
    """
    samples = list(samples)
    common: FloatArray = np.zeros(2)
    if options.label_offset is LabelOffset.COMMON and samples:
        common = fit_label_offset(samples, level, options)
    own = np.tile(common, (len(samples), 1))
    fit = _fit_response(samples, own, level, size, options)
    moves = options.label_offset is not LabelOffset.NONE and len(samples) > 1
    for _ in range(_CENTRE_ROUNDS if moves else 0):
        reach = largest_label_offset(samples)
        own = np.array(
            [_moved_to_dent(*pair, fit, options, reach) for pair in zip(samples, own, strict=True)]
        )
        fit = _fit_response(samples, own, level, size, options)
    if options.label_offset is LabelOffset.COMMON and len(samples) > 1:
        common = _middle(own)
    scatter = float(np.median(np.linalg.norm(own - common, axis=1))) if samples else 0.0
    fits.warn_of_weak_fit(fit.quality)
    return replace(fit, label_offset_px=common, label_scatter_px=scatter)


def _moved_to_dent(
    part: PressSamples, offset_px: FloatArray, fit: GelFit, options: PressOptions, reach_px: float
) -> FloatArray:
    """Where the response sees the ball of a press, as an offset (2,) from its label."""
    offsets = part.offsets_px(offset_px)
    touched = np.linalg.norm(offsets, axis=1) < options.contact_share * part.press.radius_px
    if np.count_nonzero(touched) < _FEWEST_OF_CENTRE:
        return offset_px
    found = fit.gel.normals_from_change(part.rgb[touched], part.positions_px[touched], fit.response)
    ball_px = options.ball_radius_mm / options.pixel_mm
    step = np.median(offsets[touched] - ball_px * found[:, :2], axis=0)
    length = float(np.linalg.norm(step))
    return np.asarray(offset_px + step * min(1.0, reach_px / max(length, 1e-9)))


def _middle(offsets_px: FloatArray) -> FloatArray:
    """Mean (2,) of offsets (n, 2) but for those that lie far from their median: labels scatter like noise."""
    distance = np.linalg.norm(offsets_px - np.median(offsets_px, axis=0), axis=1)
    return np.asarray(offsets_px[distance <= _FAR_OFF * np.median(distance)].mean(axis=0))


def _fit_response(
    samples: list[PressSamples],
    offsets_px: FloatArray,
    level: Vector3,
    size: tuple[int, int],
    options: PressOptions,
) -> GelFit:
    """Fit M and its correction to presses whose dents lie at given offsets (presses, 2) from the labels."""
    pairs = pairs_from_samples(samples, offsets_px, options).thinned(_PAIRS)
    response = _fit_matrix(pairs, level, options)
    scaled = pairs.rgb @ response.inverse.T
    reach = float(np.percentile(np.linalg.norm(scaled[pairs.touched], axis=1), _REACH_PERCENTILE))
    centre, scale = (np.array(size) - 1.0) / 2, max(size) / 2.0
    # In units of the reach no factor exceeds 1: the higher a term, the more firmly the ridge holds it.
    unit = reach ** -gels.TERM_DEGREES[:, 0].astype(np.float64)
    terms = unit * gels.correction_terms(scaled, (pairs.positions_px - centre) / scale, reach)
    first = gels.first_estimate(scaled)
    wanted = gels.stereographic_from_normals(pairs.normals) - first
    coefficients, predicted = _Ridge(terms, wanted, pairs).choose()
    touched = pairs.touched
    errors, held_back = None, float("nan")
    if predicted is not None:
        found = gels.normals_from_stereographic(first + predicted)
        angles = fits.angles_deg(found, pairs.normals)
        errors, held_back = _errors_by_tilt(found, angles), float(np.median(angles[touched]))
    gel = gels.GelResponse(
        coefficients=coefficients * unit[:, None],
        centre_px=centre,
        scale_px=scale,
        reach=reach,
        errors_deg=errors,
    )
    normals, rgb = pairs.normals[touched], pairs.rgb[touched]
    found = gel.normals_from_change(rgb, pairs.positions_px[touched], response)
    quality = FitQuality(
        method="presses",
        residual_deg=float(np.median(fits.angles_deg(found, normals))),
        condition_number=response.condition_number,
        samples=len(normals),
        cone_deg=fits.cone_of_normals_deg(normals),
    )
    return GelFit(
        response=response, gel=gel, quality=quality, held_back_deg=held_back,
        label_offset_px=np.zeros(2), label_scatter_px=0.0, normals=normals, rgb=rgb,
    )  # fmt: skip


class _Ridge:
    """Robust ridge regression of the correction, and its strength by cross-validation over presses."""

    def __init__(self, terms: FloatArray, wanted: Points2, pairs: PressPairs) -> None:
        self._terms, self._wanted = terms, wanted
        numbers, self._presses = np.unique(pairs.presses, return_inverse=True)
        self._folds = min(len(numbers), _FOLDS)
        self._unit = len(terms) / len(numbers)  # pairs of one press
        self._weight = np.ones(len(terms))
        middle = _STRENGTHS[len(_STRENGTHS) // 2]
        for _ in range(_REWEIGHTINGS):
            normal, right = self._equations(np.ones(len(terms), np.bool_))
            squared = ((terms @ self._solve(normal, right, middle) - wanted) ** 2).sum(axis=1)
            self._weight = 1.0 / np.sqrt(1.0 + squared / _SOFT**2)

    def choose(self) -> tuple[FloatArray, Points2 | None]:
        """The coefficients (111, 2) of the strength that predicts best; (n, 2), what it predicts held back.

        A single press predicts none: no correction, and None.
        """
        if self._folds < 2:
            return np.zeros((gels.TERMS, 2)), None
        fold = self._presses % self._folds
        parts = [self._equations(fold == k) for k in range(self._folds)]
        normal, right = (np.sum(group, axis=0) for group in zip(*parts, strict=True))
        predicted = np.empty((len(_STRENGTHS), len(self._terms), 2))
        for k, (own_normal, own_right) in enumerate(parts):
            out = fold == k
            for rows, strength in zip(predicted, _STRENGTHS, strict=True):
                rows[out] = self._terms[out] @ self._solve(normal - own_normal, right - own_right, strength)
        residuals = np.linalg.norm(predicted - self._wanted, axis=2)
        losses = (np.sqrt(1.0 + (residuals / _SOFT) ** 2) - 1.0).mean(axis=1)
        best = int(np.argmin(losses))
        return self._solve(normal, right, _STRENGTHS[best]), predicted[best]

    def _equations(self, chosen: Mask) -> tuple[FloatArray, FloatArray]:
        weighted = self._terms[chosen] * self._weight[chosen, None]
        return weighted.T @ self._terms[chosen], weighted.T @ self._wanted[chosen]

    def _solve(self, normal: FloatArray, right: FloatArray, strength: float) -> FloatArray:
        return np.asarray(np.linalg.solve(normal + strength * self._unit * np.eye(gels.TERMS), right))


def _errors_by_tilt(found: Points, angles: FloatArray) -> FloatArray:
    """`GelResponse.errors_deg` of normals (n, 3), off by (n,) degrees, in equal groups by their tilt."""
    tilts = np.degrees(np.arccos(np.clip(-found[:, 2], -1.0, 1.0)))
    groups = np.array_split(np.argsort(tilts, kind="stable"), _ERROR_GROUPS)
    errors = np.array([(np.median(tilts[g]), np.percentile(angles[g], 90)) for g in groups if len(g)])
    return errors[np.append(True, np.diff(errors[:, 0]) > 0)]


def _fit_matrix(pairs: PressPairs, level: Vector3, options: PressOptions) -> LightResponse:
    """One M for the whole gel, from the contacts; its column of n_z is known from the untouched gel."""
    normals, rgb = pairs.normals[pairs.touched], pairs.rgb[pairs.touched]
    design = fits.Design(rows=normals[:, :2], colours=rgb + (1.0 + normals[:, 2:]) * level)
    everything = np.ones(len(rgb), np.bool_)
    unknowns, _ = fits.fit_by_trimming(design, everything, 0.0, options.outlier_sigmas, _ROUNDS)
    return fits.response_from_unknowns(np.vstack([unknowns, -level, -level]))


def angle_of_one_matrix(
    samples: Iterable[PressSamples], level: Vector3, offset_px: FloatArray, options: PressOptions
) -> float:
    """Median angle in degrees that one M leaves in the contacts: how linear the colours are."""
    pairs = pairs_from_samples(samples, offset_px, options).thinned(_PAIRS_OF_OFFSET)
    response = _fit_matrix(pairs, level, options)
    normals, rgb = pairs.normals[pairs.touched], pairs.rgb[pairs.touched]
    found = gels.normals_from_stereographic(gels.first_estimate(rgb @ response.inverse.T))
    return float(np.median(fits.angles_deg(found, normals)))


def largest_label_offset(samples: Iterable[PressSamples]) -> float:
    """Largest common offset that is looked for, pixels."""
    return _LARGEST_OFFSET_RADII * float(np.median([part.press.radius_px for part in samples]))


def fit_label_offset(samples: list[PressSamples], level: Vector3, options: PressOptions) -> FloatArray:
    """The offset (du, dv) in pixels from label to dent, common to all presses.

    Fits M, moves the offset by the median tilt that is left, and repeats.
    """
    thin = [
        replace(
            part,
            rgb=part.rgb[::step],
            untouched=part.untouched[::step],
            positions_px=part.positions_px[::step],
        )
        for part in samples
        for step in [max(1, len(samples) * len(part.rgb) // _PAIRS_OF_OFFSET)]
    ]
    reach = largest_label_offset(samples)
    offset: FloatArray = np.zeros(2)
    for _ in range(_OFFSET_ROUNDS):
        pairs = pairs_from_samples(thin, offset, options)
        response = _fit_matrix(pairs, level, options)
        normals, rgb = pairs.normals[pairs.touched], pairs.rgb[pairs.touched]
        found = gels.normals_from_stereographic(gels.first_estimate(rgb @ response.inverse.T))
        tilt = np.median(found[:, :2] - normals[:, :2], axis=0)
        step = -tilt * options.ball_radius_mm / options.pixel_mm
        offset = offset + step
        length = float(np.linalg.norm(offset))
        if length > reach:
            offset *= reach / length
        if np.linalg.norm(step) < _SETTLED_PX:
            break
    if np.linalg.norm(offset) > _NOTABLE_PX:
        logger.warning(
            "all labels seem to lie beside their dents by (%.1f, %.1f) pixels, which is allowed for; "
            "--label-offset none takes them as they are",
            *offset,
        )
    return offset


# Contact circles of presses, found in the change of colour alone, before any response is known. A dent is
# symmetric about its middle, and a normal and the one opposite lean opposite ways. The change of colour d is
# nearly linear in the normal, so that d(c + δ) ≈ −d(c − δ) about the middle c, whatever M is. The
# autoconvolution Σ d(x) · d(2c − x) is then most negative at the middle: one Fourier transform finds it.
# Inside the contact the tilt grows with the distance, beyond it the gel flattens out: the change is strongest
# at the contact's rim.


_SEARCHED_PX = 120  # shorter side of the picture that is searched; the middle is found between its pixels
_BLUR_PX = 1.0  # there: what is left of dots and grain is no dent
_NOISE_FACTOR = 3.0  # changes below so many times the median are noise, and are shrunk to 0
_SMALLEST_RADIUS_PX = 3
_LEAST_SYMMETRY = 0.4  # 1 where all of the change is odd about the middle, 0 for one that is not at all


@dataclass(frozen=True, kw_only=True)
class FoundCircle:
    """A contact circle and how odd the change is about its middle, at most 1."""

    press: Press
    symmetry: float


def find_contact_circle(change: LinearImage) -> FoundCircle | None:
    """Find the dent of one ball in a change of colour (h, w, 3) without drift and dots; None without one."""
    require_shape(change, (None, None, 3), "change of colour")
    step = max(1, min(change.shape[:2]) // _SEARCHED_PX)
    height, width = change.shape[0] // step, change.shape[1] // step
    small = cv2.resize(change[: height * step, : width * step], (width, height), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), _BLUR_PX)
    strength = np.linalg.norm(small, axis=2)
    noise = _NOISE_FACTOR * float(np.median(strength))
    small = small * (np.maximum(strength - noise, 0.0) / np.maximum(strength, 1e-12))[..., None]
    energy = float((small**2).sum())
    if not energy > 0:
        return None
    spectrum = fft.rfft2(small, (2 * height, 2 * width), axes=(0, 1))
    odd = -np.asarray(fft.irfft2((spectrum**2).sum(axis=2), (2 * height, 2 * width)))
    row, column = np.unravel_index(int(np.argmax(odd)), odd.shape)
    symmetry = float(odd[row, column]) / energy
    if symmetry < _LEAST_SYMMETRY:
        return None
    v = (row + _peak(odd[:, column], int(row))) / 2
    u = (column + _peak(odd[row], int(column))) / 2
    radius = _rim(strength, float(u), float(v))
    if radius is None:
        return None
    middle = (step - 1) / 2  # of a block of pixels
    press = Press(u_px=u * step + middle, v_px=v * step + middle, radius_px=radius * step)
    return FoundCircle(press=press, symmetry=symmetry)


def _peak(values: FloatArray, at: int) -> float:
    """Where between pixels a parabola through the largest value and its neighbours peaks, −1/2 to 1/2."""
    if not 0 < at < len(values) - 1:
        return 0.0
    before, here, after = (float(values[at + k]) for k in (-1, 0, 1))
    bend = before - 2 * here + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0


def _rim(strength: FloatArray, u: float, v: float) -> float | None:
    """Radius at which the change is strongest, in the median over the circle."""
    rows, columns = np.indices(strength.shape)
    distance = np.hypot(columns - u, rows - v)
    furthest = int(min(strength.shape) / 2)
    profile = np.array(
        [
            np.median(strength[(distance >= radius - 0.5) & (distance < radius + 0.5)])
            for radius in range(_SMALLEST_RADIUS_PX, furthest)
        ]
    )
    if len(profile) < 3:
        return None
    at = int(np.argmax(profile))
    return _SMALLEST_RADIUS_PX + at + _peak(profile, at)
