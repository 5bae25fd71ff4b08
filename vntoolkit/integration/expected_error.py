"""How far off is the depth? The error of the normals, carried through the integration on a coarse grid.

What bends a surface is an error that many normals share. Its pattern is unknown, its size is each normal's
expected error without noise. So every entry of a matrix ΔM turns the normals, by as much as their own error
allows, the turned slopes are integrated, and the nine depths add up in squares. Noise nearly averages out:
least squares turns white noise of variance σ² on the slopes of n×n pixels into depth of variance
σ² (ln n) / 2π.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numba import prange
from scipy import ndimage

from vntoolkit.arrays import Float32Array, FloatArray, Mask
from vntoolkit.checks import require_same_size
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NOISE_CELL_PX, DepthMap, NormalMap
from vntoolkit.integration.slopes import RayField, rays_from_camera
from vntoolkit.native import njit

_LARGEST_SIDE = 24  # of the coarse grid, in blocks, about: shared errors are smooth
_SAMPLES_A_SIDE = 4  # of a block
_ROWS = 180  # that tell the range of the depth
_LEAST_COVER = 0.25  # of a block by the depth map
_LEAST_FACING = 0.15
_LEAST_WEIGHT = 1e-3
_PER_NORMAL = 1.0 / 2.146  # standard deviation of a direction over the bound of nine of ten
_NINE_OF_TEN = 1.2  # standard deviations that hold nine of ten pixels of the package's own scenes …
_OF_NOISE = 1.645  # … and of what is normally distributed
_FARTHEST = np.float32(3e38)
_TURNS = 9  # entries of ΔM
_HOLD = 1e-9  # holds the constant that every component leaves free, before its mean is removed


def with_expected_depth_error(depth_map: DepthMap, normal_map: NormalMap, camera: Camera) -> DepthMap:
    """Return the depth with the error that nine of ten pixels stay within, in % of the depth's range.

    normal_map: what the depth was integrated from, with its errors; (h, w) as the depth. The constant that
    integration leaves free in every component counts as right. Raises `BadInput` where the maps differ in
    size or the normals' errors are not known.
    """
    require_same_size(depth_map.depth, "depth map", normal_map.mask, "normal map")
    if normal_map.error_deg is None:
        raise BadInput("normals: their expected error is not known, so that of the depth is not either")
    mask = np.ascontiguousarray(depth_map.mask & normal_map.mask)
    span = float(_range(np.ascontiguousarray(depth_map.depth), mask, max(1, len(mask) // _ROWS)))
    error = np.empty(depth_map.shape, np.float32)
    if not span > 0:
        error[:] = 0.0
    else:
        spread, block = _spread_of(normal_map, mask, rays_from_camera(camera))
        scale = np.ascontiguousarray(depth_map.depth) if camera.is_perspective else None
        _enlarge(spread * np.float32(100.0 * _NINE_OF_TEN / span), block, mask, scale, error)
    return replace(depth_map, error_percent=error)


def depth_deviations(normal_map: NormalMap, mask: Mask, rays: RayField) -> Float32Array:
    """Return (h, w), the standard deviation of depth (perspective: of log depth); 0 outside the mask.

    normal_map: (h, w), with its errors.
    """
    spread, block = _spread_of(normal_map, mask, rays)
    out = np.empty(mask.shape, np.float32)
    _enlarge(spread, block, mask, None, out)
    return out


def _spread_of(normal_map: NormalMap, mask: Mask, rays: RayField) -> tuple[Float32Array, int]:
    """Return the standard deviation by blocks, and the side of a block."""
    block = -(-max(mask.shape) // _LARGEST_SIDE)
    block -= block % max(1, block // _SAMPLES_A_SIDE)  # a whole number of samples
    return _filled(*_coarse_error(normal_map, mask, block, rays)).astype(np.float32), block


def _coarse_error(normal_map: NormalMap, mask: Mask, block: int, rays: RayField) -> tuple[FloatArray, Mask]:
    """Return the standard deviation of depth (perspective: of log depth) by blocks, and where it is known."""
    step = max(1, block // _SAMPLES_A_SIDE)
    shape = (-(-mask.shape[0] // block), -(-mask.shape[1] // block))
    cells = tuple(-(-n // NOISE_CELL_PX) for n in mask.shape)
    noise_deg = np.zeros(cells, np.float32) if normal_map.noise_deg is None else normal_map.noise_deg
    sums = np.zeros((7, *shape))
    arrays = (normal_map.normals_in_camera, normal_map.error_deg, noise_deg, normal_map.weight)
    _sum_blocks(*arrays, mask, block, step, sums)
    places = (block // step) ** 2
    inside: Mask = sums[0] > _LEAST_COVER * places
    ray = (rays.affine.astype(np.float64), rays.depth_scales_ray)
    growth = math.log(max(mask.shape)) / (2 * math.pi) / rays.pixels_per_unit**2
    random = (np.radians(_PER_NORMAL) * _OF_NOISE / _NINE_OF_TEN) ** 2 * growth
    depth, variance = np.empty((*shape, _TURNS)), np.empty(shape)
    _depth_of_turns(sums, inside, places, block, ray, random, depth, variance)
    if inside.all():
        depth -= depth.mean(axis=(0, 1))
    else:
        parts, number = ndimage.label(inside)
        for part in range(1, number + 1):
            here = parts == part
            depth[here] -= depth[here].mean(axis=0)
    return np.sqrt(np.einsum("vuk,vuk->vu", depth, depth) + variance), inside


def _filled(spread: FloatArray, inside: Mask) -> FloatArray:
    """Return the blocks' values; blocks without one take their nearest neighbour's."""
    if inside.all() or not inside.any():
        return np.where(inside, spread, 0.0)
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return np.asarray(spread[tuple(nearest)])


@njit(cache=True, fastmath=True, error_model="numpy")
def _range(depth: Any, mask: Mask, step: int) -> float:
    """Return the largest depth less the least, over every `step`-th row; below 0 where none is valid."""
    width = mask.shape[1]
    least, most = np.full(width, _FARTHEST, depth.dtype), np.full(width, -_FARTHEST, depth.dtype)
    for v in range(0, mask.shape[0], step):
        row, inside = depth[v], mask[v]
        for u in range(width):  # column by column and without a branch: eight at a time
            least[u] = min(least[u], row[u] if inside[u] else least[u])
            most[u] = max(most[u], row[u] if inside[u] else most[u])
    return float(most.max() - least.min())


@njit(cache=True)
def _depth_of_turns(
    sums: Any, inside: Mask, places: int, block: int, ray: Any, random: float, depth: Any, variance: Any
) -> None:  # fmt: skip
    """Fill the depth (h, w, 9) of the nine turns, and noise's variance; blocks go along the shorter side."""
    _, height, width = sums.shape
    right, down = np.zeros((height, width, _TURNS)), np.zeros((height, width, _TURNS))
    trust = np.zeros((height, width))
    normal = np.zeros(3)
    for v in range(height):
        for u in range(width):
            count = max(sums[0, v, u], 1e-6)
            for i in range(3):
                normal[i] = sums[1 + i, v, u] / count
            normal /= max(np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2), 1e-6)
            sigma = np.radians(_PER_NORMAL) * sums[4, v, u] / count
            _turned_slopes(normal, sigma, ray, block, v, u, right[v, u], down[v, u])
            if inside[v, u]:
                trust[v, u] = max(sums[6, v, u] / count, _LEAST_WEIGHT) * sums[0, v, u] / places
            # a slope grows by 1 / cos² along the inclination and by 1 / cos across
            variance[v, u] = random * sums[5, v, u] / count / max(-normal[2], _LEAST_FACING) ** 3
    if height > width:
        turned = np.zeros((width, height, _TURNS))
        first, second = np.ascontiguousarray(down.transpose(1, 0, 2)), right.transpose(1, 0, 2)
        _integrate(first, np.ascontiguousarray(second), np.ascontiguousarray(trust.T), turned)
        depth[:] = turned.transpose(1, 0, 2)
    else:
        _integrate(right, down, trust, depth)


@njit(cache=True)
def _turned_slopes(
    normal: Any, sigma: float, ray: Any, block: int, v: int, u: int, right: Any, down: Any
) -> None:
    """Fill by how much every entry of ΔM changes a block's slopes along u and v, (9,), a block at a time.

    The slope is −(n·r_u)/(n·r). The squares of a normal's nine turns sum to sigma² in all directions across
    it.
    """
    a, scales = ray
    x, y = (u + 0.5) * block - 0.5, (v + 0.5) * block - 0.5
    along_x, along_y = scales * (a[0] * x + a[1] * y + a[2]), scales * (a[3] * x + a[4] * y + a[5])
    seen = normal[0] * along_x + normal[1] * along_y + normal[2]
    facing = min(seen, -_LEAST_FACING)
    slope_right, slope_down = normal[0] * a[0] + normal[1] * a[3], normal[0] * a[1] + normal[1] * a[4]
    axis = np.zeros(3)
    for i in range(3):  # the part across the normal of what turns it along an axis
        for k in range(3):
            axis[k] = (1.0 if i == k else 0.0) - normal[i] * normal[k]
        by_ray = axis[0] * along_x + axis[1] * along_y + axis[2]
        by_right, by_down = axis[0] * a[0] + axis[1] * a[3], axis[0] * a[1] + axis[1] * a[4]
        to_right = block * (slope_right * by_ray / facing**2 - by_right / facing)
        to_down = block * (slope_down * by_ray / facing**2 - by_down / facing)
        for k in range(3):
            right[3 * i + k] = to_right * normal[k] * sigma
            down[3 * i + k] = to_down * normal[k] * sigma


@njit(cache=True)
def _integrate(right: Any, down: Any, trust: Any, depth: Any) -> None:
    """Fill the weighted least-squares depth (h, w, 9) of slopes (h, w, 9); h is at most w."""
    height, width = trust.shape
    count, reach = height * width, height
    band = np.zeros((count + reach, reach + 1))  # of row i: the entries from the diagonal on
    load = np.zeros((count + reach, _TURNS))
    band[:count, 0] = _HOLD
    band[count:, 0] = 1.0
    for u in range(width):
        for v in range(height):
            i = u * height + v
            if u + 1 < width:
                weight = min(trust[v, u], trust[v, u + 1])
                _add_edge(band, load, i, height, weight, right[v, u], right[v, u + 1])
            if v + 1 < height:
                weight = min(trust[v, u], trust[v + 1, u])
                _add_edge(band, load, i, 1, weight, down[v, u], down[v + 1, u])
    for i in range(count):  # elimination down the band …
        own, given = band[i], load[i]
        for d in range(1, reach + 1):
            if own[d] != 0.0:
                factor = own[d] / own[0]
                to, to_load = band[i + d], load[i + d]
                for j in range(reach + 1 - d):
                    to[j] -= factor * own[d + j]
                for k in range(_TURNS):
                    to_load[k] -= factor * given[k]
    for i in range(count - 1, -1, -1):  # … and substitution back up
        own, to_load = band[i], load[i]
        for d in range(1, reach + 1):
            for k in range(_TURNS):
                to_load[k] -= own[d] * load[i + d, k]
        for k in range(_TURNS):
            to_load[k] /= own[0]
            depth[i % height, i // height, k] = to_load[k]


@njit(cache=True)
def _add_edge(band: Any, load: Any, i: int, d: int, weight: float, before: Any, after: Any) -> None:
    """Add to the normal equations that the depth rises by the mean of two slopes from block i to i + d."""
    band[i, 0] += weight
    band[i + d, 0] += weight
    band[i, d] -= weight
    for k in range(_TURNS):
        flow = weight * 0.5 * (before[k] + after[k])
        load[i + d, k] += flow
        load[i, k] -= flow


@njit(cache=True)
def _sum_blocks(
    normals: Any, error: Any, noise_deg: Any, weight: Any, mask: Mask, block: int, step: int, sums: Any
) -> None:
    """Sum up samples by blocks (7, h, w): 1, normal, error without noise, squared noise, weight; degrees."""
    for v in range(0, mask.shape[0], step):
        for u in range(0, mask.shape[1], step):
            if mask[v, u]:
                to = sums[:, v // block, u // block]
                total, random = error[v, u] ** 2, noise_deg[v // NOISE_CELL_PX, u // NOISE_CELL_PX] ** 2
                random = min(random, total)
                to[0] += 1.0
                for k in range(3):
                    to[1 + k] += normals[v, u, k]
                to[4] += np.sqrt(total - random)
                to[5] += random
                if weight is None:
                    to[6] += 1.0
                else:
                    to[6] += weight[v, u]


@njit(cache=True, parallel=True, error_model="numpy")
def _enlarge(coarse: Any, block: int, mask: Mask, scale: Any, out: Any) -> None:
    """Fill (h, w) between centres of blocks linearly; 0 outside the mask. scale: (h, w) factors, or None."""
    height, width = mask.shape
    rows, columns = coarse.shape
    half, one, zero = np.float32(0.5), np.float32(1.0), np.float32(0.0)
    per_pixel = one / np.float32(block)
    beyond = half * np.float32(1 - block % 2)  # from the centre of block k - 1 to the first pixel
    for v in prange(height):
        y = min(max((np.float32(v) + half) * per_pixel - half, zero), np.float32(rows - 1))
        up = int(y)
        down, t = min(up + 1, rows - 1), y - np.float32(up)
        for k in range(columns + 1):
            left, right = max(k - 1, 0), min(k, columns - 1)
            before = (one - t) * coarse[up, left] + t * coarse[down, left]
            after = (one - t) * coarse[up, right] + t * coarse[down, right]
            start = k * block - block // 2
            first, last = max(start, 0), min(start + block, width)
            slope = (after - before) * per_pixel
            before += slope * (np.float32(first - start) + beyond)
            to, inside = out[v, first:last], mask[v, first:last]
            if scale is None:
                for i in range(len(to)):
                    to[i] = before + slope * np.float32(i) if inside[i] else zero
            else:
                factor = scale[v, first:last]
                for i in range(len(to)):
                    value = (before + slope * np.float32(i)) * np.float32(factor[i])
                    to[i] = value if inside[i] else zero
