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
import numpy.typing as npt
import scipy.sparse as sp
from scipy import ndimage
from scipy.sparse.linalg import splu

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_same_size
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.integration.slopes import RayField, rays_from_camera

_LARGEST_SIDE = 32  # of the coarse grid, in blocks, about: shared errors are smooth
_SAMPLES_A_SIDE = 4  # of a block
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
    shared = normal_map.error_deg if normal_map.shared_error_deg is None else normal_map.shared_error_deg
    mask = depth_map.mask & normal_map.mask
    depth = depth_map.depth
    span = float(depth.max(where=mask, initial=-np.inf) - depth.min(where=mask, initial=np.inf))
    error = np.zeros(depth_map.shape, np.float32)
    if span > 0:
        block = -(-max(mask.shape) // _LARGEST_SIDE)
        block -= block % max(1, block // _SAMPLES_A_SIDE)  # a whole number of samples
        spread, inside = _coarse_error(normal_map, shared, mask, block, rays_from_camera(camera))
        error = _enlarged(100.0 * _NINE_OF_TEN / span * spread, inside, block, mask.shape)
        if camera.is_perspective:
            error *= depth
        error *= mask
    return replace(depth_map, error_percent=error)


def _coarse_error(
    normal_map: NormalMap, shared: FloatArray, mask: Mask, block: int, rays: RayField
) -> tuple[FloatArray, Mask]:
    """Return the standard deviation of depth (perspective: of log depth) by blocks, and where it is known."""
    step = max(1, block // _SAMPLES_A_SIDE)
    used, side = mask[::step, ::step], block // step
    height, width = (-(-n // side) for n in used.shape)
    padding = ((0, height * side - used.shape[0]), (0, width * side - used.shape[1]))

    def mean(samples: npt.NDArray[np.floating[Any]]) -> FloatArray:
        blocks = np.pad(samples * used, padding).reshape(height, side, width, side)
        return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float64))

    cover = mean(np.ones(used.shape, np.float32))
    inside = cover > _LEAST_COVER
    share = np.maximum(cover, 1e-6)
    sampled = normal_map.normals_in_camera[::step, ::step]
    normals = np.stack([mean(sampled[..., k]) for k in range(3)], axis=-1)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-6)
    assert normal_map.error_deg is not None
    of_neighbours = shared[::step, ::step]
    noise = normal_map.error_deg[::step, ::step] ** 2 - of_neighbours**2
    sigma = np.radians(_PER_NORMAL * mean(of_neighbours) / share)
    weight = np.ones_like(noise) if normal_map.weight is None else normal_map.weight[::step, ::step]
    trust = np.where(inside, np.maximum(mean(weight) / share, _LEAST_WEIGHT) * cover, 0.0)
    right, down = _turned_slopes(normals, sigma, rays, block)
    depth = _integrated(right, down, trust, inside)
    steepness = np.maximum(-normals[..., 2], _LEAST_FACING) ** -3  # slope along and across the inclination
    growth = math.log(max(mask.shape)) / (2 * math.pi) / rays.pixels_per_unit**2
    random = (
        (np.radians(_PER_NORMAL) * _OF_NOISE / _NINE_OF_TEN) ** 2 * growth * steepness * mean(noise) / share
    )
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
    """Return the weighted least-squares depth (h, w, 9) of slopes (h, w, 9); mean 0 over each component."""
    node = np.full(inside.shape, -1)
    count = int(inside.sum())
    node[inside] = np.arange(count)
    tails, heads, wanted, worth = [], [], [], []
    for slopes, near, far in (
        (right, np.s_[:, :-1], np.s_[:, 1:]),
        (down, np.s_[:-1], np.s_[1:]),
    ):
        both = inside[near] & inside[far]
        tails.append(node[near][both])
        heads.append(node[far][both])
        wanted.append(0.5 * (slopes[near] + slopes[far])[both])
        worth.append(np.minimum(trust[near], trust[far])[both])
    tail, head, weight = np.concatenate(tails), np.concatenate(heads), np.concatenate(worth)
    rows = np.arange(len(tail))
    ones = np.ones(len(tail))
    difference = sp.csr_matrix(
        (np.concatenate([ones, -ones]), (np.tile(rows, 2), np.concatenate([head, tail]))), (len(tail), count)
    )
    system = (difference.T @ sp.diags(weight) @ difference + _HOLD * sp.identity(count)).tocsc()
    load = difference.T @ (weight[:, None] * np.concatenate(wanted))
    solved = splu(system, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(load)
    component = ndimage.label(inside)[0][inside] - 1
    sizes = np.bincount(component)
    means = np.stack([np.bincount(component, column) / sizes for column in solved.T], axis=1)
    depth = np.zeros((*inside.shape, solved.shape[1]))
    depth[inside] = solved - means[component]
    return depth


def _enlarged(spread: FloatArray, inside: Mask, block: int, shape: tuple[int, int]) -> FloatArray:
    """Return the blocks' values at every pixel; blocks without one take their nearest neighbour's."""
    if not inside.any():
        return np.zeros(shape)
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    rows, columns = (_interpolation(n, blocks, block) for n, blocks in zip(shape, spread.shape, strict=True))
    return np.asarray(rows @ spread[tuple(nearest)].astype(np.float32) @ columns.T)


def _interpolation(pixels: int, blocks: int, block: int) -> npt.NDArray[np.float32]:
    """Return (pixels, blocks): linear interpolation between the blocks' centres."""
    place = np.clip((np.arange(pixels) + 0.5) / block - 0.5, 0, blocks - 1)
    return np.maximum(0, 1 - np.abs(place[:, None] - np.arange(blocks))).astype(np.float32)
