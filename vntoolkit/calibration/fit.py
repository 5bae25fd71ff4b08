"""The light response fitted to pairs of normal and colour (equation 4), and the quality of the fit.

Every calibration object (ball, board, head) gives such pairs. Two methods leave out shadow, gloss and wrong
pairs: trimmed least squares, and MSAC.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from vntoolkit.arrays import BoolArray, FloatArray, IntArray, Mask, Points, Points2
from vntoolkit.checks import checks_kinds, require_finite, require_shape
from vntoolkit.errors import BadCalibration, BadInput, BadRig
from vntoolkit.options.calibration import FitMethod, ResponseFitOptions, ResponseModel
from vntoolkit.photometry.fit_quality import angles_deg, cone_of_normals_deg, warn_of_weak_fit
from vntoolkit.photometry.response import LightResponse, scaled_normals_from_rgb
from vntoolkit.photometry.rig import FitQuality
from vntoolkit.spread import robust_deviation

_FIRST_SHADOW_SHARE = 0.15  # of a channel's 99th percentile: what surely is lit before anything is known
SHADOW_SHARE = 0.08  # of a channel's largest contribution: a pair with less counts as shadowed
_OUTLIER_SIGMAS = 3.0  # robust standard deviations of the colour residual: beyond is gloss or cast shadow
_INLIER_SHARE = 0.08  # of the median length of the colours: largest residual of MSAC's inliers
_ROUNDING = 1e-9  # of the largest colour: residuals below it are arithmetic
_FLATTEST_DESIGN = 5e-3  # smallest over largest singular value of the normals that still determine M
_SMALLEST_DETERMINANT = 0.02  # of three unit normals: below it noise decides
LARGEST_CONDITION = 1e3  # of M, anywhere in the image: no such rig is usable
_SCORED_PAIRS = 4000  # a cost over more pairs ranks the samples no better
_DRAWS = 2000  # minimal samples of MSAC


@dataclass(frozen=True, kw_only=True, eq=False)
class ResponseFit:
    """A fitted light response. inliers: (n,) bool, the pairs it rests on; normals, rgb: (n, 3), all pairs."""

    response: LightResponse
    quality: FitQuality
    inliers: BoolArray
    normals: Points
    rgb: Points


@checks_kinds
def fit_response(
    normals_in_camera: Points,
    rgb: Points,
    options: ResponseFitOptions | None = None,
    *,
    clipped: Mask | None = None,
    verb: str = "fit",
    rng: np.random.Generator | None = None,
) -> ResponseFit:
    """Equation 4: fit the 3×4 M, `r = [M a] [n; 1]`, to pairs of normal and linear colour, both (n, 3).

    Without ambient light (the default) a = 0 and M is 3×3. Sections III-A and IV of brostow2011.
    clipped: (n,) pairs with a saturated channel, left out. verb: goes into the quality's `method`.
    rng: draws the minimal samples; needed by MSAC only. Logs a warning where the normals span a narrow cone.
    Raises `BadCalibration` where the pairs are too few, all dark or clipped, or do not determine M.
    """
    options = options or ResponseFitOptions()
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
        unknowns, inliers = fit_by_msac(design, usable, rng)
    else:
        unknowns, inliers = fit_by_trimming(design, usable)
    response = response_from_unknowns(unknowns)
    quality = fit_quality(normals[inliers], colours[inliers], response, verb)
    warn_of_weak_fit(quality)
    return ResponseFit(response=response, quality=quality, inliers=inliers, normals=normals, rgb=colours)


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """The linear system rows @ unknowns = colours.

    rows: (n, k), k = 3: normals, k = 4: normals and a constant. colours: (n, 3). flattest: smallest over
    largest singular value of the rows that still determine the unknowns.
    """

    rows: Points
    colours: Points
    flattest: float = _FLATTEST_DESIGN

    @classmethod
    def from_pairs(cls, normals: Points, colours: Points, *, with_ambient: bool) -> Self:
        """Build from normals and colours (n, 3)."""
        rows = np.column_stack([normals, np.ones(len(normals))]) if with_ambient else normals
        return cls(rows=rows, colours=colours)

    @property
    def unknown_count(self) -> int:
        """k, of each channel."""
        return int(self.rows.shape[1])

    def solve(self, chosen: Mask) -> FloatArray:
        """Least squares over the chosen pairs, (k, 3); refuses where they do not determine it."""
        count = int(np.count_nonzero(chosen))
        if count < self.unknown_count:
            raise BadCalibration(
                f"calibration: only {count} lit, unclipped pixels or poses agree with one light response; "
                f"at least {self.unknown_count} are needed, hundreds are better"
            )
        unknowns, _, _, singular = np.linalg.lstsq(self.rows[chosen], self.colours[chosen], rcond=None)
        if not singular[-1] > self.flattest * singular[0]:
            raise BadCalibration(
                "calibration: the normals seen do not determine the light response (they lie in one plane or "
                "in too narrow a cone); show the target from more directions"
            )
        return unknowns

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        """Length of the colour error of every pair, (n,)."""
        return np.linalg.norm(self.rows @ unknowns - self.colours, axis=1)


def fit_by_trimming(
    design: Design, usable: Mask, shadow_share: float = SHADOW_SHARE
) -> tuple[FloatArray, Mask]:
    """Repeat least squares without attached shadow and without outliers until the set of pairs is stable.

    Returns the unknowns (3 or 4, 3) and the pairs used (n,). Robust scale: 1.4826 × median residual.
    """
    chosen = usable
    if shadow_share > 0:
        top = np.percentile(design.colours[usable], 99, axis=0)
        chosen = usable & (design.colours > _FIRST_SHADOW_SHARE * top).all(axis=1)
    floor = _ROUNDING * float(np.abs(design.colours[usable]).max())
    unknowns = design.solve(chosen)
    for _ in range(30):
        contributions = design.rows[:, :3] @ unknowns[:3]
        brightest = contributions[chosen].max(axis=0)
        lit = usable
        if shadow_share > 0:
            lit = usable & (contributions > shadow_share * brightest).all(axis=1)
        residuals = design.residuals(unknowns)
        if not lit.any():
            raise BadCalibration("calibration: no pixel is lit by all three lights; move the lights closer")
        scale = robust_deviation(residuals[lit])
        update = lit & (residuals <= max(_OUTLIER_SIGMAS * scale, floor))
        converged = np.array_equal(update, chosen)
        chosen = update
        unknowns = design.solve(chosen)
        if converged:
            break
    return unknowns, chosen


def fit_by_msac(
    design: Design,
    usable: Mask,
    rng: np.random.Generator,
    draws: int = _DRAWS,
    inlier_share: float = _INLIER_SHARE,
) -> tuple[FloatArray, Mask]:
    """Draw triples (quadruples with ambient), keep the lowest truncated cost, refit on its inliers.

    MSAC: Torr and Zisserman, MLESAC, 2000 (torr2000). Samples of nearly dependent normals and those that give
    a nearly singular M are passed over. inlier_share: threshold over the median colour length.
    """
    candidates = np.flatnonzero(usable)
    size = design.unknown_count
    if len(candidates) < size:
        design.solve(usable)  # raises with the count
    threshold = inlier_share * float(np.median(np.linalg.norm(design.colours[usable], axis=1)))
    samples = candidates[rng.integers(0, len(candidates), (draws, size))]
    models = _models_from_samples(design, samples)
    if not len(models):
        raise BadCalibration(
            f"calibration: none of {draws} samples of {size} normals determines a light response; "
            "the normals or the colours are too much alike"
        )
    scored = rng.permutation(candidates)[:_SCORED_PAIRS]
    best = models[int(np.argmin(_truncated_costs(design, scored, models, threshold)))]
    inliers = usable & (design.residuals(best) <= threshold)
    for _ in range(5):  # the refit moves the border of the inliers a little; it rests after a few rounds
        best = design.solve(inliers)
        update = usable & (design.residuals(best) <= threshold)
        if np.array_equal(update, inliers):
            break
        inliers = update
    return design.solve(inliers), inliers


def _models_from_samples(design: Design, samples: IntArray) -> FloatArray:
    """Solve all minimal samples (k, s) at once; returns the sound ones, (m, s, 3)."""
    rows = design.rows[samples]
    lengths = np.linalg.norm(rows, axis=2).prod(axis=1)
    sound = np.abs(np.linalg.det(rows)) > _SMALLEST_DETERMINANT * lengths
    models = np.linalg.solve(rows[sound], design.colours[samples[sound]])
    singular = np.linalg.svd(models[:, :3], compute_uv=False)
    return models[singular[:, 2] * LARGEST_CONDITION > singular[:, 0]]


def _truncated_costs(design: Design, scored: IntArray, models: FloatArray, threshold: float) -> FloatArray:
    rows, colours = design.rows[scored], design.colours[scored]
    costs = np.empty(len(models))
    for i, unknowns in enumerate(models):
        squared = np.square(rows @ unknowns - colours).sum(axis=1)
        costs[i] = np.minimum(squared, threshold * threshold).sum()
    return costs


def fit_quality(
    normals: Points, rgb: Points, response: LightResponse, method: str, positions_px: Points2 | None = None
) -> FitQuality:
    """Measure a fit on the pairs it used, normals and colours (n, 3), at pixels (n, 2) where it varies."""
    recovered = scaled_normals_from_rgb(rgb, response, positions_px)
    return FitQuality(
        method=method,
        residual_deg=float(np.median(angles_deg(recovered, normals))),
        condition_number=response.condition_number,
        samples=len(normals),
        cone_deg=cone_of_normals_deg(normals),
    )
