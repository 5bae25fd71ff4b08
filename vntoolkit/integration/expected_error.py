"""How far off is the depth? The error of the normals, carried through the integration on a coarse grid.

What bends a surface is an error that many normals share. Its pattern is unknown, its size is each normal's
expected error without noise. So every entry of a matrix ΔM turns the normals, by as much as their own error
allows, the turned slopes are integrated, and the nine depths add up in squares. Noise nearly averages out:
least squares turns white noise of variance σ² on the slopes of n×n pixels into depth of variance
σ² (ln n) / 2π.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numba import prange
from scipy import ndimage
from scipy.linalg import solveh_banded

from vntoolkit.arrays import FloatArray, Mask
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
    step = max(1, len(mask) // _ROWS)
    looked_at = depth_map.depth[::step][mask[::step]]
    span = float(looked_at.max(initial=-np.inf)) - float(looked_at.min(initial=np.inf))
    error = np.empty(depth_map.shape, np.float32)
    if not span > 0:
        error[:] = 0.0
    else:
        block = -(-max(mask.shape) // _LARGEST_SIDE)
        block -= block % max(1, block // _SAMPLES_A_SIDE)  # a whole number of samples
        spread, inside = _coarse_error(normal_map, mask, block, rays_from_camera(camera))
        spread = 100.0 * _NINE_OF_TEN / span * _filled(spread, inside)
        scale = np.ascontiguousarray(depth_map.depth) if camera.is_perspective else None
        _enlarge(spread.astype(np.float32), block, mask, scale, error)
    return replace(depth_map, error_percent=error)


def _coarse_error(normal_map: NormalMap, mask: Mask, block: int, rays: RayField) -> tuple[FloatArray, Mask]:
    """Return the standard deviation of depth (perspective: of log depth) by blocks, and where it is known."""
    step = max(1, block // _SAMPLES_A_SIDE)
    height, width = (-(-n // block) for n in mask.shape)
    cells = tuple(-(-n // NOISE_CELL_PX) for n in mask.shape)
    noise_deg = np.zeros(cells, np.float32) if normal_map.noise_deg is None else normal_map.noise_deg
    weight = normal_map.weight
    sums = np.zeros((7, height, width))
    arrays = (normal_map.normals_in_camera, normal_map.error_deg, noise_deg, weight)
    _sum_blocks(*arrays, mask, block, step, sums)
    places = (block // step) ** 2
    cover = sums[0] / places
    inside: Mask = cover > _LEAST_COVER
    count = np.maximum(sums[0], 1e-6)
    normals = np.moveaxis(sums[1:4], 0, -1)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-6)
    sigma, noise = np.radians(_PER_NORMAL) * sums[4] / count, sums[5] / count
    trust = np.where(inside, np.maximum(sums[6] / count, _LEAST_WEIGHT) * cover, 0.0)
    right, down = _turned_slopes(normals, sigma, rays, block)
    depth = _integrated(right, down, trust, inside)
    steepness = np.maximum(-normals[..., 2], _LEAST_FACING) ** -3  # slope along and across the inclination
    growth = math.log(max(mask.shape)) / (2 * math.pi) / rays.pixels_per_unit**2
    random = (np.radians(_PER_NORMAL) * _OF_NOISE / _NINE_OF_TEN) ** 2 * growth * steepness * noise
    return np.sqrt(np.square(depth).sum(axis=-1) + random), inside


def _turned_slopes(
    normals: FloatArray, sigma: FloatArray, rays: RayField, block: int
) -> tuple[FloatArray, FloatArray]:
    """Return by how much every entry of ΔM changes the slopes along u and v, (h, w, 9), a block at a time.

    The slope is −(n·r_u)/(n·r). The squares of a normal's nine turns sum to sigma² in all directions across
    it.
    """
    height, width = sigma.shape
    a = rays.affine.astype(np.float64)
    u, v = np.meshgrid((np.arange(width) + 0.5) * block - 0.5, (np.arange(height) + 0.5) * block - 0.5)
    ray = np.stack([a[0] * u + a[1] * v + a[2], a[3] * u + a[4] * v + a[5], np.ones_like(u)], axis=-1)
    ray[..., :2] *= rays.depth_scales_ray
    across = np.eye(3) - normals[..., :, None] * normals[..., None, :]
    turns = across[..., :, :, None] * normals[..., None, None, :] * sigma[..., None, None, None]
    turns = turns.reshape(height, width, 3, 9)
    facing = np.minimum(np.einsum("vui,vui->vu", normals, ray), -_LEAST_FACING)[..., None]
    by_ray = np.einsum("vuik,vui->vuk", turns, ray)
    changes = []
    for step in (np.array([a[0], a[3], 0.0]), np.array([a[1], a[4], 0.0])):
        along = np.einsum("vuik,i->vuk", turns, step)
        slope = (normals @ step)[..., None]
        changes.append(block * (slope * by_ray / facing**2 - along / facing))
    return changes[0], changes[1]


def _integrated(right: FloatArray, down: FloatArray, trust: FloatArray, inside: Mask) -> FloatArray:
    """Return the weighted least-squares depth (h, w, 9) of slopes (h, w, 9); mean 0 over each component.

    Blocks are numbered along the shorter side, so that the matrix is a narrow band.
    """
    if inside.shape[0] > inside.shape[1]:
        down, right = np.swapaxes(down, 0, 1), np.swapaxes(right, 0, 1)
        return np.swapaxes(_integrated(down, right, trust.T, inside.T), 0, 1)
    height, width = inside.shape
    # (w, h): a column is consecutive
    across, along = np.zeros((width, height)), np.zeros((width, height))  # weight of the edge after a block
    across[:-1] = np.minimum(trust[:, :-1], trust[:, 1:]).T
    along[:, :-1] = np.minimum(trust[:-1], trust[1:]).T
    load = np.zeros((width, height, right.shape[2]))
    flow = across[:-1, :, None] * 0.5 * np.swapaxes(right[:, :-1] + right[:, 1:], 0, 1)
    load[1:] += flow
    load[:-1] -= flow
    flow = along[:, :-1, None] * 0.5 * np.swapaxes(down[:-1] + down[1:], 0, 1)
    load[:, 1:] += flow
    load[:, :-1] -= flow
    band = np.zeros((height + 1, width, height))
    band[0] = _HOLD + across + along
    band[0, 1:] += across[:-1]
    band[0, :, 1:] += along[:, :-1]
    band[min(1, height)] -= along
    band[height] -= across
    count = width * height
    band = band.reshape(height + 1, count)
    solved = solveh_banded(band, load.reshape(count, -1), lower=True, overwrite_ab=True, check_finite=False)
    depth = np.swapaxes(solved.reshape(width, height, -1), 0, 1)
    parts, number = ndimage.label(inside)
    for part in range(1, number + 1):
        here = parts == part
        depth[here] -= depth[here].mean(axis=0)
    return np.where(inside[..., None], depth, 0.0)


def _filled(spread: FloatArray, inside: Mask) -> FloatArray:
    """Return the blocks' values; blocks without one take their nearest neighbour's."""
    if inside.all() or not inside.any():
        return np.where(inside, spread, 0.0)
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return np.asarray(spread[tuple(nearest)])


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


@njit(cache=True, parallel=True, fastmath={"contract", "arcp", "nsz"}, error_model="numpy")
def _enlarge(coarse: Any, block: int, mask: Mask, scale: Any, out: Any) -> None:
    """Fill (h, w) between the centres of the blocks by linear interpolation; 0 outside the mask.

    scale: (h, w), a factor on every pixel, or None.
    """
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
