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
"""

import cv2
import numpy as np

from vntoolkit.arrays import Array, Float32Array, Matrix3, Vector3
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer, linear_from_encoded

# λ: noise of luma, 0.005 of full scale (one level of 8 bits and the codec), over 3 degrees, squared.
# From a third to three times it, errors on simulated knits move by less than a tenth of what is gained.
_NOISE_OVER_DETAIL = 0.01
_CODES = 1024  # of the decoding table
_DARKEST = 1e-3  # of M's own brightness: no direction is known below
# Filters of 3×3 whose response to a wave in the direction θ is nearest to cos 2θ and sin 2θ, for waves that
# chroma does not hold: above a fourth of a cycle per pixel, across or along.
_WAVES: tuple[Float32Array, Float32Array] = (
    0.2854 * np.array([[0, 1, 0], [-1, 0, -1], [0, 1, 0]], np.float32),
    0.3303 * np.array([[-1, 0, 1], [0, 0, 0], [1, 0, -1]], np.float32),
)


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

    def chroma(
        self, planes: list[Array], matrix: Matrix3, offset: Vector3
    ) -> tuple[Float32Array, Float32Array]:
        """Return Cb and Cr (h, w) with the detail of the luma.

        planes: Y (h, w), and Cb and Cr of fewer pixels, integers as stored. matrix, offset: from these to RGB
        of 0 to 1.
        """
        luma, blue, red = (np.ascontiguousarray(plane) for plane in planes)
        steps = [-(-n // m) for n, m in zip(luma.shape, blue.shape, strict=True)]
        coarse = np.stack([_mean_of_blocks(luma, *steps), blue, red], dtype=np.float32, casting="unsafe")
        # the turns change slowly: a fourth of the samples tells them
        fewer = np.stack([_mean_of_blocks(plane, 2, 2) for plane in coarse])
        to_rgb, shift = matrix.astype(np.float32), offset.astype(np.float32)
        from_rgb = np.linalg.inv(matrix).astype(np.float32)
        turns = self._chroma_per_luma(fewer, to_rgb, shift, from_rgb)

        def fine(plane: Float32Array, method: int, factor: int = 1) -> Float32Array:
            size = (plane.shape[1] * steps[1] * factor, plane.shape[0] * steps[0] * factor)
            whole = cv2.resize(plane, size, interpolation=method)
            return np.ascontiguousarray(whole[: luma.shape[0], : luma.shape[1]], dtype=np.float32)

        mean, *chroma = (fine(plane, cv2.INTER_CUBIC) for plane in coarse)
        detail: Float32Array = luma - mean
        waves = [cv2.filter2D(detail, -1, kernel, borderType=cv2.BORDER_REPLICATE) for kernel in _WAVES]
        for k, turn in enumerate(turns):
            filtered = (detail, *waves)[k % 3]
            cv2.accumulateProduct(fine(turn, cv2.INTER_LINEAR, 2), filtered, chroma[k // 3])
        return chroma[0], chroma[1]

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


def _mean_of_blocks(plane: Array, down: int, across: int) -> Float32Array:
    """Return the mean of each block of so many rows and columns; the last row and column go on beyond."""
    height, width = plane.shape
    whole = cv2.copyMakeBorder(plane, 0, -height % down, 0, -width % across, cv2.BORDER_REPLICATE)
    size = (whole.shape[1] // across, whole.shape[0] // down)
    mean = cv2.resize(whole.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.asarray(mean, dtype=np.float32)
