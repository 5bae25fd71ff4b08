"""Calibration of a tactile sensor on presses of balls of known radii into its gel.

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

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Points, Points2, Vector3
from vntoolkit.errors import BadCalibration, BadRig
from vntoolkit.options.calibration import LabelOffset, PressOptions
from vntoolkit.photometry.fit_quality import angles_deg, cone_of_normals_deg, warn_of_weak_fit
from vntoolkit.photometry.gel import TERM_DEGREES, TERMS, GelResponse
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality
from vntoolkit.spread import robust_deviation
from vntoolkit.tactile.presses import CONTACT_SHARE, PressPairs, PressSamples, pairs_from_samples
from vntoolkit.tactile.response import (
    correction_terms,
    first_estimate,
    normals_from_change,
    normals_from_stereographic,
    stereographic_from_normals,
)

logger = logging.getLogger(__name__)
_ROUNDS = 30
_OUTLIER_SIGMAS = 4.0  # robust standard deviations of the colour residual: beyond are dots and creases
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
_FLATTEST = 5e-3  # smallest over largest singular value of the slopes that still determine M


@dataclass(frozen=True, kw_only=True, eq=False)
class GelFit:
    """A gel's response fitted to presses.

    response: M, with M n0 taken off by its ambient term. gel: what corrects it. quality: on the pairs used.
    held_back_deg: median angle on presses that a fit did not see, from the cross-validation; NaN for a single
    press. label_offset_px: (2,), from label to dent, common to all. label_scatter_px: median distance of the
    dents from the labels so moved. normals, rgb: (n, 3), the pairs inside contacts.
    """

    response: LightResponse
    gel: GelResponse
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
    warn_of_weak_fit(fit.quality)
    return replace(fit, label_offset_px=common, label_scatter_px=scatter)


def _moved_to_dent(
    part: PressSamples, offset_px: FloatArray, fit: GelFit, options: PressOptions, reach_px: float
) -> FloatArray:
    """Where the response sees the ball of a press, as an offset (2,) from its label."""
    offsets = part.offsets_px(offset_px)
    touched = np.linalg.norm(offsets, axis=1) < CONTACT_SHARE * part.press.radius_px
    if np.count_nonzero(touched) < _FEWEST_OF_CENTRE:
        return offset_px
    found = normals_from_change(part.rgb[touched], part.positions_px[touched], fit.response, fit.gel)
    ball_px = part.ball_radius_mm / options.side_mm
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
    unit = reach ** -TERM_DEGREES[:, 0].astype(np.float64)
    terms = unit * correction_terms(scaled, (pairs.positions_px - centre) / scale, reach)
    first = first_estimate(scaled)
    wanted = stereographic_from_normals(pairs.normals) - first
    coefficients, predicted = _Ridge(terms, wanted, pairs).choose()
    touched = pairs.touched
    errors, held_back = None, float("nan")
    if predicted is not None:
        found = normals_from_stereographic(first + predicted)
        angles = angles_deg(found, pairs.normals)
        errors, held_back = _errors_by_tilt(found, angles), float(np.median(angles[touched]))
    gel = GelResponse(
        coefficients=coefficients * unit[:, None],
        centre_px=centre,
        scale_px=scale,
        reach=reach,
        errors_deg=errors,
    )
    normals, rgb = pairs.normals[touched], pairs.rgb[touched]
    found = normals_from_change(rgb, pairs.positions_px[touched], response, gel)
    quality = FitQuality(
        method="presses",
        residual_deg=float(np.median(angles_deg(found, normals))),
        condition_number=response.condition_number,
        samples=len(normals),
        cone_deg=cone_of_normals_deg(normals),
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
            return np.zeros((TERMS, 2)), None
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
        return np.asarray(np.linalg.solve(normal + strength * self._unit * np.eye(TERMS), right))


def _errors_by_tilt(found: Points, angles: FloatArray) -> FloatArray:
    """`GelResponse.errors_deg` of normals (n, 3), off by (n,) degrees, in equal groups by their tilt."""
    tilts = np.degrees(np.arccos(np.clip(-found[:, 2], -1.0, 1.0)))
    groups = np.array_split(np.argsort(tilts, kind="stable"), _ERROR_GROUPS)
    errors = np.array([(np.median(tilts[g]), np.percentile(angles[g], 90)) for g in groups if len(g)])
    return errors[np.append(True, np.diff(errors[:, 0]) > 0)]


def _fit_matrix(pairs: PressPairs, level: Vector3, options: PressOptions) -> LightResponse:
    """One M for the whole gel, from the contacts; its column of n_z is known from the untouched gel."""
    normals, rgb = pairs.normals[pairs.touched], pairs.rgb[pairs.touched]
    slopes, colours = normals[:, :2], rgb + (1.0 + normals[:, 2:]) * level
    chosen = np.ones(len(rgb), np.bool_)
    for _ in range(_ROUNDS):
        columns, _, _, singular = np.linalg.lstsq(slopes[chosen], colours[chosen], rcond=None)
        if not singular[-1] > _FLATTEST * singular[0]:
            raise BadCalibration(
                "calibrate presses: the slopes seen do not determine the light response; press the ball "
                "deeper, and all over the gel"
            )
        residuals = np.linalg.norm(slopes @ columns - colours, axis=1)
        update = residuals <= _OUTLIER_SIGMAS * robust_deviation(residuals)
        if np.array_equal(update, chosen):
            break
        chosen = update
    try:
        return LightResponse(matrix=np.vstack([columns, -level]).T, ambient=-level)
    except BadRig as error:
        raise BadCalibration(f"calibrate presses: {error}") from error


def angle_of_one_matrix(
    samples: Iterable[PressSamples], level: Vector3, offset_px: FloatArray, options: PressOptions
) -> float:
    """Median angle in degrees that one M leaves in the contacts: how linear the colours are."""
    pairs = pairs_from_samples(samples, offset_px, options).thinned(_PAIRS_OF_OFFSET)
    return float(np.median(angles_deg(*_by_one_matrix(pairs, level, options))))


def _by_one_matrix(pairs: PressPairs, level: Vector3, options: PressOptions) -> tuple[Points, Points]:
    """Return the normals in the contacts, (n, 3), as one M finds them, and as they are."""
    response = _fit_matrix(pairs, level, options)
    scaled = pairs.rgb[pairs.touched] @ response.inverse.T
    return normals_from_stereographic(first_estimate(scaled)), pairs.normals[pairs.touched]


def largest_label_offset(samples: Iterable[PressSamples]) -> float:
    """Largest common offset that is looked for, pixels."""
    return _LARGEST_OFFSET_RADII * float(np.median([part.press.radius_px for part in samples]))


def fit_label_offset(samples: list[PressSamples], level: Vector3, options: PressOptions) -> FloatArray:
    """The offset (du, dv) in pixels from label to dent, common to all presses.

    Fits M, moves the offset by what the median of the tilts left is on the ball, and repeats.
    """
    reach = largest_label_offset(samples)
    offset: FloatArray = np.zeros(2)
    for _ in range(_OFFSET_ROUNDS):
        pairs = pairs_from_samples(samples, offset, options).thinned(_PAIRS_OF_OFFSET)
        found, normals = _by_one_matrix(pairs, level, options)
        balls_px = np.array([part.ball_radius_mm for part in samples])[pairs.presses[pairs.touched]]
        step = np.median((normals - found)[:, :2] * balls_px[:, None], axis=0) / options.side_mm
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
