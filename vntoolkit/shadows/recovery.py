"""Normals for every pixel of a frame with self-shadows (brostow2011, Section VI-B, and past it)."""

from typing import Any

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels, Weight
from vntoolkit.checks import checks_kinds, require_mask, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.slope_grid import FLATTEST_Z, STEEPEST, RayGrid, ray_at, ray_grid
from vntoolkit.native import njit
from vntoolkit.options.normals import RecoveryMethod
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.levelling import FLAGS, span_of
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import albedo_from_lit, departure, fill_smoothly
from vntoolkit.shadows.contributions import (
    CLIPPED_TRUST,
    LightContributions,
    Numbers,
    columns_between,
    contributions_from_frame,
    finite,
    flat,
    frame_in_window,
    in_whole_image,
    lengths_of,
    numbers_of,
    row_between,
    scaled_normal,
    shrinking,
    turned,
    window_around,
    working_image,
)
from vntoolkit.shadows.evidence import Lamps, lamps_of
from vntoolkit.shadows.initialisation import TRUST_BY_LIGHTS, noise_of_frame, solve_from_start
from vntoolkit.shadows.roots import roots_of_labels, spread_of_albedo
from vntoolkit.shadows.surface import (
    ALBEDO_SPREAD,
    LabelledImage,
    Model,
    Surface,
    local_quadratic,
    mixed,
    model_of,
)

_SMALLEST_ALBEDO = 1e-3
_HELD = 600.0  # of the slope from the smaller image: about what four neighbours know together

# The weight of a normal.
_WEIGHT_BY_LIGHTS = (0.05, 0.2, 0.5, 1.0)  # of a pixel that 0, 1, 2, 3 lights reach
_CLIPPED_WEIGHT = 0.1  # factor on saturated pixels
_ALBEDO_TOLERANCE = 0.4  # departure of a lit pixel's log albedo from its surroundings that halves the weight

# Cosines of the most grazing light to the normal from colour alone.
_GRAZING = 0.6  # below it the normal solved with the depth stays
_STEEP = 0.8  # from it on only the colour counts


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
    if method is RecoveryMethod.SURFACE:
        normals, weight = _with_surface(part, label, response, here, near, start)
    else:
        normals, weight = _by_pixel(part, label, response, here, method)
    return NormalMap(
        normals_in_camera=in_whole_image(normals, window, frame.shape),
        mask=inside,
        weight=in_whole_image(weight, window, frame.shape),
    )


def _with_surface(
    frame: LinearFrame,
    labels: VisibilityLabels,
    response: LightResponse,
    inside: Mask,
    camera: Camera | None,
    start: Surface | None,
) -> tuple[FloatArray, Weight]:
    """Return normals (h, w, 3) and weights, solved together with the depth."""
    if start is not None and start.image is not None:
        image, factor = start.image, shrinking(inside)
    else:
        image, factor = working_image(frame, response, inside, camera)
    small_labels = _shrunk(labels, image.mask.shape)
    albedo = albedo_from_lit(image.light.length, image.mask & (small_labels == ALL_LIT), factor)
    lamps, rgb = lamps_of(response), np.ascontiguousarray(frame.rgb)
    labelled = LabelledImage(image=image, labels=small_labels, albedo=albedo)
    noise = noise_of_frame(rgb, response, inside & (labels == ALL_LIT))
    surface, options = solve_from_start(labelled, noise)
    solved = np.stack([*np.moveaxis(surface.normals, -1, 0), albedo, surface.agreement]).astype(np.float32)
    normals, weight = np.zeros_like(rgb), np.zeros(frame.shape, np.float32)
    _detail_kernel(
        flat(rgb), frame.clipped, np.asarray(labels), inside, lamps, numbers_of(response.light_directions),
        numbers_of(response.lights), ray_grid(camera), model_of(options, settled=True),
        np.float32(_HELD if factor > 1 else 0.0), solved, flat(normals), weight,
    )  # fmt: skip
    return normals, weight


def _shrunk(labels: VisibilityLabels, shape: tuple[int, ...]) -> VisibilityLabels:
    if labels.shape == shape:
        return labels
    return cv2.resize(labels, shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.uint8)


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _detail_kernel(
    rgb: FloatArray, clipped: Mask, labels: VisibilityLabels, mask: Mask, lamps: Lamps,
    directions: Numbers, lights: Numbers, rays: RayGrid, model: Model, held: Any, solved: FloatArray,
    normals: FloatArray, weights: Weight,
) -> None:  # fmt: skip
    """Bring a surface that was solved on a smaller image to the detail of this one; fill normals and weights.

    What pixels owe to each other the smaller image has settled: here every pixel takes what its own light
    says beyond it. Where all lights arrive and depth and colour disagree, or no light grazes, the normal from
    colour alone counts. solved: (5, h', w'), normal, albedo and agreement. normals, weights: 0 on entry.
    """
    h, w = mask.shape
    split, ambient = lamps.split, lamps.ambient
    inverse, haze, rest = lamps.inverse, lamps.haze, lamps.rest
    left, part = columns_between(w, solved.shape[2])
    for v in prange(h):
        first, last = span_of(mask[v])
        if first == last:
            continue
        rows = np.empty((9, last - first), np.float32)
        row_between(solved, np.int64(v), h, left[first:last], part[first:last], rows[:5])
        line, label, bound = rgb[v, 3 * first : 3 * last], labels[v, first:last], clipped[v, first:last]
        _colour_row(line, inverse, haze, rest, rows[5], rows[6], rows[7], rows[8])
        if held > np.float32(0.0):
            x, y = ray_at(rays, v, first)
            _refine_row(
                line, label, bound, split, ambient, lights, x, y, rays.per_pixel_u, model, held, rows[0],
                rows[1], rows[2], rows[3], rows[8],
            )  # fmt: skip
        _blend_row(
            label, bound, mask[v, first:last], directions, held, rows[0], rows[1], rows[2], rows[3], rows[4],
            rows[5], rows[6], rows[7], rows[8], normals[v, 3 * first : 3 * last], weights[v, first:last],
        )  # fmt: skip


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _colour_row(
    line: FloatArray, inverse: Numbers, haze: Numbers, rest: Any, x: FloatArray, y: FloatArray,
    z: FloatArray, length: FloatArray,
) -> None:  # fmt: skip
    """Fill the normal that the colours alone give, and the albedo."""
    for u in range(len(x)):
        r, g, b = finite(line[3 * u]), finite(line[3 * u + 1]), finite(line[3 * u + 2])
        x[u], y[u], z[u], length[u] = scaled_normal(r, g, b, inverse, haze, rest)


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _refine_row(
    line: FloatArray, labels: VisibilityLabels, clipped: Mask, split: Numbers, ambient: Numbers,
    lights: Numbers, x: Any, y: Any, step: Any, model: Model, held: Any, normal_x: FloatArray,
    normal_y: FloatArray, normal_z: FloatArray, albedo: FloatArray, length: FloatArray,
) -> None:  # fmt: skip
    """Turn normals to what light asks, held by `held`. x, y: the first pixel's ray; step: of x by a pixel."""
    one, least = np.float32(1.0), np.float32(_SMALLEST_ALBEDO)
    for u in range(len(labels)):
        label = labels[u]
        is_lit = label == ALL_LIT
        r, g, b = turned(split, finite(line[3 * u]), finite(line[3 * u + 1]), finite(line[3 * u + 2]))
        scale = one / max(length[u] if is_lit else albedo[u], least)
        trust = np.float32(CLIPPED_TRUST) if clipped[u] else one
        trust *= by_lights(label, TRUST_BY_LIGHTS)
        ray = x + step * np.float32(u)
        n0, n1, n2 = normal_x[u], normal_y[u], normal_z[u]
        size = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        along = one / min(n2 + ray * n0 + y * n1, np.float32(-FLATTEST_Z) * size - np.float32(1e-6))
        p, q = -n0 * along, -n1 * along
        a00, a01, a11, b0, b1, _ = local_quadratic(
            ray, y, p, q, p, q, r * scale - ambient[0], g * scale - ambient[1], b * scale - ambient[2], label,
            max(trust, least), lights, model,
        )  # fmt: skip
        a00, a11 = a00 + held, a11 + held
        over = one / (a00 * a11 - a01 * a01)
        p, q = p + (a11 * b0 - a01 * b1) * over, q + (a00 * b1 - a01 * b0) * over
        hold = np.float32(STEEPEST) / max(np.sqrt(p * p + q * q), np.float32(STEEPEST))
        p, q = p * hold, q * hold
        n2 = -one - ray * p - y * q
        over = one / np.sqrt(p * p + q * q + n2 * n2)
        normal_x[u], normal_y[u], normal_z[u] = p * over, q * over, n2 * over


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _blend_row(
    labels: VisibilityLabels, clipped: Mask, inside: Mask, directions: Numbers, held: Any, sx: FloatArray,
    sy: FloatArray, sz: FloatArray, albedo: FloatArray, agreement: FloatArray, x: FloatArray,
    y: FloatArray, z: FloatArray, length: FloatArray, normals: FloatArray, weights: Weight,
) -> None:  # fmt: skip
    """Blend the solved normals sx, sy, sz with those of the colours; fill unit normals and weights."""
    zero, one = np.float32(0.0), np.float32(1.0)
    for u in range(len(labels)):
        label = labels[u]
        is_lit = label == ALL_LIT
        n0, n1, n2 = x[u], y[u], z[u]
        colour = weight_of_colour(n0, n1, n2, directions) if is_lit else zero
        agreed = agreement[u] if is_lit & (held > zero) else one
        a, b, c = mixed(sx[u], sy[u], sz[u], agreed, n0, n1, n2)
        a, b, c = mixed(n0, n1, n2, colour, a, b, c)
        c = min(c, np.float32(-1e-3))  # one that would face away turns edge-on
        scale = one / np.sqrt(a * a + b * b + c * c)
        scale = scale if inside[u] else zero
        normals[3 * u], normals[3 * u + 1], normals[3 * u + 2] = a * scale, b * scale, c * scale
        found = _confidence(label, clipped[u], length[u], albedo[u], agreement[u])
        weights[u] = found if inside[u] else zero


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
    weight = confidence_weight(labels, frame.clipped, measured.length, albedo)
    return _towards_viewer(normals, inside), np.where(inside, weight, 0.0).astype(np.float32)


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


# How far each pixel's normal may be trusted: saturation, shadow, an albedo that does not fit.


def confidence_weight(
    labels: VisibilityLabels, clipped: Mask, length: FloatArray, albedo: FloatArray
) -> Weight:
    """Return (h, w) weights from 0 to 1, where no depth is known.

    length: (h, w), the albedo if all lights arrive; albedo: (h, w), the surroundings'.
    """
    out = np.empty(labels.shape, np.float32)
    _confidence_kernel(labels, clipped, length, albedo, out)
    return out


@njit(cache=True)
def _confidence_kernel(
    labels: VisibilityLabels, clipped: Mask, length: FloatArray, albedo: FloatArray, out: Weight
) -> None:
    unknown = np.float32(0.0)
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            out[v, u] = _confidence(labels[v, u], clipped[v, u], length[v, u], albedo[v, u], unknown)


@njit(cache=True, forceinline=True, error_model="numpy")
def by_lights(label: int, values: Numbers) -> Any:
    """Return the first value where no light arrives … the fourth where all three do."""
    one, two, three = (label & 1) != 0, (label & 2) != 0, (label & 4) != 0
    some, pair, every = one | two | three, (one & two) | (one & three) | (two & three), one & two & three
    found = np.float32(values[1]) if some else np.float32(values[0])
    found = np.float32(values[2]) if pair else found
    return np.float32(values[3]) if every else found


@njit(cache=True, forceinline=True, error_model="numpy")
def _confidence(label: int, clipped: bool, length: Any, albedo: Any, agreement: Any) -> Any:
    one = np.float32(1.0)
    departed = departure(length, albedo) * np.float32(1.0 / _ALBEDO_TOLERANCE)
    agreed = max(agreement, np.float32(0.1)) if agreement > np.float32(0.0) else one
    fits = agreed / (one + departed * departed)
    weight = by_lights(label, _WEIGHT_BY_LIGHTS) * (fits if label == ALL_LIT else one)
    return weight * np.float32(_CLIPPED_WEIGHT) if clipped else weight


# Colour before depth where all three lights meet the surface steeply.


@njit(cache=True, forceinline=True, error_model="numpy")
def weight_of_colour(x: Any, y: Any, z: Any, directions: Numbers) -> Any:
    """Return 1 where colour alone counts, 0 where the solved normal stays. directions: a unit row a light."""
    first, second, third = turned(directions, x, y, z)
    cosine = min(first, second)
    cosine = min(cosine, third)  # of two at a time: numba makes SIMD of that
    weight = (cosine - np.float32(_GRAZING)) * np.float32(1.0 / (_STEEP - _GRAZING))
    return min(max(weight, np.float32(0.0)), np.float32(1.0))
