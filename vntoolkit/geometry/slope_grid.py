"""A depth on the pixel grid whose slopes are what every pixel asks of them.

Under a perspective camera the unknown is f · log z, whose gradient takes the place of the slope: then the
normal is n ∝ (p, q, −1 − x p − y q) along the ray (x, y, 1).

A quadrant is the pixel, its neighbour along u and its neighbour along v: 0 right and below, 1 left and below,
2 right and above, 3 left and above. In each the depth has one gradient. A pixel asks by a quadratic of the
slope s, sᵀ A s − 2 sᵀ t, and a weight says how far a quadrant belongs to its surface.
"""

from typing import Any, NamedTuple

import numpy as np

from vntoolkit.arrays import ByteArray, Float32Array, Mask
from vntoolkit.geometry.camera import Camera
from vntoolkit.native import njit

Grid = Float32Array
Labels = ByteArray
NO_STEP = 1e30  # so soft that nothing is a step
FLATTEST_Z = 0.12  # |n_z| below which a first slope is held, so that no pixel starts edge-on
STEEPEST = 8.0  # largest slope: the tangent of the angle from the viewing ray


class RayGrid(NamedTuple):
    """The ray through pixel (u, v): x = (u − centre_u) · per_pixel_u, y = (v − centre_v) · per_pixel_v."""

    centre_u: np.float32
    centre_v: np.float32
    per_pixel_u: np.float32
    per_pixel_v: np.float32


def ray_grid(camera: Camera | None) -> RayGrid:
    """Return a camera's rays, distortion ignored; all along the axis without one, or if orthographic."""
    if camera is None or not camera.is_perspective:
        return RayGrid(*np.zeros(4, np.float32))
    k = camera.matrix
    values = (k[0, 2], k[1, 2], 1.0 / k[0, 0], 1.0 / k[1, 1])
    return RayGrid(*(np.float32(value) for value in values))


@njit(forceinline=True)
def ray_at(rays: RayGrid, v: int, u: int) -> tuple[Any, Any]:
    """Return (x, y) of the pixel's ray at depth 1."""
    x = (np.float32(u) - rays.centre_u) * rays.per_pixel_u
    return x, (np.float32(v) - rays.centre_v) * rays.per_pixel_v


@njit
def weights_kernel(
    quadratics: Grid, labels: Labels, mask: Mask, slopes: Grid, depth: Grid, robust_scale: Any,
    shadow_robust_scale: Any, out: Grid,
) -> None:  # fmt: skip
    """Fill out (4, h, w): how far each quadrant's gradient belongs to the pixel's own surface, 0 to 1.

    Where lights arrive the pixel knows its slope; a quadrant whose depth gradient disagrees crosses a step:
    weight (s / (s + χ²))² (Geman and McClure's: a step has no weight at all), where s = robust_scale under
    three lights and shadow_robust_scale under two. Other pixels take what they are given.
    """
    h, w = labels.shape
    for v in range(h):
        soft, label = np.empty(w, np.float32), labels[v]
        a00, a01, a11 = quadratics[0, v], quadratics[1, v], quadratics[2, v]
        b0, b1, c = quadratics[3, v], quadratics[4, v], quadratics[5, v]
        for u in range(w):
            bits = label[u]
            lights = (bits & 1) + ((bits >> 1) & 1) + (bits >> 2)
            known = robust_scale if lights == 3 else shadow_robust_scale
            soft[u] = known if lights >= 2 else np.float32(NO_STEP)
        for i in range(4):
            y, to = (v + 1 if i < 2 else v - 1), out[i, v]
            for u in range(w):
                to[u] = np.float32(0.0)
            if y < 0 or y >= h or w < 2:
                continue
            here = slice(0, w - 1) if i % 2 == 0 else slice(1, w)
            there = slice(1, w) if i % 2 == 0 else slice(0, w - 1)
            _quadrant_row(
                depth[v, here], depth[v, there], depth[y, here], mask[v, here], mask[v, there], mask[y, here],
                slopes[0, v, here], slopes[1, v, here], a00[here], a01[here], a11[here], b0[here], b1[here],
                c[here], soft[here], np.float32(1 - 2 * (i % 2)), np.float32(1.0 if i < 2 else -1.0),
                to[here],
            )  # fmt: skip


@njit
def _quadrant_row(
    depth: Grid, beside: Grid, below: Grid, mask: Mask, mask_beside: Mask, mask_below: Mask, p: Grid,
    q: Grid, a00: Grid, a01: Grid, a11: Grid, b0: Grid, b1: Grid, c: Grid, soft: Grid, right: Any, down: Any,
    out: Grid,
) -> None:  # fmt: skip
    zero, two = np.float32(0.0), np.float32(2.0)
    for u in range(len(out)):
        d0 = right * (beside[u] - depth[u]) - p[u]
        d1 = down * (below[u] - depth[u]) - q[u]
        chi = c[u] - two * (b0[u] * d0 + b1[u] * d1)
        chi += a00[u] * d0 * d0 + two * a01[u] * d0 * d1 + a11[u] * d1 * d1
        weight = soft[u] / (soft[u] + max(chi, zero))
        inside = mask[u] & mask_beside[u] & mask_below[u]
        out[u] = weight * weight if inside else zero


@njit
def edges_kernel(quadratics: Grid, targets: Grid, weights: Grid, edges: Grid, right: Grid) -> None:
    """Sum all quadrants' quadratics into the edges (4, h, w) of a graph Laplacian and its right-hand side.

    With σ = ±1 the sign of the quadrant, 2 σ A01 d_u d_v = σ A01 (d_u² + d_v² − (d_u − d_v)²): every term is
    a squared difference between two pixels.
    """
    for v in range(len(right)):
        _edges_row(quadratics, targets, weights, v, edges, right[v])


@njit
def _edges_row(quadratics: Grid, targets: Grid, weights: Grid, v: int, edges: Grid, right: Grid) -> None:
    _, h, w = edges.shape
    last, quarter, zero = w - 1, np.float32(0.25), np.float32(0.0)
    q0, q1, q2, q3 = weights[0, v], weights[1, v], weights[2, v], weights[3, v]
    a00, a01, a11 = quadratics[0, v], quadratics[1, v], quadratics[2, v]
    east, south, south_east, south_west = edges[0, v], edges[1, v], edges[2, v], edges[3, v]
    s, t = targets[0, v], targets[1, v]
    for u in range(w):
        along, across = (q1[u] + q3[u]) - (q0[u] + q2[u]), (q2[u] + q3[u]) - (q0[u] + q1[u])
        right[u] = quarter * (along * s[u] + across * t[u])
        east[u] = south[u] = south_east[u] = south_west[u] = zero
    n1, n3, n00, n01, n_s, after = q1[1:], q3[1:], a00[1:], a01[1:], s[1:], right[1:]
    for u in range(last):
        east[u] = quarter * (
            (q0[u] + q2[u]) * a00[u] + (q0[u] - q2[u]) * a01[u] + (n1[u] + n3[u]) * n00[u]
            + (n3[u] - n1[u]) * n01[u]
        )  # fmt: skip
        right[u] -= quarter * (n1[u] + n3[u]) * n_s[u]
    for u in range(last):
        after[u] += quarter * (q0[u] + q2[u]) * s[u]
    if v > 0:
        p0, p1, above = weights[0, v - 1], weights[1, v - 1], targets[1, v - 1]
        for u in range(w):
            right[u] += quarter * (p0[u] + p1[u]) * above[u]
    if v + 1 < h:
        r2, r3, below = weights[2, v + 1], weights[3, v + 1], targets[1, v + 1]
        b01, b11 = quadratics[1, v + 1], quadratics[2, v + 1]
        for u in range(w):
            right[u] -= quarter * (r2[u] + r3[u]) * below[u]
            south[u] = quarter * (
                (q0[u] + q1[u]) * a11[u] + (q0[u] - q1[u]) * a01[u] + (r2[u] + r3[u]) * b11[u]
                + (r3[u] - r2[u]) * b01[u]
            )  # fmt: skip
        m3, m01 = r3[1:], b01[1:]
        for u in range(last):
            south_east[u] = quarter * (n1[u] * n01[u] + r2[u] * b01[u])
            south_west[u] = -quarter * (q0[u] * a01[u] + m3[u] * m01[u])


@njit
def slopes_kernel(depth: Grid, weights: Grid, steepest: Any, slopes: Grid, agreement: Grid) -> None:
    """Replace slopes (2, h, w) by the weighted mean over the quadrants; agreement (h, w) = mean weight.

    At the border, where quadrants are missing and differences are one-sided, the agreement is 0.
    """
    h, w = depth.shape
    for v in range(h):
        row = np.zeros(w + 2, np.float32)
        for u in range(w):
            row[u + 1] = depth[v, u]
        above, below = depth[max(v - 1, 0)], depth[min(v + 1, h - 1)]
        _slope_row(
            row[:w], row[1 : w + 1], row[2:], above, below, weights[0, v], weights[1, v], weights[2, v],
            weights[3, v], steepest, slopes[0, v], slopes[1, v], agreement[v],
        )  # fmt: skip


@njit
def _slope_row(
    left: Grid, here: Grid, right: Grid, above: Grid, below: Grid, q0: Grid, q1: Grid, q2: Grid, q3: Grid,
    steepest: Any, slope_p: Grid, slope_q: Grid, agreement: Grid,
) -> None:  # fmt: skip
    zero, one = np.float32(0.0), np.float32(1.0)
    for u in range(len(here)):
        a, b, c, d = q0[u], q1[u], q2[u], q3[u]
        total = (a + b) + (c + d)
        p = (a + c) * (right[u] - here[u]) + (b + d) * (here[u] - left[u])
        q = (a + b) * (below[u] - here[u]) + (c + d) * (here[u] - above[u])
        some = total > np.float32(1e-6)
        over = one / (total if some else one)
        p, q = p * over, q * over
        hold = steepest / max(np.sqrt(p * p + q * q), steepest)
        slope_p[u] = p * hold if some else slope_p[u]
        slope_q[u] = q * hold if some else slope_q[u]
        whole = (a > zero) & (b > zero) & (c > zero) & (d > zero)
        agreement[u] = np.float32(0.25) * total if whole else zero
