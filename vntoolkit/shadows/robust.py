"""Shadow detection against a surface: a light is missing where the surface should return more of it.

Start, on a small image: a light is doubted where its cosine, its contribution over albedo and strength, is
too small for the surrounding albedo. Then alternate: solve the surface from the lights that are not doubted
(`surface`), predict each light's cosine on it, compare with the cosine measured, and cut (`graph_cut`). Go on
from that surface at twice the size, and so on up to the working size; on the frame itself only pixels in
doubt are looked at again. A frame after another goes on from that one's surface, but in shadows that a small
image of its own explains better. A pixel that is dark in all three lights alike is dark paint; paint that
changes within eight pixels is told from shadow by that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame, labels_from_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import albedo_from_lit
from vntoolkit.shadows.contributions import (
    LightContributions,
    Window,
    WorkingImage,
    all_of_three,
    flat,
    largest_of_three,
    lengths_of,
    working_image,
)
from vntoolkit.shadows.evidence import (
    PAINT_COSINE,
    SMALLEST_ALBEDO,
    TOLERANCE_DARK,
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
from vntoolkit.shadows.initialisation import better_shadows
from vntoolkit.shadows.shadow_edges import labels_beyond_half, turned_from_lights
from vntoolkit.shadows.surface import LabelledImage, Surface, SurfaceOptions, with_normals

# A cosine is 1 where a surface of the local albedo faces the light.
_WEAK_COSINE = 0.35  # a frame without any that is less has no shadow
_FIRST_COSINE = 0.2  # lights with less are doubted at the start
_SMOOTHNESS = 0.5  # price of a change of label between neighbours, in units of evidence
_CONTRAST = 0.6  # see `bonds_of_light`
_ROUNDS = 3  # alternations of surface and labels on the smallest image; most of the change comes in the first
_FINER_ROUNDS = 2  # the same on every larger one
_START_PIXELS = 15_000  # images are halved until they are not larger; there the labels start
_PERSISTENCE = 0.25  # weight of the previous frame's evidence
_CHANGED = 0.25  # of the light: a frame that differs by more from the one before has nothing to do with it
_CORRECTED_EVERY = 2  # frames: a wrong answer takes several to grow, and asking costs a tenth of a frame
_SAME_ANSWER = 0.85  # cosine between two normals below which they are two answers, not one
# Of a surface whose labels may still be wrong.
_FIRST_SURFACE = SurfaceOptions(iterations=3, noise=0.08, smoothness=1.5)
_FINER_SURFACE = SurfaceOptions(iterations=2, noise=0.08, smoothness=1.5)
_NEXT_SURFACE = SurfaceOptions(iterations=1, noise=0.08, smoothness=1.5, cycles=3)


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameMemory:
    """What a frame leaves for the next, of its window in the image.

    evidence: (3, h, w) of the window, see `evidence_of_frame`; None where nothing was in doubt. colours:
    (h', w', 3), contributions on the working size. surface: on that size, where the labels came from.
    albedo: (h', w'). recovered: (h', w', 3), normals that recovery found, or None. start: what recovery goes
    on from. age: frames since the first that it goes on from.
    """

    window: Window
    evidence: npt.NDArray[np.int8] | None
    colours: FloatArray
    surface: Surface | None
    albedo: FloatArray
    recovered: FloatArray | None = None
    start: Surface | None = None
    age: int = 0


def labels_by_surface(
    frame: LinearFrame,
    response: LightResponse,
    mask: Mask,
    window: Window,
    camera: Camera | None = None,
    last: FrameMemory | None = None,
) -> tuple[VisibilityLabels, FrameMemory]:
    """Return (h, w) labels, bit k set where light k arrives, of a frame, which is a window of its image.

    Also return what the next frame may remember; its surface is that of the labels, on the working size.
    """
    image, factor = working_image(frame, response, mask, camera)
    small = image.light
    labels: VisibilityLabels = np.full(mask.shape, ALL_LIT, np.uint8)
    if not _is_doubted(image):
        return labels, FrameMemory(
            window=window, evidence=None, colours=small.contributions, surface=None, albedo=small.length
        )
    last = None if last is None else _placed(last, window, mask.shape, image.mask.shape)
    if last is not None and not _goes_on(last, image):
        last = None
    if last is None or last.surface is None:
        surface, albedo = _surface_by_rounds(image)
    else:
        start = last.surface
        if last.age % _CORRECTED_EVERY == 0:
            start = _corrected(start, image)
        surface, albedo = _solved(image, _lit_on(start, image, last.albedo), _NEXT_SURFACE, start)
    predicted = _predicted(surface, small)
    raw = small.cosines(albedo)
    kept = np.zeros(image.mask.shape, np.float32)
    if last is not None:
        kept = _PERSISTENCE * _sameness(raw, last, small, albedo)
    if factor == 1:
        raw = sharpened_cosines(raw, image.mask)
    dark = typical_dark_cosine(_without_paint(raw, predicted), predicted, albedo, image.mask)
    expected = np.stack([*np.moveaxis(predicted, -1, 0), albedo, kept]).astype(np.float32)
    inset = inset_of(mask)
    found = evidence_of_frame(
        np.ascontiguousarray(frame.rgb), mask, inset, lamps_of(response), expected, dark,
        None if last is None else last.evidence,
    )  # fmt: skip
    if found.memory is not None:
        for k in range(3):
            lit = _cut_light(found.evidence[k], found.cosines, k, found.near)
            labels[~lit] &= ALL_LIT - (1 << k)
        if inset is not None:
            labels &= ~turned_from_lights(surface.normals, found.cosines, small.directions, inset, found.near)
        labels = labels_beyond_half(labels, found.cosines, found.facing, mask, found.near)
    return labels, FrameMemory(
        window=window, evidence=found.memory, colours=small.contributions, surface=surface, albedo=albedo,
        age=0 if last is None else last.age + 1,
        start=_between(surface, None if last is None else last.recovered, labels),
    )  # fmt: skip


def _corrected(last: Surface, image: WorkingImage) -> Surface:
    """Return the surface of the frame before, with this frame's own in shadows that this explains better.

    A wrong answer would be handed on from frame to frame, and grow as the subject moves. This frame's own
    comes from a small image, which costs little, and counts only where it is another answer.
    """
    small, before = image, last
    while small.mask.size > _START_PIXELS:
        before, small = before.shrunk(small.mask, 2), small.halved()
    own, albedo = _surface_by_rounds(small, rounds=1)
    labels = labels_from_lit(_lit_on(own, small, albedo))
    better = better_shadows(own, before, LabelledImage(image=small, labels=labels, albedo=albedo))
    if not better.any():
        return last
    shape = image.mask.shape
    near = np.asarray(cv2.dilate(better.astype(np.float32), np.ones((3, 3), np.uint8)), dtype=np.float32)
    normals = _enlarged(own.normals.astype(np.float32), shape)
    differs = np.einsum("vuc,vuc->vu", normals, last.normals) < _SAME_ANSWER
    return with_normals(last, normals, _enlarged(near, shape) * differs)


def _between(surface: Surface, recovered: FloatArray | None, labels: VisibilityLabels) -> Surface:
    """Return the surface to recover from: under shadow, halfway to what was recovered of the frame before.

    There the energy has two valleys. The labels' surface may lie in the one, what was recovered in the other,
    and either is the right one at times; from between, the light decides.
    """
    if recovered is None:
        return surface
    shadow = cv2.resize(labels, recovered.shape[1::-1], interpolation=cv2.INTER_NEAREST) != ALL_LIT
    normals = surface.normals.copy()
    between = normals[shadow] + recovered[shadow]
    normals[shadow] = between / np.maximum(lengths_of(between), 1e-3)
    return replace(surface, normals=normals)


def _is_doubted(image: WorkingImage) -> bool:
    """Tell whether any light is weak anywhere, so that a surface must say whether it is missing."""
    cosines = image.light.cosines(albedo_from_lit(image.light.length, image.mask))
    weak = cosines < _WEAK_COSINE
    return bool(((weak[..., 0] | weak[..., 1] | weak[..., 2]) & image.mask).any())


def _placed(last: FrameMemory, window: Window, shape: tuple[int, ...], small: tuple[int, ...]) -> FrameMemory:
    """Return what was remembered of one window of the image in the place of another.

    shape, small: (h, w) of the window and of its working size.
    """
    if last.window == window:
        return last
    rows, columns = last.window
    height, width = last.colours.shape[:2]
    # pixels of the old working size per pixel of the new
    down, right = height * shape[0] / small[0] / (rows.stop - rows.start), width * shape[1] / small[1]
    right /= columns.stop - columns.start
    top = (window[0].start - rows.start) * height / (rows.stop - rows.start) + 0.5 * down - 0.5
    left = (window[1].start - columns.start) * width / (columns.stop - columns.start) + 0.5 * right - 0.5
    place = np.array([[right, 0.0, left], [0.0, down, top]])

    def moved(image: FloatArray) -> FloatArray:
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        single = np.asarray(image, np.float32)
        placed = cv2.warpAffine(single, place, small[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(placed, dtype=np.float32)

    evidence = None
    if last.evidence is not None:
        evidence = np.full((3, *shape), 127, np.int8)
        first = [max(new.start, old.start) for new, old in zip(window, last.window, strict=True)]
        end = [min(new.stop, old.stop) for new, old in zip(window, last.window, strict=True)]
        if end[0] > first[0] and end[1] > first[1]:
            to, of = (
                tuple(slice(a - w.start, b - w.start) for a, b, w in zip(first, end, place_of, strict=True))
                for place_of in (window, last.window)
            )
            evidence[:, *to] = last.evidence[:, *of]
    return FrameMemory(
        window=window, evidence=evidence, colours=moved(last.colours), albedo=moved(last.albedo),
        surface=None if last.surface is None else last.surface.moved(moved, 1.0 / down),
        recovered=None if last.recovered is None else moved(last.recovered), age=last.age,
    )  # fmt: skip


def _goes_on(last: FrameMemory, image: WorkingImage) -> bool:
    """Tell whether a frame shows what the one before it showed, about in the same place."""
    inside = image.mask[::2, ::2, None]
    now, before = image.light.contributions[::2, ::2], last.colours[::2, ::2]
    change, light = np.abs(now - before) * inside, np.abs(now) * inside
    return float(change.sum()) <= _CHANGED * float(light.sum())


def _sameness(
    cosines: FloatArray, last: FrameMemory, small: LightContributions, albedo: FloatArray
) -> FloatArray:
    """(h, w), 1 where no light changed since the frame before, 0 where one did."""
    before = replace(small, contributions=last.colours).cosines(albedo)
    change = largest_of_three(np.abs(cosines - before)) / TOLERANCE_DARK
    return np.exp(-change * change)


def _surface_by_rounds(image: WorkingImage, rounds: int = _ROUNDS) -> tuple[Surface, FloatArray]:
    """Alternate between surface and labels, coarse to fine; return the surface and the albedo (h, w)."""
    shape = image.mask.shape
    if image.mask.size <= _START_PIXELS:
        surface, options = None, _FIRST_SURFACE
        lit = _first_doubts(image)
    else:
        coarse, albedo = _surface_by_rounds(image.halved())
        surface, rounds, options = coarse.enlarged(shape, 2), _FINER_ROUNDS, _FINER_SURFACE
        lit = _lit_on(surface, image, _enlarged(albedo, shape))
    for i in range(rounds):
        surface, albedo = _solved(image, lit, options, surface)
        if i + 1 < rounds:
            lit = _lit_on(surface, image, albedo)
    assert surface is not None
    return surface, albedo


def _solved(
    image: WorkingImage, lit: npt.NDArray[np.bool_], options: SurfaceOptions, start: Surface | None
) -> tuple[Surface, FloatArray]:
    """Return the surface (h, w) under these labels, and the albedo."""
    albedo = albedo_from_lit(image.light.length, all_of_three(lit) & image.mask)
    labelled = LabelledImage(image=image, labels=labels_from_lit(lit), albedo=albedo)
    return labelled.solve(options, start), albedo


def _predicted(surface: Surface, measured: LightContributions) -> FloatArray:
    """(h, w, 3): what the surface would return of each light."""
    normals: FloatArray = surface.normals.astype(np.float32)
    return normals @ measured.directions.T.astype(np.float32)


def _lit_on(surface: Surface, image: WorkingImage, albedo: FloatArray) -> npt.NDArray[np.bool_]:
    """Label by what the surface would return."""
    predicted = _predicted(surface, image.light)
    cosines = _without_paint(image.light.cosines(albedo), predicted)
    evidence = _evidence(cosines, predicted, albedo, image.mask)
    return np.stack([_cut_light(evidence[k], cosines, k, image.mask) for k in range(3)], axis=-1)


def _cut_light(evidence: FloatArray, cosines: FloatArray, k: int, mask: Mask) -> npt.NDArray[np.bool_]:
    def bonds(number: Nodes) -> tuple[FloatArray, FloatArray]:
        return bonds_of_light(cosines, k, number, _SMOOTHNESS, _CONTRAST)

    return lit_by_cut(evidence, bonds, mask, _SMOOTHNESS)


def _enlarged(image: Any, shape: tuple[int, ...]) -> FloatArray:
    if image.shape[:2] == shape:
        return image
    return np.asarray(cv2.resize(image, shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _first_doubts(image: WorkingImage) -> npt.NDArray[np.bool_]:
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
