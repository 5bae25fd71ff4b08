"""Spectra on one wavelength grid: lamps behind filters, a camera's three channels, pigments.

The curves are ours, made from a few bands each, with the shapes that published measurements have: a
tungsten lamp behind dichroic filters whose skirts overlap; a single-chip camera's colour filter array with
its long tails (jiang2013); pigments that change slowly with wavelength. None is a copy of a measurement.
"""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray

WAVELENGTHS_NM = np.arange(380.0, 731.0, 5.0)
_STEP_NM = 5.0
_LAMP_TEMPERATURE_K = 3200.0
_SECOND_RADIATION_CONSTANT_NM_K = 1.4387769e7


def camera_sensitivities() -> FloatArray:
    """Return ν_i(λ), (3, λ): red, green, blue channels of a single-chip camera, green's peak = 1."""
    red = 0.86 * _band(605, 18, 34) + 0.10 * _band(455, 30, 28) + 0.10 * _band(530, 28, 20)
    green = 1.00 * _band(530, 32, 36) + 0.06 * _band(430, 22, 22) + 0.05 * _band(655, 20, 25)
    blue = 0.82 * _band(462, 26, 27) + 0.05 * _band(545, 22, 26) + 0.015 * _band(640, 25, 25)
    infrared_cut = 1.0 / (1.0 + np.exp((WAVELENGTHS_NM - 682.0) / 8.0))
    return np.stack([red, green, blue]) * infrared_cut


def coloured_lamps() -> FloatArray:
    """Return S_k(λ), (3, λ): a tungsten lamp behind a red, a green and a blue filter.

    Each is as strong as makes a white surface that faces it 1 in its own channel (red, green, blue).
    """
    red = _edge(600, 7) * 0.92 + 0.012 + 0.02 * _band(450, 15, 15)
    green = 0.72 * _band(532, 17, 22) + 0.012 + 0.05 * _edge(705, 8)
    blue = 0.62 * _band(452, 24, 21) + 0.008 + 0.04 * _edge(700, 8)
    lamps = np.stack([red, green, blue]) * _tungsten()
    own_channel = np.einsum("kl,kl->k", lamps, camera_sensitivities()) * _STEP_NM
    return lamps / own_channel[:, None]


def white_lamp() -> FloatArray:
    """Return (λ,) a lamp that the camera sees as white: a white surface that faces it is 1 in all channels.

    Daylight-like: tungsten's light with its blue, green and red bands weighed against the camera.
    """
    bands = rgb_pigments() * _tungsten()
    seen = colour_from_spectrum(bands, camera_sensitivities())
    return np.linalg.solve(seen.T, np.ones(3)) @ bands


def room_glow(level: float) -> FloatArray:
    """Return (λ,) ambient light as `level` of a white lamp's light."""
    return level * white_lamp()


def colour_from_spectrum(power: FloatArray, sensitivities: FloatArray) -> FloatArray:
    """Integrate power (..., λ) against sensitivities (3, λ) over wavelength: (..., 3)."""
    return np.asarray(power) @ np.asarray(sensitivities).T * _STEP_NM


def rgb_pigments() -> FloatArray:
    """Return (3, λ) smooth red, green, blue reflectances that add up to 1 at every wavelength.

    With weights (r, g, b) from 0 to 1 they are a spectrum for any RGB texture; (1, 1, 1) is white.
    """
    red = _edge(582, 9)
    blue = 1.0 - _edge(490, 9)
    return np.stack([red, 1.0 - red - blue, blue])


def _band(centre_nm: float, below_nm: float, above_nm: float) -> FloatArray:
    """Bell with unequal flanks: standard deviations below and above the centre."""
    width = np.where(centre_nm > WAVELENGTHS_NM, below_nm, above_nm)
    return np.exp(-0.5 * ((WAVELENGTHS_NM - centre_nm) / width) ** 2)


def _edge(centre_nm: float, width_nm: float) -> FloatArray:
    """Long-pass filter: 0 below, 1 above, a logistic edge."""
    return 1.0 / (1.0 + np.exp(-(WAVELENGTHS_NM - centre_nm) / width_nm))


def _tungsten() -> FloatArray:
    """Planck's law at a studio lamp's temperature, 1 at 560 nm."""
    exponent = _SECOND_RADIATION_CONSTANT_NM_K / _LAMP_TEMPERATURE_K
    power = WAVELENGTHS_NM**-5 / np.expm1(exponent / WAVELENGTHS_NM)
    return power / power[WAVELENGTHS_NM == 560.0]
