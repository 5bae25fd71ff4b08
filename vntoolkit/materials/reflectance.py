"""The reflectance of one material from the unit length of its normals.

Lamp k of direction l_k reaches a normal n with l_k · n. A material returns ρ_k of it, relative to the
material that the rig was calibrated on. Split by lamp, its colour is s_k = ρ_k (l_k · n + w_k), with the
ambient light's share w. L is the matrix of the rows l_k. Every pixel of one material then obeys

    |L⁻¹ (s ∘ 1/ρ − w)| = 1,

a quadric in 1/ρ with three unknowns (chakrabarti2016). It determines ρ as far as the normals spread.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vntoolkit.arrays import FloatArray, Matrix3, Points, Vector3
from vntoolkit.errors import BadInput
from vntoolkit.photometry.response import LightResponse
from vntoolkit.spread import robust_deviation

CAP = 3.0  # standard deviations at which a residual stops to count more
# Spread of log ρ before anything is seen: paints return 0.1 to 1 of the light.
_PRIOR_SPREAD = 0.6
LARGEST_RATIO = np.log(12.0)  # of the reflectances of one material
_ROUNDS = 14
_FIRST_TOLERANCE = 0.3  # of the first round; halved every round, so that a poor start is no outlier
_LARGEST_STEP = 0.5
_STARTS = np.vstack([np.zeros(3), 0.7 * np.eye(3), -0.7 * np.eye(3)])


class Lamps(NamedTuple):
    """What a response tells of each lamp.

    split: (3, 3), colour to contributions of the lamps. ambient: (3,), those of the ambient light. inverse:
    (3, 3), L⁻¹. noise: (3,), standard deviation of each contribution. mixing: (3, 3), split times the
    standard deviation of the channels. deviations: (3,), standard deviations of the lamps' directions,
    radians.
    """

    split: Matrix3
    ambient: Vector3
    inverse: Matrix3
    noise: Vector3
    mixing: Matrix3
    deviations: Vector3


@dataclass(frozen=True, kw_only=True, eq=False)
class Reflectance:
    """What a material returns of each lamp, relative to the calibration material.

    values: (3,). covariance: (3, 3), of log values. error_deg: root mean square angle by which this turns the
    normals that it was fitted on. lamps_deg: the same, by what is not known of the lamps' directions.
    residual: robust standard deviation of the normals' lengths.
    """

    values: Vector3
    covariance: Matrix3
    error_deg: float
    lamps_deg: float
    residual: float


def lamps_from_response(response: LightResponse, noise: Vector3) -> Lamps:
    """Return what a response tells of each lamp. noise: (3,), standard deviation of the channels R, G, B.

    Raises `BadInput` where the response does not hold the colours of its lamps.
    """
    if response.light_colours is None:
        raise BadInput(
            "materials: the rig does not hold the colours of its lamps, so that nothing tells a material's "
            "colour from its shape: calibrate with one photograph per lamp (--single-light), or use "
            "--materials calibrated"
        )
    split = response.contributions_from_rgb
    mixing = split * noise
    deviations = np.zeros(3) if response.light_doubts_deg is None else np.radians(response.light_doubts_deg)
    return Lamps(
        split=split,
        ambient=split @ response.ambient,
        inverse=np.linalg.inv(response.lights),
        noise=np.linalg.norm(mixing, axis=1),
        mixing=mixing,
        deviations=deviations,
    )


def reflectance_from_fit(
    log: Vector3, covariance: Matrix3, contributions: Points, lamps: Lamps
) -> Reflectance:
    """Return the reflectance of log values (3,) and their covariance (3, 3), judged on pixels (n, 3)."""
    values = np.exp(log)
    normals = (contributions / values - lamps.ambient) @ lamps.inverse.T
    lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-9)
    normals, shares = normals / lengths[:, None], contributions / values
    residual = robust_deviation(lengths - 1.0)
    return Reflectance(
        values=values,
        covariance=covariance,
        error_deg=_error_deg(normals, shares, lamps.inverse, covariance),
        lamps_deg=_error_of_lamps_deg(normals, shares, values, lamps, residual),
        residual=residual,
    )


def best_fit(
    s: Points,
    lamps: Lamps,
    tolerance: float,
    starts: Points | None = None,
    spread: float | None = None,
    independent: float = 1.0,
) -> tuple[Vector3, Matrix3, float]:
    """Return log ρ (3,), its normal matrix (3, 3) without the prior, and the mean cost, of the best start.

    spread: standard deviation of log ρ about the start; without it, about one reflectance in all bands.
    independent: share of the pixels whose errors are independent. No paint is of one band alone.
    """
    scale = _scale_of(s, lamps)
    if starts is None:
        starts = scale + _STARTS
    prior = np.eye(3) / (independent * (_PRIOR_SPREAD if spread is None else spread) ** 2)
    best: tuple[Vector3, Matrix3, float] | None = None
    for start in starts:
        found = _fit(s, lamps, tolerance, start, scale if spread is None else start, prior)
        is_paint = np.ptp(found[0]) < LARGEST_RATIO
        if best is None or (is_paint, -found[2]) > (np.ptp(best[0]) < LARGEST_RATIO, -best[2]):
            best = found
    assert best is not None
    return best


def _scale_of(s: Points, lamps: Lamps) -> Vector3:
    """(3,), log of the one reflectance in all bands that gives normals unit length in the median."""
    length = np.median(np.linalg.norm(s @ lamps.inverse.T, axis=1))
    return np.full(3, np.log(max(float(length), 1e-6)))


def _error_deg(normals: Points, shares: Points, inverse: Matrix3, covariance: Matrix3) -> float:
    """Root mean square turn of the normals under errors of log ρ."""
    turns = -inverse[None] * shares[:, None, :]  # (n, 3 of normal, 3 of log ρ)
    turns -= normals[:, :, None] * np.einsum("ni,nij->nj", normals, turns)[:, None, :]
    squares = np.einsum("nij,jk,nik->n", turns, covariance, turns)
    return float(np.degrees(np.sqrt(np.mean(squares))))


def _error_of_lamps_deg(
    normals: Points, shares: Points, values: Vector3, lamps: Lamps, residual: float
) -> float:
    """Root mean square turn of the normals under errors δL of the lamps' directions, M being known.

    With D = diag(1/ρ) a normal is L⁻¹ D L M⁻¹ r. So δL turns it by L⁻¹ (D E D⁻¹ − E) L n with E = δL L⁻¹, and
    element k, j of the bracket is E_kj (ρ_j/ρ_k − 1): 0 for the rig's own material. Then ρ is fitted, so that
    lengths are 1 again, which turns normals once more.
    """
    if not lamps.deviations.any():
        return 0.0
    others = values / values[:, None] - 1.0  # k, j
    turns = []
    for k, lamp in enumerate(np.linalg.inv(lamps.inverse)):
        strength = float(np.linalg.norm(lamp))
        across = np.linalg.svd(lamp[None])[2][1:] * lamps.deviations[k] * strength  # where it may move to
        of_k = shares @ (others[k][:, None] * (lamps.inverse.T @ across.T))
        turns.append(lamps.inverse[:, k][None, :, None] * of_k[:, None, :])
    turned = np.concatenate(turns, axis=2)  # (n, 3 of normal, 6 of the lamps)
    of_log = -lamps.inverse[None] * shares[:, None, :]  # (n, 3 of normal, 3 of log ρ)
    longer, longer_by_log = (np.einsum("ni,nij->nj", normals, each) for each in (turned, of_log))
    prior = (residual / _PRIOR_SPREAD) ** 2 * np.eye(3)
    turned -= of_log @ np.linalg.solve(longer_by_log.T @ longer_by_log + prior, longer_by_log.T @ longer)
    turned -= normals[:, :, None] * np.einsum("ni,nij->nj", normals, turned)[:, None, :]
    return float(np.degrees(np.sqrt(np.mean((turned**2).sum(axis=(1, 2))))))


def _fit(
    s: Points, lamps: Lamps, tolerance: float, start: Vector3, centre: Vector3, prior: Matrix3
) -> tuple[Vector3, Matrix3, float]:
    """Gauss–Newton in log ρ with Geman and McClure's weights, from rough to fine."""
    z = np.array(start, np.float64)
    for i in range(_ROUNDS):
        error, variance, slopes = lengths_of_normals(s, np.exp(-z), lamps)
        variance = variance + max(tolerance, _FIRST_TOLERANCE * 0.5**i) ** 2
        t = error**2 / variance
        falling = 1.0 / (1.0 + t / CAP**2)
        weighed = slopes * (falling**2 / variance)[:, None]
        normal_matrix = weighed.T @ slopes
        if i + 1 < _ROUNDS:
            step = np.linalg.solve(normal_matrix + prior, prior @ (centre - z) - weighed.T @ error)
            z = z + step.clip(-_LARGEST_STEP, _LARGEST_STEP)
    return z, normal_matrix, 0.5 * float((t * falling).sum()) / max(len(s), 1)


def lengths_of_normals(
    s: FloatArray, q: FloatArray, lamps: Lamps
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return |n| − 1 (…), its variance by noise (…), and its derivative by log ρ (…, 3).

    s: (…, 3), contributions. q: (3,) or (…, 3), 1 / ρ.
    """
    normals = (s * q - lamps.ambient) @ lamps.inverse.T
    lengths = np.sqrt((normals**2).sum(axis=-1)) + 1e-12
    along = (normals @ lamps.inverse) * (q / lengths[..., None])
    variance = ((along @ lamps.mixing) ** 2).sum(axis=-1)
    error = (lengths**2 - bias_of_noise(q, lamps.inverse, lamps.mixing) - 1.0) / (lengths + 1.0)
    return error, variance, -along * s


def bias_of_noise(q: FloatArray, inverse: Matrix3, mixing: Matrix3) -> FloatArray:
    """(…), trace of the covariance of n, of 1 / ρ q (…, 3): noise across a normal makes it longer."""
    return np.asarray((((inverse * q[..., None, :]) @ mixing) ** 2).sum(axis=(-2, -1)))
