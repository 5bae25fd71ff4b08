"""Encoded samples to a linear frame in one pass over the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import LinearImage
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.transfer import Transfer, decoding_table


@dataclass(frozen=True, kw_only=True, eq=False)
class EncodedFrame:
    """One frame as stored, for a kernel that computes normals directly from the stored samples.

    values: (h, w, 3) RGB, uint8, uint16 or float32 (EXR: linear already). bits: significant bits of an
    integer sample, so that 2**bits - 1 is full scale. number: counted from 0 in the capture. name: the file,
    or file and frame number, for messages.
    """

    values: npt.NDArray[Any]
    bits: int
    number: int
    name: str


def linear_frame_from_encoded(
    frame: EncodedFrame, transfer: Transfer, background: LinearImage | None = None
) -> LinearFrame:
    """Undo the transfer curve, remove the black level or the background, mark clipped pixels.

    background: (h, w, 3) linear, of the same size, subtracted; None for none. A pixel is clipped where any
    channel, before subtraction, reached `transfer.white_level`. Float values are linear by definition: the
    curve does not apply to them, the levels do.
    """
    values = np.ascontiguousarray(frame.values)
    rgb = np.empty(values.shape, dtype=np.float32)
    clipped = np.empty(values.shape[:2], dtype=np.bool_)
    if values.dtype == np.float32:
        np.subtract(values, np.float32(transfer.black_level), out=rgb)
        rgb *= np.float32(1.0 / (1.0 - transfer.black_level))
        np.any(values >= np.float32(transfer.white_level), axis=2, out=clipped)
    else:
        table = decoding_table(transfer, frame.bits, values.dtype.itemsize * 8)
        _look_up(values, table, clipping_code(transfer, table, frame.bits), rgb, clipped)
    if background is not None:
        rgb -= background
    return LinearFrame(rgb=rgb, clipped=clipped, number=frame.number)


def clipping_code(transfer: Transfer, table: npt.NDArray[np.float32], bits: int) -> int:
    """Return the smallest stored integer that counts as clipped under `table`."""
    saturation = (transfer.white_level - transfer.black_level) / (1.0 - transfer.black_level)
    code = int(np.searchsorted(table, np.float32(saturation * (1.0 - 1e-6))))
    return min(code, 2**bits - 1)


@njit(cache=True)
def _look_up(values, table, clip_code, rgb, clipped):  # type: ignore[no-untyped-def]  # pragma: no cover
    for v in range(values.shape[0]):
        for u in range(values.shape[1]):
            r, g, b = values[v, u, 0], values[v, u, 1], values[v, u, 2]
            rgb[v, u, 0] = table[r]
            rgb[v, u, 1] = table[g]
            rgb[v, u, 2] = table[b]
            clipped[v, u] = r >= clip_code or g >= clip_code or b >= clip_code
