"""Conversion between encoded values and linear light: transfer curves, black level, white level.

Decoding 8- and 16-bit integers goes through a table of all values, so the cost of the curve vanishes.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray
from vntoolkit.errors import BadInput


class TransferCurve(Enum):
    """Which curve relates stored values to light."""

    LINEAR = "linear"
    SRGB = "srgb"  # IEC 61966-2-1
    BT709 = "bt709"  # ITU-R BT.709-6, item 1.2, the camera's curve
    GAMMA = "gamma"  # a pure power


@dataclass(frozen=True, kw_only=True)
class Transfer:
    """A transfer curve with its levels.

    curve: which. gamma: exponent of `GAMMA` (light = value^gamma). black_level, white_level: the linear
    values, 0 to 1 of full scale, that mean no light and saturation.
    """

    curve: TransferCurve = TransferCurve.LINEAR
    gamma: float = 1.0
    black_level: float = 0.0
    white_level: float = 1.0

    def __post_init__(self) -> None:
        if not 0.1 <= self.gamma <= 10:
            raise BadInput(f"transfer: expected a gamma from 0.1 to 10, got {self.gamma:g}")
        if not 0 <= self.black_level < self.white_level <= 1:
            raise BadInput(
                "transfer: expected 0 <= black_level < white_level <= 1, "
                f"got {self.black_level:g} and {self.white_level:g}"
            )

    @classmethod
    def from_text(cls, text: str) -> Transfer:
        """Parse `linear`, `srgb`, `bt709` or `gamma:G`."""
        name, _, value = text.strip().lower().partition(":")
        try:
            if name == "gamma":
                return cls(curve=TransferCurve.GAMMA, gamma=float(value))
            if not value:
                return cls(curve=TransferCurve(name))
        except ValueError:
            pass
        raise BadInput(f"transfer: expected linear, srgb, bt709 or gamma:G (such as gamma:2.2), got '{text}'")

    def to_text(self) -> str:
        """Return the form that `from_text` reads (levels not included); a gamma keeps every digit."""
        if self.curve is not TransferCurve.GAMMA:
            return self.curve.value
        short = f"{self.gamma:g}"
        return f"gamma:{short if float(short) == self.gamma else repr(float(self.gamma))}"


def linear_from_encoded(encoded: FloatArray, transfer: Transfer) -> FloatArray:
    """Undo the curve and subtract the black level: values 0 to 1 in, linear light out, same shape."""
    light = _undo_curve(np.clip(encoded, 0.0, None), transfer)
    return (light - transfer.black_level) / (1.0 - transfer.black_level)


def encoded_from_linear(linear: FloatArray, transfer: Transfer) -> FloatArray:
    """Inverse of `linear_from_encoded`, clipped to 0 to 1."""
    light = np.clip(linear * (1.0 - transfer.black_level) + transfer.black_level, 0.0, 1.0)
    match transfer.curve:
        case TransferCurve.LINEAR:
            return light
        case TransferCurve.SRGB:
            return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
        case TransferCurve.BT709:
            return np.where(light < 0.018, 4.5 * light, 1.099 * light**0.45 - 0.099)
        case TransferCurve.GAMMA:
            return light ** (1.0 / transfer.gamma)


def linear_from_integers(
    values: npt.NDArray[Any], transfer: Transfer, bits: int | None = None
) -> npt.NDArray[np.float32]:
    """Decode uint8 or uint16 samples of `bits` significant bits (default: all) to linear float32."""
    if values.dtype not in (np.uint8, np.uint16):
        raise BadInput(f"image: expected 8- or 16-bit samples, got {values.dtype}")
    bits = bits or values.dtype.itemsize * 8
    return decoding_table(transfer, bits, values.dtype.itemsize * 8)[values]


@lru_cache(maxsize=16)
def decoding_table(transfer: Transfer, bits: int, storage_bits: int) -> npt.NDArray[np.float32]:
    """Linear float32 value of every stored integer; (2**storage_bits,)."""
    encoded = np.arange(2**storage_bits, dtype=np.float64) / (2**bits - 1)
    table = linear_from_encoded(encoded, transfer).astype(np.float32)
    table.flags.writeable = False
    return table


def _undo_curve(encoded: FloatArray, transfer: Transfer) -> FloatArray:
    match transfer.curve:
        case TransferCurve.LINEAR:
            return encoded
        case TransferCurve.SRGB:
            return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
        case TransferCurve.BT709:
            return np.where(encoded < 0.081, encoded / 4.5, ((encoded + 0.099) / 1.099) ** (1 / 0.45))
        case TransferCurve.GAMMA:
            return encoded**transfer.gamma
