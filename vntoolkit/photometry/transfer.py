"""Conversion between encoded values and linear light: transfer curves, black level, white level.

Decoding 8- and 16-bit integers goes through a table of all values, so the cost of the curve vanishes.
"""

from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np

from vntoolkit.arrays import Array, Float32Array, FloatArray
from vntoolkit.errors import BadInput


class TransferCurve(Enum):
    """Which curve relates stored values to light."""

    LINEAR = "linear"
    SRGB = "srgb"  # IEC 61966-2-1
    BT709 = "bt709"  # ITU-R BT.709-6, item 1.2, the camera's curve
    GAMMA = "gamma"  # a pure power
    PQ = "pq"  # bt2100, table 4: the camera's side, through the reference OOTF
    HLG = "hlg"  # bt2100, table 5
    SLOG3 = "slog3"  # sony2014
    VLOG = "vlog"  # panasonic2014
    CLOG3 = "clog3"  # canon2018
    LOGC3 = "logc3"  # arri2012, exposure index 800


@dataclass(frozen=True, kw_only=True)
class _CameraLog:
    """A camera's logarithm: light = (10^((x - d) / c) - b) / a above a code, a straight line below it.

    x: code, 0 to 1. light: reflectance, 1 = ideal white. cut: code where the line ends. slope: of the line,
    light per code; zero: code of no light. takes_codes: the formula takes the stored code itself, also where
    the file states a limited range.
    """

    a: float
    b: float
    c: float
    d: float
    cut: float
    slope: float
    zero: float
    takes_codes: bool = True

    def light(self, code: FloatArray | np.float64) -> FloatArray:
        within = np.clip(code, self.cut, 2.0)  # 12 bits stored in 16 leave codes above 1, which overflow
        logarithmic = (10.0 ** ((within - self.d) / self.c) - self.b) / self.a
        return np.where(code >= self.cut, logarithmic, (code - self.zero) * self.slope)

    def code(self, light: FloatArray) -> FloatArray:
        least = (self.cut - self.zero) * self.slope
        logarithmic = self.c * np.log10(self.a * np.maximum(light, least) + self.b) + self.d
        return np.where(light >= least, logarithmic, light / self.slope + self.zero)


_CAMERA_LOGS = {
    TransferCurve.SLOG3: _CameraLog(
        a=1 / 0.19, b=0.01 / 0.19, c=261.5 / 1023, d=420 / 1023, cut=171.2102946929 / 1023,
        slope=0.01125 * 1023 / (171.2102946929 - 95), zero=95 / 1023,
    ),
    TransferCurve.VLOG: _CameraLog(
        a=1, b=0.00873, c=0.241514, d=0.598206, cut=0.181, slope=1 / 5.6, zero=0.125,
    ),
    # Below -0.0126 the published curve is a logarithm of the negative light; here the line goes on.
    TransferCurve.CLOG3: _CameraLog(
        a=14.98325 / 0.9, b=1, c=0.36726845, d=0.12240537, cut=0.15277891,
        slope=0.9 / 1.9754798, zero=0.12512219,
    ),
    TransferCurve.LOGC3: _CameraLog(
        a=5.555556, b=0.052272, c=0.247190, d=0.385537, cut=5.367655 * 0.010591 + 0.092809,
        slope=1 / 5.367655, zero=0.092809, takes_codes=False,
    ),
}  # fmt: skip
_NAMES = "linear, srgb, bt709, gamma:G (such as gamma:2.2), pq, hlg, slog3, vlog, clog3 or logc3"
# bt2100, table 4
_PQ_M1, _PQ_M2 = 2610 / 16384, 2523 / 4096 * 128
_PQ_C1, _PQ_C2, _PQ_C3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
# bt2100, table 5
_HLG_A = 0.17883277
_HLG_B, _HLG_C = 1 - 4 * _HLG_A, 0.5 - _HLG_A * float(np.log(4 * _HLG_A))
# Codes of a diffuse white, bt2408: 203 cd/m² in PQ, 75 % in HLG.
_WHITE_CODES = {TransferCurve.PQ: 0.5807, TransferCurve.HLG: 0.75}


@dataclass(frozen=True, kw_only=True)
class Transfer:
    """A transfer curve with its levels.

    curve: which. gamma: exponent of `GAMMA` (light = value^gamma). black_level, white_level: the linear
    values, 0 to 1 of full scale, that mean no light and saturation. Full scale is the light of the largest
    code, for every curve.
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
    def from_text(cls, text: str) -> "Transfer":
        """Parse `linear`, `srgb`, `bt709`, `gamma:G`, `pq`, `hlg`, `slog3`, `vlog`, `clog3` or `logc3`.

        Hyphens may stand in a name, as in S-Log3.
        """
        name, _, value = text.strip().lower().partition(":")
        try:
            if name == "gamma":
                return cls(curve=TransferCurve.GAMMA, gamma=float(value))
            if not value:
                return cls(curve=TransferCurve(name.replace("-", "")))
        except ValueError:
            pass
        raise BadInput(f"transfer: expected {_NAMES}, got '{text}'")

    @property
    def takes_codes(self) -> bool:
        """True where the curve is defined on the stored codes, whatever range the file states."""
        log = _CAMERA_LOGS.get(self.curve)
        return log is not None and log.takes_codes

    @property
    def is_camera_log(self) -> bool:
        """True for a camera's own logarithm, which no tag of a video file can state."""
        return self.curve in _CAMERA_LOGS

    @property
    def diffuse_white(self) -> float:
        """Light of a well exposed white surface, as a share of full scale: 1 where nothing is brighter."""
        if self.curve in _CAMERA_LOGS:
            return 1.0 / float(_CAMERA_LOGS[self.curve].light(np.float64(1.0)))
        if self.curve in _WHITE_CODES:
            return float(_undo_curve(np.array(_WHITE_CODES[self.curve]), self))
        return 1.0

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
        case TransferCurve.PQ:
            return _pq_from_light(light)
        case TransferCurve.HLG:
            upper = _HLG_A * np.log(np.maximum(12 * light - _HLG_B, 1e-9)) + _HLG_C
            return np.where(light <= 1 / 12, np.sqrt(3 * light), upper)
        case _:
            log = _CAMERA_LOGS[transfer.curve]
            return np.clip(log.code(light * log.light(np.float64(1.0))), 0.0, 1.0)


def linear_from_integers(values: Array, transfer: Transfer, bits: int | None = None) -> Float32Array:
    """Decode uint8 or uint16 samples of `bits` significant bits (default: all) to linear float32."""
    if values.dtype not in (np.uint8, np.uint16):
        raise BadInput(f"image: expected 8- or 16-bit samples, got {values.dtype}")
    bits = bits or values.dtype.itemsize * 8
    return decoding_table(transfer, bits, values.dtype.itemsize * 8)[values]


@lru_cache(maxsize=16)
def decoding_table(transfer: Transfer, bits: int, storage_bits: int) -> Float32Array:
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
        case TransferCurve.PQ:
            return _light_from_pq(encoded)
        case TransferCurve.HLG:
            return np.where(
                encoded <= 0.5, encoded**2 / 3, (np.exp((encoded - _HLG_C) / _HLG_A) + _HLG_B) / 12
            )
        case _:
            log = _CAMERA_LOGS[transfer.curve]
            return log.light(encoded) / log.light(np.float64(1.0))


def _light_from_pq(encoded: FloatArray) -> FloatArray:
    """Undo the reference OETF of PQ: from the code to the display's light, and back through the OOTF."""
    root = np.clip(encoded, 0.0, 1.0) ** (1 / _PQ_M2)
    display = 100 * (np.maximum(root - _PQ_C1, 0) / (_PQ_C2 - _PQ_C3 * root)) ** (1 / _PQ_M1)  # of 100 cd/m²
    camera = display ** (1 / 2.4)
    return np.where(camera <= 0.081, camera / 267.84, ((camera + 0.099) / 1.099) ** (1 / 0.45) / 59.5208)


def _pq_from_light(light: FloatArray) -> FloatArray:
    camera = np.where(light <= 0.0003024, 267.84 * light, 1.099 * (59.5208 * light) ** 0.45 - 0.099)
    power = (camera**2.4 / 100) ** _PQ_M1
    return ((_PQ_C1 + _PQ_C2 * power) / (1 + _PQ_C3 * power)) ** _PQ_M2
