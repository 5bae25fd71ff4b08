"""How much a file may ask for: bounds that hold for every reader of this process, unless a call sets its own.

They guard against headers that declare more than there is memory for. The command line sets them by
`--max-megapixels` and `--max-vertices`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.io.files import require_file

_BYTES_PER_VERTEX = 256  # with its faces, normal, colour and texture coordinates, as text of full precision
_BYTES_BESIDE = 1 << 20


@dataclass(frozen=True, kw_only=True)
class ReadingLimits:
    """The largest files that are read.

    max_megapixels: larger images and frames are refused before memory is asked for them (million pixels).
    max_vertices: meshes and point clouds of more vertices are refused, and so are files too long for as many.
    """

    max_megapixels: float = 200.0
    max_vertices: int = 20_000_000

    def __post_init__(self) -> None:
        """Refuse limits that would let everything in, or nothing."""
        if not self.max_megapixels > 0 or math.isinf(self.max_megapixels):
            raise BadInput(
                f"--max-megapixels: expected a number above 0, such as 400, got {self.max_megapixels:g}"
            )
        if self.max_vertices < 1:
            raise BadInput(
                f"--max-vertices: expected a whole number above 0, such as 50000000, got {self.max_vertices}"
            )


_current = [ReadingLimits()]


def reading_limits() -> ReadingLimits:
    """Return the limits that hold now."""
    return _current[-1]


@contextmanager
def limited_to(limits: ReadingLimits) -> Iterator[None]:
    """Read within other limits in this block, on all threads of this process."""
    _current.append(limits)
    try:
        yield
    finally:
        _current.pop()


def require_pixels(
    width: int, height: int, max_megapixels: float | None, name: str, error: type[BadInput]
) -> None:
    """Refuse a size that a damaged or hostile header claims, before memory is asked for.

    max_megapixels: None for the limit that holds.
    """
    most = reading_limits().max_megapixels if max_megapixels is None else max_megapixels
    megapixels = width * height / 1e6
    if megapixels > most:
        size = f"{width}×{height} is {megapixels:.{0 if megapixels >= 10 else 3}f} megapixels"
        raise error(
            f"{name}: {size}, more than the limit of {most:g}; raise --max-megapixels if that is meant"
        )


def require_vertices(count: int, name: str) -> None:
    """Refuse a mesh or point cloud of more vertices than the limit that holds."""
    most = reading_limits().max_vertices
    if count > most:
        raise BadMesh(
            f"{name}: {count} vertices are more than the limit of {most}; raise --max-vertices if that is "
            "meant"
        )


def require_mesh_file(path: Path | str) -> Path:
    """Return the path of a file that holds no more than the limit's vertices can take, or raise `BadMesh`."""
    path = require_file(path, BadMesh)
    size, most = path.stat().st_size, reading_limits().max_vertices
    if size > most * _BYTES_PER_VERTEX + _BYTES_BESIDE:
        raise BadMesh(
            f"{path}: {size / 1e6:.0f} MB are more than a mesh of {most} vertices takes, the limit; raise "
            "--max-vertices if that is meant"
        )
    return path
