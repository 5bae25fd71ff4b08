"""Shadow detection against a surface: a light is missing where the surface should return more of it.

Start, on a small image: a light is doubted where its cosine, its contribution over albedo and strength, is
too small for the surrounding albedo. Then alternate: solve the surface from the lights that are not doubted
(`surface`), predict each light's cosine on it, compare with the cosine measured, and cut (`graph_cut`). Go on
from that surface at twice the size, and so on. A pixel that is dark in all three lights alike is dark paint;
paint that changes within eight pixels is told from shadow by that.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.geometry.camera import Camera
from vntoolkit.native import njit
from vntoolkit.photometry.frame import labels_from_lit
from vntoolkit.shadows.albedo import albedo_from_lit
from vntoolkit.shadows.contributions import LightContributions, all_of_three, largest_of_three, shrinking
from vntoolkit.shadows.evidence import (
    evidence_from_albedo,
    largest_dark_cosine,
    sharpened_cosines,
)
from vntoolkit.shadows.graph_cut import bonds_of_light, lit_by_cut
from vntoolkit.shadows.shadow_edges import (
    lit_beyond_half,
    turned_from_lights,
)
from vntoolkit.shadows.surface import Surface, SurfaceOptions, solve_surface

_STRONGEST_EVIDENCE = 4.0
_SMALLEST_ALBEDO = 1e-3

# A cosine is 1 where a surface of the local albedo faces the light.
_FIRST_COSINE = 0.2  # lights with less are doubted at the start
_PAINT_PART = 0.5  # dark paint: all three cosines are below this part of the predicted ones …
_PAINT_COSINE = 0.12  # … and above this one
_TOLERANCE_DARK = 0.04  # change of a cosine that is one unit of evidence where none is predicted
_TOLERANCE_BRIGHT = 0.05  # what each unit of predicted cosine adds to that
_SMOOTHNESS = 0.5  # price of a change of label between neighbours, in units of evidence
_CONTRAST = 0.6  # see `bonds_of_light`
_ROUNDS = 3  # alternations of surface and labels on the smallest image; most of the change comes in the first
_FINER_ROUNDS = 2  # the same on every larger one
_START_PIXELS = 15_000  # images are halved until they are not larger; there the labels start
_PERSISTENCE = 0.25  # weight of the previous frame's evidence
# Of a surface whose labels may still be wrong.
_FIRST_SURFACE = SurfaceOptions(iterations=3, noise=0.08, smoothness=1.5)
_FINER_SURFACE = SurfaceOptions(iterations=2, noise=0.08, smoothness=1.5)


def lit_by_surface(
    measured: LightContributions,
    mask: Mask,
    camera: Camera | None = None,
    memory: FloatArray | None = None,
) -> tuple[npt.NDArray[np.bool_], FloatArray, Surface]:
    """Return (h, w, 3) which lights arrive.

    Also return the (h, w, 3) evidence that the next frame may remember, and the surface, on the working size,
    that the labels came from.
    """
    factor = shrinking(mask)
    small, small_mask = (measured, mask) if factor == 1 else measured.shrunk(mask, factor)
    small_camera = None if camera is None else camera.scaled(1.0 / factor)
    surface, albedo = _surface_by_rounds(small, small_mask, small_camera)
    normals = surface.normals.astype(np.float32)
    normals, albedo = _enlarged(normals, mask.shape), _enlarged(albedo, mask.shape)
    predicted = normals @ measured.directions.T.astype(np.float32)
    raw = measured.cosines(albedo)
    cosines = _without_paint(raw, predicted)
    sharp = _without_paint(sharpened_cosines(raw, mask), predicted)
    evidence = _evidence(sharp, predicted, albedo, mask)
    evidence += evidence_from_albedo(measured, sharp, predicted, albedo, mask)
    evidence = np.clip(evidence, -_STRONGEST_EVIDENCE, _STRONGEST_EVIDENCE)
    if memory is not None and memory.shape == evidence.shape:
        evidence = (1 - _PERSISTENCE) * evidence + _PERSISTENCE * memory
    turned = turned_from_lights(normals, cosines, measured.directions, mask, factor)
    lit = _cut(evidence, cosines, mask) & ~turned
    return lit_beyond_half(lit, cosines, predicted, mask), evidence, surface


def _surface_by_rounds(
    measured: LightContributions, mask: Mask, camera: Camera | None
) -> tuple[Surface, FloatArray]:
    """Alternate between surface and labels, coarse to fine; return the surface and the albedo (h, w)."""
    if mask.size <= _START_PIXELS:
        surface, rounds, options = None, _ROUNDS, _FIRST_SURFACE
        lit = _first_doubts(measured, mask)
    else:
        small, small_mask = measured.shrunk(mask, 2)
        half = None if camera is None else camera.scaled(0.5)
        coarse, albedo = _surface_by_rounds(small, small_mask, half)
        surface, rounds, options = coarse.enlarged(mask.shape, 2), _FINER_ROUNDS, _FINER_SURFACE
        lit = _lit_on(surface, measured, _enlarged(albedo, mask.shape), mask)
    for i in range(rounds):
        full = all_of_three(lit) & mask
        albedo = albedo_from_lit(measured.length, full)
        surface = solve_surface(
            measured.relative_to(np.where(full, measured.length, albedo)), labels_from_lit(lit),
            measured.lights, mask, first_normals=measured.normals, weight=measured.trust, camera=camera,
            options=options, start=surface,
        )  # fmt: skip
        if i + 1 < rounds:
            lit = _lit_on(surface, measured, albedo, mask)
    assert surface is not None
    return surface, albedo


def _lit_on(
    surface: Surface, measured: LightContributions, albedo: FloatArray, mask: Mask
) -> npt.NDArray[np.bool_]:
    """Label by what the surface would return."""
    predicted = surface.normals.astype(np.float32) @ measured.directions.T.astype(np.float32)
    cosines = _without_paint(measured.cosines(albedo), predicted)
    return _cut(_evidence(cosines, predicted, albedo, mask), cosines, mask)


def _cut(evidence: FloatArray, cosines: FloatArray, mask: Mask) -> npt.NDArray[np.bool_]:
    lit = np.empty(cosines.shape, dtype=np.bool_)
    for k in range(3):
        bonds = bonds_of_light(cosines, k, mask, _SMOOTHNESS, _CONTRAST)
        lit[..., k] = lit_by_cut(evidence[..., k], bonds, mask)
    return lit


def _enlarged(image: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    if image.shape[:2] == shape:
        return image
    return np.asarray(cv2.resize(image, shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _first_doubts(measured: LightContributions, mask: Mask) -> npt.NDArray[np.bool_]:
    inside = measured.length[mask]
    typical = float(np.median(inside)) if inside.size else 1.0
    albedo: FloatArray = np.full(mask.shape, max(typical, _SMALLEST_ALBEDO), dtype=np.float32)
    lit = np.ones((*mask.shape, 3), dtype=np.bool_)
    for _ in range(3):  # albedo and doubts settle each other
        cosines = measured.cosines(albedo)
        lit = cosines > _FIRST_COSINE
        brightest = largest_of_three(cosines)[..., None]
        paint = all_of_three(~lit)[..., None] & (brightest > _PAINT_COSINE)
        lit |= paint & (cosines > _FIRST_COSINE * brightest)
        albedo = albedo_from_lit(measured.length, all_of_three(lit) & mask)
    return lit


def _without_paint(cosines: FloatArray, predicted: FloatArray) -> FloatArray:
    """Undo dark paint: where all three lights are missing alike, it is the albedo that is off."""
    out: FloatArray = np.empty(cosines.shape, np.float32)
    _paint_kernel(np.asarray(cosines, np.float32), np.asarray(predicted, np.float32), out)
    return out


@njit(cache=True, parallel=True)
def _paint_kernel(cosines: FloatArray, predicted: FloatArray, out: FloatArray) -> None:
    h, w, _ = cosines.shape
    for v in prange(h):
        for u in range(w):
            a = cosines[v, u, 0] / max(predicted[v, u, 0], np.float32(_TOLERANCE_DARK))
            b = cosines[v, u, 1] / max(predicted[v, u, 1], np.float32(_TOLERANCE_DARK))
            c = cosines[v, u, 2] / max(predicted[v, u, 2], np.float32(_TOLERANCE_DARK))
            typical = max(min(a, b), min(max(a, b), c))
            paint = max(a, b, c) < _PAINT_PART and typical > _PAINT_COSINE
            scale = np.float32(1.0) / max(typical, np.float32(_SMALLEST_ALBEDO)) if paint else np.float32(1.0)
            for k in range(3):
                out[v, u, k] = cosines[v, u, k] * scale


def _evidence(cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask) -> FloatArray:
    """(h, w, 3), positive where more is measured than a shadow returns."""
    level, grain = largest_dark_cosine(cosines, predicted, albedo, mask)
    _evidence_kernel(cosines, predicted, grain, level)
    return level


@njit(cache=True, parallel=True)
def _evidence_kernel(
    cosines: FloatArray, predicted: FloatArray, grain: FloatArray, level: FloatArray
) -> None:
    """Put the evidence in the place of the level."""
    h, w, _ = cosines.shape
    for v in prange(h):
        for u in range(w):
            noise = grain[v, u, 0]
            for k in range(3):
                unit = _TOLERANCE_DARK + _TOLERANCE_BRIGHT * max(predicted[v, u, k], 0.0)
                found = (cosines[v, u, k] - level[v, u, k]) / np.sqrt(unit * unit + noise * noise)
                level[v, u, k] = min(max(found, -_STRONGEST_EVIDENCE), _STRONGEST_EVIDENCE)
