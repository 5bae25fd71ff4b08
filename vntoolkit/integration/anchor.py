"""The free offset of depth over time: every frame is tied to one reference frame.

Normals tell depth up to a constant (a factor, in perspective) per connected part. Set to a mean, it jumps
whenever the outline changes: an arm that enters the picture pushes the whole body back. Here each part is
shifted so that the median difference to the reference frame is 0 over the pixels that both frames cover;
what moves is outvoted by what rests. A frame depends on the reference and itself alone, never on
its neighbours, so that nothing drifts and frames may be worked on in any order.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vntoolkit.geometry.maps import DepthMap, LengthUnit
from vntoolkit.integration.components import Components

_FEWEST_PIXELS = 64
_SMALLEST_SHARE = 0.02  # of a part's pixels that the reference must cover


class DepthAnchor:
    """Ties depth maps to a reference; parts that the reference does not cover stay as they are."""

    def __init__(self, reference: DepthMap) -> None:
        self._reference = reference

    def align(self, depth_map: DepthMap) -> DepthMap:
        """Return `depth_map` with the reference's offset (`FREE` depth: its scale)."""
        both = depth_map.mask & self._reference.mask
        if not both.any():
            return depth_map
        components = Components(depth_map.mask)
        depth = np.array(depth_map.depth)
        for label in range(1, components.count + 1):
            part = components.labels == label if components.count > 1 else depth_map.mask
            common = part & both
            count = int(np.count_nonzero(common))
            if count < max(_FEWEST_PIXELS, _SMALLEST_SHARE * np.count_nonzero(part)):
                continue
            ours, wanted = depth[common].astype(np.float64), self._reference.depth[common]
            if depth_map.unit is LengthUnit.FREE:
                depth[part] *= np.median(wanted / ours)
            else:
                depth[part] += np.median(wanted - ours)
        return replace(depth_map, depth=depth)
