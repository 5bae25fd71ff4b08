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
from scipy import ndimage
from scipy.linalg import solveh_banded

from vntoolkit.arrays import Float32Array, FloatArray, Mask
from vntoolkit.checks import require_same_size
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NOISE_CELL_PX, DepthMap, NormalMap
from vntoolkit.integration.slopes import RayField, rays_from_camera
from vntoolkit.native import njit
from vntoolkit.spread import NINE_OF_TEN, NINE_OF_TEN_IN_PLANE

_LARGEST_SIDE = 24  # of the coarse grid, in blocks, about: shared errors are smooth
_SAMPLES_A_SIDE = 4  # of a block
_ROWS = 180  # that tell the range of the depth
_LEAST_COVER = 0.25  # of a block by the depth map
_LEAST_FACING = 0.15
_LEAST_WEIGHT = 1e-3
_PER_NORMAL = 1.0 / NINE_OF_TEN_IN_PLANE  # standard deviation of a direction over the bound of nine of ten
_OF_SCENES = 1.2  # standard deviations that hold nine of ten pixels of the package's own scenes
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
    some = np.s_[:: max(1, len(mask) // _ROWS)]
    found = depth_map.depth[some][mask[some]]
    error = np.zeros(depth_map.shape, np.float32)
    if found.size and (span := float(np.ptp(found))) > 0:
        spread, block = _spread_of(normal_map, mask, rays_from_camera(camera))
        scale = np.ascontiguousarray(depth_map.depth) if camera.is_perspective else None
        _enlarge(spread * np.float32(100.0 * _OF_SCENES / span), block, mask, scale, error)
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
    random = (np.radians(_PER_NORMAL) * NINE_OF_TEN / _OF_SCENES) ** 2 * growth
    depth, variance = _depth_of_turns(sums, inside, places, block, ray, random)
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


def _depth_of_turns(
    sums: FloatArray, inside: Mask, places: int, block: int, ray: Any, random: float
) -> tuple[FloatArray, FloatArray]:
    """Return the depth (h, w, 9) of the nine turns, and noise's variance."""
    count = np.maximum(sums[0], 1e-6)
    normal = np.moveaxis(sums[1:4] / count, 0, -1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
    sigma = np.radians(_PER_NORMAL) * sums[4] / count
    trust = np.where(inside, np.maximum(sums[6] / count, _LEAST_WEIGHT) * sums[0] / places, 0.0)
    depth = _integrated(*_turned_slopes(normal, sigma, ray, block), trust)
    # a slope grows by 1 / cos² along the inclination and by 1 / cos across
    return depth, random * sums[5] / count / np.maximum(-normal[..., 2], _LEAST_FACING) ** 3


def _turned_slopes(
    normal: FloatArray, sigma: FloatArray, ray: Any, block: int
) -> tuple[FloatArray, FloatArray]:
    """Return by how much every entry of ΔM changes slopes along u and v, (h, w, 9), a block at a time.

    The slope is −(n·r_u)/(n·r). The squares of a normal's nine turns sum to sigma² in all directions across
    it.
    """
    a, scales = ray
    height, width = sigma.shape
    y, x = ((np.mgrid[:height, :width] + 0.5) * block - 0.5).astype(np.float64)
    rays = np.stack([scales * (a[0] * x + a[1] * y + a[2]), scales * (a[3] * x + a[4] * y + a[5]), x**0], -1)
    facing = np.minimum((normal * rays).sum(axis=-1, keepdims=True), -_LEAST_FACING)
    across = np.eye(3) - normal[..., :, None] * normal[..., None, :]  # what turns a normal along each axis
    by_ray = np.einsum("vuij,vuj->vui", across, rays)
    slopes = []
    for along in (np.array([a[0], a[3], 0.0]), np.array([a[1], a[4], 0.0])):
        turned = (normal @ along)[..., None] * by_ray / facing**2 - across @ along / facing
        nine = turned[..., :, None] * normal[..., None, :] * (block * sigma)[..., None, None]
        slopes.append(nine.reshape(height, width, _TURNS))
    return slopes[0], slopes[1]


def _integrated(right: FloatArray, down: FloatArray, trust: FloatArray) -> FloatArray:
    """Return the weighted least-squares depth (h, w, 9) of slopes (h, w, 9)."""
    height, width = trust.shape
    load, diagonal = np.zeros(right.shape), np.full(trust.shape, _HOLD)
    band = np.zeros((width + 1, height, width))  # below the diagonal: to the right one on, down a row on
    for slopes, first, last, on in (
        (right, np.s_[:, :-1], np.s_[:, 1:], 1),
        (down, np.s_[:-1], np.s_[1:], width),
    ):
        weight = np.minimum(trust[first], trust[last])
        flow = 0.5 * weight[..., None] * (slopes[first] + slopes[last])
        load[first] -= flow
        load[last] += flow
        diagonal[first] += weight
        diagonal[last] += weight
        band[on][first] -= weight
    band[0] = diagonal
    solved = solveh_banded(band.reshape(width + 1, -1), load.reshape(-1, _TURNS), lower=True)
    return np.asarray(solved).reshape(right.shape)


@njit
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


@njit
def _enlarge(coarse: Any, block: int, mask: Mask, scale: Any, out: Any) -> None:
    """Fill (h, w) between centres of blocks linearly; 0 outside the mask. scale: (h, w) factors, or None."""
    height, width = mask.shape
    rows, columns = coarse.shape
    half, one, zero = np.float32(0.5), np.float32(1.0), np.float32(0.0)
    per_pixel = one / np.float32(block)
    beyond = half * np.float32(1 - block % 2)  # from the centre of block k - 1 to the first pixel
    for v in range(height):
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
