"""Normals for every pixel of a frame with self-shadows (brostow2011, Section VI-B, and past it)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels, Weight
from vntoolkit.checks import checks_kinds, require_mask, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import albedo_from_lit, fill_smoothly, gloss_trust, trust_beside_gloss
from vntoolkit.shadows.contributions import (
    CLIPPED_TRUST,
    FLAGS,
    LightContributions,
    Window,
    contributions_from_frame,
    finite,
    frame_in_window,
    in_whole_image,
    lengths_of,
    scaled_normal,
    shrinking,
    small_contributions,
    window_around,
)
from vntoolkit.shadows.evidence import Lamps, lamps_of, place_between
from vntoolkit.shadows.initialisation import (
    TRUST_BY_LIGHTS,
    continue_with_two_lights,
    noise_of_frame,
    options_with_noise,
    solve_from_best_initialisation,
)
from vntoolkit.shadows.shadow_edges import labels_without_penumbra
from vntoolkit.shadows.surface import (
    FLATTEST_Z,
    STEEPEST,
    Model,
    RayGrid,
    Surface,
    depth_map_from_surface,
    local_quadratic,
    model_of,
    ray_at,
    ray_grid,
)

_SMALLEST_ALBEDO = 1e-3
_HELD = 600.0  # of the slope from the smaller image: about what four neighbours know together
_AROUND = np.ones((7, 7), np.uint8)  # how far from a shadow half-shadow and its lit neighbours reach

# The weight of a normal.
_WEIGHT_BY_LIGHTS = (0.05, 0.2, 0.5, 1.0)  # of a pixel that 0, 1, 2, 3 lights reach
_CLIPPED_WEIGHT = 0.1  # factor on saturated pixels
_ALBEDO_TOLERANCE = 0.4  # departure of a lit pixel's log albedo from its surroundings that halves the weight

# Cosines of the most grazing light to the normal from colour alone.
_GRAZING = 0.6  # below it the normal solved with the depth stays
_STEEP = 0.8  # from it on only the colour counts


class RecoveryMethod(Enum):
    """How normals are found where a light is missing."""

    INVERSION = "inversion"  # as if all three lights arrived: the baseline
    TWO_LIGHTS = "two-lights"  # Onn and Bruckstein's quadratic pixel by pixel, smooth fill elsewhere
    SURFACE = "surface"  # solved together with the depth, Hernández, Vogiatzis and Cipolla


@dataclass(frozen=True, kw_only=True, eq=False)
class RecoveredSurface:
    """Normals with weights, and the surface that they were solved with (None where the method has none).

    surface: of `window`, rows and columns of the image, on its working size. camera: of the window.
    """

    normal_map: NormalMap
    surface: Surface | None
    window: Window
    camera: Camera | None

    @property
    def depth_map(self) -> DepthMap | None:
        """The surface's depth (h, w), or None; computed when it is asked for."""
        if self.surface is None:
            return None
        mask = self.normal_map.mask
        inside = mask[self.window]
        factor = shrinking(inside)
        surface = self.surface if factor == 1 else self.surface.enlarged(inside.shape, factor)
        part = depth_map_from_surface(surface, inside, self.camera)
        depth = in_whole_image(part.depth, self.window, mask.shape)
        return DepthMap(depth=depth, mask=mask, unit=part.unit)


@checks_kinds
def recover_normals(
    frame: LinearFrame,
    labels: VisibilityLabels,
    response: LightResponse,
    mask: Mask | None = None,
    camera: Camera | None = None,
    method: RecoveryMethod = RecoveryMethod.SURFACE,
    start: Surface | None = None,
) -> NormalMap:
    """Return a normal and a weight for every pixel of `mask`, whichever lights reach it.

    labels: (h, w), bit k set where light k arrives. camera: None for orthographic. start:
    `ShadowDetector.surface` where the labels are that detector's, of the same frame and mask; spares a solve.
    """
    return recover_surface(frame, labels, response, mask, camera, method, start).normal_map


@checks_kinds
def recover_surface(
    frame: LinearFrame,
    labels: VisibilityLabels,
    response: LightResponse,
    mask: Mask | None = None,
    camera: Camera | None = None,
    method: RecoveryMethod = RecoveryMethod.SURFACE,
    start: Surface | None = None,
) -> RecoveredSurface:
    """`recover_normals`, with the depth that the surface method solves for at the same time."""
    inside = np.ones(frame.shape, dtype=np.bool_) if mask is None else np.asarray(mask)
    require_mask(inside, frame.shape)
    require_shape(labels, frame.shape, "visibility labels")
    if labels.dtype != np.uint8 or labels.max(initial=0) > ALL_LIT:
        raise BadInput("visibility labels: expected bytes from 0 to 7")
    window = window_around(inside)
    near = None if camera is None else camera.cropped(*window)
    part = frame_in_window(frame, window)
    if method is RecoveryMethod.SURFACE:
        normals, weight, surface = _with_surface(part, labels[window], response, inside[window], near, start)
    else:
        normals, weight = _by_pixel(part, labels[window], response, inside[window], method)
        surface = None
    normal_map = NormalMap(
        normals_in_camera=in_whole_image(normals, window, frame.shape),
        mask=inside,
        weight=in_whole_image(weight, window, frame.shape),
    )
    return RecoveredSurface(normal_map=normal_map, surface=surface, window=window, camera=near)


def _with_surface(
    frame: LinearFrame,
    labels: VisibilityLabels,
    response: LightResponse,
    inside: Mask,
    camera: Camera | None,
    start: Surface | None,
) -> tuple[FloatArray, Weight, Surface]:
    """Return normals (h, w, 3), weights, and the surface on the working size."""
    factor = shrinking(inside)
    small, small_mask = small_contributions(frame, response, inside, factor)
    small_labels = _shrunk(labels, small_mask.shape)
    albedo = albedo_from_lit(small.length, small_mask & (small_labels == ALL_LIT), factor)
    lamps, rgb = lamps_of(response), np.ascontiguousarray(frame.rgb)
    near = cv2.dilate(((labels != ALL_LIT) & inside).astype(np.uint8), _AROUND) > 0
    if near.any():
        relative = np.empty_like(rgb)
        _relative_kernel(rgb, near, lamps, albedo, relative)
        labels = labels_without_penumbra(labels, relative, inside, near)
        small_labels = _shrunk(labels, small_mask.shape)
    options = options_with_noise(noise_of_frame(rgb, response, inside & (labels == ALL_LIT)))
    known = small_mask & (small_labels == ALL_LIT)
    surface = solve_from_best_initialisation(
        small, small_labels, albedo, small_mask,
        camera=None if camera is None else camera.scaled(1.0 / factor), start=start,
        trust=gloss_trust(small.length, albedo, known), options=options,
    )  # fmt: skip
    solved = np.dstack([surface.normals.astype(np.float32), albedo, surface.agreement])
    normals, weight = np.empty_like(rgb), np.empty(frame.shape, np.float32)
    _detail_kernel(
        rgb, frame.clipped, np.asarray(labels), inside, lamps, response.light_directions.astype(np.float32),
        np.ascontiguousarray(response.lights, dtype=np.float32), ray_grid(camera), model_of(options),
        np.float32(_HELD if factor > 1 else 0.0), solved, normals, weight,
    )  # fmt: skip
    return normals, weight, surface


def _shrunk(labels: VisibilityLabels, shape: tuple[int, ...]) -> VisibilityLabels:
    if labels.shape == shape:
        return labels
    return cv2.resize(labels, shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.uint8)


@njit(cache=True, parallel=True, error_model="numpy")
def _relative_kernel(rgb: FloatArray, near: Mask, lamps: Lamps, albedo: FloatArray, out: FloatArray) -> None:
    """Fill the contributions over the albedo (of a smaller image) where `near`."""
    h, w = near.shape
    height, width = albedo.shape
    split, ambient = lamps.split, lamps.ambient
    for v in prange(h):
        up, _, _ = place_between(v, h, height)
        for u in range(w):
            if near[v, u]:
                left, _, _ = place_between(u, w, width)
                r, g, b = finite(rgb[v, u, 0]), finite(rgb[v, u, 1]), finite(rgb[v, u, 2])
                scale = np.float32(1.0) / max(albedo[up, left], np.float32(_SMALLEST_ALBEDO))
                for k in range(3):
                    seen = (split[k, 0] * r + split[k, 1] * g + split[k, 2] * b) * scale
                    out[v, u, k] = seen - ambient[k]


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _detail_kernel(
    rgb: FloatArray, clipped: Mask, labels: VisibilityLabels, mask: Mask, lamps: Lamps,
    directions: FloatArray, lights: FloatArray, rays: RayGrid, model: Model, held: Any, solved: FloatArray,
    normals: FloatArray, weights: Weight,
) -> None:  # fmt: skip
    """Bring a surface that was solved on a smaller image to the detail of this one; fill normals and weights.

    What pixels owe to each other the smaller image has settled: here every pixel takes what its own light
    says beyond it. Where all lights arrive and depth and colour disagree, or no light grazes, the normal from
    colour alone counts. solved: (h', w', 5), normal, albedo and agreement.
    """
    h, w = mask.shape
    height, width, _ = solved.shape
    split, ambient = lamps.split, lamps.ambient
    inverse, haze, rest = lamps.inverse, lamps.haze, lamps.rest
    zero, one, least = np.float32(0.0), np.float32(1.0), np.float32(_SMALLEST_ALBEDO)
    for v in prange(h):
        up, down, t = place_between(v, h, height)
        seen = np.empty((1, 3), np.float32)
        row = np.empty((width, 5), np.float32)
        for column in range(width):
            for i in range(5):
                row[column, i] = (one - t) * solved[up, column, i] + t * solved[down, column, i]
        for u in range(w):
            if not mask[v, u]:
                normals[v, u, 0], normals[v, u, 1], normals[v, u, 2] = zero, zero, zero
                weights[v, u] = zero
                continue
            left, right, s = place_between(u, w, width)
            r, g, b = finite(rgb[v, u, 0]), finite(rgb[v, u, 1]), finite(rgb[v, u, 2])
            x, y, z, length = scaled_normal(r, g, b, inverse, haze, rest)
            label = labels[v, u]
            albedo = (one - s) * row[left, 3] + s * row[right, 3]
            agreement = (one - s) * row[left, 4] + s * row[right, 4]
            colour = weight_of_colour(x, y, z, directions) if label == ALL_LIT else zero
            if colour < one:
                n0 = (one - s) * row[left, 0] + s * row[right, 0]
                n1 = (one - s) * row[left, 1] + s * row[right, 1]
                n2 = (one - s) * row[left, 2] + s * row[right, 2]
                size = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
                if size > np.float32(1e-3):
                    n0, n1, n2 = n0 / size, n1 / size, n2 / size
                else:
                    n0, n1, n2 = zero, zero, -one
                if held > zero:
                    scale = one / max(length if label == ALL_LIT else albedo, least)
                    for k in range(3):
                        own = split[k, 0] * r + split[k, 1] * g + split[k, 2] * b
                        seen[0, k] = own * scale - ambient[k]
                    trust = np.float32(TRUST_BY_LIGHTS[_count(label)])
                    if clipped[v, u]:
                        trust *= np.float32(CLIPPED_TRUST)
                    if label == ALL_LIT:
                        trust *= np.float32(trust_beside_gloss(length, albedo))
                    n0, n1, n2 = _refined(
                        v, u, n0, n1, n2, seen, label, max(trust, least), lights, rays, model, held
                    )
                    if label == ALL_LIT:
                        n0, n1, n2 = mixed(n0, n1, n2, agreement, x, y, z)
                x, y, z = mixed(x, y, z, colour, n0, n1, n2)
            z = min(z, np.float32(-1e-3))  # one that would face away turns edge-on
            scale = one / np.sqrt(x * x + y * y + z * z)
            normals[v, u, 0], normals[v, u, 1], normals[v, u, 2] = x * scale, y * scale, z * scale
            weights[v, u] = _confidence(label, clipped[v, u], length, albedo, agreement)


@njit(cache=True, inline="always", error_model="numpy")
def mixed(a0: Any, a1: Any, a2: Any, weight: Any, b0: Any, b1: Any, b2: Any) -> tuple[Any, Any, Any]:
    """Blend two unit vectors, the first with `weight`."""
    rest = np.float32(1.0) - weight
    x = weight * a0 + rest * b0
    y = weight * a1 + rest * b1
    z = weight * a2 + rest * b2
    scale = np.float32(1.0) / max(np.sqrt(x * x + y * y + z * z), np.float32(1e-6))
    return x * scale, y * scale, z * scale


@njit(cache=True, inline="always", error_model="numpy")
def _refined(
    v: int, u: int, n0: Any, n1: Any, n2: Any, seen: FloatArray, label: int, trust: Any,
    lights: FloatArray, rays: RayGrid, model: Model, held: Any,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Turn a normal to what its pixel's light asks, held where it is by the weight `held`."""
    one = np.float32(1.0)
    x, y = ray_at(rays, v, u)
    along = one / min(n2 + x * n0 + y * n1, np.float32(-FLATTEST_Z))
    p, q = -n0 * along, -n1 * along
    a00, a01, a11, b0, b1, _ = local_quadratic(x, y, p, q, p, q, seen, 0, label, trust, lights, model)
    a00 += held
    a11 += held
    scale = one / (a00 * a11 - a01 * a01)
    p, q = p + (a11 * b0 - a01 * b1) * scale, q + (a00 * b1 - a01 * b0) * scale
    steep = p * p + q * q
    if steep > np.float32(STEEPEST * STEEPEST):
        hold = np.float32(STEEPEST) / np.sqrt(steep)
        p, q = p * hold, q * hold
    n2 = -one - x * p - y * q
    scale = one / np.sqrt(p * p + q * q + n2 * n2)
    return p * scale, q * scale, n2 * scale


def _by_pixel(
    frame: LinearFrame,
    labels: VisibilityLabels,
    response: LightResponse,
    inside: Mask,
    method: RecoveryMethod,
) -> tuple[FloatArray, Weight]:
    """Return normals (h, w, 3) and weights, without a surface."""
    measured = contributions_from_frame(frame, response)
    albedo = albedo_from_lit(measured.length, inside & (labels == ALL_LIT))
    normals = measured.normals
    if method is RecoveryMethod.TWO_LIGHTS:
        normals = _pixel_by_pixel(measured, labels, albedo, inside)
    weight = confidence_weight(labels, frame.clipped, measured.length, albedo, None)
    return _towards_viewer(normals, inside), np.where(inside, weight, 0.0).astype(np.float32)


def _pixel_by_pixel(
    measured: LightContributions, labels: VisibilityLabels, albedo: FloatArray, mask: Mask
) -> FloatArray:
    relative = measured.relative_to(albedo)
    normals, decided = continue_with_two_lights(measured.normals, relative, labels, measured.lights, mask)
    filled = fill_smoothly(normals, decided.astype(np.float32))
    return np.where(decided[..., None], normals, filled)


def _towards_viewer(normals: FloatArray, mask: Mask) -> FloatArray:
    """Unit normals; one that would face away keeps its direction in the image and turns edge-on."""
    turned: FloatArray = np.array(normals, dtype=np.float32)
    turned[..., 2] = np.minimum(turned[..., 2], -1e-3)
    return np.where(mask[..., None], turned / lengths_of(turned), 0.0).astype(np.float32)


# How far each pixel's normal may be trusted: saturation, shadow, gloss, an albedo that does not fit.


def confidence_weight(
    labels: VisibilityLabels,
    clipped: Mask,
    length: FloatArray,
    albedo: FloatArray,
    agreement: FloatArray | None,
) -> Weight:
    """Return (h, w) weights from 0 to 1.

    length: (h, w), the albedo if all lights arrive; albedo: (h, w), the surroundings'. agreement: (h, w), of
    colour and depth, 0 where unknown, or None.
    """
    out = np.empty(labels.shape, np.float32)
    agreed = np.zeros(labels.shape, np.float32) if agreement is None else agreement
    _confidence_kernel(labels, clipped, length, albedo, agreed, out)
    return out


@njit(cache=True)
def _confidence_kernel(
    labels: VisibilityLabels, clipped: Mask, length: FloatArray, albedo: FloatArray, agreement: FloatArray,
    out: Weight,
) -> None:  # fmt: skip
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            out[v, u] = _confidence(labels[v, u], clipped[v, u], length[v, u], albedo[v, u], agreement[v, u])


@njit(cache=True, inline="always", error_model="numpy")
def _count(label: int) -> int:
    return (label & 1) + ((label >> 1) & 1) + ((label >> 2) & 1)


@njit(cache=True, inline="always", error_model="numpy")
def _confidence(label: int, clipped: bool, length: Any, albedo: Any, agreement: Any) -> Any:
    weight = np.float32(_WEIGHT_BY_LIGHTS[_count(label)])
    one, least = np.float32(1.0), np.float32(_SMALLEST_ALBEDO)
    if label == ALL_LIT:
        length, albedo = max(length, least), max(albedo, least)
        # sinh of the log of the ratio: as the logarithm where paint fits, harder on what does not
        departure = np.float32(0.5 / _ALBEDO_TOLERANCE) * (length / albedo - albedo / length)
        weight /= one + departure * departure
        if agreement > np.float32(0.0):
            weight *= max(agreement, np.float32(0.1))
    return weight * np.float32(_CLIPPED_WEIGHT) if clipped else weight


# Colour before depth where all three lights meet the surface steeply.


@njit(cache=True, inline="always", error_model="numpy")
def weight_of_colour(x: Any, y: Any, z: Any, directions: FloatArray) -> Any:
    """Return 1 where colour alone counts, 0 where the solved normal stays. directions: a unit row a light."""
    cosine = np.float32(1.0)
    for k in range(3):
        cosine = min(cosine, x * directions[k, 0] + y * directions[k, 1] + z * directions[k, 2])
    weight = (cosine - np.float32(_GRAZING)) * np.float32(1.0 / (_STEEP - _GRAZING))
    return min(max(weight, np.float32(0.0)), np.float32(1.0))
