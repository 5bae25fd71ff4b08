"""Lengths of many short vectors; numpy's own reduction over an axis of three takes five times as long."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray


def lengths_of(vectors: FloatArray) -> FloatArray:
    """Return the lengths (..., 1) of vectors (..., n)."""
    squared: FloatArray = np.einsum("...i,...i->...", vectors, vectors)
    return np.sqrt(squared)[..., None]
