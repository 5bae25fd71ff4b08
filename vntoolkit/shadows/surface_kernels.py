"""Compiled loops of `surface`: what each pixel asks of the depth around it, gathered into grid edges.

A pixel's slope is s = (p, q), its normal n ∝ (p, q, −1 − x p − y q) with (x, y) the ray through it (0 for an
orthographic camera). The light it returns is f_k = L_k · n; J = ∂f/∂s. Around the current slope its energy is
the quadratic (g − s)ᵀ A (g − s) − 2 bᵀ(g − s) + c of the depth gradient g, with A = JᵀWJ, b = JᵀW(r − f).

Each pixel has four gradients g, one per quadrant: east or west difference with south or north difference.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

Grid = npt.NDArray[np.float32]
Labels = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]


class RayGrid(NamedTuple):
    """The ray through pixel (u, v): x = (u − centre_u) · per_pixel_u, y = (v − centre_v) · per_pixel_v."""

    centre_u: float
    centre_v: float
    per_pixel_u: float
    per_pixel_v: float


class Model(NamedTuple):
    """Standard deviations and weights of the energy; see `SurfaceOptions`."""

    noise: float
    albedo_known: float
    albedo_own: float
    prior: float
    damping: float
    doubt_trust: float
    doubt_reach: float


@njit(cache=True, inline="always")
def _ray(rays: RayGrid, v: int, u: int) -> tuple[float, float]:
    return (u - rays.centre_u) * rays.per_pixel_u, (v - rays.centre_v) * rays.per_pixel_v


@njit(cache=True, inline="always")
def _trust_of_missing(light: float, share: float, model: Model) -> float:
    """Weight of a light that is labelled missing: where the surface turns from it, what is seen is right.

    0 where the surface faces away (nothing is expected) or, beyond `doubt_reach`, faces a light that
    something else blocks (biweight).
    """
    away = (share - light) / model.doubt_reach
    if light <= 0.0 or away * away >= 1.0:
        return 0.0
    return model.doubt_trust * (1.0 - away * away) ** 2


@njit(cache=True, fastmath=True)
def local_quadratics_kernel(
    shares: Grid, labels: Labels, weight: Grid, slopes: Grid, prior: Grid,
    lights: npt.NDArray[np.float64], rays: RayGrid, model: Model, out: Grid,
) -> None:  # fmt: skip
    """Fill out (h, w, 6) = A00, A01, A11, b0, b1, c at every pixel.

    shares: (h, w, 3) contribution of each light over the albedo. The covariance of r is noise² I plus the
    albedo's uncertainty squared times f fᵀ, inverted by the Sherman–Morrison formula.
    """
    h, w = labels.shape
    inverse_variance = 1.0 / (model.noise * model.noise)
    for v in range(h):
        for u in range(w):
            trust = weight[v, u]
            if trust <= 0.0:
                for i in range(6):
                    out[v, u, i] = 0.0
                continue
            label = labels[v, u]
            x, y = _ray(rays, v, u)
            p, q = float(slopes[v, u, 0]), float(slopes[v, u, 1])
            nz = -1.0 - x * p - y * q
            scale = 1.0 / np.sqrt(p * p + q * q + nz * nz)
            n0, n1, n2 = p * scale, q * scale, nz * scale
            along_p, along_q = n0 - x * n2, n1 - y * n2
            ff, fr, f0, f1, a00, a01, a11, b0, b1, c = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(3):
                l0, l1, l2 = lights[k, 0], lights[k, 1], lights[k, 2]
                light = l0 * n0 + l1 * n1 + l2 * n2
                count = 1.0
                if (label >> k) & 1 == 0:
                    count = _trust_of_missing(light, shares[v, u, k], model)
                    if count == 0.0:
                        continue
                rest = shares[v, u, k] - light
                j0 = (l0 - x * l2 - light * along_p) * scale
                j1 = (l1 - y * l2 - light * along_q) * scale
                seen0, seen1, seen = count * j0, count * j1, count * light
                a00 += seen0 * j0
                a01 += seen0 * j1
                a11 += seen1 * j1
                b0 += seen0 * rest
                b1 += seen1 * rest
                c += count * rest * rest
                ff += seen * light
                fr += seen * rest
                f0 += seen * j0
                f1 += seen * j1
            spread = model.albedo_own if label == 7 else model.albedo_known
            unsure = spread * spread * inverse_variance
            shrink = unsure / (1.0 + unsure * ff)
            scaled = inverse_variance * trust
            toward = model.prior if label != 7 else 0.0
            extra = toward + model.damping
            out[v, u, 0] = scaled * (a00 - shrink * f0 * f0) + extra
            out[v, u, 1] = scaled * (a01 - shrink * f0 * f1)
            out[v, u, 2] = scaled * (a11 - shrink * f1 * f1) + extra
            out[v, u, 3] = scaled * (b0 - shrink * f0 * fr) + toward * (prior[v, u, 0] - p)
            out[v, u, 4] = scaled * (b1 - shrink * f1 * fr) + toward * (prior[v, u, 1] - q)
            out[v, u, 5] = scaled * (c - shrink * fr * fr)


@njit(cache=True, inline="always")
def _quadrant(i: int) -> tuple[int, int]:
    return (1 if i & 1 == 0 else -1), (1 if i & 2 == 0 else -1)


@njit(cache=True, fastmath=True)
def quadrant_weights_kernel(
    quadratics: Grid, labels: Labels, mask: Mask, slopes: Grid, depth: Grid,
    softness: float, shadow_softness: float, out: Grid,
) -> None:  # fmt: skip
    """Fill out (h, w, 4): how far each quadrant's gradient belongs to the pixel's own surface, 0 to 1.

    Where lights arrive the pixel knows its slope; a quadrant whose depth gradient disagrees crosses a step:
    weight (s / (s + χ²))² (Geman and McClure's: a step has no pull at all), where s = softness under three
    lights and shadow_softness under two. Other pixels take what they are given. softness 0: all 1.
    """
    h, w = labels.shape
    for v in range(h):
        for u in range(w):
            label = labels[v, u]
            lights = (label & 1) + ((label >> 1) & 1) + ((label >> 2) & 1)
            soft = softness if lights == 3 else shadow_softness
            for i in range(4):
                out[v, u, i] = 0.0
                su, sv = _quadrant(i)
                if not mask[v, u] or u + su < 0 or u + su >= w or v + sv < 0 or v + sv >= h:
                    continue
                if not mask[v, u + su] or not mask[v + sv, u]:
                    continue
                out[v, u, i] = 1.0
                if softness <= 0.0 or lights < 2:
                    continue
                d0 = su * (depth[v, u + su] - depth[v, u]) - slopes[v, u, 0]
                d1 = sv * (depth[v + sv, u] - depth[v, u]) - slopes[v, u, 1]
                a = quadratics[v, u]
                chi = a[5] - 2.0 * (a[3] * d0 + a[4] * d1)
                chi += a[0] * d0 * d0 + 2.0 * a[1] * d0 * d1 + a[2] * d1 * d1
                share = soft / (soft + max(chi, 0.0))
                out[v, u, i] = share * share


@njit(cache=True, fastmath=True)
def edges_kernel(quadratics: Grid, weights: Grid, edges: Grid) -> None:
    """Sum all quadrants' quadratics into the edges (4, h, w) of a graph Laplacian.

    With σ = ±1 the sign of the quadrant, 2 σ A01 d_u d_v = σ A01 (d_u² + d_v² − (d_u − d_v)²): every term is
    a squared difference between two pixels.
    """
    _, h, w = edges.shape
    for v in range(h):
        for u in range(w):
            here = quadratics[v, u]
            for kind in range(4):
                edges[kind, v, u] = 0.0
            if u + 1 < w:
                right = quadratics[v, u + 1]
                edges[0, v, u] = 0.25 * (
                    weights[v, u, 0] * (here[0] + here[1]) + weights[v, u, 2] * (here[0] - here[1])
                    + weights[v, u + 1, 1] * (right[0] - right[1])
                    + weights[v, u + 1, 3] * (right[0] + right[1])
                )  # fmt: skip
            if v + 1 < h:
                below = quadratics[v + 1, u]
                edges[1, v, u] = 0.25 * (
                    weights[v, u, 0] * (here[2] + here[1]) + weights[v, u, 1] * (here[2] - here[1])
                    + weights[v + 1, u, 2] * (below[2] - below[1])
                    + weights[v + 1, u, 3] * (below[2] + below[1])
                )  # fmt: skip
            if u + 1 < w and v + 1 < h:
                edges[2, v, u] = 0.25 * (
                    weights[v, u + 1, 1] * quadratics[v, u + 1, 1]
                    + weights[v + 1, u, 2] * quadratics[v + 1, u, 1]
                )
                edges[3, v, u] = -0.25 * (
                    weights[v, u, 0] * here[1] + weights[v + 1, u + 1, 3] * quadratics[v + 1, u + 1, 1]
                )


@njit(cache=True, inline="always")
def _target(quadratics: Grid, slopes: Grid, v: int, u: int) -> tuple[float, float]:
    a, p, q = quadratics[v, u], slopes[v, u, 0], slopes[v, u, 1]
    return a[0] * p + a[1] * q + a[3], a[1] * p + a[2] * q + a[4]


@njit(cache=True, fastmath=True)
def right_side_kernel(quadratics: Grid, slopes: Grid, weights: Grid, out: Grid) -> None:
    """Fill out (h, w), the right-hand side that belongs to `edges_kernel`."""
    h, w = out.shape
    for v in range(h):
        for u in range(w):
            total = 0.0
            t0, t1 = _target(quadratics, slopes, v, u)
            for i in range(4):
                su, sv = _quadrant(i)
                total -= weights[v, u, i] * (su * t0 + sv * t1)
                if 0 <= u - su < w:
                    total += weights[v, u - su, i] * su * _target(quadratics, slopes, v, u - su)[0]
                if 0 <= v - sv < h:
                    total += weights[v - sv, u, i] * sv * _target(quadratics, slopes, v - sv, u)[1]
            out[v, u] = 0.25 * total


@njit(cache=True, fastmath=True)
def slopes_kernel(depth: Grid, weights: Grid, steepest: float, slopes: Grid, agreement: Grid) -> None:
    """Replace slopes (h, w, 2) by the weighted mean over the quadrants; agreement (h, w) = mean weight.

    At the border, where quadrants are missing and differences are one-sided, the agreement is 0.
    """
    h, w = depth.shape
    for v in range(h):
        for u in range(w):
            total, count, p, q = 0.0, 0, 0.0, 0.0
            for i in range(4):
                share = weights[v, u, i]
                if share > 0.0:
                    su, sv = _quadrant(i)
                    p += share * su * (depth[v, u + su] - depth[v, u])
                    q += share * sv * (depth[v + sv, u] - depth[v, u])
                    total += share
                    count += 1
            agreement[v, u] = total / 4 if count == 4 else 0.0
            if total > 1e-6:
                p, q = p / total, q / total
                long = np.sqrt(p * p + q * q)
                hold = min(1.0, steepest / max(long, 1e-12))
                slopes[v, u, 0], slopes[v, u, 1] = p * hold, q * hold
