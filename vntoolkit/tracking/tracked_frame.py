"""The result of tracking in one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Points, Points2, read_only
from vntoolkit.geometry.camera import Camera


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedFrame:
    """Where the template's vertices are.

    vertices_in_camera: (n, 3). positions_px: (n, 2) their pixels. confidence: (n,) from 0 (not seen here,
    carried along by what is) to 1; below 0.5 a vertex is declared lost.
    """

    vertices_in_camera: Points
    positions_px: Points2
    confidence: npt.NDArray[np.floating]


def tracked_frame(
    vertices_in_camera: Points, confidence: npt.NDArray[np.floating], camera: Camera
) -> TrackedFrame:
    """Return a frame in the single precision that files hold.

    The state that tracking goes on from is then the one on disk, and a run that was interrupted ends in the
    same bytes as one that was not.
    """
    vertices = np.asarray(vertices_in_camera, dtype=np.float32)
    return TrackedFrame(
        vertices_in_camera=read_only(vertices),
        positions_px=read_only(camera.project(vertices)),
        confidence=read_only(np.asarray(confidence, dtype=np.float32)),
    )
