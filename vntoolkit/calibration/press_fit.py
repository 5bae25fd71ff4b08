"""The gel's response from the samples of many presses, and how far all labels lie beside their dents."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from vntoolkit.arrays import FloatArray, Vector3
from vntoolkit.calibration.fit import ResponseFit, response_from_unknowns
from vntoolkit.calibration.presses import (
    LabelOffset,
    PressOptions,
    PressPairs,
    PressSamples,
    pairs_from_samples,
)
from vntoolkit.calibration.quality import angles_deg, fit_quality, warn_of_weak_fit
from vntoolkit.calibration.robust import Design, fit_by_trimming
from vntoolkit.calibration.varying import VariationOptions, fit_varying_response
from vntoolkit.errors import BadCalibration
from vntoolkit.photometry.lambertian import scaled_normals_from_rgb
from vntoolkit.photometry.response import LightResponse

logger = logging.getLogger(__name__)

_ROUNDS = 30
_PAIRS_OF_VARIATION = 12_000  # more refine nothing
_PAIRS_OF_OFFSET = 3_000
_STEPS_PX = (4.0, 2.0, 1.0, 0.5)
_LARGEST_OFFSET_RADII = 0.5  # of the median contact: beyond it the labels mean something else
_NOTABLE_PX = 1.0


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
    return ResponseFit(response=response, quality=quality, inliers=inliers)


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
    return ResponseFit(response=response, quality=quality, inliers=touched)


def _fit_highest_degree(pairs: PressPairs, size: tuple[int, int], options: VariationOptions) -> LightResponse:
    """Lower the degree, and say so, where the presses leave parts of the gel undetermined."""
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
