"""Labels of ball presses: one text file a frame, `u v contact_radius` in pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vntoolkit.errors import BadInput
from vntoolkit.io.files import read_text


def read_press_label(path: Path | str) -> tuple[float, float, float]:
    """Read centre u, v and contact radius, pixels, of one press."""
    words = read_text(path).split()
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise BadInput(
            f"{path}: expected three numbers (u, v, contact radius), got '{words[0][:40]} …'"
        ) from error
    if len(values) != 3 or not np.isfinite(values).all() or values[2] <= 0:
        raise BadInput(f"{path}: expected three numbers (u, v, contact radius > 0), got {len(values)}")
    return values[0], values[1], values[2]


def label_path(folder: Path, image: Path) -> Path:
    """The label of an image: the file of its name with the suffix .txt."""
    return folder / f"{image.stem}.txt"
