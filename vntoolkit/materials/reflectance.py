"""The reflectance of one material from the unit length of its normals.

Lamp k of direction l_k reaches a normal n with l_k · n. A material returns ρ_k of it, relative to the
material that the rig was calibrated on. Split by lamp, its colour is s_k = ρ_k (l_k · n + w_k), with the
ambient light's share w. L is the matrix of the rows l_k. Every pixel of one material then obeys

    |L⁻¹ (s ∘ 1/ρ − w)| = 1,

a quadric in 1/ρ with three unknowns (chakrabarti2016). It determines ρ as far as the normals spread.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from vntoolkit.arrays import Matrix3, Points, Vector3
from vntoolkit.errors import BadInput
from vntoolkit.native import njit
from vntoolkit.photometry.response import LightResponse

CAP = 3.0  # standard deviations at which a residual stops to count more
# Spread of log ρ before anything is seen: paints return 0.1 to 1 of the light.
_PRIOR_SPREAD = 0.6
_LARGEST_RATIO = np.log(12.0)  # of the reflectances of one material
_ROUNDS = 14
_FIRST_TOLERANCE = 0.3  # of the first round; halved every round, so that a poor start is no outlier
_LARGEST_STEP = 0.5
_STARTS = np.vstack([np.zeros(3), 0.7 * np.eye(3), -0.7 * np.eye(3)])


class Lamps(NamedTuple):
    """What the kernels need of a response.

    split: (3, 3), colour to contributions of the lamps. haze: (3,), those of the ambient light. inverse:
    (3, 3), L⁻¹. noise: (3,), standard deviation of each contribution. mixing: (3, 3), split times the
    standard deviation of the channels. doubts: (3,), standard deviations of the lamps' directions, radians.
    """

    split: Matrix3
    haze: Vector3
    inverse: Matrix3
    noise: Vector3
    mixing: Matrix3
    doubts: Vector3


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
    """Return what the kernels need. noise: (3,), standard deviation of the channels R, G, B.

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
    doubts = np.zeros(3) if response.light_doubts_deg is None else np.radians(response.light_doubts_deg)
    return Lamps(
        split=split,
        haze=split @ response.ambient,
        inverse=np.linalg.inv(response.lights),
        noise=np.linalg.norm(mixing, axis=1),
        mixing=mixing,
        doubts=doubts,
    )


def reflectance_from_fit(
    log: Vector3, covariance: Matrix3, contributions: Points, lamps: Lamps
) -> Reflectance:
    """Return the reflectance of log values (3,) and their covariance (3, 3), judged on pixels (n, 3)."""
    values = np.exp(log)
    normals = (contributions / values - lamps.haze) @ lamps.inverse.T
    lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-9)
    normals, shares = normals / lengths[:, None], contributions / values
    residual = 1.4826 * float(np.median(np.abs(lengths - 1.0)))
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
        is_paint = np.ptp(found[0]) < _LARGEST_RATIO
        if best is None or (is_paint, -found[2]) > (np.ptp(best[0]) < _LARGEST_RATIO, -best[2]):
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
    if not lamps.doubts.any():
        return 0.0
    others = values / values[:, None] - 1.0  # k, j
    turns = []
    for k, lamp in enumerate(np.linalg.inv(lamps.inverse)):
        strength = float(np.linalg.norm(lamp))
        across = np.linalg.svd(lamp[None])[2][1:] * lamps.doubts[k] * strength  # where it may move to
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
    z, normal_matrix = np.array(start, np.float64), np.zeros((3, 3))
    cost = _go_down(s, *lamps[1:3], lamps.mixing, tolerance, centre, prior, z, normal_matrix)
    return z, normal_matrix, cost / max(s.shape[0], 1)


@njit(cache=True, error_model="numpy")
def _go_down(
    s: Any, haze: Any, inverse: Any, mixing: Any, tolerance: float, centre: Any, prior: Any, z: Any,
    normal_matrix: Any,
) -> float:  # fmt: skip
    """Move z (3,) to the least cost, which is returned, and fill the normal matrix there."""
    cost, gradient, step = 0.0, np.zeros(3), np.zeros(3)
    for i in range(_ROUNDS):
        rough = max(tolerance, _FIRST_TOLERANCE * 0.5**i)
        normal_matrix[:] = 0.0
        gradient[:] = 0.0
        cost = _gather(s, np.exp(-z), haze, inverse, mixing, rough, normal_matrix, gradient)
        if i + 1 < _ROUNDS:
            for a in range(3):
                for b in range(3):
                    gradient[a] += prior[a, b] * (centre[b] - z[b])
            _solve(normal_matrix + prior, gradient, step)
            for a in range(3):
                z[a] += min(max(step[a], -_LARGEST_STEP), _LARGEST_STEP)
    return cost


@njit(cache=True, error_model="numpy")
def _solve(m: Any, right: Any, out: Any) -> None:
    """Solve three equations by cofactors: numpy's solver would take ten seconds to compile."""
    c0 = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    c1 = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    c2 = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    determinant = m[0, 0] * c0 + m[0, 1] * c1 + m[0, 2] * c2
    r0, r1, r2 = right[0], right[1], right[2]
    out[0] = r0 * c0 + m[0, 1] * (m[1, 2] * r2 - r1 * m[2, 2]) + m[0, 2] * (r1 * m[2, 1] - m[1, 1] * r2)
    out[1] = m[0, 0] * (r1 * m[2, 2] - m[1, 2] * r2) + r0 * c1 + m[0, 2] * (m[1, 0] * r2 - r1 * m[2, 0])
    out[2] = m[0, 0] * (m[1, 1] * r2 - r1 * m[2, 1]) + m[0, 1] * (r1 * m[2, 0] - m[1, 0] * r2) + r0 * c2
    for a in range(3):
        out[a] /= determinant


@njit(cache=True, error_model="numpy")
def _gather(
    s: Any, q: Any, haze: Any, inverse: Any, mixing: Any, rough: float, normal_matrix: Any, gradient: Any
) -> float:
    """Add up the normal matrix (3, 3) and the gradient (3,) over all pixels; return the cost."""
    cost = 0.0
    j = np.empty(3)
    bias = bias_of_noise(q, inverse, mixing)
    for p in range(s.shape[0]):
        e, variance = length_and_variance(s[p], q, haze, inverse, mixing, bias, j)
        variance += rough * rough
        t = e * e / variance
        falling = 1.0 / (1.0 + t / (CAP * CAP))
        cost += 0.5 * t * falling
        weight = falling * falling / variance
        for a in range(3):
            gradient[a] -= weight * j[a] * e
            for b in range(3):
                normal_matrix[a, b] += weight * j[a] * j[b]
    return cost


@njit(cache=True, inline="always", error_model="numpy")
def length_and_variance(s: Any, q: Any, haze: Any, inverse: Any, mixing: Any, bias: float, j: Any) -> Any:
    """Return |n| − 1, its variance by noise, and fill j (3,) with its derivative by log ρ.

    bias: what noise adds to |n|² on average; see `bias_of_noise`.
    """
    x0, x1, x2 = s[0] * q[0] - haze[0], s[1] * q[1] - haze[1], s[2] * q[2] - haze[2]
    n0 = inverse[0, 0] * x0 + inverse[0, 1] * x1 + inverse[0, 2] * x2
    n1 = inverse[1, 0] * x0 + inverse[1, 1] * x1 + inverse[1, 2] * x2
    n2 = inverse[2, 0] * x0 + inverse[2, 1] * x1 + inverse[2, 2] * x2
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + 1e-12
    over = 1.0 / length
    h0 = (n0 * inverse[0, 0] + n1 * inverse[1, 0] + n2 * inverse[2, 0]) * over * q[0]
    h1 = (n0 * inverse[0, 1] + n1 * inverse[1, 1] + n2 * inverse[2, 1]) * over * q[1]
    h2 = (n0 * inverse[0, 2] + n1 * inverse[1, 2] + n2 * inverse[2, 2]) * over * q[2]
    j[0], j[1], j[2] = -h0 * s[0], -h1 * s[1], -h2 * s[2]
    variance = 0.0
    for c in range(3):
        along = h0 * mixing[0, c] + h1 * mixing[1, c] + h2 * mixing[2, c]
        variance += along * along
    return (length * length - bias - 1.0) / (length + 1.0), variance


@njit(cache=True, error_model="numpy")
def bias_of_noise(q: Any, inverse: Any, mixing: Any) -> float:
    """Trace of the covariance of n: noise across a normal makes it longer."""
    total = 0.0
    for i in range(3):
        for c in range(3):
            along = 0.0
            for k in range(3):
                along += inverse[i, k] * q[k] * mixing[k, c]
            total += along * along
    return total
