"""A contact sheet of a simulated capture: film, normals and lights of frames spread over it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import VisibilityLabels
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.photometry.visibility import lit_from_labels

Picture = npt.NDArray[np.uint8]
_DISPLAY_GAMMA = 2.2


def contact_row(
    stored: npt.NDArray[Any], normals: NormalMap, labels: VisibilityLabels, linear: bool, width: int
) -> Picture:
    """Return one frame's film, normals (colours as in a normal map file) and lit channels, side by side.

    stored: (h, w, 3) as in the file; linear: whether its values need a display curve. width: of each picture.
    """
    film = stored.astype(np.float32) / np.iinfo(stored.dtype).max
    if linear:
        film = film ** np.float32(1.0 / _DISPLAY_GAMMA)
    towards_viewer = normals.normals_in_camera * np.array([1.0, -1.0, -1.0], np.float32)
    coloured = np.where(normals.mask[..., None], 0.5 * (towards_viewer + 1.0), 0.0)
    lit = lit_from_labels(labels).astype(np.float32)
    height = round(film.shape[0] * width / film.shape[1])
    pictures = [
        cv2.resize(picture.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
        for picture in (film, coloured, lit)
    ]
    return np.rint(255.0 * np.clip(np.hstack(pictures), 0.0, 1.0)).astype(np.uint8)


def contact_sheet(rows: Iterable[Picture]) -> Picture:
    """Stack rows of equal size, two abreast where there are more than three."""
    stacked = list(rows)
    if len(stacked) <= 3:
        return np.vstack(stacked)
    if len(stacked) % 2:
        stacked.append(np.zeros_like(stacked[0]))
    return np.vstack([np.hstack(stacked[i : i + 2]) for i in range(0, len(stacked), 2)])
