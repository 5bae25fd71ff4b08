"""How far off is each normal? The angle that nine of ten normals stay within, from the footage itself.

Independent errors add up in squares. `frame_evidence` measures three of them on the frame itself: noise,
relief that blur took, an error of M. Beside them

- the rotation in M⁻¹ΔM leaves no trace; its size is taken to be E's, the symmetric part's;
- the rig's own residual is what its calibration could not explain. That of a ball's pixels holds the noise of
  the calibration, too, which would count twice: as much as this footage has is taken away;
- what departs from the ellipsoid by more than three standard deviations of the frame's own lengths is another
  paint, gloss, or a light that is missing;
- where a light is missing the normal rests on its surroundings. Two lights leave two normals, mirror images
  across the plane of the two. The distance from the found normal to the nearer of them counts. So does the
  distance to the other one, which may be the right one, unless found and nearer one both face away from the
  missing light: that explains the shadow. Both hang on the albedo, which the surroundings tell: with it they
  move in the plane of the two lights, and across it the more, the nearer to it they lie. One light leaves a
  cone of normals, which tells next to nothing.
"""

import math
from dataclasses import replace

import numpy as np

from vntoolkit.arrays import ByteArray, Float32Array, FloatArray, Mask, VisibilityLabels
from vntoolkit.checks import require_shape
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import HALF_WEIGHT_DEG, NormalMap
from vntoolkit.normals.frame_evidence import LEAST_FACING, LONGEST, SHORTEST, evidence_of_frame
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.response import LightResponse, scaled_normals_from_rgb

# Nine of ten angles of a two-dimensional normal distribution lie within √(2 ln 10) standard deviations.
NINE_OF_TEN = 2.146
OF_ANGLE = NINE_OF_TEN / math.sqrt(2.0)  # … and within 1.5 times the root of their mean square
# … and, where five numbers tell that mean square, as the entries of E, within √F₀.₉(2, 5) times the root.
_OF_ELLIPSOID = 1.944
# The bounds of nine of ten pixels over each measured error, fitted on simulated scenes.
_OF_RESIDUAL = 1.1  # of a median
_OF_LENGTH = 2.75  # radians over a log length that departs from the ellipsoid
_OF_TWO_LIGHTS = 1.2  # radians over the distances to the normals that two lights leave
_ALBEDO_SPREAD = np.float32(0.03)  # relative standard deviation of lit pixels' albedo about the surroundings'
# A sphere shows nine tenths of its image within this angle of the axis: what a guess without data is worth.
_LARGEST_DEG = np.float32(71.6)


def with_expected_error(
    normal_map: NormalMap,
    frame: LinearFrame,
    response: LightResponse,
    labels: VisibilityLabels | None = None,
    camera: Camera | None = None,
    residual_deg: float = 0.0,
    blur_px: float = 0.0,
    residual_of_pixels: bool = False,
) -> NormalMap:
    """Return the map with the angle in degrees that nine of ten normals stay within, and the weight from it.

    The weight is 1 without error and 1/2 at 12 degrees.

    frame: the (h, w, 3) colours that the normals came from, as the central M of `response` forms them.
    labels: (h, w), bit k set where light k arrives; None for all, and for normals of the colours alone.
    camera: None for orthographic; distortion is ignored. residual_deg: median residual of the rig's
    calibration. blur_px: standard deviation of the picture's blur, 0 for unknown. residual_of_pixels: whether
    the residual is that of single pixels, noise included, for which this frame's own stands.
    Raises `BadInput` for other shapes.
    """
    shape = normal_map.shape
    require_shape(frame.rgb, (*shape, 3), "frame of the normals")
    if labels is not None:
        require_shape(labels, shape, "visibility labels")
    mask, central = normal_map.mask, response.central
    noise, seen, turns, ellipsoid = evidence_of_frame(frame, mask, labels, central, camera, blur_px)
    residual = np.radians(_OF_RESIDUAL * max(residual_deg, 0.0)) ** 2
    if residual_of_pixels and seen.any():
        residual = max(residual - NINE_OF_TEN**2 * float(np.median(noise[seen > 0])), 0.0)
    scaled = scaled_normals_from_rgb(frame.rgb, central)
    turned, departed, known = _against_ellipsoid(scaled, turns, ellipsoid)
    unlit = 0.0 if labels is None else _unlit(scaled, normal_map, labels, central, ellipsoid[0])
    square = np.float32(residual) + np.float32(_OF_ELLIPSOID**2) * turned + np.float32(NINE_OF_TEN**2) * turns
    square += np.float32(_OF_LENGTH**2) * departed * (unlit == 0.0) + unlit
    error = np.where(known, np.minimum(np.degrees(np.sqrt(square)), _LARGEST_DEG), _LARGEST_DEG) * mask
    noise_deg = np.degrees(NINE_OF_TEN * np.sqrt(noise))
    weight = mask / (1.0 + np.square(error / np.float32(HALF_WEIGHT_DEG)))
    return replace(normal_map, error_deg=error, noise_deg=noise_deg, weight=np.asarray(weight, np.float32))


def _against_ellipsoid(
    scaled: Float32Array, turns: Float32Array, ellipsoid: FloatArray
) -> tuple[Float32Array, Float32Array, Mask]:
    """Return of M⁻¹(r − a) (h, w, 3) the turns by M's error, squared, departures of its length, squared, and
    where it has one. ellipsoid: of `fit_ellipsoid`.
    """
    h, w = turns.shape
    e00, e01, e02, e11, e12, e22 = ellipsoid[1:7]
    matrix = np.array([[e00, e01, e02], [e01, e11, e12], [e02, e12, e22]], np.float32)
    f = ellipsoid[7:13].astype(np.float32)
    u = np.arange(w, dtype=np.float32) - np.float32(0.5 * (w - 1))
    v = np.arange(h, dtype=np.float32)[:, None] - np.float32(0.5 * (h - 1))
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.sqrt(np.einsum("vui,vui->vu", scaled, scaled))
        known = (size > SHORTEST) & (size < LONGEST)
        size = np.where(known, size, np.float32(1))
        own = np.where(known[..., None], scaled, np.float32(0)) / size[..., None]
    moved = own @ matrix
    along = np.einsum("vui,vui->vu", moved, own)
    turned = np.maximum(np.einsum("vui,vui->vu", moved, moved) - along**2, 0)
    brightness = 1 + f[0] + f[1] * u + f[2] * v + f[3] * u**2 + f[4] * v**2 + f[5] * u * v
    foretold = np.maximum(along + brightness, LEAST_FACING)
    measured = np.maximum(size * np.float32(ellipsoid[0]), SHORTEST)
    ratio = measured / foretold
    departure = np.minimum(np.square(0.5 * (ratio - 1 / ratio)), 1)  # squared sinh of the log length
    # as robust fits weigh: next to nothing within three standard deviations, all of it far beyond
    departed = departure**2 / (departure + 9 * (np.float32(ellipsoid[13]) + turns) + SHORTEST)
    share = np.float32(ellipsoid[15] ** 2) + np.float32(ellipsoid[14]) * turned
    return share, departed, known


def with_doubt(normal_map: NormalMap, doubt_deg: Float32Array) -> NormalMap:
    """Return the map with a further, independent error (h, w) in degrees, and the weight from both."""
    assert normal_map.error_deg is not None
    error = np.minimum(np.hypot(normal_map.error_deg, doubt_deg), _LARGEST_DEG) * normal_map.mask
    weight = normal_map.mask / (1.0 + (error / HALF_WEIGHT_DEG) ** 2)
    return replace(normal_map, error_deg=error, weight=np.asarray(weight, np.float32))


def doubts_of_materials(
    numbers: ByteArray, bounds_deg: Float32Array, turned_deg: Float32Array | None
) -> Float32Array:
    """Return (h, w), degrees: the bound (m,) of each pixel's material, and a further, independent doubt.

    numbers: (h, w), of the materials. turned_deg: (h, w), None for 0.
    """
    bounds = bounds_deg[numbers]
    return bounds if turned_deg is None else np.hypot(bounds, turned_deg)


def _pairs_of_lights(response: LightResponse) -> Float32Array:
    """Return (8, 6): for labels of two lights the normal of the plane of both and the third's direction."""
    pairs = np.zeros((8, 6))
    for missing in range(3):
        one, other = np.delete(response.light_directions, missing, axis=0)
        across = np.cross(one, other)
        pairs[ALL_LIT - (1 << missing), :3] = across / max(float(np.linalg.norm(across)), 1e-12)
        pairs[ALL_LIT - (1 << missing), 3:] = response.light_directions[missing]
    return pairs.astype(np.float32)


def _unlit(
    scaled: Float32Array,
    found: NormalMap,
    labels: VisibilityLabels,
    response: LightResponse,
    over_albedo: float,
) -> Float32Array:
    """(h, w) squared bounds, radians², of pixels that not all lights reach, 0 of the others.

    scaled: (h, w, 3) M⁻¹(r − a).
    """
    pairs = _pairs_of_lights(response)
    largest = np.radians(_LARGEST_DEG) ** 2
    bound = np.where(labels == ALL_LIT, np.float32(0), largest)
    two: Mask = found.mask & np.asarray(pairs.any(axis=1))[labels]
    across, missing = np.hsplit(pairs[labels[two]], 2)
    normals = found.normals_in_camera[two]
    # M⁻¹(r − a) says in the plane of the two lights what the normal is, and nothing across it
    seen = np.float32(over_albedo) * scaled[two]
    seen -= _dot(seen, across)[:, None] * across
    off, plane = _dot(normals, across), _dot(seen, seen)
    moved = plane + plane**2 / (np.abs(1 - plane) + 2 * _ALBEDO_SPREAD * plane + SHORTEST)
    height = np.where(off > 0, 1, -1) * np.sqrt(np.maximum(1 - plane, 0))
    seen += height[:, None] * across
    seen /= np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), SHORTEST)
    squared = np.square(seen - normals).sum(axis=1)
    behind = (_dot(seen, missing) < 0) & (_dot(normals, missing) < 0)
    other_faces = normals[:, 2] - 2 * off * across[:, 2] < 0  # the camera
    squared += np.where(~behind & other_faces, 4 * off**2, 0)
    known = squared < 8  # no NaN
    square = _OF_TWO_LIGHTS**2 * squared + (NINE_OF_TEN * _ALBEDO_SPREAD) ** 2 * moved
    bound[two] = np.where(known, np.maximum(square, SHORTEST), largest)
    return bound


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.sum(a * b, axis=-1))
