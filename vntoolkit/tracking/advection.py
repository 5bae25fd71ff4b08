"""Equations 5 and 6 of `brostow2011`: where flow carries a vertex, and the point of the surface there."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Flow, Mask, Points, Points2
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.tracking.sampling import sample_depth, sample_image


def advected_positions(positions_px: Points2, flow_px: Flow) -> npt.NDArray[np.float64]:
    """Equation 5: u^j = u^(j−1) + d(u^(j−1)), d looked up bilinearly; positions (n, 2) in pixels."""
    return np.asarray(positions_px + sample_image(flow_px, positions_px))


def targets_on_surface(
    positions_px: Points2, depth_map: DepthMap, camera: Camera, fallback_depth: npt.NDArray[np.floating]
) -> tuple[Points, Mask]:
    """Equation 6: the points y (n, 3) in the camera frame at positions (n, 2), with the depth found there.

    Where the depth map has none, fallback_depth (n,) stands in. Also returns where depth was found, (n,).
    """
    depth, found = sample_depth(depth_map.depth, depth_map.mask, positions_px)
    return camera.unproject(positions_px, np.where(found, depth, fallback_depth)), found
