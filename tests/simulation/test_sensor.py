"""The sensor: noise of the variance asked for, mosaic and its inverse, levels, curve."""

import numpy as np
import pytest
from scipy import stats

from vntoolkit.options.simulation import Nuisances
from vntoolkit.photometry.transfer import Transfer, linear_from_integers
from vntoolkit.simulation.nuisances import (
    blurred,
    expose,
    mosaic_from_rgb,
    rgb_from_mosaic,
    stored_from_linear,
)


@pytest.mark.parametrize("light", [0.0, 0.02, 0.3, 0.9])
@pytest.mark.parametrize("well", [4000.0, 20000.0])
def test_noise_has_the_variance_asked_for(light, well):
    """Both sides: 99.99 % interval of the variance of 250,000 normal samples."""
    nuisances = Nuisances(blur_px=0, bayer=False, quantisation=False, clipping=False,
                          full_well_electrons=well, read_noise_electrons=6.0)  # fmt: skip
    flat = np.full((300, 300, 3), light, np.float32)
    measured = expose(flat, nuisances, np.random.default_rng(7))[1].rgb.astype(float)
    expected = light / well + (6.0 / well) ** 2
    n = measured.size
    low, high = stats.chi2.ppf([5e-5, 1 - 5e-5], n - 1) / (n - 1) * expected
    assert low < measured.var(ddof=1) < high
    assert abs(measured.mean() - light) < 5 * np.sqrt(expected / n)


def test_without_nuisances_light_passes_unchanged():
    light = np.random.default_rng(0).uniform(0, 1, (20, 30, 3)).astype(np.float32)
    assert np.array_equal(expose(light, Nuisances.none(), np.random.default_rng(0))[1].rgb, light)


@pytest.mark.parametrize("bits", [8, 10, 12])
@pytest.mark.parametrize("transfer", ["linear", "srgb", "bt709", "gamma:2.2"])
def test_a_reader_gets_the_light_back_to_half_a_level(bits, transfer):
    nuisances = Nuisances(noise=False, blur_px=0, bayer=False, bits=bits, transfer=transfer, black_level=0.05)
    light = np.linspace(0, 1, 3000, dtype=np.float32).reshape(10, 100, 3)
    stored = stored_from_linear(light, nuisances)
    assert stored.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert len(np.unique(stored)) <= 2**bits
    read = linear_from_integers(stored, nuisances.file_transfer)
    # Half a level at the curve's steepest, and the stretch to 16 bits on top.
    decode = linear_from_integers(np.arange(65536, dtype=np.uint16), nuisances.file_transfer)
    level = np.max(np.diff(decode.astype(float))) * 65535 / (2**bits - 1)
    assert np.abs(read - light).max() < 0.5 * level * 1.02 + 2e-5


def test_quantisation_error_is_uniform_within_a_level():
    nuisances = Nuisances(noise=False, blur_px=0, bayer=False)
    light = np.random.default_rng(2).uniform(0.1, 0.9, (200, 200, 3)).astype(np.float32)
    error = (expose(light, nuisances, np.random.default_rng(0))[1].rgb - light) * 255
    assert 0.98 < error.std() * np.sqrt(12) < 1.02
    assert np.abs(error).max() < 0.501


def test_demosaicing_keeps_measured_values_and_reproduces_ramps():
    v, u = np.mgrid[0:40, 0:60].astype(np.float32)
    ramp = np.stack([0.1 + 0.004 * u, 0.2 + 0.003 * v, 0.3 + 0.002 * (u + v)], axis=-1).astype(np.float32)
    flat = np.broadcast_to(np.array([0.7, 0.4, 0.2], np.float32), (40, 60, 3))
    assert np.abs(rgb_from_mosaic(mosaic_from_rgb(flat)) - flat).max() < 1e-6
    restored = rgb_from_mosaic(mosaic_from_rgb(ramp))
    assert np.abs(restored - ramp)[4:-4, 4:-4].max() < 1e-5
    assert np.array_equal(restored[0::2, 0::2, 0], ramp[0::2, 0::2, 0])
    assert np.array_equal(restored[1::2, 1::2, 2], ramp[1::2, 1::2, 2])
    assert np.array_equal(restored[0::2, 1::2, 1], ramp[0::2, 1::2, 1])


def test_blur_spreads_a_point_to_the_standard_deviation_asked_for():
    point = np.zeros((61, 61, 3), np.float32)
    point[30, 30] = 1.0
    spread = blurred(point, 2.0)[..., 0].astype(float)
    across = spread.sum(axis=0)
    assert across.sum() == pytest.approx(1.0, abs=1e-5)
    assert np.sqrt(np.sum(across * (np.arange(61) - 30.0) ** 2)) == pytest.approx(2.0, rel=0.02)


def test_bright_light_clips_and_is_marked():
    light = np.full((8, 8, 3), 0.5, np.float32)
    light[:, 4:] = 1.5
    _, shot = expose(light, Nuisances(noise=False, blur_px=0, bayer=False), np.random.default_rng(0))
    assert shot.clipped[:, 4:].all()
    assert not shot.clipped[:, :4].any()
    assert shot.rgb.max() == 1.0
    free = Nuisances(noise=False, blur_px=0, bayer=False, clipping=False, quantisation=False)
    assert expose(light, free, np.random.default_rng(0))[1].rgb.max() == 1.5


def test_black_level_saves_the_noise_below_zero():
    dark = np.zeros((100, 100, 3), np.float32)
    lifted = Nuisances(blur_px=0, bayer=False, bits=12, read_noise_electrons=40.0, black_level=0.05)
    read = expose(dark, lifted, np.random.default_rng(1))[1].rgb
    assert abs(read.mean()) < 5 * read.std() / np.sqrt(read.size)
    assert lifted.file_transfer == Transfer(black_level=0.05)
