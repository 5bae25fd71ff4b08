"""The light of each lamp on a subject in several materials, likeliest under all that is known of a pixel.

Divided by its reflectance, a pixel tells the light on it. Noise makes that uncertain, most in dark paint. So
does the mixture beside a seam: where a seam runs is known to a part of a pixel. But what is printed on a
surface is no relief: light goes on from the pixels around, as evenly as inside a material. And normals have
length 1, as far as they do not scatter. All of these are weighed by their variances. Arrays are planes of
pixels in single precision.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vntoolkit.arrays import ByteArray, Float32Array, Mask, Points
from vntoolkit.materials.mixtures import Seams, blur_weights, near_seams, reach_of_blur
from vntoolkit.materials.reflectance import CAP, Lamps
from vntoolkit.native import njit

_REACH_PX = 2  # over which pixels tell each other's light
_UNSURE = np.float32(0.3**2)  # variance of a pixel's share of a seam, over the product of both shares
_FEWEST = np.float32(1e-6)  # share of the pixels around that tell light
_NONE, _ONE, _TINY, _THIRD = np.float32(0.0), np.float32(1.0), np.float32(1e-12), np.float32(1 / 3)
_OF_CAP = np.float32(CAP**-2)
_ALONE = np.float32(1 / 3)  # pixels around are about as 12 of equal weight, of which 2 × 2 share their errors
_LEAST_SHARE = np.float32(0.01)


def likeliest_light(
    contributions: Float32Array, labels: ByteArray, mask: Mask, lamps: Lamps, rho: Points, seams: Seams
) -> Float32Array:
    """Return (h, w, 3), the light of the lamps, from their contributions (h, w, 3) to colours.

    labels: (h, w), numbers of the materials. mask: (h, w), pixels that tell others' light. rho: (m, 3).
    """
    reach, shape = reach_of_blur(seams.blur_px), labels.shape
    blur, around = (blur_weights(seams.blur_px, each).astype(np.float32) for each in (reach, _REACH_PX))
    mixtures, observed = np.empty((8, *shape), np.float32), np.empty((7, *shape), np.float32)
    _mix(labels, near_seams(labels, reach), rho.astype(np.float32), blur, mixtures)
    ambient, inverse = lamps.ambient.astype(np.float32), lamps.inverse.astype(np.float32)
    steps, tolerance = np.float32(seams.steps), np.float32(seams.tolerance)
    noise = np.asarray(seams.noise, np.float32) ** 2
    planes = np.ascontiguousarray(np.moveaxis(contributions, 2, 0))
    _observe(planes, mixtures, mask, ambient, inverse, noise, steps, tolerance, observed)
    out = np.empty((3, *shape), np.float32)
    _weigh(observed, around, ambient, inverse, steps, tolerance, out)
    return np.moveaxis(out, 0, 2)


@njit
def _mix(labels: Any, near: Any, rho: Any, weights: Any, out: Any) -> None:
    """Fill (8, h, w): mean reflectance under the blur, three planes; from the commonest material there to the
    next, three; and the shares of these two.
    """
    h, w = labels.shape
    reach = len(weights) // 2
    for v in range(h):
        shares = np.zeros(len(rho), np.float32)
        for u in range(w):
            own = labels[v, u]
            if not near[v, u]:
                for k in range(3):
                    out[k, v, u], out[3 + k, v, u] = rho[own, k], _NONE
                out[6, v, u], out[7, v, u] = _ONE, _NONE
                continue
            shares[:] = _NONE
            for a in range(-reach, reach + 1):
                for b in range(-reach, reach + 1):
                    m = labels[min(max(v + a, 0), h - 1), min(max(u + b, 0), w - 1)]
                    shares[m] += weights[a + reach] * weights[b + reach]
            first = int(shares.argmax())
            second = first
            for m in range(len(rho)):
                if m != first and (second == first or shares[m] > shares[second]):
                    second = m
            for k in range(3):
                mean = _NONE
                for m in range(len(rho)):
                    mean += shares[m] * rho[m, k]
                out[k, v, u], out[3 + k, v, u] = mean, rho[second, k] - rho[first, k]
            out[6, v, u], out[7, v, u] = shares[first], shares[second]


@njit
def _observe(
    s: Any, mixtures: Any, mask: Any, ambient: Any, inverse: Any, noise: Any, steps: Any, tolerance: Any,
    out: Any,
) -> None:  # fmt: skip
    """Fill (7, h, w): light, its relative variance by noise and mixture, and what a pixel tells others.

    Mean reflectances are moved along the line of the two materials mixed most, towards a normal of length 1:
    the length, itself uncertain, corrects the share (Gauss and Newton, twice).
    """
    for v in range(s.shape[1]):
        for u in range(s.shape[2]):
            d = mixtures[3, v, u], mixtures[4, v, u], mixtures[5, v, u]
            first, second = mixtures[6, v, u], mixtures[7, v, u]
            mean = mixtures[0, v, u], mixtures[1, v, u], mixtures[2, v, u]
            light, moved = (s[0, v, u], s[1, v, u], s[2, v, u]), _NONE
            if second >= _LEAST_SHARE:
                ratio = tolerance / (_UNSURE * first * second)
                for _ in range(2):
                    moved = _moved(moved, light, mean, d, ambient, inverse, ratio)
                    moved = min(max(moved, -second), first)
            total = _NONE
            for k in range(3):
                over = _ONE / (mixtures[k, v, u] + moved * mixtures[3 + k, v, u])
                y, step = s[k, v, u] * over, mixtures[3 + k, v, u] * over
                variance = noise[k] * over * over + _TINY
                variance = variance / max(y * y, variance) + _UNSURE * first * second * step * step
                out[k, v, u], out[3 + k, v, u] = y, variance
                total += variance
            out[6, v, u] = steps / (steps + total * _THIRD) if mask[v, u] else _NONE


@njit(forceinline=True)
def _moved(moved: Any, s: Any, mean: Any, d: Any, ambient: Any, inverse: Any, ratio: Any) -> Any:
    """Return how far along d a mean reflectance is moved, from what was found before."""
    q0, q1, q2 = (
        _ONE / (mean[0] + moved * d[0]), _ONE / (mean[1] + moved * d[1]), _ONE / (mean[2] + moved * d[2])
    )  # fmt: skip
    y0, y1, y2 = s[0] * q0, s[1] * q1, s[2] * q2
    length, g0, g1, g2 = _length(y0 - ambient[0], y1 - ambient[1], y2 - ambient[2], inverse)
    slope = -(g0 * y0 * d[0] * q0 + g1 * y1 * d[1] * q1 + g2 * y2 * d[2] * q2)
    return slope * (slope * moved - length + _ONE) / (slope * slope + ratio)


@njit(forceinline=True)
def _length(x0: Any, x1: Any, x2: Any, inverse: Any) -> Any:
    """Return the length of the normal L⁻¹ x, and its derivatives by x."""
    n0 = inverse[0, 0] * x0 + inverse[0, 1] * x1 + inverse[0, 2] * x2
    n1 = inverse[1, 0] * x0 + inverse[1, 1] * x1 + inverse[1, 2] * x2
    n2 = inverse[2, 0] * x0 + inverse[2, 1] * x1 + inverse[2, 2] * x2
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + _TINY
    return (
        length,
        (n0 * inverse[0, 0] + n1 * inverse[1, 0] + n2 * inverse[2, 0]) / length,
        (n0 * inverse[0, 1] + n1 * inverse[1, 1] + n2 * inverse[2, 1]) / length,
        (n0 * inverse[0, 2] + n1 * inverse[1, 2] + n2 * inverse[2, 2]) / length,
    )


@njit
def _weigh(
    observed: Any, weights: Any, ambient: Any, inverse: Any, steps: Any, tolerance: Any, out: Any
) -> None:
    """Fill (3, h, w), light moved towards that of the pixels around, then towards a normal of length 1.

    observed: of `_observe`. weights: of the pixels around, along a row; a pixel itself is taken out of them.
    """
    _, h, w = observed.shape
    reach = len(weights) // 2
    for v in range(h):
        columns = np.zeros((4, w + 2 * reach), np.float32)
        for a in range(max(v - reach, 0), min(v + reach + 1, h)):
            weight = weights[a - v + reach]
            for u in range(w):
                columns[3, reach + u] += weight * observed[6, a, u]
            for k in range(3):
                for u in range(w):
                    columns[k, reach + u] += weight * observed[6, a, u] * observed[k, a, u]
        sums = np.zeros((4, w), np.float32)
        for k in range(4):
            for b in range(len(weights)):
                for u in range(w):
                    sums[k, u] += weights[b] * columns[k, u + b]
        for u in range(w):
            y0, y1, y2 = observed[0, v, u], observed[1, v, u], observed[2, v, u]
            a0, a1, a2 = observed[3, v, u] + _TINY, observed[4, v, u] + _TINY, observed[5, v, u] + _TINY
            own = weights[reach] * weights[reach] * observed[6, v, u]
            share = _ONE / max(sums[3, u] - own, _FEWEST)
            m0, m1 = (sums[0, u] - own * y0) * share, (sums[1, u] - own * y1) * share
            m2 = (sums[2, u] - own * y2) * share
            b = steps + steps * _ALONE * (share - _ONE)  # the fewer pixels around tell it, the less is known
            t0, t1, t2 = m0 - y0, m1 - y1, m2 - y2
            u0, u1, u2 = m0 * m0 + _TINY, m1 * m1 + _TINY, m2 * m2 + _TINY
            apart = t0 * t0 / (u0 * (a0 + b)) + t1 * t1 / (u1 * (a1 + b)) + t2 * t2 / (u2 * (a2 + b))
            apart = _ONE + _OF_CAP * apart  # large at a crease, and at the edge of a shadow
            b *= apart * apart
            q0, q1, q2 = a0 / (a0 + b), a1 / (a1 + b), a2 / (a2 + b)
            y0, y1, y2 = y0 + t0 * q0, y1 + t1 * q1, y2 + t2 * q2
            d0, d1, d2 = b * q0 * u0, b * q1 * u1, b * q2 * u2
            length, g0, g1, g2 = _length(y0 - ambient[0], y1 - ambient[1], y2 - ambient[2], inverse)
            variance, wrong = tolerance + g0 * g0 * d0 + g1 * g1 * d1 + g2 * g2 * d2, _ONE - length
            falling = _ONE + _OF_CAP * wrong * wrong / variance
            move = wrong / (variance * falling * falling)
            out[0, v, u], out[1, v, u], out[2, v, u] = (
                y0 + d0 * g0 * move,
                y1 + d1 * g1 * move,
                y2 + d2 * g2 * move,
            )
