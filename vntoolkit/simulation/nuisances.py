"""Effects of a real camera that violate r = M n; each can be turned off alone."""

import cv2
import numpy as np

from vntoolkit.arrays import Array, Float32Array, FloatArray, LinearImage
from vntoolkit.options.simulation import Nuisances
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.transfer import encoded_from_linear, linear_from_integers

# Malvar's linear interpolation (malvar2004), RGGB: green at red and blue; a colour along its own row of
# green pixels; red at blue and the reverse.
_GREEN = np.array(
    [[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]
) / np.float32(8)
_ALONG = np.array(
    [[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]]
) / np.float32(8)
_ACROSS = np.array(
    [[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]
) / np.float32(8)


# The camera: lens blur, noise, Bayer mosaic, clipping, quantisation.


def expose(
    radiance: LinearImage, nuisances: Nuisances, generator: np.random.Generator, number: int = 0
) -> tuple[Array, LinearFrame]:
    """Photograph linear light (h, w, 3), 1 = full scale.

    Returns (h, w, 3) uint8 or uint16 RGB over the type's full range, as the file holds it, and what a reader
    who knows the transfer gets from it (without quantisation: the sensor's own values).
    """
    if nuisances.blur_px > 0:
        radiance = blurred(radiance, nuisances.blur_px)
    raw = mosaic_from_rgb(radiance) if nuisances.bayer else radiance
    if nuisances.noise:
        raw = with_noise(raw, nuisances, generator)
    if nuisances.clipping:
        raw = np.minimum(raw, np.float32(1.0))
    rgb = rgb_from_mosaic(raw) if nuisances.bayer else raw
    stored = stored_from_linear(rgb, nuisances)
    clipped = _largest(rgb) >= 1.0
    if nuisances.quantisation:
        rgb = linear_from_integers(stored, nuisances.file_transfer)
        clipped = _largest(stored) == np.iinfo(stored.dtype).max
    return stored, LinearFrame(rgb=rgb.astype(np.float32), clipped=clipped, number=number)


def _largest(rgb: Array) -> Array:
    """Return the largest channel (h, w); numpy reduces a short axis many times slower."""
    return np.maximum(np.maximum(rgb[..., 0], rgb[..., 1]), rgb[..., 2])


def blurred(image: FloatArray, sigma_px: float) -> Float32Array:
    """Blur by a Gaussian of that standard deviation."""
    image = np.asarray(image, dtype=np.float32)
    result: Float32Array = np.empty_like(image)
    cv2.GaussianBlur(image, (0, 0), sigma_px, dst=result, borderType=cv2.BORDER_REFLECT_101)
    return result


def with_noise(light: FloatArray, nuisances: Nuisances, generator: np.random.Generator) -> Float32Array:
    """Add shot and read noise: variance light / full_well + (read_noise / full_well)², full scale = 1."""
    well = nuisances.full_well_electrons
    electrons = generator.poisson(np.maximum(light, 0.0) * well).astype(np.float32)
    read = generator.standard_normal(light.shape, dtype=np.float32)
    noisy: Float32Array = electrons + read * np.float32(nuisances.read_noise_electrons)
    return noisy / np.float32(well)


def mosaic_from_rgb(rgb: LinearImage) -> Float32Array:
    """Keep one colour per pixel, (h, w): red at even rows and columns, blue at odd ones, green elsewhere."""
    mosaic = rgb[..., 1].copy()
    mosaic[0::2, 0::2] = rgb[0::2, 0::2, 0]
    mosaic[1::2, 1::2] = rgb[1::2, 1::2, 2]
    return mosaic


def rgb_from_mosaic(mosaic: Float32Array) -> Float32Array:
    """Interpolate the missing two colours of every pixel linearly (malvar2004): (h, w) to (h, w, 3)."""
    green, along, down, across = (
        cv2.filter2D(mosaic, cv2.CV_32F, kernel.astype(np.float32), borderType=cv2.BORDER_REFLECT_101)
        for kernel in (_GREEN, _ALONG, _ALONG.T, _ACROSS)
    )
    rgb = np.repeat(mosaic[..., None], 3, axis=2)
    for own, other, odd in ((0, 2, 0), (2, 0, 1)):
        here, there = slice(odd, None, 2), slice(1 - odd, None, 2)
        rgb[here, here, 1] = green[here, here]
        rgb[here, here, other] = across[here, here]
        rgb[here, there, own] = along[here, there]
        rgb[here, there, other] = down[here, there]
    return rgb


def stored_from_linear(linear: FloatArray, nuisances: Nuisances) -> Array:
    """Apply the file's curve and round to its bits; more than 8 fill 16 bits, so that 65535 is white."""
    levels = 2**nuisances.file_bits - 1
    encoded = encoded_from_linear(np.asarray(linear, dtype=np.float64), nuisances.file_transfer)
    values = np.rint(encoded * levels)
    if nuisances.file_bits == 8:
        return values.astype(np.uint8)
    return np.rint(values * (65535.0 / levels)).astype(np.uint16)
