"""Seams on disk: a small JSON file of polylines on the template image.

    {"seams": [[[310, 402], [330, 405], [352, 401]], [[280, 250], [300, 248]]]}

Each seam is a list of points (u, v) in pixels of the template frame, integers at pixel centres.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Points2
from vntoolkit.errors import BadInput
from vntoolkit.io.atomic import write_text
from vntoolkit.io.files import read_json

_EXPECTED = 'polylines in pixels, {"seams": [[[u, v], [u, v], ...], ...]}'


def read_seams(path: Path | str) -> tuple[Points2, ...]:
    """Read the seams, each (k, 2) float64 with k >= 2. Raises `BadInput` with one line."""
    content = read_json(path, expected=_EXPECTED)
    if not isinstance(content, dict) or set(content) != {"seams"} or not isinstance(content["seams"], list):
        raise BadInput(f"{path}: expected {_EXPECTED} and no other key")
    seams = []
    for number, points in enumerate(content["seams"]):
        try:
            seam = np.array(points, dtype=np.float64)
        except (ValueError, TypeError, OverflowError):
            seam = np.empty(0)
        if seam.ndim != 2 or seam.shape[1] != 2 or len(seam) < 2 or not np.isfinite(seam).all():
            raise BadInput(f"{path}: seam {number}: expected two points [u, v] or more, in pixels")
        seams.append(seam)
    return tuple(seams)


def write_seams(path: Path | str, seams: Sequence[Points2]) -> None:
    """Write seams, each (k, 2) in pixels of the template, to a hundredth of one. Raises `CannotWrite`."""
    points = [np.round(np.asarray(seam, dtype=np.float64), 2).tolist() for seam in seams]
    write_text(Path(path), json.dumps({"seams": points}) + "\n")
