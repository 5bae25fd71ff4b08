"""How far off is each normal? The angle that nine of ten normals stay within, from the footage itself.

Five independent errors add up in squares. Each is measured where it shows:

- noise of every kind (shot, read, quantisation, codec) turns normals at random. A surface's slopes (p, q)
  have no curl; noise of standard deviation σ on both gives ∂p/∂v − ∂q/∂u, by central differences, that σ;
- an error ΔM of the rig or of the material's colour moves M⁻¹r from the unit sphere onto an ellipsoid,
  |M⁻¹r| ≈ 1 + nᵀE n with E the symmetric part of M⁻¹ΔM. The ellipsoid that fits the frame tells E, and E the
  turn of every normal, but for the rotation in M⁻¹ΔM, which leaves no trace;
- the rig's own residual is what its calibration could not explain;
- what departs from the ellipsoid at one pixel is another paint, gloss, saturation, or light from elsewhere;
- where a light is missing the normal rests on its surroundings. A channel that is nearly dark may be such a
  place that no label tells of.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import Mask, VisibilityLabels
from vntoolkit.checks import require_shape
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.response import LightResponse

# Nine of ten angles of a two-dimensional normal distribution lie within √(2 ln 10) standard deviations.
_NINE_OF_TEN = 2.146
# The bounds of nine of ten pixels over each measured error, fitted on the package's own simulated scenes.
_OF_ELLIPSOID = 3.6  # also stands for the rotation, which leaves no trace
_OF_RESIDUAL = 1.1  # of a median
_OF_LENGTH = 2.8  # radians over log length
_BY_LIGHTS_DEG = (46.0, 34.0, 31.0, 0.0)  # of a pixel that 0, 1, 2, 3 lights reach
_DARK_CHANNEL_DEG = 20.0  # of a pixel with a channel without light, which falls …
_DARK_CHANNEL = 0.45  # … to 0 at this share of the channel's largest value
# A sphere shows nine tenths of its image within this angle of the axis: what a guess without data is worth.
_LARGEST_DEG = np.float32(71.6)
_HALF_WEIGHT_DEG = 12.0
_NOISE_WINDOW_PX = 9
_LEAST_FACING = np.float32(0.1)
_SAMPLES = 2000
_ROUNDS = 6
_ELLIPSOID_SPREAD = 0.05  # prior standard deviation of E's entries …
_FALLOFF_SPREAD = 0.1  # … and of the slow change of brightness over the image that near lamps make
_INDEPENDENT = 100  # of the samples: neighbours share their errors
_SHORTEST, _LONGEST = np.float32(1e-6), np.float32(1e18)  # lengths whose squares float32 holds

# The same, as the loops need it: squared, in degrees.
_FLAGS = {"contract", "arcp", "nsz"}  # reordering that keeps NaN and infinity meaningful
_PER_NOISE = np.float32(np.degrees(_NINE_OF_TEN) ** 2)
_PER_TURN = np.float32(np.degrees(_OF_ELLIPSOID) ** 2)
_PER_DEPARTURE = np.float32(np.degrees(_OF_LENGTH) ** 2)
_PER_FALL = np.float32(_DARK_CHANNEL_DEG**2)
_PER_DARK_CHANNEL = np.float32(1.0 / _DARK_CHANNEL)
_PER_HALF_WEIGHT = np.float32(1.0 / _HALF_WEIGHT_DEG)
_BY_LABEL = np.array([_BY_LIGHTS_DEG[bin(label).count("1")] ** 2 for label in range(8)], np.float32)


def with_expected_error(
    normal_map: NormalMap,
    frame: LinearFrame,
    response: LightResponse,
    labels: VisibilityLabels | None = None,
    camera: Camera | None = None,
    residual_deg: float = 0.0,
) -> NormalMap:
    """Return the map with the angle in degrees that nine of ten normals stay within, and the weight from it.

    The weight is 1 without error and 1/2 at 12 degrees.

    frame: the (h, w, 3) colours that the normals came from, as the central M of `response` forms them.
    labels: (h, w), bit k set where light k arrives; None for all. camera: None for orthographic; distortion
    is ignored. residual_deg: median residual of the rig's calibration. Raises `BadInput` for other shapes.
    """
    shape = normal_map.shape
    require_shape(frame.rgb, (*shape, 3), "frame of the normals")
    lit = np.full(shape, ALL_LIT, np.uint8) if labels is None else np.ascontiguousarray(labels)
    require_shape(lit, shape, "visibility labels")
    rgb = np.ascontiguousarray(frame.rgb)
    mask = np.ascontiguousarray(normal_map.mask)
    c = _coefficients(response, camera)
    curl, inside = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    slopes = np.empty((3, *shape), np.float32)
    _slopes_kernel(rgb, mask, c, slopes)
    _curl_kernel(slopes, curl, inside)
    window = (_NOISE_WINDOW_PX, _NOISE_WINDOW_PX)
    noise = cv2.blur(curl, window) / np.maximum(cv2.blur(inside, window), np.float32(1e-3))
    ellipsoid = _fit_ellipsoid(frame, mask & (lit == ALL_LIT) & ~frame.clipped, c)
    error, shared, weight = (np.empty(shape, np.float32) for _ in range(3))
    normals = np.ascontiguousarray(normal_map.normals_in_camera)
    fixed = np.float32((_OF_RESIDUAL * max(residual_deg, 0.0)) ** 2)
    _error_kernel(rgb, normals, mask, lit, noise, c, ellipsoid, fixed, (error, shared, weight))
    return replace(normal_map, error_deg=error, shared_error_deg=shared, weight=weight)


class _Coefficients(NamedTuple):
    """What the loops need to know, float32.

    inverse: M⁻¹, (3, 3). ambient: (3,). channel: 1 / |row of M|, (3,). rays: (6,), an affine map from a pixel
    to its ray. along: variance of equal noise in all channels along a normal that faces the camera, over that
    across it.
    """

    inverse: Any
    ambient: Any
    channel: Any
    rays: Any
    along: np.float32


class _Ellipsoid(NamedTuple):
    """|M⁻¹(r − a)| = albedo (1 + nᵀE n); E (3, 3), symmetric, without trace."""

    albedo: np.float32
    shape: Any


def _coefficients(response: LightResponse, camera: Camera | None) -> _Coefficients:
    rays = np.zeros(6)
    if camera is not None and camera.is_perspective:
        inverse = np.linalg.inv(camera.matrix[:2, :2])
        rays = np.column_stack([inverse, -inverse @ camera.matrix[:2, 2]]).ravel()
    spread = response.inverse @ response.inverse.T
    along = 2.0 * spread[2, 2] / max(float(np.trace(spread) - spread[2, 2]), 1e-12)
    return _Coefficients(
        inverse=response.inverse.astype(np.float32),
        ambient=response.ambient.astype(np.float32),
        channel=(1.0 / np.maximum(np.linalg.norm(response.matrix, axis=1), 1e-9)).astype(np.float32),
        rays=rays.astype(np.float32),
        along=np.float32(along),
    )


def _fit_ellipsoid(frame: LinearFrame, lit: Mask, c: _Coefficients) -> _Ellipsoid:
    """Regress the log length of M⁻¹(r − a) on the normal's squares, robustly; near lamps fall off besides."""
    width = frame.shape[1]
    near = np.array([step_v * width + step_u for step_v in (-2, 0, 2) for step_u in (-2, 0, 2)])
    inner = lit.copy()
    inner[:2] = inner[-2:] = inner[:, :2] = inner[:, -2:] = False
    places = np.flatnonzero(inner)
    places = places[:: max(1, len(places) // _SAMPLES)]
    places = places[lit.ravel()[places[:, None] + near].all(axis=1)]
    light = frame.rgb.reshape(-1, 3)[places[:, None] + near].mean(axis=1, dtype=np.float64)  # less noise
    scaled = (light - c.ambient) @ c.inverse.T.astype(np.float64)
    length = np.linalg.norm(scaled, axis=1)
    usable = np.isfinite(length) & (length > _SHORTEST)
    if usable.sum() < 2 * _INDEPENDENT:
        typical = float(np.median(length[usable])) if usable.any() else 1.0
        return _Ellipsoid(np.float32(typical), np.zeros((3, 3), np.float32))
    places, length = places[usable], length[usable]
    x, y, z = (scaled[usable] / length[:, None]).T
    v, u = np.divmod(places, width)
    half = max(frame.shape) / 2
    s, t = (u - u.mean()) / half, (v - v.mean()) / half
    falloff = np.stack([s, t, s * s, t * t, s * t], axis=1)
    design = np.column_stack(
        [
            np.ones(len(x)), x * x - z * z, y * y - z * z, 2 * x * y, 2 * x * z, 2 * y * z,
            falloff - falloff.mean(axis=0),
        ]
    )  # fmt: skip
    prior = np.repeat([0.0, _ELLIPSOID_SPREAD**-2, _FALLOFF_SPREAD**-2], [1, 5, 5])
    logs = np.log(length)
    weight, spread = np.ones(len(logs)), max(float(logs.std()), 1e-3)
    for _ in range(_ROUNDS):
        worth = weight * (_INDEPENDENT / len(logs) / spread**2)
        normal_matrix = (design.T * worth) @ design + np.diag(prior)
        found = np.linalg.solve(normal_matrix, design.T @ (worth * logs))
        left = np.abs(logs - design @ found)
        spread = 1.48 * float(np.median(left)) + 1e-3
        weight = 1.0 / (1.0 + np.square(left / (2 * spread)))
    e = found[1:6]
    shape = np.array([[e[0], e[2], e[3]], [e[2], e[1], e[4]], [e[3], e[4], -e[0] - e[1]]])
    return _Ellipsoid(np.float32(np.exp(found[0])), shape.astype(np.float32))


@njit(cache=True, parallel=True, fastmath=_FLAGS, error_model="numpy")
def _slopes_kernel(rgb: Any, mask: Mask, c: _Coefficients, slopes: Any) -> None:
    """Fill (3, h, w): the slopes p, q of the colours' own normals, and cos^1.5 of their inclination.

    A turn by ε moves the slope by ε / cos² along the inclination and ε / cos across. 0 without a normal.
    """
    height, width = mask.shape
    inverse, ambient, rays, one = c.inverse, c.ambient, c.rays, np.float32(1.0)
    for v in prange(height):
        p, q, known, inside = slopes[0, v], slopes[1, v], slopes[2, v], mask[v]
        for u in range(width):
            p[u], q[u], known[u] = rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2]
        for u in range(width):
            r, g, b = p[u] - ambient[0], q[u] - ambient[1], known[u] - ambient[2]
            x = inverse[0, 0] * r + inverse[0, 1] * g + inverse[0, 2] * b
            y = inverse[1, 0] * r + inverse[1, 1] * g + inverse[1, 2] * b
            z = inverse[2, 0] * r + inverse[2, 1] * g + inverse[2, 2] * b
            length = np.sqrt(x * x + y * y + z * z)
            good = inside[u] & (length > _SHORTEST) & (length < _LONGEST)
            scale = one / length if good else one
            ray_x = rays[0] * np.float32(u) + rays[1] * np.float32(v) + rays[2]
            ray_y = rays[3] * np.float32(u) + rays[4] * np.float32(v) + rays[5]
            facing = max(-(x * ray_x + y * ray_y + z) * scale, _LEAST_FACING)
            p[u] = x * scale / facing
            q[u] = y * scale / facing
            known[u] = facing * np.sqrt(facing) if good else np.float32(0.0)


@njit(cache=True, parallel=True, fastmath=_FLAGS, error_model="numpy")
def _curl_kernel(slopes: Any, curl: Any, inside: Any) -> None:
    """Fill (h, w) with the squared curl, as an angle in radians, and 1 where all four neighbours have one."""
    _, height, width = slopes.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    for v in prange(1, height - 1):
        above, here, below = slopes[:, v - 1], slopes[:, v], slopes[:, v + 1]
        for u in range(1, width - 1):
            least = min(here[2, u - 1], here[2, u + 1], above[2, u], below[2, u], here[2, u])
            turned = (below[0, u] - above[0, u]) - (here[1, u + 1] - here[1, u - 1])
            angle = np.float32(0.5) * turned * here[2, u]
            curl[v, u] = min(angle * angle, one) if least > zero else zero
            inside[v, u] = one if least > zero else zero


@njit(cache=True, parallel=True, fastmath=_FLAGS, error_model="numpy")
def _error_kernel(
    rgb: Any, normals: Any, mask: Mask, labels: Any, noise: Any, c: _Coefficients, ellipsoid: _Ellipsoid,
    fixed: Any, out: tuple[Any, Any, Any],
) -> None:  # fmt: skip
    """Fill (h, w): the bound in degrees, its part without noise, and the weight; 0 outside the mask.

    noise: (h, w) squared radians.
    """
    height, width = mask.shape
    error, shared, weight = out  # numba drops stores through a tuple's field inside prange
    inverse, ambient, channel = c.inverse, c.ambient, c.channel
    e, zero, half, one = ellipsoid.shape, np.float32(0.0), np.float32(0.5), np.float32(1.0)
    inverse_albedo = one / ellipsoid.albedo
    by_noise = np.float32(2.0) * c.along  # of a squared departure: what noise rarely makes
    for v in prange(height):
        red, green, blue = (
            np.empty(width, np.float32),
            np.empty(width, np.float32),
            np.empty(width, np.float32),
        )
        n0, n1, n2 = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
        unlit = np.empty(width, np.float32)
        for u in range(width):
            red[u], green[u], blue[u] = rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2]
            n0[u], n1[u], n2[u] = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
            unlit[u] = _BY_LABEL[labels[v, u]]
        to_error, to_shared, to_weight = error[v], shared[v], weight[v]
        row_noise, inside = noise[v], mask[v]
        for u in range(width):  # rows without a branch: eight pixels at a time
            r, g, b = red[u] - ambient[0], green[u] - ambient[1], blue[u] - ambient[2]
            x = inverse[0, 0] * r + inverse[0, 1] * g + inverse[0, 2] * b
            y = inverse[1, 0] * r + inverse[1, 1] * g + inverse[1, 2] * b
            z = inverse[2, 0] * r + inverse[2, 1] * g + inverse[2, 2] * b
            length = np.sqrt(x * x + y * y + z * z)
            seen = (length > _SHORTEST) & (length < _LONGEST)
            scale = one / length if seen else one
            x, y, z = x * scale, y * scale, z * scale
            foretold = one + x * (e[0, 0] * x + e[0, 1] * y + e[0, 2] * z)
            foretold += y * (e[1, 0] * x + e[1, 1] * y + e[1, 2] * z)
            foretold += z * (e[2, 0] * x + e[2, 1] * y + e[2, 2] * z)
            ratio = max(length * inverse_albedo / max(foretold, _LEAST_FACING), _SHORTEST)
            departure = min(abs(ratio - one / ratio) * half, one)  # sinh of the log length
            darkest = min(r * channel[0], g * channel[1])
            darkest = min(darkest, b * channel[2])  # of two at a time: numba makes SIMD of that
            dark = max(darkest * scale, zero)
            fall = max(one - dark * _PER_DARK_CHANNEL, zero)
            fall = fall * fall
            t0 = e[0, 0] * n0[u] + e[0, 1] * n1[u] + e[0, 2] * n2[u]
            t1 = e[1, 0] * n0[u] + e[1, 1] * n1[u] + e[1, 2] * n2[u]
            t2 = e[2, 0] * n0[u] + e[2, 1] * n1[u] + e[2, 2] * n2[u]
            along = t0 * n0[u] + t1 * n1[u] + t2 * n2[u]
            turn = max(t0 * t0 + t1 * t1 + t2 * t2 - along * along, zero)
            own = max(departure * departure - by_noise * row_noise[u], zero)
            local = _PER_DEPARTURE * own + _PER_FALL * fall * fall
            total = fixed + _PER_TURN * turn + (local if unlit[u] == zero else unlit[u])
            of_neighbours = min(np.sqrt(total), _LARGEST_DEG) if seen else _LARGEST_DEG
            bound = np.sqrt(total + _PER_NOISE * row_noise[u])
            bound = min(bound, _LARGEST_DEG) if seen else _LARGEST_DEG
            share = bound * _PER_HALF_WEIGHT
            to_error[u] = bound if inside[u] else zero
            to_shared[u] = of_neighbours if inside[u] else zero
            to_weight[u] = one / (one + share * share) if inside[u] else zero
