"""The light of each lamp on a subject in several materials, likeliest under all that is known of a pixel.

Divided by its reflectance, a pixel tells the light on it. Noise makes that uncertain, most in dark paint. So
does the mixture beside a seam: where a seam runs is known to a part of a pixel, and for each lamp apart,
since a Bayer pattern sees each elsewhere. But what is printed on a surface is no relief: light goes on from
the pixels around, as evenly as inside a material. And normals have length 1, as far as they do not scatter.
All of these are weighed by their variances. Loops go along rows, many pixels at a time: their arrays are
planes in single precision.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange

from vntoolkit.materials.mixtures import CHUNK_PX, fill_largest, fill_means, places_in_room, room_for
from vntoolkit.materials.pixels import scattering
from vntoolkit.materials.reflectance import CAP
from vntoolkit.native import njit

_STRIP = 32  # rows that are done together, with those around that reach into them
REACH_PX = 2  # over which pixels tell each other's light
_ROWS = 2 * REACH_PX + 1  # that are held at a time
_UNSURE = np.float32(0.3**2)  # variance of a pixel's share of a seam, over the product of both shares
_FEWEST = np.float32(1e-6)  # share of the pixels around that tell light
_NONE, _ONE, _TINY = np.float32(0.0), np.float32(1.0), np.float32(1e-12)
_OF_CAP = np.float32(CAP**-2)
_THIRD = np.float32(1 / 3)
_ALONE = np.float32(1 / 3)  # pixels around are about as 12 of equal weight, of which 2 × 2 share their errors
_LEAST_SHARE = np.float32(0.01)
_WEIGHT, _PLANES = 6, 7  # after light of three lamps and its variances
_LIGHT, _FIRST, _SECOND, _OWN, _OTHER = places_in_room()


@njit(cache=True, parallel=True, error_model="numpy")
def take_likeliest(
    rgb: Any, labels: Any, near: Any, mask: Any, of_lamps: Any, rho: Any, blur: Any, around: Any,
    variances: Any, noise: Any, box: Any, out: Any,
) -> None:  # fmt: skip
    """Fill out (h, w, 3), colours as they would be in the calibration material, within a box; 0 beyond.

    rgb: (h, w, 3). labels: (h, w). near: (h, w), pixels that may be mixtures. mask: (h, w), pixels that tell
    others' light. of_lamps: w, L⁻¹, split and its inverse. rho: (m, 3). blur, around: weights of
    `wide_weights`, of the picture's blur in full and REACH_PX to either side. variances: of the step of log
    light from pixel to pixel, and of normals' lengths. noise: (3,), variance of the lamps' contributions.
    Numbers in single precision.
    """
    top, bottom, left, right = box
    count = (bottom - top + _STRIP - 1) // _STRIP
    jump = scattering(count)
    for v in prange(len(labels)):
        if top <= v < bottom:
            out[v, :left] = _NONE
            out[v, right:] = _NONE
        else:
            out[v] = _NONE
    for i in prange(count):
        first = top + i * jump % count * _STRIP
        _take_strip(
            rgb, labels, near, mask, of_lamps, rho, blur, around, variances, noise, first,
            min(first + _STRIP, bottom), box, out,
        )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _take_strip(
    rgb: Any, labels: Any, near: Any, mask: Any, of_lamps: Any, rho: Any, blur: Any, around: Any,
    variances: Any, noise: Any, first: int, last: int, box: Any, out: Any,
) -> None:  # fmt: skip
    h = len(labels)
    above, below = max(first - REACH_PX, 0), min(last + REACH_PX, h)
    left, right = _extent(mask, max(above, box[0]), min(below, box[1]), box[2], box[3])
    for v in range(first, last):
        out[v, box[2] : left] = _NONE
        out[v, right : box[3]] = _NONE
    begin, end = left, right
    width = (end - begin + CHUNK_PX - 1) // CHUNK_PX
    rows = np.empty((_ROWS, width, _PLANES * CHUNK_PX), np.float32)  # the last ones, chunk by chunk
    columns = np.zeros((4, width * CHUNK_PX + 2 * REACH_PX), np.float32)
    line, room = np.empty((_PLANES + 4) * CHUNK_PX, np.float32), room_for(len(rho))
    room[1][:] = _ONE  # beyond the last pixel of a row, too, all is finite
    for ahead in range(first - REACH_PX, last + REACH_PX):
        now = rows[ahead % _ROWS]
        now[:] = _NONE
        for u in range(begin, end if above <= ahead < below else begin, CHUNK_PX):
            stop = min(u + CHUNK_PX, end)
            if not _any(mask[ahead, u:stop]):
                continue
            _split(rgb[ahead, u:stop], of_lamps[2], room[1])
            if _any(near[ahead, u:stop]):
                there = fill_means(labels, ahead, u, blur, rho, room)
                fill_largest(room[0], there, rho, room[1])
                _shift(of_lamps[0], of_lamps[1], variances[1], room[1])
            else:
                _fill_plain(labels[ahead, u:stop], rho, room[1])
            light = now[(u - begin) // CHUNK_PX]
            _weigh(mask[ahead, u:stop], noise, variances[0], room[1], light)
        v = ahead - REACH_PX
        if v < first:
            continue
        for i in range(width):
            _blur_columns(rows, v, i, around, columns)
        for i in range(width):
            u = begin + i * CHUNK_PX
            _copy(rows[v % _ROWS, i], line)
            _blur_row(columns, i * CHUNK_PX, around, line)
            _settle(line, of_lamps, around[3], variances)
            start = max(u, left)
            _merge(line[start - u :], of_lamps[3], out[v, start : min(u + CHUNK_PX, right)])


@njit(cache=True)
def _any(flags: Any) -> bool:
    found = False
    for j in range(len(flags)):
        found |= flags[j]
    return found


@njit(cache=True)
def _copy(values: Any, out: Any) -> None:
    for j in range(_PLANES * CHUNK_PX):
        out[j] = values[j]


@njit(cache=True)
def _extent(mask: Any, above: int, below: int, left: int, right: int) -> Any:
    """Return the first column in which rows of a mask have a pixel, and the one after the last."""
    first, last = right, left
    for v in range(above, below):
        u = left
        while u < first and not mask[v, u]:
            u += 1
        first, u = u, right
        while u > last and not mask[v, u - 1]:
            u -= 1
        last = u
    return min(first, last), last


@njit(cache=True)
def _fill_plain(labels: Any, rho: Any, work: Any) -> None:
    """Fill what `fill_means` and `fill_largest` do, for pixels of one material each."""
    for j in range(len(labels)):
        m = labels[j]
        work[_FIRST + j], work[_SECOND + j] = _ONE, _NONE
        for k in range(3):
            place = CHUNK_PX * k + j
            work[place] = work[_OWN + place] = work[_OTHER + place] = rho[m, k]


@njit(cache=True, fastmath=True, error_model="numpy")
def _split(rgb: Any, split: Any, work: Any) -> None:
    for k in range(3):
        s0, s1, s2 = split[k]
        for j in range(len(rgb)):
            work[_LIGHT + CHUNK_PX * k + j] = s0 * rgb[j, 0] + s1 * rgb[j, 1] + s2 * rgb[j, 2]


@njit(cache=True, fastmath=True, error_model="numpy")
def _shift(haze: Any, inverse: Any, tolerance: Any, work: Any) -> None:
    """Move mean reflectances along the line of the two materials mixed most, towards a normal of length 1.

    The length, itself uncertain, corrects the share (Gauss and Newton, twice).
    """
    matrix = (
        inverse[0, 0], inverse[0, 1], inverse[0, 2], inverse[1, 0], inverse[1, 1], inverse[1, 2],
        inverse[2, 0], inverse[2, 1], inverse[2, 2],
    )  # fmt: skip
    haze_ = (haze[0], haze[1], haze[2])
    for j in range(CHUNK_PX):
        s0, s1, s2 = work[_LIGHT + j], work[_LIGHT + CHUNK_PX + j], work[_LIGHT + 2 * CHUNK_PX + j]
        m0, m1, m2 = work[j], work[CHUNK_PX + j], work[2 * CHUNK_PX + j]
        d0 = work[_OTHER + j] - work[_OWN + j]
        d1 = work[_OTHER + CHUNK_PX + j] - work[_OWN + CHUNK_PX + j]
        d2 = work[_OTHER + 2 * CHUNK_PX + j] - work[_OWN + 2 * CHUNK_PX + j]
        first, second = work[_FIRST + j], work[_SECOND + j]
        ratio = tolerance / max(_UNSURE * first * second, _TINY)
        light, mean, step = (s0, s1, s2), (m0, m1, m2), (d0, d1, d2)
        moved = _moved(_NONE, light, mean, step, matrix, haze_, first, second, ratio)
        moved = _moved(moved, light, mean, step, matrix, haze_, first, second, ratio)
        moved = moved if second >= _LEAST_SHARE else _NONE
        work[j], work[CHUNK_PX + j] = m0 + moved * d0, m1 + moved * d1
        work[2 * CHUNK_PX + j] = m2 + moved * d2


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def _moved(
    moved: Any, s: Any, mean: Any, d: Any, inverse: Any, haze: Any, first: Any, second: Any, ratio: Any
) -> Any:
    """Return how far along d a mean reflectance is moved, from what was found before; tuples throughout."""
    q0 = _ONE / (mean[0] + moved * d[0])
    q1 = _ONE / (mean[1] + moved * d[1])
    q2 = _ONE / (mean[2] + moved * d[2])
    y0, y1, y2 = s[0] * q0, s[1] * q1, s[2] * q2
    x0, x1, x2 = y0 - haze[0], y1 - haze[1], y2 - haze[2]
    n0 = inverse[0] * x0 + inverse[1] * x1 + inverse[2] * x2
    n1 = inverse[3] * x0 + inverse[4] * x1 + inverse[5] * x2
    n2 = inverse[6] * x0 + inverse[7] * x1 + inverse[8] * x2
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + _TINY
    slope = (n0 * inverse[0] + n1 * inverse[3] + n2 * inverse[6]) * y0 * d[0] * q0
    slope += (n0 * inverse[1] + n1 * inverse[4] + n2 * inverse[7]) * y1 * d[1] * q1
    slope += (n0 * inverse[2] + n1 * inverse[5] + n2 * inverse[8]) * y2 * d[2] * q2
    slope /= -length
    found = slope * (slope * moved - length + _ONE) / (slope * slope + ratio)
    return min(max(found, -second), first)


@njit(cache=True, fastmath=True, error_model="numpy")
def _weigh(mask: Any, noise: Any, steps: Any, work: Any, line: Any) -> None:
    """Fill line (7 · CHUNK_PX,): light, its relative variance by noise and mixture, what a pixel tells."""
    for j in range(CHUNK_PX):
        line[_WEIGHT * CHUNK_PX + j] = _NONE
    for k in range(3):
        least, place = noise[k], CHUNK_PX * k
        for j in range(CHUNK_PX):
            inverse = _ONE / work[place + j]
            y = work[_LIGHT + place + j] * inverse
            step = (work[_OTHER + place + j] - work[_OWN + place + j]) * inverse
            doubt, squared = least * inverse * inverse + _TINY, y * y
            doubt /= max(squared, doubt)
            doubt += _UNSURE * work[_FIRST + j] * work[_SECOND + j] * step * step
            line[place + j], line[3 * CHUNK_PX + place + j] = y, doubt
            line[_WEIGHT * CHUNK_PX + j] += doubt * _THIRD
    for j in range(len(mask)):
        told = steps / (steps + line[_WEIGHT * CHUNK_PX + j])
        line[_WEIGHT * CHUNK_PX + j] = told if mask[j] else _NONE
    for j in range(len(mask), CHUNK_PX):
        line[_WEIGHT * CHUNK_PX + j] = _NONE


@njit(cache=True, fastmath=True, error_model="numpy")
def _blur_columns(rows: Any, v: int, i: int, weights: Any, out: Any) -> None:
    """Fill sums of a chunk down the rows around row v of what pixels tell: light of lamps, and weights."""
    _, w0, w1, w2, w3, w4, _ = weights
    r0, r1, r2 = rows[(v - 2) % _ROWS, i], rows[(v - 1) % _ROWS, i], rows[v % _ROWS, i]
    r3, r4 = rows[(v + 1) % _ROWS, i], rows[(v + 2) % _ROWS, i]
    begin, t = i * CHUNK_PX + REACH_PX, _WEIGHT * CHUNK_PX
    for k in range(3):
        total, y = out[k, begin : begin + CHUNK_PX], k * CHUNK_PX
        for j in range(CHUNK_PX):
            a = w0 * r0[t + j] * r0[y + j] + w1 * r1[t + j] * r1[y + j] + w2 * r2[t + j] * r2[y + j]
            total[j] = a + w3 * r3[t + j] * r3[y + j] + w4 * r4[t + j] * r4[y + j]
    total = out[3, begin : begin + CHUNK_PX]
    for j in range(CHUNK_PX):
        total[j] = w0 * r0[t + j] + w1 * r1[t + j] + w2 * r2[t + j] + w3 * r3[t + j] + w4 * r4[t + j]


@njit(cache=True, fastmath=True, error_model="numpy")
def _blur_row(columns: Any, begin: int, weights: Any, line: Any) -> None:
    _, w0, w1, w2, w3, w4, _ = weights
    for k in range(4):
        c = columns[k, begin : begin + CHUNK_PX + 2 * REACH_PX]
        total = line[(_PLANES + k) * CHUNK_PX : (_PLANES + k + 1) * CHUNK_PX]
        for j in range(CHUNK_PX):
            total[j] = w0 * c[j] + w1 * c[j + 1] + w2 * c[j + 2] + w3 * c[j + 3] + w4 * c[j + 4]


@njit(cache=True, fastmath=True, error_model="numpy")
def _settle(line: Any, of_lamps: Any, weight: Any, variances: Any) -> None:
    """Move light of CHUNK_PX pixels towards that of those around, then towards a normal of length 1.

    line: (11 · CHUNK_PX,), light, its relative variances, what a pixel tells, and the sums around it. weight:
    of a pixel itself in them, which it is taken out of.
    """
    haze, inverse, _, _ = of_lamps
    h0, h1, h2 = haze
    i00, i01, i02 = inverse[0]
    i10, i11, i12 = inverse[1]
    i20, i21, i22 = inverse[2]
    steps, tolerance = variances
    for j in range(CHUNK_PX):
        y0, y1, y2 = line[j], line[CHUNK_PX + j], line[2 * CHUNK_PX + j]
        a0, a1 = line[3 * CHUNK_PX + j] + _TINY, line[4 * CHUNK_PX + j] + _TINY  # 0 where nothing was seen
        a2 = line[5 * CHUNK_PX + j] + _TINY
        self = weight * weight * line[6 * CHUNK_PX + j]
        there = line[10 * CHUNK_PX + j] - self
        share = _ONE / max(there, _FEWEST)
        m0, m1 = (line[7 * CHUNK_PX + j] - self * y0) * share, (line[8 * CHUNK_PX + j] - self * y1) * share
        m2 = (line[9 * CHUNK_PX + j] - self * y2) * share
        b = steps + steps * _ALONE * (share - _ONE)  # the fewer pixels around tell it, the less is known
        t0, t1, t2 = m0 - y0, m1 - y1, m2 - y2
        u0, u1, u2 = m0 * m0 + _TINY, m1 * m1 + _TINY, m2 * m2 + _TINY
        apart = t0 * t0 / (u0 * (a0 + b)) + t1 * t1 / (u1 * (a1 + b)) + t2 * t2 / (u2 * (a2 + b))
        apart = _ONE + _OF_CAP * apart  # large at a crease, and at the edge of a shadow
        b *= apart * apart
        q0, q1, q2 = a0 / (a0 + b), a1 / (a1 + b), a2 / (a2 + b)
        y0, y1, y2 = y0 + t0 * q0, y1 + t1 * q1, y2 + t2 * q2
        d0, d1, d2 = b * q0 * u0, b * q1 * u1, b * q2 * u2
        x0, x1, x2 = y0 - h0, y1 - h1, y2 - h2
        n0, n1 = i00 * x0 + i01 * x1 + i02 * x2, i10 * x0 + i11 * x1 + i12 * x2
        n2 = i20 * x0 + i21 * x1 + i22 * x2
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + _TINY
        over = _ONE / length
        g0, g1 = (n0 * i00 + n1 * i10 + n2 * i20) * over, (n0 * i01 + n1 * i11 + n2 * i21) * over
        g2 = (n0 * i02 + n1 * i12 + n2 * i22) * over
        variance, wrong = tolerance + g0 * g0 * d0 + g1 * g1 * d1 + g2 * g2 * d2, _ONE - length
        falling = _ONE + _OF_CAP * wrong * wrong / variance
        move = wrong / (variance * falling * falling)
        line[j], line[CHUNK_PX + j] = y0 + d0 * g0 * move, y1 + d1 * g1 * move
        line[2 * CHUNK_PX + j] = y2 + d2 * g2 * move


@njit(cache=True, fastmath=True, error_model="numpy")
def _merge(light: Any, merge: Any, out: Any) -> None:
    m00, m01, m02 = merge[0]
    m10, m11, m12 = merge[1]
    m20, m21, m22 = merge[2]
    for u in range(len(out)):
        x, y, z = light[u], light[CHUNK_PX + u], light[2 * CHUNK_PX + u]
        out[u, 0] = m00 * x + m01 * y + m02 * z
        out[u, 1] = m10 * x + m11 * y + m12 * z
        out[u, 2] = m20 * x + m21 * y + m22 * z
