"""Tiling textures and height maps: grain, paper fibres, woven cloth. All are (size, size) and seamless."""

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray


def tiling_noise(size: int, wavelength: float, generator: np.random.Generator) -> FloatArray:
    """Return smooth noise of mean 0 and standard deviation 1; wavelength in texels."""
    frequency = np.fft.fftfreq(size)
    radius = np.hypot(frequency[:, None], np.fft.rfftfreq(size)[None, :]) * wavelength
    spectrum = np.fft.rfft2(generator.standard_normal((size, size))) * np.exp(-np.square(radius))
    spectrum[0, 0] = 0.0
    noise = np.fft.irfft2(spectrum, s=(size, size))
    return noise / noise.std()


def paper_fibres(size: int, count: int, length: float, generator: np.random.Generator) -> FloatArray:
    """Return matted fibres, 0 to 1: `count` short bent strokes of about `length` texels, on a torus."""
    canvas = np.zeros((size, size), np.float32)
    for _ in range(count):
        start = generator.uniform(0, size, 2)
        angle, bend = generator.uniform(0, 2 * np.pi), generator.normal(0, 0.6)
        steps = np.linspace(0.0, 1.0, 7)
        heading = angle + bend * steps
        stroke = start + np.cumsum(
            np.stack([np.cos(heading), np.sin(heading)], 1) * length * generator.uniform(0.5, 1.5) / 7, axis=0
        )
        shade = float(generator.uniform(0.4, 1.0))
        for wrap in _wraps(stroke, size):
            cv2.polylines(
                canvas, [np.rint((stroke + wrap) * 16).astype(np.int32)], False, shade, 1, cv2.LINE_AA, 4
            )
    soft = cv2.GaussianBlur(np.pad(canvas, 8, mode="wrap"), (0, 0), 1.0)[8:-8, 8:-8]
    return np.asarray(soft / soft.max(), dtype=np.float64)


def plain_weave(threads: int, texels_per_thread: int) -> FloatArray:
    """Return the height, 0 to 1, of a plain weave of `threads` (even) threads each way."""
    x, y = _thread_grid(threads, texels_per_thread)
    over = np.cos(np.pi * (np.floor(x) + np.floor(y)))  # +1 where the thread along x lies on top
    along_x = _round(y) + 0.5 * over * np.abs(np.sin(np.pi * x))
    along_y = _round(x) - 0.5 * over * np.abs(np.sin(np.pi * y))
    return _unit_range(np.maximum(along_x, along_y))


def twill_weave(threads: int, texels_per_thread: int) -> FloatArray:
    """Return the height, 0 to 1, of a 3/1 twill, whose diagonal ribs a jacket's cotton shows.

    threads: each way, a multiple of four, so that it tiles.
    """
    x, y = _thread_grid(threads, texels_per_thread)
    over = np.where((np.floor(x) + np.floor(y)) % 4 == 0, -1.0, 1.0)
    rib = np.cos(np.pi / 2 * (x + y))
    return _unit_range(np.maximum(_round(y) + 0.3 * over, _round(x) - 0.3 * over) + 0.6 * rib)


def _wraps(stroke: FloatArray, size: int) -> list[FloatArray]:
    low, high = stroke.min(axis=0) - 2, stroke.max(axis=0) + 2
    shifts = [[0.0] + [size] * bool(low[i] < 0) + [-size] * bool(high[i] >= size) for i in range(2)]
    return [np.array([a, b], dtype=np.float64) for a in shifts[0] for b in shifts[1]]


def _thread_grid(threads: int, texels: int) -> tuple[FloatArray, FloatArray]:
    at = (np.arange(threads * texels) + 0.5) / texels
    x, y = np.meshgrid(at, at)
    return x, y


def _round(across: FloatArray) -> FloatArray:
    """Half-round profile of a thread whose middle lies at half-integers."""
    return np.sqrt(np.maximum(0.0, 1.0 - np.square(2.0 * (across % 1.0) - 1.0)))


def _unit_range(height: FloatArray) -> FloatArray:
    return (height - height.min()) / np.ptp(height)
