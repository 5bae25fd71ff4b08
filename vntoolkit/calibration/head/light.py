"""The light response from skin with approximate normals (brostow2011, Section IV).

Hypotheses come from three samples each (four with ambient light): MSAC, in turns with the shadow that the
head casts on itself under the lights found. Then each point of the skin gets its own albedo, because lips,
brows and freckles are no noise.
"""

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import BoolArray, FloatArray, IntArray, Points, read_only
from vntoolkit.calibration.fit import Design, fit_by_msac, fit_quality, response_from_unknowns
from vntoolkit.calibration.head.samples import HeadRays, HeadSamples
from vntoolkit.errors import BadCalibration
from vntoolkit.options.calibration import ResponseModel
from vntoolkit.options.head import HeadSteps
from vntoolkit.photometry.fit_quality import warn_of_weak_fit
from vntoolkit.photometry.response import LightResponse, rgb_from_normals
from vntoolkit.photometry.rig import FitQuality

LEAST_COSINE = 0.08  # to a light: flatter, the shape's error decides whether it arrives
_DARK = 0.05  # of the brightest colours: added to the colour, so that dark samples do not decide
_SHADOW_ROUNDS = 3
_ALBEDO_ROUNDS = 12  # on noisy normals: in more, albedo takes up what noise takes from the shading
_LEAST_SEEN = 3  # frames in which a point must be lit for an albedo of its own
_LEAST_SUPPORT = 0.1  # of the samples


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadLight:
    """A response fitted to a head. inliers, shadowed: (n,) bool, albedo: (n, 3), over the samples."""

    response: LightResponse
    quality: FitQuality
    inliers: BoolArray
    shadowed: BoolArray
    albedo: FloatArray

    def __post_init__(self) -> None:
        for name in ("inliers", "shadowed", "albedo"):
            object.__setattr__(self, name, read_only(np.asarray(getattr(self, name))))


def fit_light(
    samples: HeadSamples,
    rays: HeadRays,
    steps: HeadSteps,
    rng: np.random.Generator,
    model: ResponseModel = ResponseModel.LINEAR,
) -> HeadLight:
    """Fit M (and ambient a) to samples of skin.

    Raises `BadCalibration` where hardly any samples agree on one response.
    """
    ambient = model is ResponseModel.AMBIENT
    pairs = Design.from_pairs(samples.normals_in_camera, samples.rgb, with_ambient=ambient)
    weight = _weights(samples.rgb)
    design = Design(rows=pairs.rows * weight, colours=pairs.colours * weight)
    shadowed = np.zeros(len(weight), np.bool_)
    for _ in range(_SHADOW_ROUNDS):
        unknowns, inliers = _agreeing(design, ~shadowed, steps, rng)
        shadowed = _shadowed(samples, rays, response_from_unknowns(unknowns))
    inliers, albedo = inliers & ~shadowed, np.ones_like(samples.rgb)
    if not ambient:
        unknowns, albedo, inliers = _with_albedo(samples, unknowns, ~shadowed, steps.light_inlier)
    response = response_from_unknowns(unknowns)
    return _judged(samples, response, inliers, shadowed, albedo)


def light_of_response(samples: HeadSamples, response: LightResponse, steps: HeadSteps) -> HeadLight:
    """Judge a response by samples of lit skin, their colours free of albedo."""
    off = rgb_from_normals(samples.normals_in_camera, response) - samples.rgb
    inliers = np.linalg.norm(off * _weights(samples.rgb), axis=1) < steps.light_inlier
    shadowed, albedo = np.zeros(len(off), np.bool_), np.ones_like(samples.rgb)
    return _judged(samples, response, inliers, shadowed, albedo)


def _judged(
    samples: HeadSamples,
    response: LightResponse,
    inliers: BoolArray,
    shadowed: BoolArray,
    albedo: FloatArray,
) -> HeadLight:
    normals, rgb = samples.normals_in_camera[inliers], (samples.rgb / albedo)[inliers]
    quality = fit_quality(normals, rgb, response, "head")
    warn_of_weak_fit(quality)
    return HeadLight(response=response, quality=quality, inliers=inliers, shadowed=shadowed, albedo=albedo)


def _weights(rgb: Points) -> FloatArray:
    """Return (n, 1), by which a colour's error becomes a share of the colour."""
    length = np.linalg.norm(rgb, axis=1, keepdims=True)
    return np.asarray(1.0 / (length + _DARK * np.percentile(length, 95)))


def _agreeing(
    design: Design, usable: BoolArray, steps: HeadSteps, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray]:
    try:
        unknowns, inliers = fit_by_msac(design, usable, rng, steps.light_draws, steps.light_inlier)
        share = float(inliers.mean())
    except BadCalibration:  # no three samples determine a response
        share = 0.0
    if share < _LEAST_SUPPORT:
        raise BadCalibration(
            f"light: only {share:.0%} of the skin's samples agree on one light response; check that the "
            "three lights differ in colour and direction and all reach the face, that the transfer curve is "
            "right and the room dark; turn the head further"
        )
    return unknowns, inliers


def _shadowed(samples: HeadSamples, rays: HeadRays, response: LightResponse) -> BoolArray:
    """Return the samples (n,) that a light does not reach, by the head's own shape."""
    dark = np.zeros(len(samples.point), np.bool_)
    for direction in response.light_directions:
        dark |= samples.normals_in_camera @ direction < LEAST_COSINE
        in_head = np.stack([pose.inverse().rotate(direction) for pose in samples.camera_from_head])
        dark |= ~rays.free(samples.point, in_head[samples.frame])
    return dark


def _with_albedo(
    samples: HeadSamples, unknowns: FloatArray, lit: BoolArray, largest: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Alternate between albedo per channel, median 1, and M: M (3, 3), albedo (n, 3), samples used (n,)."""
    normals, rgb, weight = samples.normals_in_camera, samples.rgb, _weights(samples.rgb)
    _, point = np.unique(samples.point, return_inverse=True)
    used = lit
    for _ in range(_ALBEDO_ROUNDS):
        shading = normals @ unknowns
        albedo = np.stack([_ratio_by(point, used, shading[:, c], rgb[:, c]) for c in range(3)], axis=1)
        albedo /= np.nanmedian(albedo[used], axis=0)
        errors = np.linalg.norm((shading * albedo - rgb) * weight, axis=1)
        used = lit & (errors < largest)  # without an albedo an error is not a number
        rows = normals * weight
        channels = [
            Design(rows=rows * albedo[:, c : c + 1], colours=rgb[:, c : c + 1] * weight) for c in range(3)
        ]
        unknowns = np.concatenate([each.solve(used) for each in channels], axis=1)
    return unknowns, np.where(np.isfinite(albedo), albedo, 1.0), used


def _ratio_by(point: IntArray, used: BoolArray, shading: FloatArray, value: FloatArray) -> FloatArray:
    """Return (n,) the factor of the shading that fits the values of each point best, NaN where too few do."""
    count = int(point.max()) + 1
    over, under, seen = (
        np.bincount(point[used], each[used], count) for each in (shading * value, shading**2, shading * 0 + 1)
    )
    known = (seen >= _LEAST_SEEN) & (over > 0)
    return np.where(known, over / np.where(known, under, 1.0), np.nan)[point]
