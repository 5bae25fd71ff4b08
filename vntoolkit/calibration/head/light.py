"""The light response from skin with approximate normals (brostow2011, Section IV).

Hypotheses come from three samples each (four with ambient light). The one with the largest support is
refined by least squares on its inliers. Then samples in the shadow of the lights found are dropped, and each
point of the skin gets its own albedo, because lips, brows and freckles are no noise.
"""

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import BoolArray, FloatArray, IntArray, Points, read_only
from vntoolkit.calibration.fit import fit_quality, response_from_unknowns, warn_of_weak_fit
from vntoolkit.calibration.head.samples import HeadRays, HeadSamples
from vntoolkit.errors import BadCalibration
from vntoolkit.options.calibration import ResponseModel
from vntoolkit.options.head import LightOptions
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality

_SMALLEST_DETERMINANT = 0.08  # of the sampled normals
_LARGEST_CONDITION = 25.0  # of a hypothesis
_DARK = 0.05  # of the brightest colours: added to the colour, so that dark samples do not decide
_SCORED = 4000
_SHADOW_ROUNDS = 3
_ALBEDO_ROUNDS = 12  # on noisy normals: in more, albedo takes up what noise takes from the shading
_LEAST_COSINE = 0.08  # to a light: flatter, the shape's error decides whether it arrives
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
    options: LightOptions,
    rng: np.random.Generator,
) -> HeadLight:
    """Fit M (and ambient a) to samples of skin.

    Raises `BadCalibration` where hardly any samples agree on one response.
    """
    ambient = options.light_model is ResponseModel.AMBIENT
    normals, rgb = samples.normals_in_camera, samples.rgb
    rows = np.column_stack([normals, np.ones(len(normals))]) if ambient else np.asarray(normals)
    floor = _DARK * float(np.percentile(np.linalg.norm(rgb, axis=1), 95))
    unknowns = _largest_support(rows, rgb, floor, options, rng)
    shadowed = np.zeros(len(rows), np.bool_)
    for _ in range(_SHADOW_ROUNDS):
        inliers = _support(rows, rgb, unknowns, floor, options.light_inlier) & ~shadowed
        unknowns = _least_squares(rows, rgb, inliers, floor)
        shadowed = _shadowed(samples, rays, response_from_unknowns(unknowns))
    inliers = _support(rows, rgb, unknowns, floor, options.light_inlier) & ~shadowed
    albedo = np.ones_like(rgb)
    if not ambient:
        unknowns, albedo, inliers = _with_albedo(samples, unknowns, shadowed, floor, options.light_inlier)
    response = response_from_unknowns(unknowns)
    quality = fit_quality(normals[inliers], (rgb / albedo)[inliers], response, "head")
    warn_of_weak_fit(quality)
    return HeadLight(response=response, quality=quality, inliers=inliers, shadowed=shadowed, albedo=albedo)


def light_of_response(samples: HeadSamples, response: LightResponse, options: LightOptions) -> HeadLight:
    """Judge a response by samples of lit skin, their colours free of albedo."""
    rows = np.column_stack([samples.normals_in_camera, np.ones(len(samples.rgb))])
    floor = _DARK * float(np.percentile(np.linalg.norm(samples.rgb, axis=1), 95))
    unknowns = np.vstack([response.matrix.T, response.ambient])
    inliers = _support(rows, samples.rgb, unknowns, floor, options.light_inlier)
    quality = fit_quality(samples.normals_in_camera[inliers], samples.rgb[inliers], response, "head")
    warn_of_weak_fit(quality)
    return HeadLight(
        response=response,
        quality=quality,
        inliers=inliers,
        shadowed=np.zeros(len(rows), np.bool_),
        albedo=np.ones_like(samples.rgb),
    )


def _largest_support(
    rows: Points, rgb: Points, floor: float, options: LightOptions, rng: np.random.Generator
) -> FloatArray:
    """Return the hypothesis (3 or 4, 3) with the lowest truncated cost (MSAC: torr2000)."""
    size = rows.shape[1]
    drawn = rng.integers(0, len(rows), (options.light_draws, size))
    sound = np.abs(np.linalg.det(rows[drawn])) > _SMALLEST_DETERMINANT
    models = np.linalg.solve(rows[drawn[sound]], rgb[drawn[sound]])
    singular = np.linalg.svd(models[:, :3], compute_uv=False)
    models = models[singular[:, 0] < _LARGEST_CONDITION * singular[:, 2]]
    if not len(models):
        raise BadCalibration(
            "light: no three samples of skin determine the lights; check that the three lights differ in "
            "colour and direction, and turn the head further"
        )
    scored = rng.permutation(len(rows))[:_SCORED]
    costs = [
        np.minimum(_errors(rows[scored], rgb[scored], model, floor), options.light_inlier).sum()
        for model in models
    ]
    best = models[int(np.argmin(costs))]
    share = float(_support(rows, rgb, best, floor, options.light_inlier).mean())
    if share < _LEAST_SUPPORT:
        raise BadCalibration(
            f"light: only {share:.0%} of the skin's samples agree on one light response; check that all "
            "three lights reach the face, that the transfer curve is right and the room dark"
        )
    return best


def _errors(rows: Points, rgb: Points, unknowns: FloatArray, floor: float) -> FloatArray:
    """Length of the colour error over the colour's, (n,)."""
    return np.linalg.norm(rows @ unknowns - rgb, axis=1) / (np.linalg.norm(rgb, axis=1) + floor)


def _support(rows: Points, rgb: Points, unknowns: FloatArray, floor: float, largest: float) -> BoolArray:
    return _errors(rows, rgb, unknowns, floor) < largest


def _least_squares(rows: Points, rgb: Points, chosen: BoolArray, floor: float) -> FloatArray:
    if np.count_nonzero(chosen) < 50:
        raise BadCalibration(
            f"light: only {np.count_nonzero(chosen)} samples of skin are lit by all three lights and agree; "
            "move the lights closer to the camera, and turn the head further"
        )
    weight = 1.0 / (np.linalg.norm(rgb[chosen], axis=1, keepdims=True) + floor)
    return np.linalg.lstsq(rows[chosen] * weight, rgb[chosen] * weight, rcond=None)[0]


def _shadowed(samples: HeadSamples, rays: HeadRays, response: LightResponse) -> BoolArray:
    """Return the samples (n,) that a light does not reach, by the head's own shape."""
    dark = np.zeros(len(samples.point), np.bool_)
    for direction in response.light_directions:
        dark |= samples.normals_in_camera @ direction < _LEAST_COSINE
        in_head = np.stack([pose.inverse().rotate(direction) for pose in samples.camera_from_head])
        dark |= ~rays.free(samples.point, in_head[samples.frame])
    return dark


def _with_albedo(
    samples: HeadSamples,
    unknowns: FloatArray,
    shadowed: BoolArray,
    floor: float,
    largest: float,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Alternate between albedo per channel, median 1, and M: M (3, 3), albedo (n, 3), samples used (n,)."""
    normals, rgb = samples.normals_in_camera, samples.rgb
    _, point = np.unique(samples.point, return_inverse=True)
    majority = _support(normals, rgb, unknowns, floor, largest) & ~shadowed
    used = ~shadowed
    albedo = np.ones_like(rgb)
    for _ in range(_ALBEDO_ROUNDS):
        shading = normals @ unknowns
        seen = np.bincount(point[used], minlength=point.max() + 1)
        own = np.stack(
            [_ratio_by(point[used], shading[used, c], rgb[used, c], len(seen)) for c in range(3)], 1
        )
        own = np.where((seen[:, None] >= _LEAST_SEEN) & (own > 0.02), own, np.nan)
        own /= np.nanmedian(own[point[majority]], axis=0)
        albedo = own[point]
        errors = np.linalg.norm(shading * albedo - rgb, axis=1) / (np.linalg.norm(rgb, axis=1) + floor)
        used = ~shadowed & np.isfinite(errors) & (errors < largest)
        if np.count_nonzero(used) < 50:
            break
        unknowns = np.stack(
            [
                _least_squares(normals * albedo[:, c : c + 1], rgb[:, c : c + 1], used, floor)[:, 0]
                for c in range(3)
            ],
            axis=1,
        )
    return unknowns, np.where(np.isfinite(albedo), albedo, 1.0), used


def _ratio_by(point: IntArray, shading: FloatArray, value: FloatArray, count: int) -> FloatArray:
    """Return per point the factor of the shading that fits the values best, (count,)."""
    over = np.bincount(point, shading * value, minlength=count)
    under = np.bincount(point, shading * shading, minlength=count)
    return over / np.maximum(under, 1e-12)
