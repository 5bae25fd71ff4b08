"""The head's shape from silhouettes and stereo, in passes from coarse to fine."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from vntoolkit.calibration.head.fusion import FusionOptions, Surface, fuse_points
from vntoolkit.calibration.head.hull import DistanceGrid, View, mesh_of_grid
from vntoolkit.calibration.head.stereo import StereoOptions, stereo_points
from vntoolkit.calibration.head.turn import spread_over_turn
from vntoolkit.calibration.head.volume import fuse_depths
from vntoolkit.geometry.mesh import Mesh


def fit_shape(
    views: Sequence[View],
    contrasts: Sequence[npt.NDArray[np.uint8]],
    hull: DistanceGrid,
    stereo: StereoOptions,
    fusion: FusionOptions,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Mesh:
    """Search depths about the hull, fuse, search again closely about the result; returns a closed mesh.

    contrasts: (h, w) local contrast of every view, 8 bits. on_progress is told depth maps done and in all.
    Raises `BadCalibration` where hardly two views agree on a depth.
    """
    references = spread_over_turn(views, stereo.references)
    mesh, volume = mesh_of_grid(hull), hull
    diagonal = mesh.diagonal
    for number in range(stereo.passes):
        maps = []
        for done, k in enumerate(references.tolist(), start=1):
            search = stereo if number == 0 else stereo.closely()
            maps.append(stereo_points(views, contrasts, mesh, k, search))
            on_progress(number * len(references) + done, stereo.passes * len(references))
        if fusion.surface is Surface.POISSON:
            mesh = fuse_points(maps, mesh, hull, fusion)
        else:
            volume = fuse_depths(maps, [views[k] for k in references], volume, hull, diagonal, fusion)
            mesh = mesh_of_grid(volume)
    return mesh
