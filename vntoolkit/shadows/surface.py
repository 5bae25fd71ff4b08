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

from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels, Weight
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit
from vntoolkit.photometry.frame import ALL_LIT
from vntoolkit.shadows.filling import fill_smoothly
from vntoolkit.shadows.grid_solver import grid_hierarchy, solve_grid
from vntoolkit.shadows.lengths import lengths_of
from vntoolkit.shadows.surface_kernels import (
    Grid,
    Model,
    RayGrid,
    edges_kernel,
    local_quadratics_kernel,
    quadrant_weights_kernel,
    right_side_kernel,
    slopes_kernel,
)
from vntoolkit.shadows.surface_options import SurfaceOptions

_FLATTEST_Z = 0.12  # |n_z| below which a first slope is held, so that no pixel starts edge-on


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """A solved surface.

    normals: (h, w, 3) unit, camera frame. depth: (h, w) float32, pixels (orthographic) or f · log z.
    agreement: (h, w), 0 to 1, how far depth and colour agree on a fully lit pixel's slope, 0 at the border.
    misfit: (h, w), χ² of the light that arrives against the light that the surface would return; 0 where the
    solution went on from a start.
    """

    normals: FloatArray
    depth: Grid
    agreement: Grid
    misfit: Grid


def solve_surface(
    shares: FloatArray,
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
    """Find the surface that explains `shares` with the lights that `labels` say arrive.

    shares: (h, w, 3), contribution of each light over the albedo. lights: (3, 3), row k = direction times
    strength. first_normals: (h, w, 3), from plain inversion where all lights arrive. guessed: pixels
    beyond those whose first normals are worth starting from. weight: (h, w), 0 to 1, trust in a pixel's
    colour. camera: None for orthographic. start: a solution to go on from. Distortion is ignored.
    """
    options = options or SurfaceOptions()
    rays = _ray_grid(camera)
    trust = np.where(mask, 1.0 if weight is None else np.maximum(weight, 1e-3), 0.0).astype(np.float32)
    data = np.nan_to_num(np.asarray(shares)).astype(np.float32)
    seen = np.where(mask, labels, 0).astype(np.uint8)
    known = mask & (labels == ALL_LIT)
    guess = known if guessed is None else known | (mask & guessed)
    slopes, depth = _first_guess(first_normals, guess, rays, options, start)
    rows = np.ascontiguousarray(lights, dtype=np.float64)
    weights = np.empty((*mask.shape, 4), np.float32)
    agreement = np.zeros(mask.shape, np.float32)
    quadratics = np.empty((*mask.shape, 6), np.float32)
    model = Model(
        options.noise, options.albedo_spread, options.own_albedo_spread, options.smoothness, options.damping,
        options.doubt_trust, options.doubt_reach,
    )  # fmt: skip
    shares_of_prior = _prior_shares(mask, known, options)
    softness = 0.0  # the first depth must hold together before it may show steps
    for _ in range(options.iterations):
        prior = _surrounding_slope(slopes, shares_of_prior, options)
        local_quadratics_kernel(data, seen, trust, slopes, prior, rows, rays, model, quadratics)
        quadrant_weights_kernel(
            quadratics, seen, mask, slopes, depth, softness, options.shadow_step_softness, weights
        )
        depth = _solve_depth(quadratics, slopes, weights, depth, options)
        slopes_kernel(depth, weights, options.steepest, slopes, agreement)
        softness = options.step_softness
    misfit = np.zeros(mask.shape, np.float32)
    if start is None:
        local_quadratics_kernel(data, seen, trust, slopes, prior, rows, rays, model, quadratics)
        misfit = quadratics[..., 5].copy()
    normals = _blend(normals_from_slopes(slopes, rays), first_normals, known, agreement)
    return Surface(
        normals=np.where(mask[..., None], normals, 0.0),
        depth=depth,
        agreement=agreement,
        misfit=misfit,
    )


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


def _ray_grid(camera: Camera | None) -> RayGrid:
    if camera is None or not camera.is_perspective:
        return RayGrid(0.0, 0.0, 0.0, 0.0)
    k = camera.matrix
    return RayGrid(float(k[0, 2]), float(k[1, 2]), 1.0 / float(k[0, 0]), 1.0 / float(k[1, 1]))


def _rays(rays: RayGrid, shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    x = ((np.arange(shape[1]) - rays.centre_u) * rays.per_pixel_u).astype(np.float32)
    y = ((np.arange(shape[0]) - rays.centre_v) * rays.per_pixel_v).astype(np.float32)
    return np.broadcast_to(x[None, :], shape[:2]), np.broadcast_to(y[:, None], shape[:2])


def _first_guess(
    normals: FloatArray, known: Mask, rays: RayGrid, options: SurfaceOptions, start: Surface | None
) -> tuple[Grid, Grid]:
    """Slopes of the lit pixels, continued smoothly into the rest, and a depth to start from."""
    source = normals if start is None else start.normals
    x, y = _rays(rays, normals.shape[:2])
    along = np.minimum(source[..., 2] + x * source[..., 0] + y * source[..., 1], -_FLATTEST_Z)
    slopes = (-source[..., :2] / along[..., None]).astype(np.float32)
    if start is None:
        slopes = fill_smoothly(slopes, known.astype(np.float32)).astype(np.float32)
    long = lengths_of(slopes)
    slopes *= np.minimum(1.0, options.steepest / np.maximum(long, 1e-12))
    depth = np.zeros(normals.shape[:2], np.float32) if start is None else start.depth
    return np.ascontiguousarray(slopes), depth


def _prior_shares(mask: Mask, known: Mask, options: SurfaceOptions) -> tuple[Grid, Grid]:
    """(h, w) how much each pixel counts in the slope around it, a third in shadow; and 1 over what counts."""
    share = known.astype(np.float32)
    share[mask & ~known] = 1 / 3
    count = cv2.GaussianBlur(share, (0, 0), options.smooth_px)
    return share, np.asarray(1.0 / np.maximum(count, 1e-6), dtype=np.float32)


def _surrounding_slope(slopes: Grid, shares: tuple[Grid, Grid], options: SurfaceOptions) -> Grid:
    """Gaussian mean of the slopes around each pixel."""
    share, inverse_count = shares
    total = cv2.GaussianBlur(slopes * share[..., None], (0, 0), options.smooth_px)
    return np.ascontiguousarray(total * inverse_count[..., None])


def _solve_depth(quadratics: Grid, slopes: Grid, weights: Grid, start: Grid, options: SurfaceOptions) -> Grid:
    edges = np.empty((4, *start.shape), np.float32)
    edges_kernel(quadratics, weights, edges)
    right = np.empty(start.shape, np.float32)
    right_side_kernel(quadratics, slopes, weights, right)
    return solve_grid(grid_hierarchy(edges), right, start, options.tolerance, options.cycles)


def _blend(solved: FloatArray, first: FloatArray, known: Mask, agreement: Grid) -> FloatArray:
    """Where colour alone gives a normal, keep it as far as the depth disagrees (a step, a crease)."""
    share = np.where(known, agreement, 1.0)[..., None]
    mixed = share * solved + (1.0 - share) * first
    length = lengths_of(mixed)
    return np.where(length > 1e-6, mixed / np.maximum(length, np.float32(1e-6)), solved)
