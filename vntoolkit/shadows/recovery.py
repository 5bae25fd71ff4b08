"""Normals for every pixel of a frame with self-shadows (brostow2011, Section VI-B, and past it)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, Normals, VisibilityLabels, Weight
from vntoolkit.checks import checks_kinds, require_mask, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame, count_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import albedo_from_lit, fill_smoothly
from vntoolkit.shadows.contributions import (
    LightContributions,
    Window,
    contributions_from_frame,
    frame_in_window,
    in_whole_image,
    lengths_of,
    window_around,
)
from vntoolkit.shadows.initialisation import continue_with_two_lights, solve_from_best_initialisation
from vntoolkit.shadows.shadow_edges import labels_without_penumbra
from vntoolkit.shadows.surface import Surface, depth_map_from_surface

_SMALLEST_ALBEDO = 1e-3

# The weight of a normal.
_WEIGHT_BY_LIGHTS = (0.05, 0.2, 0.5, 1.0)  # of a pixel that 0, 1, 2, 3 lights reach
_CLIPPED_WEIGHT = 0.1  # factor on saturated pixels
_ALBEDO_TOLERANCE = 0.4  # departure of a lit pixel's log albedo from its surroundings that halves the weight
_GLOSS = 0.2  # excess of log albedo that paint may have; twice that halves the trust in the colour

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
    """Normals with weights, and the depth they were solved with (None where the method has none)."""

    normal_map: NormalMap
    depth_map: DepthMap | None


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
    part = _recover(
        frame_in_window(frame, window), labels[window], response, inside[window],
        None if camera is None else camera.cropped(*window), method, start,
    )  # fmt: skip
    return part if part.normal_map.shape == frame.shape else _in_whole_image(part, window, frame.shape)


def _recover(
    frame: LinearFrame,
    labels: VisibilityLabels,
    response: LightResponse,
    inside: Mask,
    camera: Camera | None,
    method: RecoveryMethod,
    start: Surface | None,
) -> RecoveredSurface:
    measured = contributions_from_frame(frame, response)
    full = inside & (labels == ALL_LIT)
    albedo = albedo_from_lit(measured.length, full)
    depth_map, agreement = None, None
    if method is RecoveryMethod.INVERSION:
        normals = measured.normals
    elif method is RecoveryMethod.TWO_LIGHTS:
        normals = _pixel_by_pixel(measured, labels, albedo, inside)
    else:
        labels = labels_without_penumbra(labels, measured.relative_to(albedo), inside)
        full = inside & (labels == ALL_LIT)
        surface = solve_from_best_initialisation(
            measured, labels, albedo, inside, camera=camera, start=start,
            trust=gloss_trust(measured.length, albedo, full),
        )  # fmt: skip
        agreement = surface.agreement
        normals = normals_by_grazing_incidence(surface.normals, measured.normals, measured.directions, full)
        depth_map = depth_map_from_surface(surface, inside, camera)
    weight = confidence_weight(labels, frame.clipped, measured.length, albedo, agreement)
    return RecoveredSurface(normal_map=_towards_viewer(normals, weight, inside), depth_map=depth_map)


def _in_whole_image(part: RecoveredSurface, window: Window, shape: tuple[int, int]) -> RecoveredSurface:
    normal_map, depth_map = part.normal_map, part.depth_map
    mask = in_whole_image(normal_map.mask, window, shape)
    whole = NormalMap(
        normals_in_camera=in_whole_image(normal_map.normals_in_camera, window, shape),
        mask=mask,
        weight=None if normal_map.weight is None else in_whole_image(normal_map.weight, window, shape),
    )
    if depth_map is None:
        return RecoveredSurface(normal_map=whole, depth_map=None)
    depth = DepthMap(depth=in_whole_image(depth_map.depth, window, shape), mask=mask, unit=depth_map.unit)
    return RecoveredSurface(normal_map=whole, depth_map=depth)


def _pixel_by_pixel(
    measured: LightContributions, labels: VisibilityLabels, albedo: FloatArray, mask: Mask
) -> FloatArray:
    relative = measured.relative_to(albedo)
    normals, decided = continue_with_two_lights(measured.normals, relative, labels, measured.lights, mask)
    filled = fill_smoothly(normals, decided.astype(np.float32))
    return np.where(decided[..., None], normals, filled)


def _towards_viewer(normals: FloatArray, weight: FloatArray, mask: Mask) -> NormalMap:
    """Unit normals; one that would face away keeps its direction in the image and turns edge-on."""
    turned: FloatArray = np.array(normals, dtype=np.float32)
    turned[..., 2] = np.minimum(turned[..., 2], -1e-3)
    length = lengths_of(turned)
    turned = np.where(mask[..., None], turned / length, 0.0).astype(np.float32)
    return NormalMap(
        normals_in_camera=turned, mask=mask, weight=np.where(mask, weight, 0.0).astype(np.float32)
    )


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
    lights = count_lit(labels)
    weight = np.asarray(_WEIGHT_BY_LIGHTS, dtype=np.float32)[lights]
    full = lights == 3
    departure = _log_excess(length, albedo) / _ALBEDO_TOLERANCE
    weight = weight * np.where(full, 1.0 / (1.0 + departure**2), 1.0)
    if agreement is not None:
        weight = weight * np.where(full & (agreement > 0.0), np.maximum(agreement, 0.1), 1.0)
    return (weight * np.where(clipped, _CLIPPED_WEIGHT, 1.0)).astype(np.float32)


def gloss_trust(length: FloatArray, albedo: FloatArray, lit: Mask) -> Weight:
    """Return (h, w): 1, less where a pixel of `lit` outshines matte paint of the surrounding albedo."""
    excess = np.maximum(_log_excess(length, albedo) - _GLOSS, 0.0) / _GLOSS
    return np.where(lit, 1.0 / (1.0 + excess**2), 1.0).astype(np.float32)


def _log_excess(length: FloatArray, albedo: FloatArray) -> FloatArray:
    return np.log(np.maximum(length, _SMALLEST_ALBEDO) / np.maximum(albedo, _SMALLEST_ALBEDO))


# Colour before depth where all three lights meet the surface steeply.


def normals_by_grazing_incidence(
    solved: Normals, inverted: Normals, directions: FloatArray, lit: Mask
) -> Normals:
    """Blend two maps of normals (h, w, 3) in the pixels of `lit`, which all three lights reach.

    solved: with the depth. inverted: from colour alone. directions: (3, 3), a unit row per light.
    """
    out = np.array(solved, dtype=np.float32)
    _grazing_kernel(out, np.asarray(inverted, np.float32), directions.astype(np.float32), np.asarray(lit))
    return out


@njit(cache=True, parallel=True)
def _grazing_kernel(out: Normals, inverted: Normals, directions: FloatArray, lit: Mask) -> None:
    h, w = lit.shape
    for v in prange(h):
        for u in range(w):
            if not lit[v, u]:
                continue
            x, y, z = inverted[v, u, 0], inverted[v, u, 1], inverted[v, u, 2]
            cosine = np.float32(1.0)
            for k in range(3):
                cosine = min(cosine, x * directions[k, 0] + y * directions[k, 1] + z * directions[k, 2])
            weight = float((cosine - np.float32(_GRAZING)) / np.float32(_STEEP - _GRAZING))
            weight = min(max(weight, 0.0), 1.0)
            x = weight * x + (1.0 - weight) * out[v, u, 0]
            y = weight * y + (1.0 - weight) * out[v, u, 1]
            z = weight * z + (1.0 - weight) * out[v, u, 2]
            length = max(np.sqrt(x * x + y * y + z * z), 1e-6)
            out[v, u, 0], out[v, u, 1], out[v, u, 2] = x / length, y / length, z / length
