"""The free offset of depth over time: every frame is tied to one reference frame.

Normals tell depth up to a constant (a factor, in perspective) per connected part. Set to a mean, it jumps
whenever the outline changes: an arm that enters the picture pushes the whole body back. Here each part is
shifted so that the median difference to the reference frame is 0 over the pixels that both frames cover;
what moves is outvoted by what rests. A frame depends on the reference and itself alone, never on
its neighbours, so that nothing drifts and frames may be worked on in any order.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from vntoolkit.arrays import Mask
from vntoolkit.geometry.maps import DepthMap, LengthUnit
from vntoolkit.integration.components import Components

_FEWEST_PIXELS = 64
_VOTES = 20_000  # pixels that the median is taken over, evenly spread
_SMALLEST_SHARE = 0.02  # of a part's pixels that the reference must cover


class DepthAnchor:
    """Ties depth maps to a reference; parts that the reference does not cover stay as they are."""

    def __init__(self, reference: DepthMap) -> None:
        self._reference = reference

    def align(self, depth_map: DepthMap) -> DepthMap:
        """Return `depth_map` with the reference's offset (`FREE` depth: its scale)."""
        depth = np.array(depth_map.depth)
        if depth_map.mask.all():
            self._align_part(depth, depth_map.mask, np.s_[:, :], depth_map.unit)
            return replace(depth_map, depth=depth)
        labels = Components(depth_map.mask).labels
        for label, box in enumerate(ndimage.find_objects(labels), start=1):
            self._align_part(depth[box], labels[box] == label, box, depth_map.unit)
        return replace(depth_map, depth=depth)

    def _align_part(
        self, depth: npt.NDArray[Any], part: Mask, box: tuple[slice, slice], unit: LengthUnit
    ) -> None:
        """Shift or scale `depth`, the view of one part's bounding box, in place where `part` is."""
        common = np.flatnonzero(part & self._reference.mask[box])
        if len(common) < max(_FEWEST_PIXELS, _SMALLEST_SHARE * np.count_nonzero(part)):
            return
        common = common[:: max(1, len(common) // _VOTES)]
        ours = depth.ravel()[common].astype(np.float64)
        wanted = self._reference.depth[box].ravel()[common]
        if unit is LengthUnit.FREE:
            np.multiply(depth, np.median(wanted / ours), out=depth, where=part)
        else:
            np.add(depth, np.median(wanted - ours), out=depth, where=part)
