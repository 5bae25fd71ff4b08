"""Calibration of a tactile sensor on presses of a ball of known radius into its gel.

The camera looks at the gel from behind, so the dent bulges towards it and inside the contact circle it is
the ball's own surface (Johnson and Adelson, Retrographic sensing for the measurement of surface texture
and shape, 2009, johnson2009). Each frame has the untouched gel's photograph subtracted, which takes most
of the light's unevenness away and leaves r = M (n − n0), n0 = the flat gel's normal.

The lights stand beside the gel, so M varies over it, as polynomials of the pixel position with an ambient
term of its own (`fit_varying_response`); pixels far from the dent, where the gel is flat, are samples too.
Labels may lie beside the dent by the same few pixels in every frame (a crop, another rectification). One
offset for all of them shows: with it, ball and flat gel obey one response, without it they contradict each
other. `LabelOffset.COMMON` fits it.

With degree 0 one M serves the whole gel; there M n0 is known, the colour of the untouched gel, so only the
columns of n_x and n_y are fitted and the untouched gel comes out flat exactly. (Fitting all nine there
follows the ball more closely, but tilts the flat gel by ten degrees.)
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, LinearImage, Mask, Points, Points2, Vector3
from vntoolkit.calibration.fit import (
    Design,
    ResponseFit,
    angles_deg,
    fit_by_trimming,
    fit_quality,
    response_from_unknowns,
    warn_of_weak_fit,
)
from vntoolkit.calibration.varying import VariationOptions, fit_varying_response
from vntoolkit.checks import require_positive, require_shape
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.lambertian import scaled_normals_from_rgb
from vntoolkit.photometry.response import LightResponse

_UNTOUCHED_RADII = 3.3  # of the labelled contact: beyond it the gel lies flat, by half a radius to spare
_FLAT_RADII = 2.8  # of the contact where it really is, which may be half a radius from its label
_DRAWN_RADII = 1.25  # of the labelled contact: room for labels that lie beside the dent
logger = logging.getLogger(__name__)
_ROUNDS = 30
_PAIRS_OF_VARIATION = 12_000  # more refine nothing
_PAIRS_OF_OFFSET = 3_000
_STEPS_PX = (4.0, 2.0, 1.0, 0.5)
_LARGEST_OFFSET_RADII = 0.5  # of the median contact: beyond it the labels mean something else
_NOTABLE_PX = 1.0


class LabelOffset(Enum):
    """Whether the labelled centres are used as they are, or with a common fitted offset."""

    COMMON = "common"  # one offset for all labels is fitted, so that ball and flat gel agree
    NONE = "none"


@dataclass(frozen=True, kw_only=True)
class PressOptions:
    """Options of the calibration on presses.

    ball_radius_mm: radius of the ball. pixel_mm: side of a pixel on the gel. contact_share: share of the
    labelled contact radius inside which the gel follows the ball. samples: pixels drawn from a press's
    contact. flat_share: pixels drawn where the gel lies flat, over those of the contact; more make the
    untouched gel flatter and the ball less round. label_offset: whether one offset common to all labels is
    fitted. outlier_sigmas: (degree 0) pixels whose colour residual exceeds this many robust standard
    deviations (dots, creases) are left out. variation: how M varies over the gel.
    """

    ball_radius_mm: float
    pixel_mm: float
    contact_share: float = 0.8
    samples: int = 400
    flat_share: float = 0.67
    label_offset: LabelOffset = LabelOffset.COMMON
    outlier_sigmas: float = 4.0
    variation: VariationOptions = field(default_factory=VariationOptions)

    def __post_init__(self) -> None:
        if not (0 < self.ball_radius_mm < np.inf and 0 < self.pixel_mm < np.inf):
            raise BadInput("presses: expected a positive ball radius and pixel size in mm")
        if not 0 < self.contact_share <= 1:
            raise BadInput(f"presses: expected a contact share from 0 to 1, got {self.contact_share:g}")
        if self.samples < 4:
            raise BadInput(f"presses: expected at least 4 samples a press, got {self.samples}")
        require_positive(self.outlier_sigmas, "presses: outlier sigmas")
        if not 0 <= self.flat_share <= 10:
            raise BadInput(f"presses: expected a flat share from 0 to 10, got {self.flat_share:g}")


@dataclass(frozen=True, kw_only=True)
class Press:
    """One press as labelled: centre (u, v) and radius of the contact circle, pixels."""

    u_px: float
    v_px: float
    radius_px: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PressSamples:
    """Pixels of one frame, at and around the contact and, far away, on the flat gel.

    rgb: (n, 3) with the background subtracted. positions_px: (n, 2). press: as labelled.
    """

    rgb: Points
    positions_px: Points2
    press: Press

    def offsets_px(self, label_offset_px: Points2) -> Points2:
        """From the centre of the ball, (n, 2), where the label is off by `label_offset_px`."""
        return self.positions_px - (self.press.u_px, self.press.v_px) - label_offset_px


@dataclass(frozen=True, kw_only=True, eq=False)
class PressPairs:
    """Pairs of normal and colour of many presses: normals, rgb (n, 3), positions_px (n, 2), touched (n,)."""

    normals: Points
    rgb: Points
    positions_px: Points2
    touched: npt.NDArray[np.bool_]

    def thinned(self, count: int) -> PressPairs:
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
    frame: LinearFrame,
    press: Press,
    background: LinearImage,
    options: PressOptions,
    rng: np.random.Generator,
) -> PressSamples:
    """Draw pixels of the contact and of the flat gel around it. background: (h, w, 3), the untouched gel."""
    require_shape(background, (*frame.shape, 3), "background")
    normals_of_press(press, options, frame.shape)  # refuses a contact that the ball cannot have
    v, u = np.indices(frame.shape)
    distance = np.hypot(u - press.u_px, v - press.v_px)
    contact = _draw((distance < _DRAWN_RADII * press.radius_px) & ~frame.clipped, 2 * options.samples, rng)
    flat = (distance > _UNTOUCHED_RADII * press.radius_px) & ~frame.clipped
    chosen = np.concatenate([contact, _draw(flat, round(options.flat_share * options.samples), rng)])
    v, u = np.divmod(chosen, frame.shape[1])
    return PressSamples(
        rgb=(frame.rgb[v, u] - background[v, u]).astype(np.float64),
        positions_px=np.column_stack([u, v]).astype(np.float64),
        press=press,
    )


def _draw(mask: Mask, count: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    chosen = np.flatnonzero(mask)
    return rng.choice(chosen, count, replace=False) if len(chosen) > count else chosen


def pairs_from_samples(
    samples: Iterable[PressSamples], label_offset_px: FloatArray, options: PressOptions
) -> PressPairs:
    """Give every sample its normal; those in the crease around the contact are left out."""
    parts: list[tuple[FloatArray, ...]] = []
    for part in samples:
        offsets = part.offsets_px(label_offset_px)
        distance = np.linalg.norm(offsets, axis=1)
        touched = distance < options.contact_share * part.press.radius_px
        xy = np.where(touched[:, None], offsets * options.pixel_mm / options.ball_radius_mm, 0.0)
        normals = np.column_stack([xy, -np.sqrt(np.maximum(1.0 - (xy**2).sum(axis=1), 0.0))])
        used = touched | (distance > _FLAT_RADII * part.press.radius_px)
        parts.append((normals[used], part.rgb[used], part.positions_px[used], touched[used]))
    if not any(touched.any() for *_, touched in parts):
        raise BadCalibration(
            "calibrate presses: no press with a label, or every contact lies outside the gel"
        )
    normals, rgb, positions_px, touched = (np.concatenate(group) for group in zip(*parts, strict=True))
    return PressPairs(normals=normals, rgb=rgb, positions_px=positions_px, touched=touched > 0)


# The fit: the gel's response from the samples of many presses, and the common offset of their labels.


def fit_response_to_presses(
    samples: Iterable[PressSamples], level: Vector3, size: tuple[int, int], options: PressOptions
) -> ResponseFit:
    """Fit the gel's response, for frames with the background subtracted.

    level: (3,) mean colour of the untouched gel. size: (width, height) of the frames.
    """
    samples = list(samples)
    offset: FloatArray = np.zeros(2)
    if options.label_offset is LabelOffset.COMMON and samples:
        offset = fit_label_offset(samples, size, options)
    pairs = pairs_from_samples(samples, offset, options)
    if options.variation.degree > 0:
        return _fit_varying(pairs.thinned(_PAIRS_OF_VARIATION), size, options.variation)
    normals, rgb = pairs.normals[pairs.touched], pairs.rgb[pairs.touched]
    design = Design(rows=normals[:, :2], colours=rgb + (1.0 + normals[:, 2:]) * level)
    everything = np.ones(len(rgb), np.bool_)
    unknowns, inliers = fit_by_trimming(design, everything, 0.0, options.outlier_sigmas, _ROUNDS)
    response = response_from_unknowns(np.vstack([unknowns, -level, -level]))
    quality = fit_quality(normals[inliers], rgb[inliers], response, "presses")
    warn_of_weak_fit(quality)
    return ResponseFit(response=response, quality=quality, inliers=inliers, normals=normals, rgb=rgb)


def fit_label_offset(samples: list[PressSamples], size: tuple[int, int], options: PressOptions) -> FloatArray:
    """The offset (du, dv) in pixels, from label to dent, that lets one M serve balls and flat gel best.

    A pattern search to half a pixel over fits of one M with ambient light.
    """
    one = replace(options.variation, degree=0)
    thin = [
        replace(part, rgb=part.rgb[::step], positions_px=part.positions_px[::step])
        for part in samples
        for step in [max(1, len(samples) * len(part.rgb) // _PAIRS_OF_OFFSET)]
    ]
    reach = _LARGEST_OFFSET_RADII * float(np.median([part.press.radius_px for part in samples]))
    tried: dict[tuple[float, float], float] = {}

    def misfit(u: float, v: float) -> float:
        if (u, v) not in tried:
            too_far = np.hypot(u, v) > reach
            tried[u, v] = np.inf if too_far else _misfit(thin, np.array([u, v]), size, options, one)
        return tried[u, v]

    best = (0.0, 0.0)
    for step in _STEPS_PX:
        while True:
            u, v = best
            around = [(u + a * step, v + b * step) for a, b in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
            best = min(around, key=lambda offset: misfit(*offset))
            if best == (u, v):
                break
    if np.hypot(*best) > _NOTABLE_PX:
        logger.warning(
            "all labels seem to lie beside their dents by (%.1f, %.1f) pixels, which is allowed for; "
            "--label-offset none takes them as they are",
            *best,
        )
    return np.array(best)


def _misfit(
    samples: list[PressSamples],
    offset: FloatArray,
    size: tuple[int, int],
    options: PressOptions,
    one: VariationOptions,
) -> float:
    """Mean angle in degrees that one M leaves, over contacts and flat gel."""
    pairs = pairs_from_samples(samples, offset, options)
    response = fit_varying_response(pairs.normals, pairs.rgb, pairs.positions_px, size, _start(pairs), one)
    return float(angles_deg(scaled_normals_from_rgb(pairs.rgb, response), pairs.normals).mean())


def _fit_varying(pairs: PressPairs, size: tuple[int, int], options: VariationOptions) -> ResponseFit:
    """Fit polynomials of the position, from the linear fit of one M with ambient light to the contacts."""
    response = _fit_highest_degree(pairs, size, options)
    touched = pairs.touched
    quality = fit_quality(
        pairs.normals[touched], pairs.rgb[touched], response, "presses", pairs.positions_px[touched]
    )
    warn_of_weak_fit(quality)
    return ResponseFit(
        response=response, quality=quality, inliers=touched, normals=pairs.normals, rgb=pairs.rgb
    )


def _fit_highest_degree(pairs: PressPairs, size: tuple[int, int], options: VariationOptions) -> LightResponse:
    """Lower the degree and log it where the presses leave parts of the gel undetermined."""
    for degree in range(options.degree, -1, -1):
        lowered = replace(options, degree=degree)
        try:
            response = fit_varying_response(
                pairs.normals, pairs.rgb, pairs.positions_px, size, _start(pairs), lowered
            )
        except BadCalibration:
            if degree == 0:
                raise
            continue
        if degree < options.degree:
            logger.warning(
                "the presses reach too little of the gel for degree %d, so degree %d is fitted; "
                "press near the corners too",
                options.degree,
                degree,
            )
        return response
    raise AssertionError("a degree is never negative")


def _start(pairs: PressPairs) -> LightResponse:
    normals, rgb = pairs.normals[pairs.touched], pairs.rgb[pairs.touched]
    design = Design.from_pairs(normals, rgb, with_ambient=True)
    return response_from_unknowns(design.solve(np.ones(len(rgb), np.bool_)))
