"""A rendered frame and everything true about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from vntoolkit.arrays import Flow, LinearImage, Points, VisibilityLabels
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.photometry.frame import LinearFrame


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameTruth:
    """What is true of one frame.

    normals: the shaded normal, relief included; where a pixel has several samples, their mean's direction.
    depth: metres, of the mesh (without relief), at the pixel's centre. Both masks are True where the ray
    through the pixel's centre meets the mesh. labels: (h, w) bit k set where light k reaches at least half
    of the pixel's samples. flow_px: (h, w, 2) to the next frame, 0 outside the mask, or None for the last
    frame. vertices: (n, 3) in the camera frame.
    """

    normals: NormalMap
    depth: DepthMap
    labels: VisibilityLabels
    flow_px: Flow | None
    vertices: Points


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedFrame:
    """One frame as filmed, and its truth.

    radiance: (h, w, 3) linear light before lens and sensor. stored: (h, w, 3) uint8 or uint16 as the file
    holds it. linear: what a reader who knows the transfer gets.
    """

    number: int
    radiance: LinearImage
    stored: npt.NDArray[Any]
    linear: LinearFrame
    truth: FrameTruth
