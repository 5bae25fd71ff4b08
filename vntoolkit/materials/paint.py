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
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, Points
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.slope_grid import (
    FLATTEST_Z,
    NO_STEP,
    STEEPEST,
    RayGrid,
    edges_kernel,
    ray_at,
    ray_grid,
    slopes_kernel,
    weights_kernel,
)
from vntoolkit.materials.pixels import SERIES
from vntoolkit.materials.reflectance import Lamps, lamps_from_response
from vntoolkit.materials.split_frame import block_size, blocks_moved, cells_of
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.levelling import Box
from vntoolkit.photometry.response import LightResponse
from vntoolkit.solvers import grid_hierarchy, solve_grid

Single = npt.NDArray[np.float32]
MaterialLabels = npt.NDArray[np.uint8]
_BLOCKS = 60_000  # of the subject; noise is finer than these, and freckles are not
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
_SMOOTH = np.float32(7.0)
_STEP_SOFTNESS = 10.0  # χ² at which a depth gradient counts a quarter, as it crosses a step in depth
_DAMPING = np.float32(0.02)  # of a step; keeps the equations definite
_AROUND = 2  # blocks to each side that share the doubt of a turn
_LEAST_SHARE = np.float32(0.06)  # of the strongest lamp's light: less may be shadow, which tells nothing
_LEAST_LIGHT, _TINY = np.float32(0.02), np.float32(1e-9)
_NONE, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_DEGREES = np.float32(np.degrees(1.0))
_ARCSINE = np.float32(1.0 / 6.0), np.float32(3.0 / 40.0)
_NO_LABEL = 255
_LEAST_COSINE = np.float32(np.cos(np.radians(45.0)))  # no paint of skin turns a normal farther
_GUESSED = 3  # for `weights_kernel` a block of two lights, whose softness is another
_DOWN, _RIGHT = (-1, 1, 0, 0), (0, 0, -1, 1)  # to those beside a block


def without_paint(
    frame: LinearFrame,
    labels: MaterialLabels,
    mask: Mask,
    response: LightResponse,
    rho: Points,
    lines: Points,
    camera: Camera | None,
    out: Single,
    box: Box,
    before: Surface | None = None,
) -> tuple[LinearFrame, Single, Surface]:
    """Return the frame as it would be without the paint of its subject, a mask (h, w).

    And (h, w), by how many degrees that turns normals: the paint may be relief, so far are they in doubt.
    And the subject's surface.

    labels: (h, w), numbers of the materials. rho: (m, 3), their reflectances. lines: (m, 3), of length 1,
    their pigments; one of 0 has no paint. camera: None for orthographic. out: (h, w, 3), which the frame's
    colours are written to. box: rows and columns that hold the subject; none are written beyond. before: the
    surface in the frame before: the search goes on from it, unless the subject has moved far since it began.
    """
    lamps = lamps_from_response(response, np.zeros(3))
    rgb, merge = frame.rgb[box], np.linalg.inv(lamps.split)
    if before is not None and before.box != box:
        before = None
    factor = block_size(mask, _BLOCKS) if before is None else before.factor
    blocks = _blocks_of(rgb, labels[box], mask[box], lamps, rho, lines, factor, box)
    cells = cells_of(rgb[factor // 2 :: factor, factor // 2 :: factor])
    if before is not None:
        if blocks_moved(before.cells, cells) > _NEAR_BLOCKS:
            before = None
        else:
            cells = before.cells
    lights = np.linalg.inv(lamps.inverse).astype(np.float32)
    surface = _surface_of(blocks, lamps, lines, ray_grid(camera), before)
    rays, inverse = blocks.rays(ray_grid(camera)), lamps.inverse.astype(np.float32)
    gains, turns = np.empty(blocks.light.shape, np.float32), np.empty(blocks.labels.shape, np.float32)
    _fill_gains(blocks.light, blocks.labels, surface.slopes, rays, lights, inverse, gains, turns)
    _spread(blocks.light, blocks.labels, gains)
    doubt = _doubt(turns)
    turned = np.zeros(mask.shape, np.float32)
    _take_out(
        rgb, labels[box], mask[box], lamps.split.astype(np.float32), merge.astype(np.float32), gains, doubt,
        blocks.labels, blocks.factor, out[box], turned[box],
    )  # fmt: skip
    found = LinearFrame(rgb=out, clipped=frame.clipped, number=frame.number)
    return found, turned, surface._replace(box=box, cells=cells)


class Surface(NamedTuple):
    """Of blocks of factor × factor pixels.

    depth: (h, w). slopes: (2, h, w). known: (h, w), where they are. box: rows and columns of the frame, and
    cells: what they showed when it was found from coarse to fine, by which movement is measured.
    """

    depth: Single
    slopes: Single
    known: Mask
    factor: int
    box: Box = (slice(0), slice(0))
    cells: Single = np.empty((0, 0, 3), np.float32)


class _Blocks(NamedTuple):
    """Blocks of factor × factor pixels.

    light: (h, w, 3), over ρ, without ambient light; 0 where a lamp is missing. labels: (h, w), the material
    of each, 255 for none. left, top: pixels before the first.
    """

    light: Single
    labels: MaterialLabels
    factor: int
    left: int = 0
    top: int = 0

    @property
    def lit(self) -> MaterialLabels:
        """(h, w), 7 where all three lamps arrive, else 0."""
        return (self.light[..., 0] > 0).view(np.uint8) * np.uint8(ALL_LIT)

    def rays(self, rays: RayGrid) -> RayGrid:
        """Return the rays through the middles of blocks, of those through pixels."""
        side, middle = np.float32(self.factor), np.float32((self.factor - 1) / 2)
        return RayGrid(
            (rays.centre_u - np.float32(self.left) - middle) / side,
            (rays.centre_v - np.float32(self.top) - middle) / side,
            rays.per_pixel_u * side,
            rays.per_pixel_v * side,
        )

    def halved(self) -> _Blocks:
        """Return blocks of twice the side, of the material that is most often in them."""
        h, w = (-(-n // 2) for n in self.labels.shape)
        light, of = np.zeros((h, w, 3), np.float32), np.full((h, w), _NO_LABEL, np.uint8)
        _halve(self.light, self.labels, light, of)
        return _Blocks(light, of, 2 * self.factor, self.left, self.top)


def _blocks_of(
    rgb: Single, labels: MaterialLabels, mask: Mask, lamps: Lamps, rho: Points, lines: Points,
    factor: int, box: Box,
) -> _Blocks:  # fmt: skip
    h, w = (-(-n // factor) for n in mask.shape)
    light, of = np.zeros((h, w, 3), np.float32), np.full((h, w), _NO_LABEL, np.uint8)
    split, haze = lamps.split.astype(np.float32), lamps.haze.astype(np.float32)
    over, has_paint = (1.0 / np.asarray(rho)).astype(np.float32), np.asarray(lines).any(axis=1)
    _take_blocks(rgb, labels, mask, factor, split, over, haze, has_paint, light, of)
    return _Blocks(light, of, factor, box[1].start, box[0].start)


def _surface_of(
    blocks: _Blocks, lamps: Lamps, lines: Points, of_pixels: RayGrid, start: Surface | None
) -> Surface:
    """The surface whose paint is least. start: from where the search goes on; None for coarse to fine."""
    lights, inverse = np.linalg.inv(lamps.inverse).astype(np.float32), lamps.inverse.astype(np.float32)
    prices = np.array([_price(line) for line in np.asarray(lines)], np.float32)
    pyramid, softness, steps = [blocks], np.float32(_STEP_SOFTNESS), 1
    if start is None:
        steps = _STEPS
        for _ in range(_LEVELS):
            pyramid.append(pyramid[-1].halved())
        half = tuple(-(-n // 2) for n in pyramid[-1].labels.shape)
        flat = np.zeros((3, *half), np.float32)
        start = Surface(flat[0], flat[1:], np.zeros(half, np.bool_), 2 * pyramid[-1].factor)
        softness = np.float32(NO_STEP)  # the first depth must hold together before it may show steps
    for level in reversed(pyramid):
        shape, inside = level.labels.shape, level.labels != _NO_LABEL
        rays, times = level.rays(of_pixels), start.factor // level.factor
        depth, slopes = np.zeros(shape, np.float32), np.empty((2, *shape), np.float32)
        known = start.depth, start.slopes, start.known
        _begin(level.light, level.labels, inverse, rays, prices, known, times, depth, slopes)
        quadratics, targets = np.empty((6, *shape), np.float32), np.empty((2, *shape), np.float32)
        edges, right, agreement = np.empty((4, *shape), np.float32), *np.empty((2, *shape), np.float32)
        weights, lit = np.empty((4, *shape), np.float32), level.lit
        seen = lit
        if times == 1:  # the first depth of a block that is new is a guess, too
            seen = np.where(start.known, lit, np.minimum(lit, np.uint8(_GUESSED)))
        smooth = _SMOOTH / np.float32((level.factor // blocks.factor) ** 2)
        for _ in range(steps):
            _ask(level.light, level.labels, slopes, rays, lights, prices, smooth, quadratics, targets)
            weights_kernel(quadratics, seen, inside, slopes, depth, softness, np.float32(NO_STEP), weights)
            edges_kernel(quadratics, targets, weights, edges, right)
            depth = solve_grid(grid_hierarchy(edges), right, depth, _TOLERANCE, _CYCLES)
            slopes_kernel(depth, weights, np.float32(STEEPEST), slopes, agreement)
            softness, seen = np.float32(_STEP_SOFTNESS), lit
        start = Surface(depth, slopes, inside, level.factor)
    return start


def _price(line: FloatArray) -> FloatArray:
    """(3, 3), the inverse covariance of the log ρ of paint of a material with a pigment along a line (3,)."""
    along = np.outer(line, line)
    return np.asarray(along / _ALONG**2 + (np.eye(3) - along) / _ACROSS**2)


@njit(cache=True, parallel=True, error_model="numpy")
def _take_blocks(
    rgb: Any, labels: Any, mask: Any, factor: int, split: Any, over: Any, haze: Any, has_paint: Any, s: Any,
    of: Any,
) -> None:  # fmt: skip
    """Fill s (h, w, 3), the blocks' light over ρ without ambient light, and their materials."""
    h, w = of.shape
    for i in prange(h):
        for j in range(w):
            top, left = i * factor, j * factor
            bottom, right = min(top + factor, mask.shape[0]), min(left + factor, mask.shape[1])
            middle = (top + bottom) // 2, (left + right) // 2
            m = labels[middle]
            if not mask[middle] or not has_paint[m]:
                continue
            r, g, b, count = _NONE, _NONE, _NONE, 0
            for v in range(top, bottom):
                for u in range(left, right):
                    if mask[v, u] and labels[v, u] == m:
                        r, g, b, count = r + rgb[v, u, 0], g + rgb[v, u, 1], b + rgb[v, u, 2], count + 1
            if 2 * count <= factor * factor:
                continue
            of[i, j] = m
            share = _ONE / np.float32(count)
            most, least = _NONE, np.float32(np.inf)
            for k in range(3):
                x = (split[k, 0] * r + split[k, 1] * g + split[k, 2] * b) * share * over[m, k] - haze[k]
                s[i, j, k] = x
                most, least = max(most, x), min(least, x)
            if not least > _LEAST_SHARE * most:
                s[i, j] = _NONE


@njit(cache=True, inline="always", error_model="numpy")
def _times(matrix: Any, x: Any, y: Any, z: Any) -> Any:
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z,
    )


@njit(cache=True, parallel=True, error_model="numpy")
def _halve(light: Any, of: Any, out: Any, labels: Any) -> None:
    h, w = of.shape
    for i in prange(out.shape[0]):
        for j in range(out.shape[1]):
            most = 1
            for v in range(2 * i, min(2 * i + 2, h)):
                for u in range(2 * j, min(2 * j + 2, w)):
                    m, count, lit = of[v, u], 0, _NONE
                    r, g, b = _NONE, _NONE, _NONE
                    for y in range(2 * i, min(2 * i + 2, h)):
                        for x in range(2 * j, min(2 * j + 2, w)):
                            if of[y, x] == m != _NO_LABEL:
                                count += 1
                                r, g, b = r + light[y, x, 0], g + light[y, x, 1], b + light[y, x, 2]
                                lit += np.float32(light[y, x, 0] > _NONE)
                    if count > most:
                        most, labels[i, j] = count, m
                        share = _ONE / max(lit, _ONE)
                        out[i, j, 0], out[i, j, 1], out[i, j, 2] = share * r, share * g, share * b


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _begin(
    light: Any, of: Any, inverse: Any, rays: Any, prices: Any, before: Any, times: int, depth: Any, out: Any
) -> None:
    """Fill depth (h, w) and slopes (2, h, w) with those of a surface before, sloping inside its blocks.

    before: depth, slopes, and where they are known, of blocks so many times as large. From larger ones, and
    where the surface cannot be that of before, slopes are those of the light itself as far as its length is
    1, as without paint.
    """
    coarse, slope, known = before
    size, middle = np.float32(times), np.float32(0.5 * (times - 1))
    h, w = of.shape
    for v in prange(h):
        x0, y = ray_at(rays, v, 0)
        for u in range(w):
            out[0, v, u] = out[1, v, u] = _NONE
            if of[v, u] == _NO_LABEL:
                continue
            i, j = _known_near(known, v // times, u // times)
            if known[i, j]:
                aside, below = np.float32(u - j * times) - middle, np.float32(v - i * times) - middle
                depth[v, u] = size * coarse[i, j] + aside * slope[0, i, j] + below * slope[1, i, j]
                out[0, v, u], out[1, v, u] = slope[0, i, j], slope[1, i, j]
            x = x0 + rays.per_pixel_u * np.float32(u)
            n0, n1, n2 = _times(inverse, light[v, u, 0], light[v, u, 1], light[v, u, 2])
            length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + _TINY
            if times == 1 and known[i, j]:
                m0, m1, m2, _ = _normal(slope[0, i, j], slope[1, i, j], x, y)
                if n0 * m0 + n1 * m1 + n2 * m2 > _LEAST_COSINE * length:
                    continue
            along = _ONE / max(-(n2 + x * n0 + y * n1), np.float32(FLATTEST_Z) * length)
            grey = np.log(length)
            left = _ONE / (_ONE + grey * grey * prices[of[v, u]].sum())
            left = left * left if light[v, u, 0] > _NONE else _NONE
            left = left if known[i, j] else _ONE
            out[0, v, u] += left * (n0 * along - out[0, v, u])
            out[1, v, u] += left * (n1 * along - out[1, v, u])


@njit(cache=True)
def _known_near(known: Any, i: int, j: int) -> Any:
    """Return the place of a block that is known, (i, j) or one beside it; (i, j) where none is."""
    if not known[i, j]:
        for far in range(1, _REACH):
            for k in range(4):
                a, b = i + far * _DOWN[k], j + far * _RIGHT[k]
                if 0 <= a < known.shape[0] and 0 <= b < known.shape[1] and known[a, b]:
                    return a, b
    return i, j


@njit(cache=True, inline="always", error_model="numpy")
def _log_ratio(one: Any, other: Any) -> Any:
    """log(one / other) = 2 artanh z, by its series: to .001 up to a ratio of 4, beyond which paint hardly
    costs more.
    """
    z = (one - other) / (one + other)
    y = z * z
    return z * (SERIES[0] + y * (SERIES[1] + y * (SERIES[2] + y * (SERIES[3] + y * SERIES[4]))))


@njit(cache=True, inline="always", error_model="numpy")
def _normal(p: Any, q: Any, x: Any, y: Any) -> Any:
    """Return the unit normal of slopes along a ray (x, y, 1), and what makes it so short."""
    n2 = -_ONE - x * p - y * q
    s = _ONE / np.sqrt(p * p + q * q + n2 * n2)
    return p * s, q * s, n2 * s, s


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _ask(
    light: Any, of: Any, slopes: Any, rays: Any, lights: Any, prices: Any, smooth: Any, out: Any, targets: Any
) -> None:
    """Fill out (6, h, w) = A00, A01, A11, b0, b1, χ² of what each block asks of its slopes s;
    targets (2, h, w) = A s + b; as `edges_kernel` takes them.

    A block asks for the slopes that leave least paint, and for those of the blocks beside it. light:
    (h, w, 3). prices: (m, 3, 3) of paint. smooth: weight of the blocks beside.
    """
    h, w = of.shape
    for v in prange(h):
        x0, y = ray_at(rays, v, 0)
        for u in range(w):
            m = of[v, u]
            if m == _NO_LABEL:
                for k in range(6):
                    out[k, v, u] = _NONE
                targets[0, v, u] = targets[1, v, u] = _NONE
                continue
            x = x0 + rays.per_pixel_u * np.float32(u)
            p, q = slopes[0, v, u], slopes[1, v, u]
            n0, n1, n2, s = _normal(p, q, x, y)
            along_p, along_q = n0 - x * n2, n1 - y * n2
            count, sum_p, sum_q = _NONE, _NONE, _NONE
            for k in range(4):
                i, j = np.int64(v) + _DOWN[k], u + _RIGHT[k]
                if 0 <= i < h and 0 <= j < w and of[i, j] != _NO_LABEL:
                    count, sum_p, sum_q = count + _ONE, sum_p + slopes[0, i, j], sum_q + slopes[1, i, j]
            towards_p, towards_q = _NONE, _NONE
            if count > _NONE:
                towards_p, towards_q = sum_p / count - p, sum_q / count - q
            s2 = smooth * s * s
            a00 = s2 * (_ONE + x * x - along_p * along_p)
            a01 = s2 * (x * y - along_p * along_q)
            a11 = s2 * (_ONE + y * y - along_q * along_q)
            b0, b1 = a00 * towards_p + a01 * towards_q, a01 * towards_p + a11 * towards_q
            e0, e1, e2 = _times(lights, n0, n1, n2)
            e0, e1, e2 = max(e0, _LEAST_LIGHT), max(e1, _LEAST_LIGHT), max(e2, _LEAST_LIGHT)
            s0, s1, s2 = max(light[v, u, 0], _TINY), max(light[v, u, 1], _TINY), max(light[v, u, 2], _TINY)
            d0, d1, d2 = _log_ratio(s0, e0), _log_ratio(s1, e1), _log_ratio(s2, e2)
            price = prices[m]
            k0, k1, k2 = _times(price, d0, d1, d2)
            chi = k0 * d0 + k1 * d1 + k2 * d2
            left = _ONE / (_ONE + chi)
            left = left * left if light[v, u, 0] > _NONE else _NONE
            g0, g1, g2 = (
                s * ((lights[0, 0] - x * lights[0, 2]) / e0 - along_p),
                s * ((lights[1, 0] - x * lights[1, 2]) / e1 - along_p),
                s * ((lights[2, 0] - x * lights[2, 2]) / e2 - along_p),
            )
            h0, h1, h2 = (
                s * ((lights[0, 1] - y * lights[0, 2]) / e0 - along_q),
                s * ((lights[1, 1] - y * lights[1, 2]) / e1 - along_q),
                s * ((lights[2, 1] - y * lights[2, 2]) / e2 - along_q),
            )
            y0, y1, y2 = _times(price, g0, g1, g2)
            z0, z1, z2 = _times(price, h0, h1, h2)
            a00 += left * (y0 * g0 + y1 * g1 + y2 * g2) + _DAMPING
            a01 += left * (y0 * h0 + y1 * h1 + y2 * h2)
            a11 += left * (z0 * h0 + z1 * h1 + z2 * h2) + _DAMPING
            b0 += left * (y0 * d0 + y1 * d1 + y2 * d2)
            b1 += left * (z0 * d0 + z1 * d1 + z2 * d2)
            out[0, v, u], out[1, v, u], out[2, v, u] = a00, a01, a11
            out[3, v, u], out[4, v, u], out[5, v, u] = b0, b1, left * chi
            targets[0, v, u], targets[1, v, u] = a00 * p + a01 * q + b0, a01 * p + a11 * q + b1


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _fill_gains(
    light: Any, of: Any, slopes: Any, rays: Any, lights: Any, inverse: Any, gains: Any, turns: Any
) -> None:
    """Fill (h, w, 3), what turns each block's light into its surface's, and (h, w), the turn in degrees."""
    h, w = of.shape
    for v in prange(h):
        x0, y = ray_at(rays, v, 0)
        for u in range(w):
            gains[v, u, 0] = gains[v, u, 1] = gains[v, u, 2] = _ONE
            turns[v, u] = _NONE
            if not light[v, u, 0] > _NONE:
                continue
            x = x0 + rays.per_pixel_u * np.float32(u)
            n0, n1, n2, _ = _normal(slopes[0, v, u], slopes[1, v, u], x, y)
            m0, m1, m2 = _times(inverse, light[v, u, 0], light[v, u, 1], light[v, u, 2])
            cosine = (n0 * m0 + n1 * m1 + n2 * m2) / np.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
            # twice the arcsine of half the chord, by its series: to .1 degrees up to 60
            half = _HALF * np.sqrt(max(_TWO - _TWO * cosine, _NONE))
            turns[v, u] = (
                _DEGREES * _TWO * half * (_ONE + half * half * (_ARCSINE[0] + half * half * _ARCSINE[1]))
            )
            e = _times(lights, n0, n1, n2)
            for k in range(3):
                gains[v, u, k] = max(e[k], _LEAST_LIGHT) / light[v, u, k]


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _doubt(turns: Any) -> Any:
    """(h, w), the root mean square of turns around each block, or its own where that is more."""
    h, w = turns.shape
    squares, out = np.zeros((h, w + 2 * _AROUND), np.float32), np.empty((h, w), np.float32)
    for v in prange(h):
        for u in range(w):
            squares[v, _AROUND + u] = turns[v, u] * turns[v, u]
    share = _ONE / np.float32((2 * _AROUND + 1) ** 2)
    for v in prange(h):
        total = np.zeros(w + 2 * _AROUND, np.float32)
        for a in range(max(v - _AROUND, 0), min(v + _AROUND + 1, h)):
            row = squares[a]
            for u in range(len(total)):
                total[u] += row[u]
        for u in range(w):
            mean = total[u]
            for shift in range(1, 2 * _AROUND + 1):
                mean += total[u + shift]
            out[v, u] = max(turns[v, u], np.sqrt(mean * share))
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def _spread(light: Any, of: Any, gains: Any) -> None:
    """Fill the gains of blocks that a lamp misses with the mean of those beside them."""
    h, w = of.shape
    for v in prange(h):
        for u in range(w):
            if of[v, u] == _NO_LABEL or light[v, u, 0] > _NONE:
                continue
            count, r, g, b = _NONE, _NONE, _NONE, _NONE
            for k in range(4):
                i, j = np.int64(v) + _DOWN[k], u + _RIGHT[k]
                if 0 <= i < h and 0 <= j < w and of[i, j] == of[v, u] and light[i, j, 0] > _NONE:
                    r, g, b = r + gains[i, j, 0], g + gains[i, j, 1], b + gains[i, j, 2]
                    count += _ONE
            if count > _NONE:
                gains[v, u, 0], gains[v, u, 1], gains[v, u, 2] = r / count, g / count, b / count


@njit(cache=True, error_model="numpy")
def _between(count: int, blocks: int, factor: int) -> Any:
    """Return, for each pixel of a line, how far it is from one block's middle to the next's, and both."""
    share = np.empty(count, np.float32)
    first, second = np.empty(count, np.int64), np.empty(count, np.int64)
    for u in range(count):
        x = (np.float32(u) + _HALF) / np.float32(factor) - _HALF
        block = int(np.floor(x))
        share[u] = x - np.float32(block)
        first[u], second[u] = max(block, 0), min(block + 1, blocks - 1)
    return share, first, second


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _take_out(
    rgb: Any, labels: Any, mask: Any, split: Any, merge: Any, gains: Any, turns: Any, of: Any, factor: int,
    out: Any, turned: Any,
) -> None:  # fmt: skip
    """Fill out (h, w, 3) and turned (h, w). Between the middles of blocks paint is interpolated, within each
    material.
    """
    h, w = mask.shape
    rows, columns = of.shape
    down, above, under = _between(h, rows, factor)
    across, before, after = _between(w, columns, factor)
    for v in prange(h):
        y, top, below = down[v], above[v], under[v]
        middles, of_both = np.empty((columns, 3), np.float32), np.empty(columns, np.uint8)
        for j in range(columns):  # between two rows of blocks
            of_both[j] = of[top, j] if of[top, j] == of[below, j] else _NO_LABEL
            for k in range(3):
                middles[j, k] = gains[top, j, k] + y * (gains[below, j, k] - gains[top, j, k])
        for u in range(w):
            red, green, blue = rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2]
            out[v, u, 0], out[v, u, 1], out[v, u, 2] = red, green, blue
            if not mask[v, u]:
                continue
            if of[v // factor, u // factor] != _NO_LABEL:
                turned[v, u] = turns[v // factor, u // factor]
            x, left, right, m = across[u], before[u], after[u], labels[v, u]
            if of_both[left] == m and of_both[right] == m:
                g0 = middles[left, 0] + x * (middles[right, 0] - middles[left, 0])
                g1 = middles[left, 1] + x * (middles[right, 1] - middles[left, 1])
                g2 = middles[left, 2] + x * (middles[right, 2] - middles[left, 2])
            else:
                total, g0, g1, g2 = _TINY, _NONE, _NONE, _NONE
                for i, share in ((top, _ONE - y), (below, y)):
                    for j, part in ((left, _ONE - x), (right, x)):
                        if of[i, j] == m:
                            weight = share * part
                            total += weight
                            g0 += weight * gains[i, j, 0]
                            g1 += weight * gains[i, j, 1]
                            g2 += weight * gains[i, j, 2]
                if not total > _TWO * _TINY:
                    continue
                g0, g1, g2 = g0 / total, g1 / total, g2 / total
            s0, s1, s2 = _times(split, red, green, blue)
            out[v, u, 0], out[v, u, 1], out[v, u, 2] = _times(merge, g0 * s0, g1 * s1, g2 * s2)
