"""Shadow detection against a surface: a light is missing where the surface should return more of it.

Start, on a small image: a light is doubted where its cosine, its contribution over albedo and strength, is
small. Then alternate: solve the surface from the lights that are not doubted (`surface`), predict each
light's cosine on it, weigh it against the cosine measured (`log_odds`), and find labels by a minimum cut. Go
on from that surface at twice the size, and so on up to the working size; the last labels are the frame's own.
Every frame stands alone: the surface of the frame before lies beside a moving shadow, and leads into the
wrong one of two valleys.
"""

from dataclasses import replace

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, FloatArray, Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame, labels_from_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import albedo_from_lit
from vntoolkit.shadows.contributions import (
    LightContributions,
    WorkingImage,
    all_of_three,
    contributions_from_frame,
    largest_of_three,
    working_image,
)
from vntoolkit.shadows.graph_cut import Nodes, lit_by_cut, weights_of_light
from vntoolkit.shadows.log_odds import PAINT_COSINE, log_odds_of_lights, typical_dark_cosine, without_paint
from vntoolkit.shadows.shadow_edges import lit_beyond_half, sharpened, turned_from_lights
from vntoolkit.shadows.surface import LabelledImage, Surface, SurfaceOptions

# A cosine is 1 where a surface of the local albedo faces the light.
_WEAK_COSINE = 0.35  # a frame without any that is less has no shadow
_FIRST_COSINE = 0.2  # lights with less are doubted at the start
_FIRST_ROUNDS = 3  # in which the albedo and the first doubts settle each other
_SMOOTHNESS = 0.5  # price of a change of label between neighbours, in units of log odds
_CONTRAST = 0.6  # see `weights_of_light`
_ROUNDS = 3  # alternations of surface and labels on the smallest image; most of the change comes in the first
_FINER_ROUNDS = (
    2  # the same on every larger one: after one, a face's labels overlap the true ones less by 0.1
)
_START_PIXELS = 15_000  # images are halved until they are not larger; there the labels start
# Of a surface whose labels may still be wrong.
_SURFACE = SurfaceOptions(noise=0.08, smoothness=1.5, cycles=3)
_ITERATIONS = (3, 2, 1)  # on the smallest image, the next, and all larger ones, which start nearer


def labels_by_surface(
    frame: LinearFrame, response: LightResponse, mask: Mask, camera: Camera | None = None
) -> tuple[VisibilityLabels, Surface | None]:
    """Return (h, w) labels, bit k set where light k arrives, and their surface on the working size.

    The surface is None where no light is weak anywhere.
    """
    image, factor = working_image(frame, response, mask, camera)
    if not _is_doubted(image):
        return np.full(mask.shape, ALL_LIT, np.uint8), None
    surface, albedo = _surface_by_rounds(image)
    predicted, light = _predicted(surface, image.light), image.light
    if factor > 1:
        light = contributions_from_frame(frame, response)
        predicted, albedo = _enlarged(predicted, mask.shape), _enlarged(albedo, mask.shape)
    cosines = light.cosines(albedo)
    sharp = without_paint(sharpened(cosines, mask), predicted)
    dark = typical_dark_cosine(sharp, predicted, albedo, mask)
    log_odds = log_odds_of_lights(sharp, predicted, albedo, light.length, dark, light.directions)
    cosines = without_paint(cosines, predicted)
    lit = _cut(log_odds, cosines, mask) & ~turned_from_lights(
        surface.normals, cosines, light.directions, mask
    )
    labels = labels_from_lit(lit_beyond_half(lit, cosines, predicted, mask))
    return labels, replace(surface, image=image)


def _is_doubted(image: WorkingImage) -> bool:
    """Tell whether any light is weak anywhere, so that a surface must say whether it is missing."""
    cosines = image.light.cosines(albedo_from_lit(image.light.length, image.mask))
    weak = cosines < _WEAK_COSINE
    return bool(((weak[..., 0] | weak[..., 1] | weak[..., 2]) & image.mask).any())


def _surface_by_rounds(image: WorkingImage) -> tuple[Surface, FloatArray]:
    """Alternate between surface and labels, coarse to fine; return the surface and the albedo (h, w)."""
    size, halvings = image.mask.size, 0
    while size > _START_PIXELS:
        size, halvings = size // 4, halvings + 1
    options = replace(_SURFACE, iterations=_ITERATIONS[min(halvings, 2)])
    if halvings == 0:
        return _first_surface(image, options)
    coarse, albedo = _surface_by_rounds(image.halved)
    surface, albedo = coarse.enlarged(image.mask.shape, 2), _enlarged(albedo, image.mask.shape)
    for _ in range(_FINER_ROUNDS):
        surface, albedo = _solved(image, _lit_on(surface, image, albedo), options, surface)
    return surface, albedo


def _first_surface(image: WorkingImage, options: SurfaceOptions) -> tuple[Surface, FloatArray]:
    surface, albedo = _solved(image, _first_lit(image), options, None)
    for _ in range(_ROUNDS - 1):
        surface, albedo = _solved(image, _lit_on(surface, image, albedo), options, surface)
    return surface, albedo


def _solved(
    image: WorkingImage, lit: BoolArray, options: SurfaceOptions, start: Surface | None
) -> tuple[Surface, FloatArray]:
    """Return the surface (h, w) under these labels, and the albedo."""
    albedo = albedo_from_lit(image.light.length, all_of_three(lit) & image.mask)
    labelled = LabelledImage(image=image, labels=labels_from_lit(lit), albedo=albedo)
    return labelled.solve(options, start), albedo


def _predicted(surface: Surface, measured: LightContributions) -> FloatArray:
    """(h, w, 3): what the surface would return of each light."""
    normals: FloatArray = surface.normals.astype(np.float32)
    return normals @ measured.directions.T.astype(np.float32)


def _lit_on(surface: Surface, image: WorkingImage, albedo: FloatArray) -> BoolArray:
    """Return (h, w, 3), the lights that arrive by what the surface would return."""
    predicted = _predicted(surface, image.light)
    cosines = without_paint(image.light.cosines(albedo), predicted)
    dark = typical_dark_cosine(cosines, predicted, albedo, image.mask)
    log_odds = log_odds_of_lights(cosines, predicted, albedo, None, dark, image.light.directions)
    return _cut(log_odds, cosines, image.mask)


def _cut(log_odds: FloatArray, cosines: FloatArray, mask: Mask) -> BoolArray:
    """Return (h, w, 3), the cheapest labels."""

    def of_light(k: int) -> BoolArray:
        def weights(number: Nodes) -> tuple[FloatArray, FloatArray]:
            return weights_of_light(cosines, k, number, _SMOOTHNESS, _CONTRAST)

        return lit_by_cut(log_odds[k], weights, mask, _SMOOTHNESS)

    return np.stack([of_light(k) for k in range(3)], axis=-1)


def _first_lit(image: WorkingImage) -> BoolArray:
    """Return (h, w, 3), the lights that are not weak; all three alike are weak on dark paint."""
    length, mask = image.light.length, image.mask
    typical = float(np.median(length[mask])) if mask.any() else 1.0
    albedo: FloatArray = np.full(mask.shape, typical, np.float32)
    for _ in range(_FIRST_ROUNDS):
        cosines = image.light.cosines(albedo)
        lit = cosines > _FIRST_COSINE
        brightest = largest_of_three(cosines)
        paint = (brightest > PAINT_COSINE) & (brightest < _FIRST_COSINE)
        lit |= paint[..., None] & (cosines > _FIRST_COSINE * brightest[..., None])
        albedo = albedo_from_lit(length, all_of_three(lit) & mask)
    return lit


def _enlarged(image: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    if image.shape[:2] == shape:
        return image
    return np.asarray(cv2.resize(image, shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float32)
