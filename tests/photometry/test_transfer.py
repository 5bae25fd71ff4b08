import numpy as np
import pytest

from vntoolkit.photometry.transfer import (
    Transfer,
    TransferCurve,
    encoded_from_linear,
    linear_from_encoded,
    linear_from_integers,
)

CURVES = [
    Transfer.from_text(text)
    for text in ("linear", "srgb", "bt709", "gamma:2.2", "pq", "hlg", "S-Log3", "v-log", "clog3", "LogC3")
] + [Transfer(curve=TransferCurve.SRGB, black_level=0.02)]


@pytest.mark.parametrize("transfer", CURVES, ids=lambda t: t.to_text())
def test_encoding_undoes_decoding(transfer: Transfer) -> None:
    encoded = np.linspace(0.15, 1, 400)  # above the black level
    linear = linear_from_encoded(encoded, transfer)
    np.testing.assert_allclose(encoded_from_linear(linear, transfer), encoded, atol=1e-9)
    assert np.all(np.diff(linear) > 0)
    assert linear[-1] == pytest.approx(1.0)


def test_published_values() -> None:
    # IEC 61966-2-1: half of full scale in sRGB is 21.4 % of the light; BT.709: 25.96 %.
    assert linear_from_encoded(np.array(0.5), Transfer.from_text("srgb")) == pytest.approx(0.2140, abs=1e-4)
    assert linear_from_encoded(np.array(0.5), Transfer.from_text("bt709")) == pytest.approx(0.2596, abs=1e-4)


@pytest.mark.parametrize(
    ("name", "grey", "black"),
    [("slog3", 420, 95), ("vlog", 433, 128), ("clog3", 351, 128), ("logc3", 400, 95)],
)
def test_camera_logs_meet_their_published_codes(name: str, grey: int, black: int) -> None:
    """10-bit codes of a grey card of 18 % and of no light, from the makers' papers."""
    transfer = Transfer.from_text(name)
    light = np.array([0.18, 0.0]) * transfer.diffuse_white
    codes = 1023 * encoded_from_linear(light, transfer)
    np.testing.assert_allclose(codes, [grey, black], atol=0.6)
    dark = linear_from_encoded(np.linspace(0, 1, 2000), transfer)
    assert np.all(np.diff(dark) > 0)  # the line and the logarithm meet


def test_broadcast_curves_meet_their_published_values() -> None:
    """BT.2100: HLG meets at E = 1/12, E' = 1/2; PQ's 58 % is 203 cd/m², of BT.2408's white."""
    hlg, pq = Transfer.from_text("hlg"), Transfer.from_text("pq")
    assert linear_from_encoded(np.array(0.5), hlg) == pytest.approx(1 / 12)
    assert hlg.diffuse_white == pytest.approx(0.265, abs=1e-3)
    display = (203 / 100) ** (1 / 2.4)  # before the display's power of 2.4
    assert pq.diffuse_white == pytest.approx(((display + 0.099) / 1.099) ** (1 / 0.45) / 59.5208, rel=2e-3)


@pytest.mark.parametrize(
    ("dtype", "bits"), [(np.uint8, 8), (np.uint16, 10), (np.uint16, 12), (np.uint16, 16)]
)
def test_integers_go_through_the_same_curve(dtype: type, bits: int, rng: np.random.Generator) -> None:
    transfer = Transfer.from_text("srgb")
    values = rng.integers(0, 2**bits, (7, 5, 3)).astype(dtype)
    expected = linear_from_encoded(values / (2**bits - 1), transfer)
    decoded = linear_from_integers(values, transfer, bits)
    assert decoded.dtype == np.float32
    np.testing.assert_allclose(decoded, expected, atol=1e-7)


def test_black_level_maps_to_zero() -> None:
    transfer = Transfer(black_level=0.1)
    assert linear_from_encoded(np.array(0.1), transfer) == pytest.approx(0)


@pytest.mark.parametrize("text", ["linear", "srgb", "gamma:2", "gamma:2.2", "gamma:2.2222222222222223"])
def test_a_curve_comes_back_from_its_text_to_the_last_digit(text: str) -> None:
    assert Transfer.from_text(text).to_text() == text
    assert Transfer.from_text(Transfer.from_text(text).to_text()) == Transfer.from_text(text)
