"""Linear fits that leave out shadow, gloss and wrong pairs: trimmed least squares and MSAC."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Mask, Points
from vntoolkit.errors import BadCalibration

_FIRST_SHADOW_SHARE = 0.15  # of a channel's 99th percentile: what surely is lit before anything is known
_ROUNDING = 1e-9  # of the largest colour: residuals below it are arithmetic, not evidence
_FLATTEST_DESIGN = 5e-3  # smallest over largest singular value of the normals that still determine M
_SMALLEST_DETERMINANT = 0.02  # of three unit normals (or of four with ambient): below it noise decides
_LARGEST_CONDITION = 1e3  # of a sampled M: no such rig is usable
_SCORED_PAIRS = 4000  # a cost over more pairs ranks the samples no better


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """The linear system rows @ unknowns = colours.

    rows: (n, 3) normals or (n, 4) normals and a constant. colours: (n, 3).
    """

    rows: Points
    colours: Points

    @classmethod
    def from_pairs(cls, normals: Points, colours: Points, *, with_ambient: bool) -> Self:
        """Build from normals and colours (n, 3)."""
        rows = np.column_stack([normals, np.ones(len(normals))]) if with_ambient else normals
        return cls(rows=rows, colours=colours)

    @property
    def unknown_count(self) -> int:
        """3, or 4 with ambient."""
        return int(self.rows.shape[1])

    def solve(self, chosen: Mask) -> FloatArray:
        """Least squares over the chosen pairs, (3 or 4, 3); refuses where they do not determine it."""
        count = int(np.count_nonzero(chosen))
        if count < self.unknown_count:
            raise BadCalibration(
                f"calibration: only {count} lit, unclipped pixels or poses agree with one light response; "
                f"at least {self.unknown_count} are needed, hundreds are better"
            )
        unknowns, _, _, singular = np.linalg.lstsq(self.rows[chosen], self.colours[chosen], rcond=None)
        if not singular[-1] > _FLATTEST_DESIGN * singular[0]:
            raise BadCalibration(
                "calibration: the normals seen do not determine the light response (they lie in one plane or "
                "in too narrow a cone); show the target from more directions"
            )
        return unknowns

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        """Length of the colour error of every pair, (n,)."""
        return np.linalg.norm(self.rows @ unknowns - self.colours, axis=1)


def fit_by_trimming(
    design: Design, usable: Mask, shadow_share: float, outlier_sigmas: float, rounds: int
) -> tuple[FloatArray, Mask]:
    """Repeat least squares without attached shadow and without outliers until the set of pairs rests.

    Returns the unknowns (3 or 4, 3) and the pairs used (n,). Robust scale: 1.4826 × median residual.
    """
    chosen = usable
    if shadow_share > 0:
        top = np.percentile(design.colours[usable], 99, axis=0)
        chosen = usable & (design.colours > _FIRST_SHADOW_SHARE * top).all(axis=1)
    floor = _ROUNDING * float(np.abs(design.colours[usable]).max())
    unknowns = design.solve(chosen)
    for _ in range(rounds):
        contributions = design.rows[:, :3] @ unknowns[:3]
        brightest = contributions[chosen].max(axis=0)
        lit = usable
        if shadow_share > 0:
            lit = usable & (contributions > shadow_share * brightest).all(axis=1)
        residuals = design.residuals(unknowns)
        if not lit.any():
            raise BadCalibration("calibration: no pixel is lit by all three lights; move the lights closer")
        scale = 1.4826 * float(np.median(residuals[lit]))
        update = lit & (residuals <= max(outlier_sigmas * scale, floor))
        settled = np.array_equal(update, chosen)
        chosen = update
        unknowns = design.solve(chosen)
        if settled:
            break
    return unknowns, chosen


def fit_by_msac(
    design: Design, usable: Mask, draws: int, inlier_share: float, rng: np.random.Generator
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
    sound = np.abs(np.linalg.det(rows)) > _SMALLEST_DETERMINANT
    models = np.linalg.solve(rows[sound], design.colours[samples[sound]])
    singular = np.linalg.svd(models[:, :3], compute_uv=False)
    return models[singular[:, 2] * _LARGEST_CONDITION > singular[:, 0]]


def _truncated_costs(design: Design, scored: IntArray, models: FloatArray, threshold: float) -> FloatArray:
    rows, colours = design.rows[scored], design.colours[scored]
    costs = np.empty(len(models))
    for i, unknowns in enumerate(models):
        squared = np.square(rows @ unknowns - colours).sum(axis=1)
        costs[i] = np.minimum(squared, threshold * threshold).sum()
    return costs
