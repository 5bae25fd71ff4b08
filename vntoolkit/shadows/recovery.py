"""Normals for every pixel of a frame with self-shadows (brostow2011, Section VI-B, and past it)."""

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels, Weight
from vntoolkit.checks import checks_kinds, require_mask, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.options.normals import RecoveryMethod
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame, count_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import albedo_from_lit, fill_smoothly
from vntoolkit.shadows.contributions import (
    LightContributions,
    contributions_from_frame,
    frame_in_window,
    in_whole_image,
    lengths_of,
    shrinking,
    window_around,
    working_image,
)
from vntoolkit.shadows.initialisation import noise_of_frame, solve_from_start
from vntoolkit.shadows.roots import roots_of_labels, spread_of_albedo
from vntoolkit.shadows.surface import ALBEDO_SPREAD, LabelledImage, Surface

# Cosines of the weakest light to the normal from colour alone.
_GRAZING = 0.6  # below it the normal solved with the depth stays
_STEEP = 0.8  # from it on only the colour counts
_LEAST_AGREED = np.float32(0.1)  # of a lit normal's weight where the depth steps
_WEIGHT_BY_LIGHTS = (0.05, 0.2, 0.5, 1.0)  # of a normal that 0, 1, 2, 3 lights tell


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
    `ShadowDetector.surface` where the labels are that detector's, of the same frame, mask and response; then
    the frame is not split by light again.
    """
    inside = np.ones(frame.shape, dtype=np.bool_) if mask is None else np.asarray(mask)
    require_mask(inside, frame.shape)
    require_shape(labels, frame.shape, "visibility labels")
    if labels.dtype != np.uint8 or labels.max(initial=0) > ALL_LIT:
        raise BadInput("visibility labels: expected bytes from 0 to 7")
    window = window_around(inside)
    near = None if camera is None else camera.cropped(*window)
    part, label, here = frame_in_window(frame, window), np.array(labels[window]), np.array(inside[window])
    mirror: FloatArray | None = None
    if method is RecoveryMethod.SURFACE:
        normals, weight, mirror = _with_surface(part, label, response, here, near, start)
    else:
        normals, weight = _by_pixel(part, label, response, here, method)
    return NormalMap(
        normals_in_camera=in_whole_image(normals, window, frame.shape),
        mask=inside,
        weight=in_whole_image(weight, window, frame.shape),
        mirror_probability=None if mirror is None else in_whole_image(mirror, window, frame.shape),
    )


def _with_surface(
    frame: LinearFrame,
    labels: VisibilityLabels,
    response: LightResponse,
    inside: Mask,
    camera: Camera | None,
    start: Surface | None,
) -> tuple[FloatArray, Weight, FloatArray | None]:
    """Return normals (h, w, 3), solved together with the depth, weights and mirror probabilities."""
    if start is not None and start.image is not None:
        image, factor = start.image, shrinking(inside)
    else:
        image, factor = working_image(frame, response, inside, camera)
    small_labels = _shrunk(labels, image.mask.shape)
    albedo = albedo_from_lit(image.light.length, image.mask & (small_labels == ALL_LIT), factor)
    labelled = LabelledImage(image=image, labels=small_labels, albedo=albedo)
    lit = inside & (labels == ALL_LIT)
    surface = solve_from_start(labelled, noise_of_frame(frame.rgb, response, lit))
    normals, agreement, light = surface.normals, surface.agreement, image.light
    if factor > 1:
        light = contributions_from_frame(frame, response)
        normals, agreement, coarse = (
            np.asarray(cv2.resize(part, inside.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
            for part in (surface.normals, surface.agreement, image.light.normals)
        )
        normals = np.where(lit[..., None], normals + (light.normals - coarse), normals)
    colour = np.where(lit, weight_of_colour(light), np.float32(0.0))[..., None]
    normals = normals + colour * (light.normals - normals)
    agreed = np.where(lit & (agreement > 0.0), np.maximum(agreement, _LEAST_AGREED), np.float32(1.0))
    mirror = surface.mirror_probability
    if mirror is not None:
        mirror = np.asarray(cv2.resize(mirror, inside.shape[::-1], interpolation=cv2.INTER_NEAREST))
    return _towards_viewer(normals, inside), _trust(labels, inside) * agreed, mirror


def weight_of_colour(light: LightContributions) -> Weight:
    """Return (h, w), 1 where all lights meet a surface so steeply that the colour alone tells the normal.

    The solved normal has less noise; it also takes in what depth makes of gloss and light from elsewhere.
    """
    cosines = light.normals @ light.directions.T.astype(np.float32)
    weakest = np.minimum(np.minimum(cosines[..., 0], cosines[..., 1]), cosines[..., 2])
    return np.clip((weakest - _GRAZING) / (_STEEP - _GRAZING), 0.0, 1.0).astype(np.float32)


def _shrunk(labels: VisibilityLabels, shape: tuple[int, ...]) -> VisibilityLabels:
    if labels.shape == shape:
        return labels
    return cv2.resize(labels, shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.uint8)


def _by_pixel(
    frame: LinearFrame,
    labels: VisibilityLabels,
    response: LightResponse,
    inside: Mask,
    method: RecoveryMethod,
) -> tuple[FloatArray, Weight]:
    """Return normals (h, w, 3) and weights, without a surface."""
    measured = contributions_from_frame(frame, response)
    normals = measured.normals
    if method is RecoveryMethod.TWO_LIGHTS:
        albedo = albedo_from_lit(measured.length, inside & (labels == ALL_LIT))
        normals = _pixel_by_pixel(measured, labels, albedo, inside)
    return _towards_viewer(normals, inside), _trust(labels, inside)


def _pixel_by_pixel(
    measured: LightContributions, labels: VisibilityLabels, albedo: FloatArray, mask: Mask
) -> FloatArray:
    spread = spread_of_albedo(measured.length, albedo, mask & (labels == ALL_LIT)) or ALBEDO_SPREAD
    roots = roots_of_labels(measured, albedo, labels, mask, spread)
    filled = fill_smoothly(roots.normals, roots.known.astype(np.float32))
    return np.where(roots.known[..., None], roots.normals, filled)


def _towards_viewer(normals: FloatArray, mask: Mask) -> FloatArray:
    """Unit normals; one that would face away keeps its direction in the image and turns edge-on."""
    turned: FloatArray = np.array(normals, dtype=np.float32)
    turned[..., 2] = np.minimum(turned[..., 2], -1e-3)
    return np.where(mask[..., None], turned / lengths_of(turned), 0.0).astype(np.float32)


def _trust(labels: VisibilityLabels, mask: Mask) -> Weight:
    """Return (h, w), how far a normal may be trusted by the number of lights that it rests on."""
    return np.where(mask, np.asarray(_WEIGHT_BY_LIGHTS, np.float32)[count_lit(labels)], np.float32(0.0))
