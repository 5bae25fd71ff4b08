"""A moving mesh: one fixed topology, and one position per vertex and frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, read_only
from vntoolkit.checks import require_finite, require_shape, sum_is_finite
from vntoolkit.display import Displayed, Facts, Picture
from vntoolkit.errors import BadMesh
from vntoolkit.geometry.mesh import Mesh


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MeshSequence(Displayed):
    """A moving mesh.

    template: topology, colours and texture coordinates. vertices: (frames, n, 3), possibly a memory map,
    so that a long sequence is read in slices. uncertainty_px: (frames, n) the error to expect of a
    vertex in the image, pixels, or None. frame_rate_hz: frames per second.
    """

    template: Mesh
    vertices: FloatArray
    frame_rate_hz: float = 60.0
    uncertainty_px: FloatArray | None = None

    def __post_init__(self) -> None:
        require_shape(self.vertices, (None, len(self.template.vertices), 3), "moving vertices", BadMesh)
        if not 0 < self.frame_rate_hz < np.inf:
            raise BadMesh(f"frame rate: expected a positive number, got {self.frame_rate_hz}")
        object.__setattr__(self, "vertices", read_only(self.vertices))
        if self.uncertainty_px is not None:
            require_shape(self.uncertainty_px, self.vertices.shape[:2], "uncertainty in pixels", BadMesh)
            object.__setattr__(self, "uncertainty_px", read_only(self.uncertainty_px))

    def _facts(self) -> Facts:
        facts = {
            "frames": str(len(self)),
            "vertices": str(len(self.template.vertices)),
            "faces": str(len(self.template.faces)),
            "rate": f"{self.frame_rate_hz:g} Hz",
        }
        if self.uncertainty_px is not None and len(self):
            facts["expected error, last frame"] = f"{np.median(self.uncertainty_px[-1]):.2f} px"
        return facts

    def _picture(self) -> Picture | None:
        return self[0]._picture() if len(self) else None

    def __len__(self) -> int:
        return int(self.vertices.shape[0])

    def require_finite(self, name: str) -> None:
        """Raise `BadMesh` for a frame with NaN or infinity; reads them one after the other."""
        for frame, vertices in enumerate(self.vertices):
            if not sum_is_finite(vertices):
                require_finite(vertices, f"{name}: frame {frame}", BadMesh)

    def __getitem__(self, frame: int) -> Mesh:
        """Return the mesh of one frame, read into memory."""
        return self.template.with_vertices(np.array(self.vertices[frame]))

    def __iter__(self) -> Iterator[Mesh]:
        return (self[frame] for frame in range(len(self)))
