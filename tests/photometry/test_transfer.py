import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.photometry.transfer import (
    Transfer,
    TransferCurve,
    encoded_from_linear,
    linear_from_encoded,
    linear_from_integers,
)

CURVES = [Transfer.from_text(text) for text in ("linear", "srgb", "bt709", "gamma:2.2")] + [
    Transfer(curve=TransferCurve.SRGB, black_level=0.02)
]


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


@pytest.mark.parametrize("text", ["", "rec2020", "gamma", "gamma:x", "srgb:2", "gamma:0"])
def test_unknown_curves_are_refused(text: str) -> None:
    with pytest.raises(BadInput, match="transfer: expected"):
        Transfer.from_text(text)


def test_signed_samples_are_refused() -> None:
    with pytest.raises(BadInput, match="8- or 16-bit"):
        linear_from_integers(np.zeros((2, 2, 3), np.int32), Transfer())


@pytest.mark.parametrize("text", ["linear", "srgb", "gamma:2", "gamma:2.2", "gamma:2.2222222222222223"])
def test_a_curve_comes_back_from_its_text_to_the_last_digit(text: str) -> None:
    assert Transfer.from_text(text).to_text() == text
    assert Transfer.from_text(Transfer.from_text(text).to_text()) == Transfer.from_text(text)
