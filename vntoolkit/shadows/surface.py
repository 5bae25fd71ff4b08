"""The surface under the shadows: depth, and with it every normal, from whichever lights arrive.

Hernández, Vogiatzis and Cipolla (hernandez2008) let depth supply the one degree of freedom that a shadow
takes away: the two remaining lights leave a line of slopes, integrability picks the point. Here the same
holds for any number of lights. Every pixel asks the depth gradient to explain the light that arrives,
f_k(s) = L_k · n(s) = r_k / albedo for each light k of its label, with an albedo that is the pixel's own where
all three lights arrive and known to 15 % from the surroundings where not. Without light a weak
prior asks for a smooth slope. Gauss–Newton steps solve one weighted Poisson equation each.

Under a perspective camera the unknown is f · log z, whose gradient takes the place of the slope.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np

from vntoolkit.arrays import ByteArray, Float32Array, FloatArray, Mask, VisibilityLabels, Weight
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.slope_grid import (
    FLATTEST_Z,
    NO_STEP,
    STEEPEST,
    RayGrid,
    edges_kernel,
    ray_at,
    ray_grid,
    slopes_kernel,
    weights_kernel,
)
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT
from vntoolkit.shadows.albedo import fill_smoothly
from vntoolkit.shadows.contributions import (
    Numbers,
    WorkingImage,
    flat,
    lengths_of,
    numbers_of,
)
from vntoolkit.solvers import grid_hierarchy, solve_grid

Grid = Float32Array
Labels = ByteArray
# The energy; cosines are 1 where a surface of the local albedo faces the light.
ALBEDO_SPREAD = 0.15  # relative standard deviation of the albedo continued into a shadow
_OWN_ALBEDO_SPREAD = 3.0  # the same where all three lights arrive: there the colour's length is the albedo
_STEP_SCALE = 10.0  # χ² at which a depth gradient counts a quarter, as it crosses a step in depth
_SHADOW_STEP_SCALE = 40.0  # the same under two lights, where the slope hangs on the albedo around
_SMOOTH_PX = 2.0  # standard deviation of the surroundings whose mean slope a shadowed pixel is drawn to
_MISSING_LIGHT_WEIGHT = 0.3  # of a light labelled missing where the surface would return what is seen …
_MISSING_LIGHT_CUTOFF = 0.2  # … and the difference of cosines at which that weight ends
_SHORTEST = np.float32(1e-3)  # a shorter vector has no direction
_DAMPING = 1.0  # holds the slope back where nothing else is known
_TOLERANCE = 3e-3  # relative residual that ends a step's multigrid cycles early


@dataclass(frozen=True, kw_only=True)
class SurfaceOptions:
    """What detection and recovery ask differently of the surface.

    noise: standard deviation of a light's cosine; it stands for camera noise and for what the model leaves
    out (interreflection, gloss). smoothness: weight of a shadowed pixel's slope being its surroundings' mean.
    iterations: Gauss–Newton steps. frozen: how many of them, the first ones, keep the slopes that they start
    from, while depth finds where it must step for them. final: how many, the last ones, know the albedo
    under shadow to the lesser of `ALBEDO_SPREAD` and `spread`, its relative standard deviation as measured.
    cycles: of multigrid in each, at most.
    """

    noise: float = 0.03
    smoothness: float = 3.0
    iterations: int = 8
    frozen: int = 0
    final: int = 0
    spread: float = ALBEDO_SPREAD
    cycles: int = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """A solved surface.

    normals: (h, w, 3) unit, camera frame. depth: (h, w) float32, pixels (orthographic) or f · log z.
    agreement: (h, w), 0 to 1, how far depth and colour agree on a fully lit pixel's slope, 0 at the border
    and on another grid than the surface was solved on. image: what it was solved from, where others go on
    from it. mirror_probability: as in `NormalMap`.
    """

    normals: FloatArray
    depth: Grid
    agreement: Grid
    image: WorkingImage | None = None
    mirror_probability: FloatArray | None = None

    def enlarged(self, shape: tuple[int, ...], factor: int) -> "Surface":
        """Return a start on a grid `factor` times finer; depth counts pixels, so it grows too."""
        size = shape[1::-1]

        def enlarge(image: FloatArray) -> FloatArray:
            return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)

        return Surface(
            normals=_unit_or_facing(enlarge(self.normals)),
            depth=enlarge(self.depth) * np.float32(factor),
            agreement=np.zeros(shape[:2], np.float32),
        )


def _unit_or_facing(vectors: FloatArray) -> FloatArray:
    """Return unit vectors (h, w, 3); towards the viewer where there is no length."""
    length = lengths_of(vectors)
    facing = np.array([0.0, 0.0, -1.0], np.float32)
    return np.where(length > _SHORTEST, vectors / np.maximum(length, _SHORTEST), facing)


@dataclass(frozen=True, kw_only=True, eq=False)
class LabelledImage:
    """A frame at its working size with the lights that arrive: what its surface is solved from.

    labels: (h, w), bit k set where light k arrives. albedo: (h, w), that of the surroundings, which counts
    under shadow. trust: (h, w), how far each pixel's light counts; None for what the image says.
    """

    image: WorkingImage
    labels: VisibilityLabels
    albedo: FloatArray
    trust: Weight | None = None

    @cached_property
    def shadow(self) -> Mask:
        """(h, w), pixels of the subject that a light is missing on."""
        return self.image.mask & (self.labels != ALL_LIT)

    @cached_property
    def cosines(self) -> FloatArray:
        """(h, w, 3), contribution of each light over the albedo, the pixel's own where all arrive."""
        lit = self.image.mask & (self.labels == ALL_LIT)
        return self.image.light.relative_to(np.where(lit, self.image.light.length, self.albedo))

    def solve(
        self,
        options: SurfaceOptions,
        start: Surface | None = None,
        *,
        first_normals: FloatArray | None = None,
        assumed: Mask | None = None,
    ) -> Surface:
        """Return the surface as `solve_surface` does; without first normals from those of full light."""
        light = self.image.light
        return solve_surface(
            self.cosines, self.labels, light.lights, self.image.mask,
            first_normals=light.normals if first_normals is None else first_normals, assumed=assumed,
            weight=self._trust, camera=self.image.camera, options=options, start=start,
        )  # fmt: skip

    @property
    def _trust(self) -> Weight:
        return self.image.light.trust if self.trust is None else self.trust


def solve_surface(
    cosines: FloatArray,
    labels: VisibilityLabels,
    lights: FloatArray,
    mask: Mask,
    *,
    first_normals: FloatArray,
    assumed: Mask | None = None,
    weight: Weight | None = None,
    camera: Camera | None = None,
    options: SurfaceOptions | None = None,
    start: Surface | None = None,
) -> Surface:
    """Find the surface that explains `cosines` with the lights that `labels` say arrive.

    cosines: (h, w, 3), contribution of each light over the albedo. lights: (3, 3), row k = direction times
    strength. first_normals: (h, w, 3), from plain inversion where all lights arrive. assumed: pixels
    beyond those whose first normals are worth starting from. weight: (h, w), 0 to 1, trust in a pixel's
    colour. camera: None for orthographic. start: a solution to go on from. Distortion is ignored.
    """
    options = options or SurfaceOptions()
    given = _given(cosines, labels, lights, mask, weight, camera)
    shape = mask.shape
    known = mask & (labels == ALL_LIT)
    assumed_or_known = known if assumed is None else known | (mask & assumed)
    first = np.ascontiguousarray(first_normals, dtype=np.float32)
    slopes, depth = _start_of(first, assumed_or_known, given.rays, start)
    agreement = np.zeros(shape, np.float32)
    quadratics, targets = np.empty((6, *shape), np.float32), np.empty((2, *shape), np.float32)
    weights = np.empty((4, *shape), np.float32)
    edges, right = np.empty((4, *shape), np.float32), np.empty(shape, np.float32)
    prior_weights = _prior_weights(mask, known)
    robust_scale = (NO_STEP, NO_STEP)  # the first depth must hold together before it may show steps
    for step in range(options.iterations):
        model = model_of(options, final=step >= options.iterations - options.final)
        prior = _surrounding_slope(slopes, prior_weights)
        given.quadratics(slopes, prior, model, quadratics, targets)
        given.weights(quadratics, slopes, depth, robust_scale, weights)
        edges_kernel(quadratics, targets, weights, edges, right)
        depth = solve_grid(grid_hierarchy(edges), right, depth, _TOLERANCE, options.cycles)
        if step >= options.frozen:
            slopes_kernel(depth, weights, np.float32(STEEPEST), slopes, agreement)
        robust_scale = (_STEP_SCALE, _SHADOW_STEP_SCALE)
    normals = np.empty_like(first)
    _normals_kernel(slopes, flat(first), agreement, known, mask, given.rays, flat(normals))
    return Surface(normals=normals, depth=depth, agreement=agreement)


class _Given(NamedTuple):
    """What a surface must explain, as the loops take it; see `solve_surface`."""

    cosines: Grid
    seen: Labels
    trust: Grid
    lights: Numbers
    rays: RayGrid
    mask: Mask

    def quadratics(self, slopes: Grid, prior: Grid, model: "Model", out: Grid, targets: Grid) -> None:
        quadratics_kernel(
            flat(self.cosines), self.seen, self.trust, slopes, prior, self.lights, self.rays, model, out,
            targets,
        )  # fmt: skip

    def weights(
        self, quadratics: Grid, slopes: Grid, depth: Grid, robust_scale: tuple[float, float], out: Grid
    ) -> None:
        """robust_scale: of steps under three lights, and under two."""
        full, shadow = (np.float32(value) for value in robust_scale)
        weights_kernel(quadratics, self.seen, self.mask, slopes, depth, full, shadow, out)


def _given(
    cosines: FloatArray,
    labels: VisibilityLabels,
    lights: FloatArray,
    mask: Mask,
    weight: Weight | None,
    camera: Camera | None,
) -> _Given:
    return _Given(
        cosines=np.ascontiguousarray(np.nan_to_num(np.asarray(cosines)), dtype=np.float32),
        seen=np.where(mask, labels, 0).astype(np.uint8),
        trust=np.where(mask, 1.0 if weight is None else np.maximum(weight, 1e-3), 0.0).astype(np.float32),
        lights=numbers_of(lights),
        rays=ray_grid(camera),
        mask=mask,
    )


def model_of(options: SurfaceOptions, *, final: bool) -> "Model":
    """Lay the energy out for the loops.

    final: whether every slope is on its side. Two lights under a known albedo leave two slopes with a ridge
    between them; one that is hardly known lets a slope cross, but then the light tells little.
    """
    spread = min(options.spread, ALBEDO_SPREAD) if final else ALBEDO_SPREAD
    missing = _MISSING_LIGHT_WEIGHT * (spread / ALBEDO_SPREAD) ** 2  # the better two lights tell, the less
    values = (
        options.noise, spread, _OWN_ALBEDO_SPREAD, options.smoothness, _DAMPING, missing,
        _MISSING_LIGHT_CUTOFF,
    )  # fmt: skip
    return Model(*(np.float32(value) for value in values))


def _start_of(normals: FloatArray, known: Mask, rays: RayGrid, start: Surface | None) -> tuple[Grid, Grid]:
    """Slopes (2, h, w) of the lit pixels, continued smoothly into the rest, and a depth to start from."""
    if start is not None:
        return _slopes_of_normals(start.normals, rays), start.depth
    slopes = np.moveaxis(_slopes_of_normals(normals, rays), 0, -1)
    filled = fill_smoothly(slopes, known.astype(np.float32))
    return np.ascontiguousarray(np.moveaxis(filled, -1, 0), np.float32), np.zeros(known.shape, np.float32)


def _slopes_of_normals(normals: FloatArray, rays: RayGrid) -> Grid:
    """Return the slopes (2, h, w) of normals (h, w, 3), limited where they are seen at grazing incidence."""
    h, w = normals.shape[:2]
    x = (np.arange(w, dtype=np.float32) - rays.centre_u) * rays.per_pixel_u
    y = (np.arange(h, dtype=np.float32)[:, None] - rays.centre_v) * rays.per_pixel_v
    along = np.minimum(normals[..., 2] + x * normals[..., 0] + y * normals[..., 1], np.float32(-FLATTEST_Z))
    slopes = np.stack([normals[..., 0] / -along, normals[..., 1] / -along])
    return slopes * (np.float32(STEEPEST) / np.maximum(np.hypot(*slopes), np.float32(STEEPEST)))


def _prior_weights(mask: Mask, known: Mask) -> tuple[Grid, Grid]:
    """(h, w) how much each pixel counts in the slope around it, a third in shadow; and 1 over what counts."""
    weight = known.astype(np.float32)
    weight[mask & ~known] = 1 / 3
    count = cv2.GaussianBlur(weight, (0, 0), _SMOOTH_PX)
    return weight, np.asarray(1.0 / np.maximum(count, 1e-6), dtype=np.float32)


def _surrounding_slope(slopes: Grid, prior_weights: tuple[Grid, Grid]) -> Grid:
    """Gaussian mean of the slopes around each pixel, (2, h, w)."""
    weight, inverse_count = prior_weights
    out = np.empty_like(slopes)
    for own, mean in zip(slopes, out, strict=True):
        np.multiply(cv2.GaussianBlur(own * weight, (0, 0), _SMOOTH_PX), inverse_count, out=mean)
    return out


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


@njit(forceinline=True)
def _of_light(
    l0: Any, l1: Any, l2: Any, n0: Any, n1: Any, n2: Any, x: Any, y: Any, along_p: Any, along_q: Any,
    scale: Any, cosine: Any, is_lit: Any, model: Model,
) -> tuple[Any, Any, Any, Any, Any]:  # fmt: skip
    """Return how much a light counts, what it returns, what is seen beyond that, and its two derivatives.

    A light that is labelled missing counts where the surface turns from it: what is seen is right there. It
    does not where the surface faces away (nothing is expected) or, beyond the cutoff, faces a light that
    something else blocks (biweight).
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    light = l0 * n0 + l1 * n1 + l2 * n2
    rest = cosine - light
    away = rest / model.missing_cutoff
    left = one - away * away
    missing = model.missing_weight * left * left if (light > zero) & (left > zero) else zero
    count = one if is_lit else missing
    j0 = (l0 - x * l2 - light * along_p) * scale
    j1 = (l1 - y * l2 - light * along_q) * scale
    return count, light, rest, j0, j1


@njit(forceinline=True)
def _local_quadratic(
    x: Any, y: Any, p: Any, q: Any, towards_p: Any, towards_q: Any, seen0: Any, seen1: Any, seen2: Any,
    label: Any, trust: Any, lights: Numbers, model: Model,
) -> tuple[Any, Any, Any, Any, Any, Any]:  # fmt: skip
    """Return A00, A01, A11, b0, b1, c of one pixel at the slope (p, q), drawn towards another slope.

    x, y: the pixel's ray. seen0, seen1, seen2: contribution of each light over the albedo. All float32.

    The covariance of r is noise² I plus the albedo's uncertainty squared times f fᵀ, inverted by the
    Sherman–Morrison formula.
    """
    one = np.float32(1.0)
    inverse_variance = one / (model.noise * model.noise)
    nz = -one - x * p - y * q
    s = one / np.sqrt(p * p + q * q + nz * nz)
    n0, n1, n2 = p * s, q * s, nz * s
    along_p, along_q = n0 - x * n2, n1 - y * n2
    w0, f0, r0, g0, h0 = _of_light(
        lights[0], lights[1], lights[2], n0, n1, n2, x, y, along_p, along_q, s, seen0, (label & 1) != 0, model
    )
    w1, f1, r1, g1, h1 = _of_light(
        lights[3], lights[4], lights[5], n0, n1, n2, x, y, along_p, along_q, s, seen1, (label & 2) != 0, model
    )
    w2, f2, r2, g2, h2 = _of_light(
        lights[6], lights[7], lights[8], n0, n1, n2, x, y, along_p, along_q, s, seen2, (label & 4) != 0, model
    )
    ff = w0 * f0 * f0 + w1 * f1 * f1 + w2 * f2 * f2
    fr = w0 * f0 * r0 + w1 * f1 * r1 + w2 * f2 * r2
    fg = w0 * f0 * g0 + w1 * f1 * g1 + w2 * f2 * g2
    fh = w0 * f0 * h0 + w1 * f1 * h1 + w2 * f2 * h2
    is_lit = label == ALL_LIT
    spread = model.albedo_own if is_lit else model.albedo_known
    unsure = spread * spread * inverse_variance
    shrink = unsure / (one + unsure * ff)
    scaled = inverse_variance * trust
    toward = np.float32(0.0) if is_lit else model.prior
    extra = toward + model.damping
    return (
        scaled * (w0 * g0 * g0 + w1 * g1 * g1 + w2 * g2 * g2 - shrink * fg * fg) + extra,
        scaled * (w0 * g0 * h0 + w1 * g1 * h1 + w2 * g2 * h2 - shrink * fg * fh),
        scaled * (w0 * h0 * h0 + w1 * h1 * h1 + w2 * h2 * h2 - shrink * fh * fh) + extra,
        scaled * (w0 * g0 * r0 + w1 * g1 * r1 + w2 * g2 * r2 - shrink * fg * fr) + toward * (towards_p - p),
        scaled * (w0 * h0 * r0 + w1 * h1 * r1 + w2 * h2 * r2 - shrink * fh * fr) + toward * (towards_q - q),
        scaled * (w0 * r0 * r0 + w1 * r1 * r1 + w2 * r2 * r2 - shrink * fr * fr),
    )


@njit
def quadratics_kernel(
    cosines: Grid, labels: Labels, weight: Grid, slopes: Grid, prior: Grid, lights: Numbers, rays: RayGrid,
    model: Model, out: Grid, targets: Grid,
) -> None:  # fmt: skip
    """Fill out (6, h, w) = A00, A01, A11, b0, b1, c, 0 where there is no weight.

    targets: (2, h, w), A s + b. cosines: (h, w, 3) contribution of each light over the albedo.
    """
    h, w = labels.shape
    for v in range(h):
        seen, label, trust = cosines[v], labels[v], weight[v]
        slope_p, slope_q, prior_p, prior_q = slopes[0, v], slopes[1, v], prior[0, v], prior[1, v]
        o00, o01, o11, o0, o1, oc = out[0, v], out[1, v], out[2, v], out[3, v], out[4, v], out[5, v]
        to_p, to_q = targets[0, v], targets[1, v]
        x0, y = ray_at(rays, v, 0)
        for u in range(w):
            x = x0 + rays.per_pixel_u * np.float32(u)
            p, q = slope_p[u], slope_q[u]
            a00, a01, a11, b0, b1, c = _local_quadratic(
                x, y, p, q, prior_p[u], prior_q[u], seen[3 * u], seen[3 * u + 1], seen[3 * u + 2], label[u],
                trust[u], lights, model,
            )  # fmt: skip
            some = np.float32(1.0) if trust[u] > np.float32(0.0) else np.float32(0.0)
            a00, a01, a11, b0, b1 = some * a00, some * a01, some * a11, some * b0, some * b1
            o00[u], o01[u], o11[u], o0[u], o1[u], oc[u] = a00, a01, a11, b0, b1, some * c
            to_p[u], to_q[u] = a00 * p + a01 * q + b0, a01 * p + a11 * q + b1


@njit
def _normals_kernel(
    slopes: Grid, first: Grid, agreement: Grid, known: Mask, mask: Mask, rays: RayGrid, out: Grid
) -> None:
    """Fill the unit normals (h, w, 3): n ∝ (p, q, −1 − x p − y q) of the slopes, 0 outside the mask.

    Where colour alone gives a normal, it is kept as far as the depth disagrees (a step, a crease).
    """
    h, w = mask.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    for v in range(h):
        x0, y = ray_at(rays, v, 0)
        slope_p, slope_q, line, to = slopes[0, v], slopes[1, v], first[v], out[v]
        agreed, own, inside = agreement[v], known[v], mask[v]
        for u in range(w):
            x = x0 + rays.per_pixel_u * np.float32(u)
            p, q = slope_p[u], slope_q[u]
            n2 = -one - x * p - y * q
            scale = one / np.sqrt(p * p + q * q + n2 * n2)
            p, q, n2 = p * scale, q * scale, n2 * scale
            weight = agreed[u] if own[u] else one
            a, b, c = _mixed(p, q, n2, weight, line[3 * u], line[3 * u + 1], line[3 * u + 2])
            to[3 * u], to[3 * u + 1], to[3 * u + 2] = (
                a if inside[u] else zero, b if inside[u] else zero, c if inside[u] else zero,
            )  # fmt: skip


@njit(forceinline=True)
def _mixed(a0: Any, a1: Any, a2: Any, weight: Any, b0: Any, b1: Any, b2: Any) -> tuple[Any, Any, Any]:
    """Blend two unit vectors, the first with `weight`."""
    rest = np.float32(1.0) - weight
    x = weight * a0 + rest * b0
    y = weight * a1 + rest * b1
    z = weight * a2 + rest * b2
    scale = np.float32(1.0) / max(np.sqrt(x * x + y * y + z * z), np.float32(1e-6))
    return x * scale, y * scale, z * scale
