"""Fine detail through subsampled chroma: what luma shows goes to the channels as a turning normal sends it.

Plain decoding adds the detail of the luma to red, green and blue alike, as if paint had changed. On a surface
of one colour it is the normal that turns, and |n| = 1 leaves it two ways: the slopes (p, q) of the relief.
The luma Y = w·(M n) sees one of them, along its own gradient G over the slopes. The other one follows from
the pattern of the detail, since slopes are the gradient of one height: a wave of relief that runs at an angle
φ to G has the slope s along itself, and shows in the luma as |G| s cos φ. Under noise of variance λ, what the
wave D of the luma tells best is s = D cos φ / (|G| (cos²φ + ε)), with ε = λ / |G|² (Wiener), and its parts
along G and across it are s cos φ and s sin φ. As functions of φ, weighted by what is observed, they are
a + b cos 2φ and c sin 2φ to the first order: three filters of the detail, of which two are second
differences. Chroma changes with the slopes. Luma is kept exactly; where G is small so is the change, and
plain decoding is left. Chroma is taken to lie in the middle of the luma that it covers.

Where the subject ends against the dark, detail is neither: less light arrives, and chroma falls with luma.
Samples of chroma that lie across the edge hold both sides in the same shares as their luma, so that chroma
over luma is the subject's.
"""

import cv2
import numpy as np

from vntoolkit.arrays import Array, Float32Array, Matrix3, UInt16Array, Vector3
from vntoolkit.native import njit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer, linear_from_encoded

# λ: noise of luma, 0.005 of full scale (one level of 8 bits and the codec), over 3 degrees, squared.
# From a third to three times it, errors on simulated knits move by less than a tenth of what is gained.
_NOISE_OVER_DETAIL = 0.01
_CODES = 1024  # of the decoding table
_DARKEST = 1e-3  # of M's own brightness: no direction is known below
# What the detail, its waves across against along, and its diagonal ones, change in Cb and in Cr; and how far
# the detail is an edge.
_KINDS = 7
# Luma beside a place over the greatest there: below the first it is an edge, above the other one relief.
_EDGE, _NO_EDGE = np.float32(0.25), np.float32(0.5)
_FAINT = 0.02  # of full scale: less luma by chroma's samples is rounding, and tells no share
# Filters of 3×3 whose response to a wave in the direction θ is nearest to cos 2θ and sin 2θ, for waves that
# chroma does not hold: above a fourth of a cycle per pixel, across or along.
_UPRIGHT = 0.2854  # of the neighbours above and below, less those to the left and right
_DIAGONAL = 0.3303  # of those above right and below left, less the other two


class LumaDetail:
    """Decodes subsampled YUV of a surface under a light response. transfer: of the stored values."""

    def __init__(self, response: LightResponse, transfer: Transfer) -> None:
        codes = np.arange(_CODES + 1) / _CODES
        light = linear_from_encoded(codes, transfer)
        self._light = light.astype(np.float32)
        self._slope = (1.0 / np.maximum(np.gradient(light, codes), 1e-3)).astype(np.float32)  # code per light
        self._matrix = response.matrix.astype(np.float32)
        self._inverse = response.inverse.astype(np.float32)
        self._ambient = response.ambient.astype(np.float32)

    def rgb(self, planes: list[Array], matrix: Matrix3, offset: Vector3) -> UInt16Array:
        """Return (h, w, 3) uint16 RGB, 65535 = full scale.

        planes: Y (h, w), and Cb and Cr of fewer pixels, integers as stored. matrix, offset: from these to RGB
        of 0 to 1.
        """
        luma, blue, red = (np.ascontiguousarray(plane) for plane in planes)
        steps = [-(-n // m) for n, m in zip(luma.shape, blue.shape, strict=True)]
        coarse = np.stack([_mean_of_blocks(luma, *steps), blue, red], dtype=np.float32, casting="unsafe")
        # the turns change slowly: a fourth of the samples tells them
        fewer = np.stack([_mean_of_blocks(plane, 2, 2) for plane in coarse])
        turns = np.empty((_KINDS, *fewer.shape[1:]), np.float32)
        to_rgb, shift = matrix.astype(np.float32), offset.astype(np.float32)
        from_rgb = np.linalg.inv(matrix).astype(np.float32)
        faint = _FAINT * from_rgb[0].sum()
        dark = np.array([*(-from_rgb @ offset), faint], np.float32)  # the codes of black, and faint luma
        turns[:-1] = self._chroma_per_luma(fewer, to_rgb, shift, from_rgb)
        _edges(fewer[0], dark[0], turns)
        rgb = np.empty((*luma.shape, 3), np.uint16)
        down, across = (_cubic_weights(step) for step in steps)
        full = np.float32(65535)
        _sharpened(luma, coarse, turns, down, across, dark, to_rgb * full, shift * full, rgb)
        return rgb

    def _chroma_per_luma(
        self, coarse: Float32Array, to_rgb: Matrix3, shift: Vector3, from_rgb: Matrix3
    ) -> Float32Array:
        """Return (6, h, w): how much Cb, then Cr, change per detail of Y and per filter of it, in codes."""
        codes = np.clip(np.tensordot(to_rgb, coarse, 1) + shift[:, None, None], 0, 1)
        place = (codes * np.float32(_CODES) + np.float32(0.5)).astype(np.intp)
        x = np.tensordot(self._inverse, self._light[place] - self._ambient[:, None, None], 1)
        squared = (x * x).sum(axis=0)
        dark = squared < np.float32(_DARKEST**2)
        along = x / np.where(dark, np.float32(1), squared)
        # n = (p, q, -1) / √(1 + p² + q²), x = ρ n: the slope along a unit vector e of the picture turns x
        # by ρ |n_z| (e - (n·e) n), and every code by its gradient over x times that
        gradient = self._slope[place] * np.abs(x[2])
        p, q = (
            gradient * np.tensordot(self._matrix, unit[:, None, None] - along * x[k], 1)
            for k, unit in enumerate(np.eye(3, dtype=np.float32)[:2])
        )
        to_p, to_q = np.tensordot(from_rgb, p, 1), np.tensordot(from_rgb, q, 1)  # of Y, Cb and Cr
        span = from_rgb[0].sum()  # luma of RGB, 0 to 1, is the row of Y, freed of its span
        g0, g1 = to_p[0] / span, to_q[0] / span
        steepest = np.maximum(g0 * g0 + g1 * g1, np.float32(1e-12))
        eps = np.float32(_NOISE_OVER_DETAIL) / steepest
        # a, b and c of this file's docstring by least squares over φ, all directions being as likely
        seen = 1 / 2 + eps
        det = seen * seen / 2 - 1 / 16
        on_level, on_wave = (seen / 4 - 1 / 16) / det, (seen / 4 - 1 / 8) / det
        beside_wave = 1 / (1 + 2 * eps)
        cosine, sine = (g0 * g0 - g1 * g1) / steepest, 2 * g0 * g1 / steepest  # of 2 γ
        turns = []
        for chroma_p, chroma_q in zip(to_p[1:], to_q[1:], strict=True):
            on = (chroma_p * g0 + chroma_q * g1) / (steepest * span)
            beside = (chroma_q * g0 - chroma_p * g1) / (steepest * span)
            turns.append(on_level * on)
            turns.append(on_wave * cosine * on - beside_wave * sine * beside)
            turns.append(on_wave * sine * on + beside_wave * cosine * beside)
        return np.where(dark, np.float32(0), np.stack(turns))


def _cubic_weights(step: int) -> Float32Array:
    """Return (step, 5) weights of five coarse samples for each fine one: `keys1981`, a = -0.75, as OpenCV."""
    distance = np.abs(((np.arange(step) + 0.5) / step - 0.5)[:, None] - np.arange(-2, 3))
    near = (1.25 * distance - 2.25) * distance**2 + 1
    far = -0.75 * (((distance - 5) * distance + 8) * distance - 4)
    return np.where(distance < 1, near, np.where(distance < 2, far, 0.0)).astype(np.float32)


def _mean_of_blocks(plane: Array, down: int, across: int) -> Float32Array:
    """Return the mean of each block of so many rows and columns; the last row and column go on beyond."""
    height, width = plane.shape
    whole = cv2.copyMakeBorder(plane, 0, -height % down, 0, -width % across, cv2.BORDER_REPLICATE)
    size = (whole.shape[1] // across, whole.shape[0] // down)
    mean = cv2.resize(whole.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.asarray(mean, dtype=np.float32)


@njit(cache=True, fastmath=True)
def _edges(luma, dark, turns):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Fill the last of the turns, 0 to 1, by the luma (h, w) around, and take edges out of the others."""
    height, width = luma.shape
    one, zero = np.float32(1), np.float32(0)
    for v in range(height):
        for u in range(width):
            least, most = luma[v, u], luma[v, u]
            for row in range(max(v - 1, 0), min(v + 2, height)):
                for column in range(max(u - 1, 0), min(u + 2, width)):
                    least, most = min(least, luma[row, column]), max(most, luma[row, column])
            share = (least - dark) / max(most - dark, np.float32(1e-6))
            edge = min(max((_NO_EDGE - share) / (_NO_EDGE - _EDGE), zero), one)
            turns[_KINDS - 1, v, u] = edge
            if edge > zero:
                for k in range(_KINDS - 1):
                    turns[k, v, u] *= one - edge


@njit(cache=True, fastmath=True)
def _turns_of_row(turns, v, across, row, to):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Fill one row of the picture with the turns of row v of the chroma, linearly. row: a buffer."""
    height, width = turns.shape
    near = v // 2
    far = min(max(near + (1 if v % 2 else -1), 0), height - 1)
    mostly, rest = np.float32(0.75), np.float32(0.25)
    for u in range(width):
        row[u + 1] = mostly * turns[near, u] + rest * turns[far, u]
    row[0], row[width + 1] = row[1], row[width]
    for u in range(len(to) // across):
        at = u // 2 + 1
        value = mostly * row[at] + rest * row[at + 1 if u % 2 else at - 1]
        for k in range(across):
            to[across * u + k] = value


@njit(cache=True, fastmath=True)
def _smooth_row(plane, v, down, across, row, to):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Fill one row of the picture from rows v - 2 to v + 2 of the chroma; row: a buffer, 4 wider."""
    height, width = plane.shape
    d0, d1, d2, d3, d4 = down[0], down[1], down[2], down[3], down[4]
    before2, before, here = plane[max(v - 2, 0)], plane[max(v - 1, 0)], plane[v]
    after, after2 = plane[min(v + 1, height - 1)], plane[min(v + 2, height - 1)]
    for u in range(width):
        row[u + 2] = d0 * before2[u] + d1 * before[u] + d2 * here[u] + d3 * after[u] + d4 * after2[u]
    row[0] = row[1] = row[2]
    row[width + 2] = row[width + 3] = row[width + 1]
    step = across.shape[0]
    if step == 2:
        a0, a1, a2, a3 = across[0, 0], across[0, 1], across[0, 2], across[0, 3]  # the other one mirrors it
        for u in range(width):
            to[2 * u] = a0 * row[u] + a1 * row[u + 1] + a2 * row[u + 2] + a3 * row[u + 3]
            to[2 * u + 1] = a0 * row[u + 4] + a1 * row[u + 3] + a2 * row[u + 2] + a3 * row[u + 1]
        return
    for k in range(step):
        a0, a1, a2, a3, a4 = across[k, 0], across[k, 1], across[k, 2], across[k, 3], across[k, 4]
        for u in range(width):
            to[step * u + k] = (
                a0 * row[u] + a1 * row[u + 1] + a2 * row[u + 2] + a3 * row[u + 3] + a4 * row[u + 4]
            )


@njit(cache=True, fastmath=True)
def _detail_row(luma, smooth, to):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Fill a row, one pixel wider on each side, with what luma has and chroma's samples of it have not."""
    width = len(luma)
    for u in range(width):
        to[u + 1] = np.float32(luma[u]) - smooth[u]
    to[0], to[width + 1] = to[1], to[width]


@njit(cache=True, fastmath=True)
def _filters_of_row(above, here, below, straight, slanted):  # type: ignore[no-untyped-def]  # pragma: no cover
    upright, diagonal = np.float32(_UPRIGHT), np.float32(_DIAGONAL)
    for u in range(len(straight)):
        straight[u] = upright * ((above[u + 1] + below[u + 1]) - (here[u] + here[u + 2]))
        slanted[u] = diagonal * ((above[u + 2] - above[u]) + (below[u] - below[u + 2]))


@njit(cache=True, fastmath=True)
def _add_detail(turn, detail, straight, slanted, to):  # type: ignore[no-untyped-def]  # pragma: no cover
    first, second, third = turn[0], turn[1], turn[2]
    for u in range(len(straight)):
        to[u] += first[u] * detail[u] + second[u] * straight[u] + third[u] * slanted[u]


@njit(cache=True, fastmath=True)
def _fall_with_luma(edge, luma, smooth, dark, blue, red):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Scale the chroma of a row as luma exceeds its mean by chroma's samples, as far as there is an edge."""
    y0, b0, r0, faint = dark[0], dark[1], dark[2], dark[3]
    for u in range(len(luma)):
        if edge[u] == np.float32(0):  # as almost everywhere
            continue
        light = (np.float32(luma[u]) - y0) / max(smooth[u] - y0, faint)
        more = edge[u] * (max(light, np.float32(0)) - np.float32(1))
        blue[u] += more * (blue[u] - b0)
        red[u] += more * (red[u] - r0)


@njit(cache=True, fastmath=True)
def _sharpened(  # type: ignore[no-untyped-def]  # pragma: no cover
    luma, coarse, turns, down, across, dark, matrix, offset, rgb
):
    height, width = luma.shape
    m00, m01, m02 = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    m10, m11, m12 = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    m20, m21, m22 = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    half = np.float32(0.5)
    s0, s1, s2 = offset[0] + half, offset[1] + half, offset[2] + half
    least, most = np.float32(0), np.float32(65535)
    step = down.shape[0]
    whole = coarse.shape[2] * across.shape[0]
    row = np.empty(coarse.shape[2] + 4, np.float32)
    blue, red = np.empty(whole, np.float32), np.empty(whole, np.float32)
    means = np.empty((2, whole), np.float32)  # of luma, rows v and v + 1, in turn
    turn = np.empty((_KINDS, whole), np.float32)
    straight, slanted = np.empty(width, np.float32), np.empty(width, np.float32)
    details = np.zeros((3, width + 2), np.float32)  # rows v - 1, v, v + 1, in turn, with a pixel on each side
    for v in range(-1, height):
        if v + 1 < height:
            mean = means[(v + 1) % 2]
            _smooth_row(coarse[0], (v + 1) // step, down[(v + 1) % step], across, row, mean)
            _detail_row(luma[v + 1], mean, details[(v + 1) % 3])
        else:
            details[(v + 1) % 3] = details[v % 3]
        if v < 0:
            details[2] = details[0]
            continue
        if v % step == 0:
            for k in range(_KINDS):
                _turns_of_row(turns[k], v // step, across.shape[0], row, turn[k])
        _smooth_row(coarse[1], v // step, down[v % step], across, row, blue)
        _smooth_row(coarse[2], v // step, down[v % step], across, row, red)
        _fall_with_luma(turn[_KINDS - 1], luma[v], means[v % 2], dark, blue, red)
        above, here, below = details[(v + 2) % 3], details[v % 3], details[(v + 1) % 3]
        _filters_of_row(above, here, below, straight, slanted)
        _add_detail(turn[:3], here[1:], straight, slanted, blue)
        _add_detail(turn[3:], here[1:], straight, slanted, red)
        fine, to = luma[v], rgb.reshape(height, -1)[v]
        for u in range(width):
            y, cb, cr = np.float32(fine[u]), blue[u], red[u]
            to[3 * u] = np.uint16(min(max(m00 * y + m01 * cb + m02 * cr + s0, least), most))
            to[3 * u + 1] = np.uint16(min(max(m10 * y + m11 * cb + m12 * cr + s1, least), most))
            to[3 * u + 2] = np.uint16(min(max(m20 * y + m21 * cb + m22 * cr + s2, least), most))
