"""Paint that varies inside a material, told from the surface: what is printed on it is no relief.

Light split by lamp and over ρ is s = (l · n) × paint. Without paint, the slopes are those of one depth. So
the depth is sought whose paint log s − log (l · n) is least, in a norm that lets painted places go (Geman and
McClure's): there the surface goes on from around. A block has three lights; depth leaves it one unknown, so
that two numbers are left for its paint. Paint along the material's pigment costs less than paint across it.
For one light a shape and a paint that are both likely are sought in a like way (barron2015).

Gauss–Newton steps solve one weighted Poisson equation each, from coarse to fine.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, uniform_filter

from vntoolkit.arrays import Box, Float32Array, FloatArray, IntArray, Mask, MaterialLabels, Points
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.slope_grid import (
    FLATTEST_Z,
    NO_STEP,
    STEEPEST,
    RayGrid,
    edges_kernel,
    ray_grid,
    slopes_kernel,
    weights_kernel,
)
from vntoolkit.materials.reflectance import Lamps, lamps_from_response
from vntoolkit.materials.split_frame import (
    LEAST_SHARE,
    block_size,
    blocks_moved,
    cells_of,
    steady_box,
    sums_of_blocks,
)
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.solvers import grid_hierarchy, solve_grid

_LEVELS = 2  # coarser ones, each of half the size: a lip is wide for steps that only reach its neighbours
_STEPS, _CYCLES = 2, 3  # of Gauss–Newton on each level, and of multigrid in each
# Blocks that a subject may move from where its surface was found from coarse to fine. Farther on, steps from
# the surface before do not follow: where a nose was, light that does not fit it passes for paint.
_NEAR_BLOCKS = 1.0
_TOLERANCE = 3e-3
_REACH = 4  # blocks, from what was known of the frame before
# Standard deviations of log ρ from which paint counts as such: across the pigment's line, and along it.
_ACROSS, _ALONG = 0.15, 0.3
# Weight of a block's normal being the mean of those beside it, over that of light. Where paint hides the
# surface, it decides.
_SMOOTH = 7.0
_STEP_SCALE = 10.0  # χ² at which a depth gradient counts a quarter, as it crosses a step in depth
_DAMPING = 0.02  # of a step; keeps the equations definite
_AROUND = 2  # blocks to each side that share the doubt of a turn
_LEAST_LIGHT, _TINY = np.float32(0.02), np.float32(1e-9)
_NO_LABEL = 255
_LEAST_COSINE = np.cos(np.radians(45.0))  # no paint of skin turns a normal farther
_GUESSED = 3  # for `weights_kernel` a block of two lights, whose scale is another


class PaintSurface(NamedTuple):
    """Of blocks of factor × factor pixels.

    depth: (h, w). slopes: (2, h, w). known: (h, w), where they are. box: rows and columns of the frame, and
    cells: what they showed when it was found from coarse to fine, by which movement is measured.
    """

    depth: Float32Array
    slopes: Float32Array
    known: Mask
    factor: int
    box: Box = (slice(0), slice(0))
    cells: Float32Array = np.empty((0, 0, 3), np.float32)


def without_paint(
    frame: LinearFrame,
    labels: MaterialLabels,
    mask: Mask,
    response: LightResponse,
    rho: Points,
    lines: Points,
    camera: Camera | None,
    before: PaintSurface | None = None,
) -> tuple[LinearFrame, Float32Array, PaintSurface]:
    """Return the frame as it would be without the paint of its subject, a mask (h, w).

    And (h, w), by how many degrees that turns normals: the paint may be relief, so far are they in doubt.
    And the subject's surface.

    labels: (h, w), numbers of the materials. rho: (m, 3), their reflectances. lines: (m, 3), of length 1,
    their pigments; one of 0 has no paint. camera: None for orthographic. before: the surface in the frame
    before: the search goes on from it, unless the subject has moved far since it began.
    """
    lamps, lines = lamps_from_response(response, np.zeros(3)), np.asarray(lines, np.float64)
    factor = block_size(mask) if before is None else before.factor
    box = steady_box(mask, factor, None if before is None else before.box)
    rgb, labels, mask = frame.rgb[box], labels[box], mask[box]
    cells = cells_of(rgb[factor // 2 :: factor, factor // 2 :: factor])
    if before is not None:
        follows = before.box == box and blocks_moved(before.cells, cells) <= _NEAR_BLOCKS
        before = before if follows else None
    blocks = _blocks_of(rgb, labels, mask, lamps, rho, lines, factor, box)
    surface = _surface_of(blocks, lamps, lines, ray_grid(camera), before)
    gains, turns = _gains(blocks, surface.slopes, ray_grid(camera), lamps)
    turned, out = np.zeros(frame.rgb.shape[:2], np.float32), frame.rgb.copy()
    turned[box] = np.where(mask, _pixels_of(_rms_around(turns), factor, mask.shape), 0.0)
    contributions = (rgb @ lamps.split.T.astype(np.float32)) * _between(gains, blocks, labels, mask)
    out[box] = contributions @ np.linalg.inv(lamps.split).T.astype(np.float32)
    found = LinearFrame(rgb=out, clipped=frame.clipped, number=frame.number)
    cells = cells if before is None else before.cells
    return found, turned, surface._replace(box=box, cells=cells)


class _Blocks(NamedTuple):
    """Blocks of factor × factor pixels.

    light: (h, w, 3), over ρ, without ambient light; 0 where a lamp is missing. labels: (h, w), the material
    of each, 255 for none. left, top: pixels before the first.
    """

    light: Float32Array
    labels: MaterialLabels
    factor: int
    left: int
    top: int

    @property
    def is_lit(self) -> Mask:
        """(h, w), where all three lamps arrive."""
        return self.light[..., 0] > 0.0

    def rays(self, rays: RayGrid) -> tuple[Float32Array, Float32Array]:
        """Return x (1, w) and y (h, 1) at depth 1 of rays through the middles of blocks."""
        middle, (h, w) = (self.factor - 1) / 2, self.labels.shape
        x = (self.left + self.factor * np.arange(w) + middle - rays.centre_u) * rays.per_pixel_u
        y = (self.top + self.factor * np.arange(h) + middle - rays.centre_v) * rays.per_pixel_v
        return x[None].astype(np.float32), y[:, None].astype(np.float32)

    def halved(self) -> _Blocks:
        """Return blocks of twice the side, of the material that is most often in them."""
        h, w = (-(-n // 2) for n in self.labels.shape)
        light, labels, most = np.zeros((h, w, 3)), np.full((h, w), _NO_LABEL, np.uint8), np.ones((h, w))
        for m in np.unique(self.labels[self.labels != _NO_LABEL]):
            own = self.labels == m
            count, lit = sums_of_blocks(own, 2), sums_of_blocks(own & self.is_lit, 2)
            more = count > most
            labels[more], most[more] = m, count[more]
            mean = sums_of_blocks(self.light * own[..., None], 2) / np.maximum(lit, 1.0)[..., None]
            light[more] = mean[more]
        return _Blocks(light.astype(np.float32), labels, 2 * self.factor, self.left, self.top)


def _blocks_of(
    rgb: Float32Array, labels: MaterialLabels, mask: Mask, lamps: Lamps, rho: Points, lines: Points,
    factor: int, box: Box,
) -> _Blocks:  # fmt: skip
    middle = [
        np.minimum(np.arange(0, n, factor) + factor // 2, n - 1) for n in mask.shape
    ]  # of a block cut off by the border: its last pixel
    of = labels[np.ix_(*middle)]
    own = np.asarray(mask & (labels == _pixels_of(of, factor, mask.shape)))
    counts = sums_of_blocks(own, factor)
    mean = sums_of_blocks(np.where(own[..., None], rgb, np.float32(0.0)), factor)
    mean /= np.maximum(counts, 1.0)[..., None]
    light = (mean @ lamps.split.T) / np.asarray(rho)[of] - lamps.ambient
    inside = mask[np.ix_(*middle)] & np.any(lines, axis=1)[of] & (2.0 * counts > factor**2)
    lit = inside & (light.min(axis=2) > LEAST_SHARE * np.maximum(light.max(axis=2), 0.0))
    observed = np.where(np.asarray(lit)[..., None], light, 0.0).astype(np.float32)
    known = np.where(inside, of, _NO_LABEL).astype(np.uint8)
    return _Blocks(observed, known, factor, box[1].start, box[0].start)


def _pixels_of(blocks: npt.NDArray[Any], factor: int, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """Return (h, w) from what blocks have."""
    return blocks.repeat(factor, 0).repeat(factor, 1)[: shape[0], : shape[1]]


def _surface_of(
    blocks: _Blocks, lamps: Lamps, lines: Points, of_pixels: RayGrid, start: PaintSurface | None
) -> PaintSurface:
    """The surface whose paint is least. start: from where the search goes on; None for coarse to fine."""
    prices = np.array([_price(line) for line in lines], np.float32)
    pyramid, scale, steps = [blocks], np.float32(_STEP_SCALE), 1
    if start is None:
        steps = _STEPS
        for _ in range(_LEVELS):
            pyramid.append(pyramid[-1].halved())
        half = tuple(-(-n // 2) for n in pyramid[-1].labels.shape)
        flat = np.zeros((3, *half), np.float32)
        start = PaintSurface(flat[0], flat[1:], np.zeros(half, np.bool_), 2 * pyramid[-1].factor)
        scale = np.float32(NO_STEP)  # the first depth must hold together before it may show steps
    for level in reversed(pyramid):
        inside, rays = level.labels != _NO_LABEL, level.rays(of_pixels)
        depth, slopes = _begun(level, lamps, rays, prices, start)
        weights, edges = np.empty((2, 4, *inside.shape), np.float32)
        right, agreement = np.empty((2, *inside.shape), np.float32)
        seen = lit = level.is_lit.astype(np.uint8) * np.uint8(ALL_LIT)
        if start.factor == level.factor:  # the first depth of a block that is new is a guess, too
            seen = np.where(start.known, lit, np.minimum(lit, np.uint8(_GUESSED)))
        smooth = _SMOOTH * (blocks.factor / level.factor) ** 2
        for _ in range(steps):
            quadratics, targets = _asked(level, lamps, slopes, rays, prices, smooth)
            weights_kernel(quadratics, seen, inside, slopes, depth, scale, np.float32(NO_STEP), weights)
            edges_kernel(quadratics, targets, weights, edges, right)
            depth = solve_grid(grid_hierarchy(edges), right, depth, _TOLERANCE, _CYCLES)
            slopes_kernel(depth, weights, np.float32(STEEPEST), slopes, agreement)
            scale, seen = np.float32(_STEP_SCALE), lit
        start = PaintSurface(depth, slopes, inside, level.factor)
    return start


def _price(line: FloatArray) -> FloatArray:
    """(3, 3), the inverse covariance of the log ρ of paint of a material with a pigment along a line (3,)."""
    along = np.outer(line, line)
    return np.asarray(along / _ALONG**2 + (np.eye(3) - along) / _ACROSS**2)


def _begun(
    level: _Blocks,
    lamps: Lamps,
    rays: tuple[Float32Array, Float32Array],
    prices: Float32Array,
    before: PaintSurface,
) -> tuple[Float32Array, Float32Array]:
    """Return depth (h, w) and slopes (2, h, w) of a surface before, sloping inside its blocks.

    From larger blocks, and where the surface cannot be that of before, slopes are those of the light itself
    as far as its length is 1, as without paint.
    """
    inside, times = level.labels != _NO_LABEL, before.factor // level.factor
    if before.known.any():
        away, nearest = distance_transform_edt(~before.known, return_indices=True)
    else:
        away, nearest = np.full(before.known.shape, np.inf), np.indices(before.known.shape)
    v, u = np.indices(inside.shape)
    i, j = (each[v // times, u // times] for each in nearest)
    known = inside & (away[v // times, u // times] < _REACH)
    middle = 0.5 * (times - 1)
    slopes = np.where(known, before.slopes[:, i, j], 0.0)
    aside, below = u - j * times - middle, v - i * times - middle
    depth = times * before.depth[i, j] + aside * slopes[0] + below * slopes[1]
    normals = level.light @ lamps.inverse.T
    length = np.linalg.norm(normals, axis=2) + _TINY
    left = (1.0 + np.log(length) ** 2 * prices.sum(axis=(1, 2))[np.where(inside, level.labels, 0)]) ** -2
    left = np.where(known, left * level.is_lit, 1.0)
    if times == 1:
        cosine = (normals * _normals(slopes, rays)[0]).sum(axis=2) / length
        left[known & (cosine > _LEAST_COSINE)] = 0.0
    along = -(normals[..., 2] + rays[0] * normals[..., 0] + rays[1] * normals[..., 1])
    own = normals[..., :2] / np.maximum(along, FLATTEST_Z * length)[..., None]
    slopes += left * inside * (np.moveaxis(own, 2, 0) - slopes)
    return np.where(known, depth, 0.0).astype(np.float32), slopes.astype(np.float32)


def _normals(slopes: FloatArray, rays: tuple[Float32Array, Float32Array]) -> tuple[FloatArray, FloatArray]:
    """Return the unit normals (h, w, 3) of slopes along rays (x, y, 1), and what makes them so short."""
    p, q = slopes
    normals = np.stack([p, q, -1.0 - rays[0] * p - rays[1] * q], axis=2)
    scale = 1.0 / np.linalg.norm(normals, axis=2)
    return normals * scale[..., None], scale


def _beside(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return (h, w, …), the sum of the four values beside each."""
    out = np.zeros_like(values)
    out[1:] += values[:-1]
    out[:-1] += values[1:]
    out[:, 1:] += values[:, :-1]
    out[:, :-1] += values[:, 1:]
    return out


def _asked(
    level: _Blocks, lamps: Lamps, slopes: Float32Array, rays: tuple[Float32Array, Float32Array],
    prices: Float32Array, smooth: float,
) -> tuple[Float32Array, Float32Array]:  # fmt: skip
    """Return (6, h, w) = A00, A01, A11, b0, b1, χ² of what each block asks of its slopes s, and (2, h, w) =
    A s + b, as `edges_kernel` takes them.

    A block asks for the slopes that leave least paint, and for those of the blocks beside it.
    """
    inside, (x, y) = level.labels != _NO_LABEL, rays
    normals, scale = _normals(slopes, rays)
    along = np.stack([normals[..., 0] - x * normals[..., 2], normals[..., 1] - y * normals[..., 2]], axis=2)
    lights = np.linalg.inv(lamps.inverse).astype(np.float32)
    expected = np.maximum(normals @ lights.T, _LEAST_LIGHT)
    paint = np.log(np.maximum(level.light, _TINY) / expected)
    of_slopes = [  # derivatives of the expected log light by the two slopes
        scale[..., None] * ((lights[:, k] - ray[..., None] * lights[:, 2]) / expected - along[..., k, None])
        for k, ray in enumerate(rays)
    ]
    price = prices[np.where(inside, level.labels, 0)]
    weighed = (price @ paint[..., None])[..., 0]
    chi = (weighed * paint).sum(axis=2)
    left = np.where(level.is_lit, (1.0 + chi) ** -2, 0.0)
    p, q = ((price @ each[..., None])[..., 0] for each in of_slopes)
    count = _beside(inside.astype(np.float32))
    around = _beside(np.moveaxis(slopes, 0, 2) * inside[..., None]) / np.maximum(count, 1.0)[..., None]
    towards = (around - np.moveaxis(slopes, 0, 2)) * (count > 0)[..., None]
    out = np.zeros((6, *inside.shape), np.float32)
    s2 = smooth * scale**2
    out[0] = s2 * (1.0 + x * x - along[..., 0] ** 2)
    out[1] = s2 * (x * y - along[..., 0] * along[..., 1])
    out[2] = s2 * (1.0 + y * y - along[..., 1] ** 2)
    out[3] = out[0] * towards[..., 0] + out[1] * towards[..., 1] + left * (p * paint).sum(axis=2)
    out[4] = out[1] * towards[..., 0] + out[2] * towards[..., 1] + left * (q * paint).sum(axis=2)
    out[0] += left * (p * of_slopes[0]).sum(axis=2) + _DAMPING
    out[1] += left * (p * of_slopes[1]).sum(axis=2)
    out[2] += left * (q * of_slopes[1]).sum(axis=2) + _DAMPING
    out[5] = left * chi
    out *= inside
    targets = out[[0, 1]] * slopes[0] + out[[1, 2]] * slopes[1] + out[[3, 4]]
    return out, targets


def _gains(
    blocks: _Blocks, slopes: Float32Array, of_pixels: RayGrid, lamps: Lamps
) -> tuple[FloatArray, FloatArray]:
    """Return (h, w, 3), what turns each block's light into its surface's, and (h, w), the turn in degrees.

    Blocks that a lamp misses have the mean gain of those beside them, of their material.
    """
    normals, _ = _normals(slopes, blocks.rays(of_pixels))
    lights, lit = np.linalg.inv(lamps.inverse), blocks.is_lit
    gains, turns = np.ones(blocks.light.shape), np.zeros(lit.shape)
    gains[lit] = np.maximum(normals[lit] @ lights.T, _LEAST_LIGHT) / blocks.light[lit]
    own = blocks.light[lit] @ lamps.inverse.T
    cosines = (normals[lit] * own).sum(axis=1) / np.linalg.norm(own, axis=1)
    turns[lit] = np.degrees(np.arccos(cosines.clip(-1.0, 1.0)))
    for m in np.unique(blocks.labels[blocks.labels != _NO_LABEL]):
        observed = lit & (blocks.labels == m)
        count = _beside(observed.astype(np.float64))
        missing = (blocks.labels == m) & ~lit & (count > 0)
        gains[missing] = _beside(gains * observed[..., None])[missing] / count[missing, None]
    return gains, turns


def _rms_around(turns: FloatArray) -> FloatArray:
    """(h, w), the root mean square of turns around each block, or its own where that is more."""
    mean = uniform_filter(turns**2, 2 * _AROUND + 1, mode="constant")
    return np.maximum(turns, np.sqrt(np.maximum(mean, 0.0)))


def _between(gains: FloatArray, blocks: _Blocks, labels: MaterialLabels, mask: Mask) -> Float32Array:
    """(h, w, 3), gains of pixels, interpolated between the middles of blocks, within each material."""
    out = np.ones((*mask.shape, 3), np.float32)
    for m in np.unique(blocks.labels[blocks.labels != _NO_LABEL]):
        own = (blocks.labels == m).astype(np.float32)[..., None]
        observed = np.concatenate([own * gains, own], axis=2, dtype=np.float32)
        for axis, size in enumerate(mask.shape):
            share, first, second = _middles(size, blocks.factor, observed.shape[axis])
            share = share.reshape(-1, 1, 1) if axis == 0 else share.reshape(1, -1, 1)
            observed = observed.take(first, axis) * (1.0 - share) + observed.take(second, axis) * share
        inside = mask & (labels == m) & (observed[..., 3] > _TINY)
        out[inside] = observed[inside, :3] / observed[inside, 3:]
    return out


def _middles(size: int, factor: int, blocks: int) -> tuple[Float32Array, IntArray, IntArray]:
    """Return, for each pixel of a line, how far it is from one block's middle to the next's, and both."""
    x = (np.arange(size) + 0.5) / factor - 0.5
    first = np.floor(x).astype(np.int64)
    share = (x - first).astype(np.float32)
    return share, np.maximum(first, 0), np.minimum(first + 1, blocks - 1)
