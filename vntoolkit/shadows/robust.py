"""Shadow detection against a surface: a light is missing where the surface should return more of it.

Start, on a small image: a light is doubted where its cosine, its contribution over albedo and strength, is
too small for the surrounding albedo. Then alternate: solve the surface from the lights that are not doubted
(`surface`), predict each light's cosine on it, compare with the cosine measured, and find labels by a minimum
cut. Go on from that surface at twice the size, and so on up to the working size; on the frame itself only
pixels in doubt are looked at again. A pixel that is dark in all three lights alike is dark paint; paint that
changes within eight pixels is told from shadow by that. Every frame stands alone: the surface of the frame
before lies beside a moving shadow, and leads into the wrong one of two valleys.
"""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, FloatArray, Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame, labels_from_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import albedo_from_lit
from vntoolkit.shadows.contributions import (
    LightContributions,
    WorkingImage,
    all_of_three,
    flat,
    largest_of_three,
    working_image,
)
from vntoolkit.shadows.evidence import (
    PAINT_COSINE,
    SMALLEST_ALBEDO,
    evidence_of_frame,
    evidence_over,
    inset_of,
    lamps_of,
    largest_dark_cosine,
    paint_scale,
    sharpened_cosines,
    typical_dark_cosine,
)
from vntoolkit.shadows.graph_cut import Nodes, bonds_of_light, lit_by_cut
from vntoolkit.shadows.shadow_edges import labels_beyond_half, turned_from_lights
from vntoolkit.shadows.surface import LabelledImage, Surface, SurfaceOptions

# A cosine is 1 where a surface of the local albedo faces the light.
_WEAK_COSINE = 0.35  # a frame without any that is less has no shadow
_FIRST_COSINE = 0.2  # lights with less are doubted at the start
_SMOOTHNESS = 0.5  # price of a change of label between neighbours, in units of evidence
_CONTRAST = 0.6  # see `bonds_of_light`
_ROUNDS = 3  # alternations of surface and labels on the smallest image; most of the change comes in the first
_FINER_ROUNDS = 2  # the same on every larger one
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
    small = image.light
    labels: VisibilityLabels = np.full(mask.shape, ALL_LIT, np.uint8)
    if not _is_doubted(image):
        return labels, None
    surface, albedo = _surface_by_rounds(image)
    predicted = _predicted(surface, small)
    raw = small.cosines(albedo)
    if factor == 1:
        raw = sharpened_cosines(raw, image.mask)
    dark = typical_dark_cosine(_without_paint(raw, predicted), predicted, albedo, image.mask)
    expected = np.stack([*np.moveaxis(predicted, -1, 0), albedo]).astype(np.float32)
    inset = inset_of(mask)
    found = evidence_of_frame(
        np.ascontiguousarray(frame.rgb), mask, inset, lamps_of(response), expected, dark
    )
    if found.near.any():
        for k in range(3):
            lit = _cut_light(found.evidence[k], found.cosines, k, found.near)
            labels[~lit] &= ALL_LIT - (1 << k)
        if inset is not None:
            labels &= ~turned_from_lights(surface.normals, found.cosines, small.directions, inset, found.near)
        labels = labels_beyond_half(labels, found.cosines, found.facing, mask, found.near)
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
        surface, rounds = None, _ROUNDS
        lit = _first_doubts(image)
    else:
        coarse, albedo = _surface_by_rounds(image.halved)
        surface, rounds = coarse.enlarged(image.mask.shape, 2), _FINER_ROUNDS
        lit = _lit_on(surface, image, _enlarged(albedo, image.mask.shape))
    for i in range(rounds):
        surface, albedo = _solved(image, lit, options, surface)
        if i + 1 < rounds:
            lit = _lit_on(surface, image, albedo)
    assert surface is not None
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
    """Label by what the surface would return."""
    predicted = _predicted(surface, image.light)
    cosines = _without_paint(image.light.cosines(albedo), predicted)
    evidence = _evidence(cosines, predicted, albedo, image.mask)
    return np.stack([_cut_light(evidence[k], cosines, k, image.mask) for k in range(3)], axis=-1)


def _cut_light(evidence: FloatArray, cosines: FloatArray, k: int, mask: Mask) -> BoolArray:
    def bonds(number: Nodes) -> tuple[FloatArray, FloatArray]:
        return bonds_of_light(cosines, k, number, _SMOOTHNESS, _CONTRAST)

    return lit_by_cut(evidence, bonds, mask, _SMOOTHNESS)


def _enlarged(image: Any, shape: tuple[int, ...]) -> FloatArray:
    if image.shape[:2] == shape:
        return image
    return np.asarray(cv2.resize(image, shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _first_doubts(image: WorkingImage) -> BoolArray:
    measured, mask = image.light, image.mask
    inside = measured.length[mask]
    typical = float(np.median(inside)) if inside.size else 1.0
    albedo: FloatArray = np.full(mask.shape, max(typical, SMALLEST_ALBEDO), dtype=np.float32)
    lit = np.ones((*mask.shape, 3), dtype=np.bool_)
    for _ in range(3):  # albedo and doubts settle each other
        cosines = measured.cosines(albedo)
        lit = cosines > _FIRST_COSINE
        brightest = largest_of_three(cosines)[..., None]
        paint = all_of_three(~lit)[..., None] & (brightest > PAINT_COSINE)
        lit |= paint & (cosines > _FIRST_COSINE * brightest)
        albedo = albedo_from_lit(measured.length, all_of_three(lit) & mask)
    return lit


def _without_paint(cosines: FloatArray, predicted: FloatArray) -> FloatArray:
    """Undo dark paint: where all three lights are missing alike, it is the albedo that is off."""
    out: FloatArray = np.empty(cosines.shape, np.float32)
    _paint_kernel(flat(cosines), flat(predicted), flat(out))
    return out


@njit(cache=True, error_model="numpy")
def _paint_kernel(cosines: FloatArray, predicted: FloatArray, out: FloatArray) -> None:
    h, w = cosines.shape[0], cosines.shape[1] // 3
    for v in range(h):
        line, surface, to = cosines[v], predicted[v], out[v]
        for u in range(w):
            a, b, c = line[3 * u], line[3 * u + 1], line[3 * u + 2]
            scale = paint_scale(a, b, c, surface[3 * u], surface[3 * u + 1], surface[3 * u + 2])
            to[3 * u], to[3 * u + 1], to[3 * u + 2] = a * scale, b * scale, c * scale


def _evidence(cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask) -> FloatArray:
    """(3, h, w), positive where more is measured than a shadow returns."""
    level, grain = largest_dark_cosine(cosines, predicted, albedo, mask)
    out: FloatArray = np.empty((3, *mask.shape), np.float32)
    _evidence_kernel(flat(cosines), flat(predicted), flat(level), flat(grain), out)
    return out


@njit(cache=True, error_model="numpy")
def _evidence_kernel(
    cosines: FloatArray, predicted: FloatArray, level: FloatArray, grain: FloatArray, out: FloatArray
) -> None:
    _, h, w = out.shape
    for v in range(h):
        line, surface, dark, noise = cosines[v], predicted[v], level[v], grain[v]
        for k in range(3):
            to = out[k, v]
            for u in range(w):
                i = 3 * u + k
                to[u] = evidence_over(line[i], dark[i], surface[i], noise[u])
