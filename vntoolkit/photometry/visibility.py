"""Which of the three lights reach a pixel: one byte per pixel, bit k for light k."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import VisibilityLabels

ALL_LIT = 7


def labels_from_lit(lit: npt.NDArray[np.bool_]) -> VisibilityLabels:
    """Pack (..., 3) booleans, one per light, into (...) labels."""
    return (lit[..., 0] + 2 * lit[..., 1].astype(np.uint8) + 4 * lit[..., 2].astype(np.uint8)).astype(
        np.uint8
    )


def lit_from_labels(labels: VisibilityLabels) -> npt.NDArray[np.bool_]:
    """Unpack (...) labels into (..., 3) booleans, one per light."""
    return (labels[..., None] >> np.arange(3, dtype=np.uint8)) & 1 == 1


def count_lit(labels: VisibilityLabels) -> npt.NDArray[np.uint8]:
    """Number of lights, 0 to 3, that reach each pixel."""
    return np.array([0, 1, 1, 2, 1, 2, 2, 3], dtype=np.uint8)[labels]
