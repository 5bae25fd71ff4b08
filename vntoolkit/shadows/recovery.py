"""Normals for every pixel of a frame with self-shadows (brostow2011, Section VI-B, and past it)."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels
from vntoolkit.checks import require_mask, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import AlbedoOptions, albedo_from_lit
from vntoolkit.shadows.confidence import ConfidenceOptions, confidence_weight, gloss_trust
from vntoolkit.shadows.filling import fill_smoothly
from vntoolkit.shadows.lengths import lengths_of
from vntoolkit.shadows.penumbra import PenumbraOptions, labels_without_penumbra
from vntoolkit.shadows.shares import LightShares, shares_from_frame
from vntoolkit.shadows.starts import surface_from_either_start
from vntoolkit.shadows.steep_lights import SteepLightOptions, normals_by_steep_lights
from vntoolkit.shadows.surface import depth_map_from_surface
from vntoolkit.shadows.surface_options import SurfaceOptions
from vntoolkit.shadows.two_lights import continue_with_two_lights
from vntoolkit.shadows.window import Window, frame_in_window, in_whole_image, window_around


class RecoveryMethod(Enum):
    """How normals are found where a light is missing."""

    INVERSION = "inversion"  # as if all three lights arrived: the baseline
    TWO_LIGHTS = "two-lights"  # Onn and Bruckstein's quadratic pixel by pixel, smooth fill elsewhere
    SURFACE = "surface"  # solved together with the depth, Hernández, Vogiatzis and Cipolla


@dataclass(frozen=True, kw_only=True)
class RecoveryOptions:
    """method: which. surface, albedo, penumbra, steep_lights, confidence: the parameters of the parts."""

    method: RecoveryMethod = RecoveryMethod.SURFACE
    surface: SurfaceOptions = field(default_factory=SurfaceOptions)
    albedo: AlbedoOptions = field(default_factory=AlbedoOptions)
    penumbra: PenumbraOptions = field(default_factory=PenumbraOptions)
    steep_lights: SteepLightOptions = field(default_factory=SteepLightOptions)
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
    require_mask(inside, frame.shape)
    require_shape(labels, frame.shape, "visibility labels")
    if labels.dtype != np.uint8 or labels.max(initial=0) > ALL_LIT:
        raise BadInput("visibility labels: expected bytes from 0 to 7")
    window = window_around(inside)
    part = _recover(
        frame_in_window(frame, window), labels[window], response, inside[window], options,
        None if camera is None else camera.cropped(*window),
    )  # fmt: skip
    return part if part.normal_map.shape == frame.shape else _in_whole_image(part, window, frame.shape)


def _recover(
    frame: LinearFrame,
    labels: VisibilityLabels,
    response: LightResponse,
    inside: Mask,
    options: RecoveryOptions,
    camera: Camera | None,
) -> RecoveredSurface:
    measured = shares_from_frame(frame, response)
    full = inside & (labels == ALL_LIT)
    albedo = albedo_from_lit(measured.length, full, options.albedo)
    depth_map, agreement = None, None
    if options.method is RecoveryMethod.INVERSION:
        normals = measured.normals
    elif options.method is RecoveryMethod.TWO_LIGHTS:
        normals = _pixel_by_pixel(measured, labels, albedo, inside)
    else:
        labels = labels_without_penumbra(labels, measured.relative_to(albedo), inside, options.penumbra)
        full = inside & (labels == ALL_LIT)
        surface = surface_from_either_start(
            measured, labels, albedo, inside, camera=camera, options=options.surface,
            trust=gloss_trust(measured.length, albedo, full, options.confidence),
        )  # fmt: skip
        agreement = surface.agreement
        normals = normals_by_steep_lights(
            surface.normals, measured.normals, measured.directions, full, options.steep_lights
        )
        depth_map = depth_map_from_surface(surface, inside, camera)
    weight = confidence_weight(labels, frame.clipped, measured.length, albedo, agreement, options.confidence)
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
    length = lengths_of(turned)
    turned = np.where(mask[..., None], turned / length, 0.0).astype(np.float32)
    return NormalMap(
        normals_in_camera=turned, mask=mask, weight=np.where(mask, weight, 0.0).astype(np.float32)
    )
