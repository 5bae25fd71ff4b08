"""Colour that changes inside a material: freckles on skin, hair that is dark and darker, worn dye.

More of one pigment makes a material darker along one line, log ρ + t d: melanin takes most of the blue and
least of the red (tsumura1999). With d known, the unit length of the normal tells t, one number a pixel. The
line is the one that leaves the smoothest normals: what is printed on a surface is no relief. Darkening that
is grey (d equal in all bands) turns no normal, and is where the search starts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from vntoolkit.arrays import FloatArray, Mask, Points, Vector3
from vntoolkit.materials.mixtures import CHUNK_PX
from vntoolkit.materials.reflectance import CAP, Lamps, bias_of_noise
from vntoolkit.native import njit

Single = npt.NDArray[np.float32]
_PAIRS = 10_000  # of neighbouring blocks that tell how rough normals are
_FEWEST_PAIRS = 1000  # fewer show lines where there are none
_STEEP = np.float32(0.08)  # difference of two neighbours' normals from which a larger one hardly counts more
# Share of the roughness that a line takes, times the root of the pairs: up to 2.4 of yarns, 6 of skin.
_CLEAR = 4.0
_LEAST_TAKEN = 0.1  # of what it takes from the darkest band: a line along one band alone is its noise
_EVALUATIONS = 35
_SPREAD, _PIGMENT_SPREAD = 0.04, 0.3  # of lengths, and of t
_INDEPENDENT_PX = 64.0  # pixels that share their errors
_KNOWN_BEFORE = 0.5  # standard deviation of log ρ as it was found before
_FIT_PIXELS = 10_000  # of the material
_FIT_ROUNDS, _LONGEST_STEP = 12, 0.1
_FIRST_STEP = 0.3
# Spread of the lengths for other reasons (gloss, light between folds) over that of t, and the most of t, with
# d of length 1. The line shows where t is free; pixels are corrected with care: eyes and lips are not of it.
_TRUST_OF_SEARCH = (np.float32(0.3), np.float32(1.5))
_TRUST = (np.float32(0.5), np.float32(0.5))
_LEAST_SHARE = np.float32(0.06)  # of the strongest lamp's light: less may be shadow, which tells nothing
# Of the kernels, which count in single precision.
_NONE, _TINY, _ONE = np.float32(0.0), np.float32(1e-12), np.float32(1.0)
_QUARTER, _HALF, _SIXTH, _OF_FOURTH = np.float32(0.25), np.float32(0.5), np.float32(1 / 6), np.float32(1 / 24)


def pigment_of(
    contributions: FloatArray, chosen: Mask, log: Vector3, lamps: Lamps, of_others: Vector3 | None = None
) -> tuple[Vector3, Vector3] | None:
    """Return d (3,), of length 1, along which a material changes, and log ρ; None where it hardly does.

    contributions: (h, w, 3). chosen: (h, w), lit pixels of the material. log: (3,), of its reflectance as of
    one colour. of_others: (3,), the line of the subject's other materials, taken where too few pixels tell.
    """
    pixels = contributions[chosen]
    pixels = pixels[:: max(1, len(pixels) // _FIT_PIXELS)]
    factor = max(2, round(float(np.sqrt(_pairs(chosen) / _PAIRS))))
    s, mask = _means_of_blocks(contributions, chosen, factor)
    if _pairs(mask) < _FEWEST_PAIRS:
        return None if of_others is None else (of_others, _of_least_pigment(log, pixels, lamps, of_others))
    chunks, pairs_of = _in_chunks(s, mask)
    matrix, origin = lamps.inverse * np.exp(-log), lamps.inverse @ lamps.haze
    squared = np.float32(1.0 + bias_of_noise(np.exp(-log), lamps.inverse, lamps.mixing / factor))
    known = matrix.astype(np.float32), origin.astype(np.float32)

    def roughness(ends: Any) -> float:
        return float(_roughness(chunks, pairs_of, *known, _along(ends).astype(np.float32), squared))

    grey = np.ones(2)
    first = grey + _FIRST_STEP * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {"maxfev": _EVALUATIONS, "initial_simplex": first}
    found = minimize(roughness, grey, method="Nelder-Mead", options=options)  # neldermead1965
    direction = _along(found.x)
    takes = (1.0 - found.fun / roughness(grey)) * np.sqrt(_pairs(mask))
    is_pigment = direction.min() > _LEAST_TAKEN * direction.max() and takes > _CLEAR
    if not is_pigment:
        return None
    return direction, _of_least_pigment(log, pixels, lamps, direction)


def _pairs(chosen: Mask) -> int:
    """Number of pixels (h, w) that are chosen together with the one to their left."""
    return int((chosen[:, 1:] & chosen[:, :-1]).sum())


def _means_of_blocks(contributions: FloatArray, chosen: Mask, factor: int) -> tuple[FloatArray, Mask]:
    """Return the means over blocks of factor × factor pixels, and the blocks of which every pixel is chosen.

    Paint is coarser than noise. In single pixels the line along which normals are smoothest is half that of
    the noisiest lamp, and of a red yarn, dark in two bands, it passes for a pigment.
    """
    h, w = (n // factor for n in chosen.shape)
    parts = np.s_[: h * factor, : w * factor]
    whole = chosen[parts].reshape(h, factor, w, factor).all(axis=(1, 3))
    places = ((i, j) for i in range(factor) for j in range(factor))
    total = sum(contributions[parts][i::factor, j::factor] for i, j in places)
    return np.asarray(total / factor**2), np.ascontiguousarray(whole)


def _in_chunks(s: FloatArray, mask: Mask) -> tuple[Single, Single]:
    """Return contributions (n, 3, CHUNK_PX) of the pixels in the mask, (h, w), row by row, then zeros.

    And (n · CHUNK_PX,), 1 where a pixel is beside the one before it, else 0.
    """
    beside = np.zeros(mask.shape, np.float32)
    beside[:, 1:] = mask[:, 1:] & mask[:, :-1]
    empty = -int(mask.sum()) % CHUNK_PX
    chunks = np.pad(s[mask].astype(np.float32), ((0, empty), (0, 0))).reshape(-1, CHUNK_PX, 3)
    return np.ascontiguousarray(chunks.transpose(0, 2, 1)), np.pad(beside[mask], (0, empty))


def _of_least_pigment(log: Vector3, s: Points, lamps: Lamps, direction: Vector3) -> Vector3:
    """Return log ρ (3,) again: pixels whose length pigment would change tell less of it.

    s: (n, 3), contributions. Geman and McClure's weights, about the log ρ that was found before.
    """
    prior = np.eye(3) * (_INDEPENDENT_PX / (len(s) * _KNOWN_BEFORE**2))
    found = log.copy()
    for _ in range(_FIT_ROUNDS):
        shares = s * np.exp(-found)
        normals = (shares - lamps.haze) @ lamps.inverse.T
        lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-6)
        slopes = -(normals / lengths[:, None] @ lamps.inverse) * shares
        error, variance = lengths - 1.0, _SPREAD**2 + (slopes @ direction * _PIGMENT_SPREAD) ** 2
        weights = 1.0 / variance / (1.0 + error**2 / variance / CAP**2) ** 2 / len(s)
        matrix = (slopes * weights[:, None]).T @ slopes + prior
        step = np.linalg.solve(matrix, prior @ (log - found) - (slopes * weights[:, None]).T @ error)
        found = found + step.clip(-_LONGEST_STEP, _LONGEST_STEP)
    return np.asarray(found)


def _along(ends: Any) -> Vector3:
    """(3,) of length 1, from the first and the last over the second component."""
    direction = np.array([ends[0], 1.0, ends[1]])
    return np.asarray(direction / np.linalg.norm(direction))


@njit(cache=True, fastmath=True, error_model="numpy")
def _roughness(s: Any, pairs: Any, matrix: Any, origin: Any, d: Any, squared: Any) -> float:
    """Mean of a robust squared difference of normals over neighbours; see `take_without_pigment`.

    s: (n, 3, CHUNK_PX), contributions. pairs: (n · CHUNK_PX,), 1 where a pixel is beside the one before it,
    else 0. squared: the square of the length to expect, with noise. All in single precision.
    """
    scalars = _scalars(matrix, origin, d)
    normals, work = np.empty((3, pairs.size), np.float32), np.empty(3 * CHUNK_PX, np.float32)
    for i in range(len(s)):
        for k in range(3):
            for j in range(CHUNK_PX):
                work[k * CHUNK_PX + j] = s[i, k, j]
        _take_normals(*scalars, squared, work)
        for k in range(3):
            for j in range(CHUNK_PX):
                normals[k, i * CHUNK_PX + j] = work[k * CHUNK_PX + j]
    return _mean_step(normals, pairs)


@njit(cache=True, fastmath=True, error_model="numpy")
def _take_normals(matrix: Any, origin: Any, line: Any, squared: Any, work: Any) -> None:
    """Replace contributions, as in `_take_pigment`, by normals without pigment."""
    for j in range(CHUNK_PX):
        s = (work[j], work[CHUNK_PX + j], work[2 * CHUNK_PX + j])
        t = _amount(s, matrix, origin, line, squared, _TRUST_OF_SEARCH)
        _, n0, n1, n2 = _normal(t, s, matrix, origin, line)
        over = _ONE / (np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + _TINY)
        work[j], work[CHUNK_PX + j], work[2 * CHUNK_PX + j] = n0 * over, n1 * over, n2 * over


@njit(cache=True, fastmath=True, error_model="numpy")
def _mean_step(normals: Any, pairs: Any) -> float:
    steep, total, count = _STEEP * _STEEP, _NONE, _NONE
    for u in range(1, len(pairs)):
        d0 = normals[0, u] - normals[0, u - 1]
        d1 = normals[1, u] - normals[1, u - 1]
        d2 = normals[2, u] - normals[2, u - 1]
        apart = d0 * d0 + d1 * d1 + d2 * d2
        total += pairs[u] * apart / (apart + steep)
        count += pairs[u]
    return float(total / max(count, _ONE))


@njit(cache=True, fastmath=True, error_model="numpy")
def take_without_pigment(
    rgb: Any, matrix: Any, origin: Any, d: Any, split: Any, merge: Any, work: Any, out: Any
) -> None:
    """Fill out (n, 3) with what pixels of colours rgb (n, 3) would show in the rig's material.

    matrix: (3, 3), L⁻¹ / ρ of their material, origin: (3,), L⁻¹ w, d: (3,), the line of the pigment. merge:
    (3, 3), from contributions as they are to colours without ρ. work: (3 · CHUNK_PX,), for what is underway.
    All in single precision.
    """
    c00, c01, c02 = split[0]
    c10, c11, c12 = split[1]
    c20, c21, c22 = split[2]
    m00, m01, m02 = merge[0]
    m10, m11, m12 = merge[1]
    m20, m21, m22 = merge[2]
    scalars = _scalars(matrix, origin, d)
    for start in range(0, len(rgb), CHUNK_PX):
        stop = min(len(rgb) - start, CHUNK_PX)
        for j in range(stop):
            r, g, b = rgb[start + j, 0], rgb[start + j, 1], rgb[start + j, 2]
            work[j] = c00 * r + c01 * g + c02 * b
            work[CHUNK_PX + j] = c10 * r + c11 * g + c12 * b
            work[2 * CHUNK_PX + j] = c20 * r + c21 * g + c22 * b
        _take_pigment(*scalars, work)
        for j in range(stop):
            x, y, z = work[j], work[CHUNK_PX + j], work[2 * CHUNK_PX + j]
            out[start + j, 0] = m00 * x + m01 * y + m02 * z
            out[start + j, 1] = m10 * x + m11 * y + m12 * z
            out[start + j, 2] = m20 * x + m21 * y + m22 * z


@njit(cache=True, fastmath=True, error_model="numpy")
def _take_pigment(matrix: Any, origin: Any, line: Any, work: Any) -> None:
    """Replace contributions, at fixed places so that many are done at a time, by those without pigment."""
    for j in range(CHUNK_PX):
        s = (work[j], work[CHUNK_PX + j], work[2 * CHUNK_PX + j])
        t = _amount(s, matrix, origin, line, _ONE, _TRUST)
        x, _, _, _ = _normal(t, s, matrix, origin, line)
        work[j], work[CHUNK_PX + j], work[2 * CHUNK_PX + j] = x


@njit(cache=True, fastmath=True, error_model="numpy")
def _scalars(matrix: Any, origin: Any, d: Any) -> Any:
    """Return matrix (3, 3), origin and d (3,) as tuples, which stay in registers."""
    m = matrix
    return (
        (m[0, 0], m[0, 1], m[0, 2], m[1, 0], m[1, 1], m[1, 2], m[2, 0], m[2, 1], m[2, 2]),
        (origin[0], origin[1], origin[2]),
        (d[0], d[1], d[2]),
    )


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def _amount(s: Any, matrix: Any, origin: Any, d: Any, squared: Any, trust: Any) -> Any:
    """Return t with which the normal of contributions s is of unit length; 0 where a lamp is missing.

    squared: the square of the length to expect, with noise. trust: spread of lengths for other reasons over
    that of t, and the most of t.
    """
    t = _step(_NONE, s, matrix, origin, d, squared, trust)  # no loop: only the innermost one is made SIMD
    t = _step(t, s, matrix, origin, d, squared, trust)
    t = _step(t, s, matrix, origin, d, squared, trust)
    first_two, most_of_two = min(s[0], s[1]), max(s[0], s[1])  # numba makes SIMD of two at a time
    least, most = min(first_two, s[2]), max(most_of_two, s[2])
    return t if least >= _LEAST_SHARE * most else _NONE


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def _step(t: Any, s: Any, matrix: Any, origin: Any, d: Any, squared: Any, trust: Any) -> Any:
    """Return t after a step of Gauss and Newton's."""
    x, n0, n1, n2 = _normal(t, s, matrix, origin, d)
    long = n0 * n0 + n1 * n1 + n2 * n2
    length = np.sqrt(long) + _TINY
    error = (long - squared) / (length + _ONE)
    slope = (n0 * matrix[0] + n1 * matrix[3] + n2 * matrix[6]) * x[0] * d[0]
    slope += (n0 * matrix[1] + n1 * matrix[4] + n2 * matrix[7]) * x[1] * d[1]
    slope += (n0 * matrix[2] + n1 * matrix[5] + n2 * matrix[8]) * x[2] * d[2]
    slope /= -length
    t = slope * (slope * t - error) / (slope * slope + trust[0] * trust[0])
    return min(max(t, -trust[1]), trust[1])


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def _normal(t: Any, s: Any, matrix: Any, origin: Any, d: Any) -> Any:
    """Return s ∘ exp(−t d), a tuple, and the normal's three components, matrix times that, less origin."""
    x0, x1, x2 = (
        s[0] * exponential(-t * d[0]),
        s[1] * exponential(-t * d[1]),
        s[2] * exponential(-t * d[2]),
    )
    return (
        (x0, x1, x2),
        matrix[0] * x0 + matrix[1] * x1 + matrix[2] * x2 - origin[0],
        matrix[3] * x0 + matrix[4] * x1 + matrix[5] * x2 - origin[1],
        matrix[6] * x0 + matrix[7] * x1 + matrix[8] * x2 - origin[2],
    )


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def exponential(x: Any) -> Any:
    """Return exp(x), to 3e-4 where |x| is at most 1.5, 1e-6 up to 0.5: a short series."""
    y = _QUARTER * x
    y = _ONE + y * (_ONE + y * (_HALF + y * (_SIXTH + y * _OF_FOURTH)))
    y *= y
    return y * y
