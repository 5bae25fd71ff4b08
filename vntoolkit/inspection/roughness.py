"""Areal roughness by ISO 25178, and files of other inspection programs, through `surfalize` (GPL 3)."""

import io
import warnings
from typing import Any

import numpy as np

from vntoolkit.inspection.heights import HeightMap
from vntoolkit.libraries import require_installed

# Height parameters: arithmetical and root mean square height, highest peak, deepest pit, both together,
# skewness and kurtosis.
PARAMETERS = ("Sa", "Sq", "Sp", "Sv", "Sz", "Ssk", "Sku")


def roughness(height_map: HeightMap) -> dict[str, float]:
    """Return the height parameters by name, in the unit of the heights (Ssk and Sku have none)."""
    surface = _surface(height_map, height_map.heights, masked=True)
    return {name: float(getattr(surface, name)()) for name in PARAMETERS}


def surface_file(height_map: HeightMap, kind: str, *, micrometres: float) -> bytes:
    """Return a file of heights, `sur` (Digital Surf) or `x3p` (ISO 25178-72), with gaps where none is.

    micrometres: of the unit of the heights.
    """
    heights = np.where(height_map.mask, height_map.heights * micrometres, np.nan)
    content = io.BytesIO()
    _surface(height_map, heights, masked=False, micrometres=micrometres).save(content, format=f".{kind}")
    return content.getvalue()


def _surface(height_map: HeightMap, heights: Any, *, masked: bool, micrometres: float = 1.0) -> Any:
    require_installed("surfalize", "'vntoolkit[roughness]'", "ISO 25178 and its files need surfalize")
    from surfalize import Surface

    across, down = (micrometres * pitch for pitch in height_map.pitch)
    mask = ~height_map.mask if masked and not height_map.mask.all() else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pixels that are not square, which height parameters may be
        return Surface(np.array(heights, np.float64), across, down, mask=mask)
