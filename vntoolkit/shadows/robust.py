"""Shadow detection against predicted normals: a light is missing where the surface should return more of it.

A light is doubted where its cosine, its contribution over albedo and strength, is too small for the albedo
around. Without the doubted lights `roots` tells the normals, these predict each light's cosine, and a minimum
cut of measured against predicted ones labels the lights again. On the frame itself only pixels in doubt are
looked at. A pixel that is dark in all three lights alike is dark paint; paint that changes within eight
pixels is told from shadow by that. Every frame stands alone.
"""

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, FloatArray, Mask, VisibilityLabels
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame, labels_from_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import albedo_from_lit
from vntoolkit.shadows.contributions import (
    LightContributions,
    all_of_three,
    contributions_from_frame,
    flat,
    largest_of_three,
    shrunk_frame,
)
from vntoolkit.shadows.evidence import (
    PAINT_COSINE,
    SMALLEST_ALBEDO,
    FrameEvidence,
    evidence_of_frame,
    lamps_of,
    paint_scale,
    typical_dark_cosine,
)
from vntoolkit.shadows.graph_cut import Nodes, bonds_of_light, lit_by_cut
from vntoolkit.shadows.roots import normals_from_labels
from vntoolkit.shadows.shadow_edges import labels_beyond_half

# A cosine is 1 where a surface of the local albedo faces the light.
_WEAK_COSINE = 0.35  # a frame without any that is less has no shadow
_FIRST_COSINE = 0.1  # lights with less are doubted at the start
_CAST_FACING = 0.2  # predicted cosine from which a shadow counts as cast
_SMOOTHNESS = 0.5  # price of a change of label between neighbours, in units of evidence
_CONTRAST = 0.6  # see `bonds_of_light`


def labels_by_prediction(frame: LinearFrame, response: LightResponse, mask: Mask) -> VisibilityLabels:
    """Return (h, w) labels, bit k set where light k arrives."""
    small, small_mask = shrunk_frame(frame, mask)
    light, lamps = contributions_from_frame(small, response), lamps_of(response)
    if not _is_doubted(light, small_mask):
        return np.full(mask.shape, ALL_LIT, np.uint8)
    lit = _first_doubts(light, small_mask)
    for image, here in ((small, small_mask), (frame, mask)):
        albedo = albedo_from_lit(light.length, all_of_three(lit) & small_mask)
        normals = normals_from_labels(light, albedo, labels_from_lit(lit), small_mask, sweeps=0)
        predicted = normals @ light.directions.T.astype(np.float32)
        measured = _without_paint(light.cosines(albedo), predicted)
        dark = typical_dark_cosine(measured, predicted, albedo, small_mask)
        expected = np.stack([*np.moveaxis(predicted, -1, 0), albedo]).astype(np.float32)
        found = evidence_of_frame(np.ascontiguousarray(image.rgb), here, lamps, expected, dark)
        lit = np.stack([_cut_light(found, k) for k in range(3)], axis=-1)
    turned_to = cv2.resize(predicted, mask.shape[::-1], interpolation=cv2.INTER_LINEAR) > _CAST_FACING
    return labels_beyond_half(labels_from_lit(lit), found.cosines, labels_from_lit(turned_to), found.near)


def _is_doubted(light: LightContributions, mask: Mask) -> bool:
    """Tell whether any light is weak anywhere, so that normals must say whether it is missing."""
    weak = light.cosines(albedo_from_lit(light.length, mask)) < _WEAK_COSINE
    return bool(((weak[..., 0] | weak[..., 1] | weak[..., 2]) & mask).any())


def _cut_light(found: FrameEvidence, k: int) -> BoolArray:
    """Return (h, w), True where light k arrives."""

    def bonds(number: Nodes) -> tuple[FloatArray, FloatArray]:
        return bonds_of_light(found.cosines, k, number, _SMOOTHNESS, _CONTRAST)

    return lit_by_cut(found.evidence[k], bonds, found.near, _SMOOTHNESS)


def _first_doubts(measured: LightContributions, mask: Mask) -> BoolArray:
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
