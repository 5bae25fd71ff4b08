"""The surface under the shadows: depth, and with it every normal, from whichever lights arrive.

Hernández, Vogiatzis and Cipolla (hernandez2008) let depth supply the one degree of freedom that a shadow
takes away: the two remaining lights leave a line of slopes, integrability picks the point. Here the same
holds for any number of lights. Every pixel asks the depth gradient to explain the light that arrives,
f_k(s) = L_k · n(s) = r_k / albedo for each light k of its label, with an albedo that is the pixel's own where
all three lights arrive and known to `albedo_spread` from the surroundings where not. Without light a weak
prior asks for a smooth slope. Gauss–Newton steps solve one weighted Poisson equation each.

Under a perspective camera the unknown is f · log z, whose gradient takes the place of the slope.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels, Weight
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT
from vntoolkit.shadows.albedo import fill_smoothly
from vntoolkit.shadows.contributions import TOWARDS_VIEWER, lengths_of, mean_inside
from vntoolkit.solvers import grid_hierarchy, solve_grid

FLATTEST_Z = 0.12  # |n_z| below which a first slope is held, so that no pixel starts edge-on
Grid = npt.NDArray[np.float32]
Labels = npt.NDArray[np.uint8]
# The energy; cosines are 1 where a surface of the local albedo faces the light.
_ALBEDO_SPREAD = 0.15  # relative standard deviation of the albedo continued into a shadow
_OWN_ALBEDO_SPREAD = 3.0  # the same where all three lights arrive: there the colour's length is the albedo
_STEP_SOFTNESS = 10.0  # χ² at which a depth gradient counts a quarter, as it crosses a step in depth
_SHADOW_STEP_SOFTNESS = 40.0  # the same under two lights, where the slope hangs on the albedo around
_SMOOTH_PX = 2.0  # standard deviation of the surroundings whose mean slope a shadowed pixel is drawn to
_MISSING_LIGHT_WEIGHT = 0.3  # of a light labelled missing where the surface would return what is seen …
_MISSING_LIGHT_CUTOFF = 0.2  # … and the difference of cosines at which that weight ends
_DAMPING = 1.0  # holds the slope back where nothing else is known
STEEPEST = 8.0  # largest slope: the tangent of the angle from the viewing ray
_CYCLES, _TOLERANCE = 5, 3e-3  # multigrid cycles a step, at most; relative residual that ends one early


@dataclass(frozen=True, kw_only=True)
class SurfaceOptions:
    """What detection and recovery ask differently of the surface.

    noise: standard deviation of a light's cosine; it stands for camera noise and for what the model leaves
    out (interreflection, gloss). smoothness: weight of a shadowed pixel's slope being its surroundings' mean.
    iterations: Gauss–Newton steps.
    """

    noise: float = 0.03
    smoothness: float = 3.0
    iterations: int = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """A solved surface.

    normals: (h, w, 3) unit, camera frame. depth: (h, w) float32, pixels (orthographic) or f · log z.
    agreement: (h, w), 0 to 1, how far depth and colour agree on a fully lit pixel's slope, 0 at the border.
    misfit: (h, w), χ² of the light that arrives against the light that the surface would return. settled:
    whether it goes on from one whose shadows took the better of their two roots.
    """

    normals: FloatArray
    depth: Grid
    agreement: Grid
    misfit: Grid
    settled: bool = False

    def enlarged(self, shape: tuple[int, ...], factor: int) -> Surface:
        """Return the same surface on a grid `factor` times finer; depth counts pixels, so it grows too."""
        size = shape[1::-1]

        def enlarge(image: FloatArray) -> FloatArray:
            return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)

        return Surface(
            normals=_unit_or_facing(enlarge(self.normals.astype(np.float32))),
            depth=np.ascontiguousarray(enlarge(self.depth) * np.float32(factor)),
            agreement=enlarge(self.agreement),
            misfit=enlarge(self.misfit),
        )

    def moved(self, move: Callable[[FloatArray], FloatArray], scale: float) -> Surface:
        """Return the same surface on another grid, with `scale` pixels per pixel of this one."""
        return replace(
            self,
            normals=_unit_or_facing(move(self.normals)),
            depth=np.ascontiguousarray(move(self.depth) * np.float32(scale)),
            agreement=move(self.agreement),
            misfit=move(self.misfit),
        )

    def shrunk(self, mask: Mask, factor: int) -> Surface:
        """Return the same surface on a grid `factor` times coarser, averaged over the mask."""
        mean, _ = mean_inside(mask, factor)
        return Surface(
            normals=_unit_or_facing(mean(self.normals)),
            depth=np.ascontiguousarray(mean(self.depth) / np.float32(factor)),
            agreement=mean(self.agreement),
            misfit=mean(self.misfit),
        )


def _unit_or_facing(normals: FloatArray) -> FloatArray:
    length = lengths_of(normals)
    unit = np.where(length > 1e-3, normals / np.maximum(length, 1e-3), TOWARDS_VIEWER)
    return np.asarray(unit, dtype=np.float32)


def solve_surface(
    cosines: FloatArray,
    labels: VisibilityLabels,
    lights: FloatArray,
    mask: Mask,
    *,
    first_normals: FloatArray,
    guessed: Mask | None = None,
    weight: Weight | None = None,
    camera: Camera | None = None,
    options: SurfaceOptions | None = None,
    start: Surface | None = None,
) -> Surface:
    """Find the surface that explains `cosines` with the lights that `labels` say arrive.

    cosines: (h, w, 3), contribution of each light over the albedo. lights: (3, 3), row k = direction times
    strength. first_normals: (h, w, 3), from plain inversion where all lights arrive. guessed: pixels
    beyond those whose first normals are worth starting from. weight: (h, w), 0 to 1, trust in a pixel's
    colour. camera: None for orthographic. start: a solution to go on from. Distortion is ignored.
    """
    options = options or SurfaceOptions()
    rays = ray_grid(camera)
    trust = np.where(mask, 1.0 if weight is None else np.maximum(weight, 1e-3), 0.0).astype(np.float32)
    data = np.nan_to_num(np.asarray(cosines)).astype(np.float32)
    seen = np.where(mask, labels, 0).astype(np.uint8)
    known = mask & (labels == ALL_LIT)
    guess = known if guessed is None else known | (mask & guessed)
    slopes, depth = _first_guess(first_normals, guess, rays, start)
    rows = np.ascontiguousarray(lights, dtype=np.float32)
    weights = np.empty((*mask.shape, 4), np.float32)
    agreement = np.zeros(mask.shape, np.float32)
    quadratics = np.empty((*mask.shape, 6), np.float32)
    model = model_of(options)
    prior_weights = _prior_weights(mask, known)
    softness = 0.0  # the first depth must hold together before it may show steps
    for _ in range(options.iterations):
        prior = _surrounding_slope(slopes, prior_weights)
        local_quadratics_kernel(data, seen, trust, slopes, prior, rows, rays, model, quadratics)
        quadrant_weights_kernel(
            quadratics, seen, mask, slopes, depth, softness, _SHADOW_STEP_SOFTNESS, weights
        )
        depth = _solve_depth(quadratics, slopes, weights, depth)
        slopes_kernel(depth, weights, STEEPEST, slopes, agreement)
        softness = _STEP_SOFTNESS
    local_quadratics_kernel(data, seen, trust, slopes, prior, rows, rays, model, quadratics)
    normals = _blend(normals_from_slopes(slopes, rays), first_normals, known, agreement)
    return Surface(
        normals=np.where(mask[..., None], normals, 0.0),
        depth=depth,
        agreement=agreement,
        misfit=quadratics[..., 5].copy(),
    )


def model_of(options: SurfaceOptions) -> Model:
    """Lay the energy out for the loops."""
    values = (
        options.noise, _ALBEDO_SPREAD, _OWN_ALBEDO_SPREAD, options.smoothness, _DAMPING,
        _MISSING_LIGHT_WEIGHT, _MISSING_LIGHT_CUTOFF,
    )  # fmt: skip
    return Model(*(np.float32(value) for value in values))


def normals_from_slopes(slopes: FloatArray, rays: RayGrid) -> FloatArray:
    """Return n ∝ (p, q, −1 − x p − y q), (h, w, 3), of slopes (h, w, 2)."""
    x, y = _rays(rays, slopes.shape[:2])
    p, q = slopes[..., 0], slopes[..., 1]
    normals: FloatArray = np.stack([p, q, -1.0 - x * p - y * q], axis=-1)
    return normals / lengths_of(normals)


def depth_map_from_surface(surface: Surface, mask: Mask, camera: Camera | None = None) -> DepthMap:
    """Return the surface's depth: pixels (mean 0) or, for a perspective camera, of free scale (mean 1)."""
    perspective = camera is not None and camera.is_perspective
    depth = np.where(mask, surface.depth, 0.0)
    if mask.any():
        depth = np.where(mask, depth - depth[mask].mean(), 0.0)
        if camera is not None and camera.is_perspective:
            depth = np.where(mask, np.exp(depth / camera.matrix[0, 0]), 0.0)
            depth /= depth[mask].mean()
    return DepthMap(depth=depth, mask=mask, unit=LengthUnit.FREE if perspective else LengthUnit.PIXEL)


def ray_grid(camera: Camera | None) -> RayGrid:
    """Return a camera's rays, distortion ignored; all along the axis without one, or if orthographic."""
    if camera is None or not camera.is_perspective:
        return RayGrid(*np.zeros(4, np.float32))
    k = camera.matrix
    values = (k[0, 2], k[1, 2], 1.0 / k[0, 0], 1.0 / k[1, 1])
    return RayGrid(*(np.float32(value) for value in values))


def _rays(rays: RayGrid, shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    x = ((np.arange(shape[1]) - rays.centre_u) * rays.per_pixel_u).astype(np.float32)
    y = ((np.arange(shape[0]) - rays.centre_v) * rays.per_pixel_v).astype(np.float32)
    return np.broadcast_to(x[None, :], shape[:2]), np.broadcast_to(y[:, None], shape[:2])


def _first_guess(normals: FloatArray, known: Mask, rays: RayGrid, start: Surface | None) -> tuple[Grid, Grid]:
    """Slopes of the lit pixels, continued smoothly into the rest, and a depth to start from."""
    source = normals if start is None else start.normals
    x, y = _rays(rays, normals.shape[:2])
    along = np.minimum(source[..., 2] + x * source[..., 0] + y * source[..., 1], -FLATTEST_Z)
    slopes = (-source[..., :2] / along[..., None]).astype(np.float32)
    if start is None:
        slopes = fill_smoothly(slopes, known.astype(np.float32)).astype(np.float32)
    long = lengths_of(slopes)
    slopes *= np.minimum(1.0, STEEPEST / np.maximum(long, 1e-12))
    depth = np.zeros(normals.shape[:2], np.float32) if start is None else start.depth
    return np.ascontiguousarray(slopes), depth


def _prior_weights(mask: Mask, known: Mask) -> tuple[Grid, Grid]:
    """(h, w) how much each pixel counts in the slope around it, a third in shadow; and 1 over what counts."""
    weight = known.astype(np.float32)
    weight[mask & ~known] = 1 / 3
    count = cv2.GaussianBlur(weight, (0, 0), _SMOOTH_PX)
    return weight, np.asarray(1.0 / np.maximum(count, 1e-6), dtype=np.float32)


def _surrounding_slope(slopes: Grid, prior_weights: tuple[Grid, Grid]) -> Grid:
    """Gaussian mean of the slopes around each pixel."""
    weight, inverse_count = prior_weights
    total = cv2.GaussianBlur(slopes * weight[..., None], (0, 0), _SMOOTH_PX)
    return np.ascontiguousarray(total * inverse_count[..., None])


def _solve_depth(quadratics: Grid, slopes: Grid, weights: Grid, start: Grid) -> Grid:
    edges = np.empty((4, *start.shape), np.float32)
    edges_kernel(quadratics, weights, edges)
    right = np.empty(start.shape, np.float32)
    right_side_kernel(quadratics, slopes, weights, right)
    return solve_grid(grid_hierarchy(edges), right, start, _TOLERANCE, _CYCLES)


def _blend(solved: FloatArray, first: FloatArray, known: Mask, agreement: Grid) -> FloatArray:
    """Where colour alone gives a normal, keep it as far as the depth disagrees (a step, a crease)."""
    weight = np.where(known, agreement, 1.0)[..., None]
    mixed = weight * solved + (1.0 - weight) * first
    length = lengths_of(mixed)
    return np.where(length > 1e-6, mixed / np.maximum(length, np.float32(1e-6)), solved)


class RayGrid(NamedTuple):
    """The ray through pixel (u, v): x = (u − centre_u) · per_pixel_u, y = (v − centre_v) · per_pixel_v."""

    centre_u: np.float32
    centre_v: np.float32
    per_pixel_u: np.float32
    per_pixel_v: np.float32


class Model(NamedTuple):
    """Standard deviations and weights of the energy; see the table above."""

    noise: np.float32
    albedo_known: np.float32
    albedo_own: np.float32
    prior: np.float32
    damping: np.float32
    missing_weight: np.float32
    missing_cutoff: np.float32


# Compiled loops of `surface`: what each pixel asks of the depth around it, gathered into grid edges.


@njit(cache=True, inline="always", error_model="numpy")
def ray_at(rays: RayGrid, v: int, u: int) -> tuple[Any, Any]:
    """Return (x, y) of the pixel's ray at depth 1."""
    x = (np.float32(u) - rays.centre_u) * rays.per_pixel_u
    return x, (np.float32(v) - rays.centre_v) * rays.per_pixel_v


@njit(cache=True, inline="always", error_model="numpy")
def _trust_of_missing(light: Any, cosine: Any, model: Model) -> Any:
    """Weight of a light that is labelled missing: where the surface turns from it, what is seen is right.

    0 where the surface faces away (nothing is expected) or, beyond the cutoff, faces a light that
    something else blocks (biweight).
    """
    away = (cosine - light) / model.missing_cutoff
    left = np.float32(1.0) - away * away
    if light <= np.float32(0.0) or left <= np.float32(0.0):
        return np.float32(0.0)
    return model.missing_weight * left * left


@njit(cache=True, fastmath=True, inline="always", error_model="numpy")
def local_quadratic(
    x: Any, y: Any, p: Any, q: Any, towards_p: Any, towards_q: Any,
    cosines: Grid, u: int, label: int, trust: Any, lights: Grid, model: Model,
) -> tuple[Any, Any, Any, Any, Any, Any]:  # fmt: skip
    """Return A00, A01, A11, b0, b1, c of one pixel at the slope (p, q), drawn towards another slope.

    x, y: the pixel's ray. cosines: (w, 3), those of its row; u: its column. All float32.

    The covariance of r is noise² I plus the albedo's uncertainty squared times f fᵀ, inverted by the
    Sherman–Morrison formula.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    inverse_variance = one / (model.noise * model.noise)
    nz = -one - x * p - y * q
    scale = one / np.sqrt(p * p + q * q + nz * nz)
    n0, n1, n2 = p * scale, q * scale, nz * scale
    along_p, along_q = n0 - x * n2, n1 - y * n2
    ff, fr, f0, f1 = zero, zero, zero, zero
    a00, a01, a11, b0, b1, c = zero, zero, zero, zero, zero, zero
    for k in range(3):
        l0, l1, l2 = lights[k, 0], lights[k, 1], lights[k, 2]
        light = l0 * n0 + l1 * n1 + l2 * n2
        count = one
        if (label >> k) & 1 == 0:
            count = _trust_of_missing(light, cosines[u, k], model)
        rest = cosines[u, k] - light
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
    shrink = unsure / (one + unsure * ff)
    scaled = inverse_variance * trust
    toward = model.prior if label != 7 else zero
    extra = toward + model.damping
    return (
        scaled * (a00 - shrink * f0 * f0) + extra,
        scaled * (a01 - shrink * f0 * f1),
        scaled * (a11 - shrink * f1 * f1) + extra,
        scaled * (b0 - shrink * f0 * fr) + toward * (towards_p - p),
        scaled * (b1 - shrink * f1 * fr) + toward * (towards_q - q),
        scaled * (c - shrink * fr * fr),
    )


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def local_quadratics_kernel(
    cosines: Grid, labels: Labels, weight: Grid, slopes: Grid, prior: Grid,
    lights: Grid, rays: RayGrid, model: Model, out: Grid,
) -> None:  # fmt: skip
    """Fill out (h, w, 6) = A00, A01, A11, b0, b1, c at every pixel; 0 where there is no weight.

    cosines: (h, w, 3) contribution of each light over the albedo.
    """
    h, w = labels.shape
    for v in prange(h):
        row = cosines[v]
        for u in range(w):
            if weight[v, u] <= 0.0:
                for i in range(6):
                    out[v, u, i] = 0.0
                continue
            x, y = ray_at(rays, v, u)
            a00, a01, a11, b0, b1, c = local_quadratic(
                x, y, slopes[v, u, 0], slopes[v, u, 1], prior[v, u, 0], prior[v, u, 1],
                row, u, labels[v, u], weight[v, u], lights, model,
            )  # fmt: skip
            out[v, u, 0], out[v, u, 1], out[v, u, 2] = a00, a01, a11
            out[v, u, 3], out[v, u, 4], out[v, u, 5] = b0, b1, c


@njit(cache=True, inline="always", error_model="numpy")
def _quadrant(i: int) -> tuple[int, int]:
    return (1 if i & 1 == 0 else -1), (1 if i & 2 == 0 else -1)


@njit(cache=True, fastmath=True, error_model="numpy")
def quadrant_weights_kernel(
    quadratics: Grid, labels: Labels, mask: Mask, slopes: Grid, depth: Grid,
    softness: Any, shadow_softness: Any, out: Grid,
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
                weight = soft / (soft + max(chi, 0.0))
                out[v, u, i] = weight * weight


@njit(cache=True, fastmath=True, error_model="numpy")
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


@njit(cache=True, inline="always", error_model="numpy")
def _target(quadratics: Grid, slopes: Grid, v: int, u: int) -> tuple[Any, Any]:
    a, p, q = quadratics[v, u], slopes[v, u, 0], slopes[v, u, 1]
    return a[0] * p + a[1] * q + a[3], a[1] * p + a[2] * q + a[4]


@njit(cache=True, fastmath=True, error_model="numpy")
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


@njit(cache=True, fastmath=True, error_model="numpy")
def slopes_kernel(depth: Grid, weights: Grid, steepest: Any, slopes: Grid, agreement: Grid) -> None:
    """Replace slopes (h, w, 2) by the weighted mean over the quadrants; agreement (h, w) = mean weight.

    At the border, where quadrants are missing and differences are one-sided, the agreement is 0.
    """
    h, w = depth.shape
    for v in range(h):
        for u in range(w):
            total, count, p, q = 0.0, 0, 0.0, 0.0
            for i in range(4):
                weight = weights[v, u, i]
                if weight > 0.0:
                    su, sv = _quadrant(i)
                    p += weight * su * (depth[v, u + su] - depth[v, u])
                    q += weight * sv * (depth[v + sv, u] - depth[v, u])
                    total += weight
                    count += 1
            agreement[v, u] = total / 4 if count == 4 else 0.0
            if total > 1e-6:
                p, q = p / total, q / total
                long = np.sqrt(p * p + q * q)
                hold = min(1.0, steepest / max(long, 1e-12))
                slopes[v, u, 0], slopes[v, u, 1] = p * hold, q * hold
