"""Inversion on any array library: what the compiled loops of `inversion_kernels` do, as whole-image steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from vntoolkit.devices import Backend
from vntoolkit.normals.inversion import InversionOptions, coefficients_from_response
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer, decoding_table

_LONGEST = 1e18


class ArrayInverter:
    """Equation 1 solved for stored integers of one camera; tables and M⁻¹ stay on the device.

    shape: (h, w) of the frames. bits: significant bits of a sample; storage_bits: 8 or 16.
    """

    def __init__(
        self,
        backend: Backend,
        response: LightResponse,
        transfer: Transfer,
        shape: tuple[int, int],
        options: InversionOptions,
        bits: int,
        storage_bits: int,
    ) -> None:
        self._backend = backend
        c = coefficients_from_response(response, options)
        self._darkest, self._sharpness = float(c.darkest), float(c.sharpness)
        self._clipped_factor = float(c.clipped_factor)
        white = (transfer.white_level - transfer.black_level) / (1.0 - transfer.black_level)
        self._white = white * (1.0 - 1e-6)
        inverse, offset = c.inverse, c.offset
        if response.variation is not None:
            v, u = np.indices(shape)
            matrices, ambients = response.at(np.stack([u, v], axis=-1))
            inverse = np.linalg.inv(matrices * options.relative_albedo)
            offset = (inverse @ ambients[..., None])[..., 0]
        put = backend.to_device
        # element (i, j) of M⁻¹ and i of M⁻¹a: a number each, or an image where the response varies
        self._inverse = [
            [put(np.float32(1) * inverse[..., i, j].astype(np.float32)) for j in range(3)] for i in range(3)
        ]
        self._offset = [put(np.float32(1) * offset[..., i].astype(np.float32)) for i in range(3)]
        self._table = put(np.array(decoding_table(transfer, bits, storage_bits)))

    def invert(self, encoded: Any, inside: Any) -> tuple[Any, Any, Any]:
        """Return normals (3 images x, y, z), weight and validity, from integers (h, w, 3) on the device."""
        xp = self._backend.xp
        r, g, b = (self._table[encoded[..., k]] for k in range(3))
        clipped = (r >= self._white) | (g >= self._white) | (b >= self._white)
        x, y, z = (
            row[0] * r + row[1] * g + row[2] * b - offset
            for row, offset in zip(self._inverse, self._offset, strict=True)
        )
        length = xp.sqrt(x * x + y * y + z * z)
        factor = xp.where(clipped, self._clipped_factor * xp.ones_like(length), xp.ones_like(length))
        good = inside & (length > self._darkest) & (length < _LONGEST) & (z < 0) & (factor > 0)
        safe = xp.where(good, length, xp.ones_like(length))
        departure = (safe - 1.0 / safe) * self._sharpness
        zero = xp.zeros_like(length)
        weight = xp.where(good, factor / (1.0 + departure * departure), zero)
        unit = tuple(xp.where(good, axis / safe, zero) for axis in (x, y, z))
        return unit, weight, good
