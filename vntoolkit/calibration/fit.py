"""The light response from pairs of normal and colour: equation 1 turned round.

Every calibration object (ball, board, head) ends here: it knows some normals and has seen their colours.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Points
from vntoolkit.calibration.quality import fit_quality, warn_of_weak_fit
from vntoolkit.calibration.robust import Design, fit_by_msac, fit_by_trimming
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadCalibration, BadInput, BadRig
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality


class ResponseModel(Enum):
    """Which unknowns the fit has."""

    LINEAR = "linear"  # 3×3: r = M n
    AMBIENT = "ambient"  # 3×4: r = M n + a


class FitMethod(Enum):
    """How pairs that do not obey the model are kept out."""

    TRIMMED = "trimmed"  # least squares, repeated without shadow and outliers: few bad pairs
    MSAC = "msac"  # minimal samples with a truncated cost: many bad pairs


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """How a light response is fitted.

    model: with or without ambient light. method: how outliers are kept out. shadow_share: (trimmed) a pair
    counts as shadowed where a channel's estimated contribution is at most this share of its largest; 0 keeps
    shadow. outlier_sigmas: (trimmed) pairs whose colour residual exceeds this many robust standard deviations
    are gloss or cast shadow. rounds: (trimmed) largest number of repetitions. draws: (MSAC) minimal samples
    tried. inlier_share: (MSAC) largest residual of an inlier as a share of the median colour's length.
    """

    model: ResponseModel = ResponseModel.LINEAR
    method: FitMethod = FitMethod.TRIMMED
    shadow_share: float = 0.08
    outlier_sigmas: float = 3.0
    rounds: int = 30
    draws: int = 2000
    inlier_share: float = 0.08

    def __post_init__(self) -> None:
        if not 0 <= self.shadow_share < 1:
            raise BadInput(f"shadow share: expected 0 to 1, got {self.shadow_share:g}")
        if not (0 < self.outlier_sigmas < np.inf and 0 < self.inlier_share < np.inf):
            raise BadInput("outlier sigmas and inlier share: expected positive numbers")
        if self.rounds < 1 or self.draws < 1:
            raise BadInput("rounds and draws: expected at least 1")


@dataclass(frozen=True, kw_only=True, eq=False)
class ResponseFit:
    """A fitted light response. inliers: (n,) bool, the pairs it rests on."""

    response: LightResponse
    quality: FitQuality
    inliers: npt.NDArray[np.bool_]


def fit_response(
    normals_in_camera: Points,
    rgb: Points,
    options: FitOptions | None = None,
    *,
    clipped: Mask | None = None,
    verb: str = "fit",
    rng: np.random.Generator | None = None,
) -> ResponseFit:
    """Fit M (and ambient a) to pairs of normal and linear colour, both (n, 3) (brostow2011, III-A and IV).

    clipped: (n,) pairs with a saturated channel, left out. verb: goes into the quality's `method`.
    rng: draws the minimal samples; needed by MSAC only. Logs a warning where the normals span a narrow cone.
    Raises `BadCalibration` where the pairs are too few, all dark or clipped, or do not determine M.
    """
    options = options or FitOptions()
    normals = np.asarray(normals_in_camera, dtype=np.float64)
    colours = np.asarray(rgb, dtype=np.float64)
    require_shape(normals, (None, 3), "normals")
    require_shape(colours, (len(normals), 3), "colours")
    require_finite(normals, "normals")
    clipped = np.zeros(len(normals), np.bool_) if clipped is None else clipped
    require_shape(clipped, (len(normals),), "clipped")
    usable = np.asarray(np.isfinite(colours).all(axis=1) & ~clipped)
    _require_light(colours, usable)
    design = Design.from_pairs(normals, colours, with_ambient=options.model is ResponseModel.AMBIENT)
    if options.method is FitMethod.MSAC:
        if rng is None:
            raise BadInput("fit: MSAC draws samples and needs a random generator (rng=...)")
        unknowns, inliers = fit_by_msac(design, usable, options.draws, options.inlier_share, rng)
    else:
        unknowns, inliers = fit_by_trimming(
            design, usable, options.shadow_share, options.outlier_sigmas, options.rounds
        )
    response = response_from_unknowns(unknowns)
    quality = fit_quality(normals[inliers], colours[inliers], response, verb)
    warn_of_weak_fit(quality)
    return ResponseFit(response=response, quality=quality, inliers=inliers)


def response_from_unknowns(unknowns: FloatArray) -> LightResponse:
    """Turn the solution (3 or 4, 3), rows n_x, n_y, n_z and constant, into a light response."""
    ambient = unknowns[3] if len(unknowns) == 4 else np.zeros(3)
    try:
        return LightResponse(matrix=unknowns[:3].T, ambient=ambient)
    except BadRig as error:
        raise BadCalibration(f"calibration: {error}") from error


def _require_light(colours: FloatArray, usable: Mask) -> None:
    if not len(colours):
        raise BadCalibration("calibration: no pixel to fit on; check the mask")
    if not usable.any():
        raise BadCalibration(
            "calibration: every pixel is clipped; expose so that no channel reaches full scale on the target"
        )
    brightest = colours[usable].max(axis=0)
    if not (brightest > 1e-6).all():
        dark = [
            name for name, value in zip(("red", "green", "blue"), brightest, strict=True) if value <= 1e-6
        ]
        raise BadCalibration(
            f"calibration: no light in the {', '.join(dark)} channel; all three lights must reach the target"
        )
