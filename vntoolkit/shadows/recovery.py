"""Normals for every pixel of a frame with self-shadows (brostow2011, Section VI-B, and past it)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.visibility import ALL_LIT
from vntoolkit.shadows.albedo import AlbedoOptions, albedo_from_lit
from vntoolkit.shadows.confidence import ConfidenceOptions, confidence_weight, gloss_trust
from vntoolkit.shadows.filling import fill_smoothly
from vntoolkit.shadows.shares import LightShares, shares_from_frame
from vntoolkit.shadows.surface import Surface, SurfaceOptions, depth_map_from_surface, solve_surface
from vntoolkit.shadows.two_lights import continue_with_two_lights

_LARGEST_MISFIT = 25.0  # χ² of one pixel beyond which it says no more about its region


class RecoveryMethod(Enum):
    """How normals are found where a light is missing."""

    INVERSION = "inversion"  # as if all three lights arrived: the baseline
    TWO_LIGHTS = "two-lights"  # Onn and Bruckstein's quadratic pixel by pixel, smooth fill elsewhere
    SURFACE = "surface"  # solved together with the depth, Hernández, Vogiatzis and Cipolla


@dataclass(frozen=True, kw_only=True)
class RecoveryOptions:
    """method: which. surface, albedo, confidence: the parameters of the parts."""

    method: RecoveryMethod = RecoveryMethod.SURFACE
    surface: SurfaceOptions = field(default_factory=SurfaceOptions)
    albedo: AlbedoOptions = field(default_factory=AlbedoOptions)
    confidence: ConfidenceOptions = field(default_factory=ConfidenceOptions)


@dataclass(frozen=True, kw_only=True, eq=False)
class RecoveredSurface:
    """Normals with weights, and the depth they were solved with (None where the method has none)."""

    normal_map: NormalMap
    depth_map: DepthMap | None


def recover_normals(
    frame: LinearFrame,
    labels: VisibilityLabels,
    response: LightResponse,
    mask: Mask | None = None,
    options: RecoveryOptions | None = None,
    camera: Camera | None = None,
) -> NormalMap:
    """Return a normal and a weight for every pixel of `mask`, whichever lights reach it.

    labels: (h, w), bit k set where light k arrives. camera: None for orthographic.
    """
    return recover_surface(frame, labels, response, mask, options, camera).normal_map


def recover_surface(
    frame: LinearFrame,
    labels: VisibilityLabels,
    response: LightResponse,
    mask: Mask | None = None,
    options: RecoveryOptions | None = None,
    camera: Camera | None = None,
) -> RecoveredSurface:
    """`recover_normals`, with the depth that the surface method solves for at the same time."""
    options = options or RecoveryOptions()
    inside = np.ones(frame.shape, dtype=np.bool_) if mask is None else np.asarray(mask)
    require_shape(inside, frame.shape, "mask")
    require_shape(labels, frame.shape, "visibility labels")
    if labels.dtype != np.uint8 or labels.max(initial=0) > ALL_LIT:
        raise BadInput("visibility labels: expected bytes from 0 to 7")
    measured = shares_from_frame(frame, response)
    full = inside & (labels == ALL_LIT)
    albedo = albedo_from_lit(measured.length, full, options.albedo)
    depth_map, agreement = None, None
    if options.method is RecoveryMethod.INVERSION:
        normals = measured.normals
    elif options.method is RecoveryMethod.TWO_LIGHTS:
        normals = _pixel_by_pixel(measured, labels, albedo, inside)
    else:
        surface = _surface_from_either_start(measured, labels, albedo, inside, camera, options)
        normals, agreement = surface.normals, surface.agreement
        depth_map = depth_map_from_surface(surface, inside, camera)
    weight = confidence_weight(labels, frame.clipped, measured.length, albedo, agreement, options.confidence)
    return RecoveredSurface(normal_map=_towards_viewer(normals, weight, inside), depth_map=depth_map)


def _surface_from_either_start(
    measured: LightShares,
    labels: VisibilityLabels,
    albedo: FloatArray,
    mask: Mask,
    camera: Camera | None,
    options: RecoveryOptions,
) -> Surface:
    """Solve from a smooth continuation and from the two-light roots; each shadow keeps what fits better.

    The energy has two valleys where two lights arrive, as the quadratic has two roots.
    """
    full = mask & (labels == ALL_LIT)
    solve = partial(
        solve_surface, measured.relative_to(np.where(full, measured.length, albedo)), labels,
        measured.lights, mask, camera=camera,
        weight=measured.trust * gloss_trust(measured.length, albedo, full, options.confidence),
    )  # fmt: skip
    smooth = solve(first_normals=measured.normals, options=options.surface)
    if full.sum() == mask.sum():
        return smooth
    relative = measured.relative_to(albedo)
    roots, decided = continue_with_two_lights(measured.normals, relative, labels, measured.lights, mask)
    rooted = solve(first_normals=roots, guessed=decided, options=options.surface)
    better = _better_regions(rooted.misfit, smooth.misfit, mask & ~full)
    if not better.any():
        return smooth
    merged = np.where(better[..., None], rooted.normals, smooth.normals)
    base = rooted if np.count_nonzero(better) * 2 > np.count_nonzero(mask & ~full) else smooth
    return solve(first_normals=measured.normals, start=replace(base, normals=merged), options=options.surface)


def _better_regions(first: FloatArray, second: FloatArray, shadow: Mask) -> Mask:
    """Connected regions of `shadow` in which `first` sums to less than `second`."""
    _, region = cv2.connectedComponents(shadow.astype(np.uint8), connectivity=4)
    cap = _LARGEST_MISFIT
    gain = np.bincount(
        region[shadow], weights=(np.minimum(second, cap) - np.minimum(first, cap))[shadow],
        minlength=int(region.max()) + 1,
    )  # fmt: skip
    return shadow & (gain > 0)[region]


def _pixel_by_pixel(
    measured: LightShares, labels: VisibilityLabels, albedo: FloatArray, mask: Mask
) -> FloatArray:
    relative = measured.relative_to(albedo)
    normals, decided = continue_with_two_lights(measured.normals, relative, labels, measured.lights, mask)
    filled = fill_smoothly(normals, decided.astype(np.float32))
    return np.where(decided[..., None], normals, filled)


def _towards_viewer(normals: FloatArray, weight: FloatArray, mask: Mask) -> NormalMap:
    """Unit normals; one that would face away keeps its direction in the image and turns edge-on."""
    turned: FloatArray = np.array(normals, dtype=np.float32)
    turned[..., 2] = np.minimum(turned[..., 2], -1e-3)
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    turned = np.where(mask[..., None], turned / length, 0.0).astype(np.float32)
    return NormalMap(
        normals_in_camera=turned, mask=mask, weight=np.where(mask, weight, 0.0).astype(np.float32)
    )
