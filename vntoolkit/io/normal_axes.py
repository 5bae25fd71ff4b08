"""Is the green axis of an imported normal map flipped? The curl of the slopes tells.

Blender and DiLiGenT store y up, DirectX tools y down, and the file does not say. Read the wrong way round,
p stays and q changes its sign, and slopes whose mixed derivatives agreed, as those of a surface that exists
do, contradict each other.
"""

from __future__ import annotations

import numpy as np

from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.consistency import curl_share

_MARGIN = 0.6  # the other reading must leave this share of the curl
_WORST_AS_FLIPPED = 0.5  # and be nearly free of curl itself: noise has 0.6 either way
_FEWEST_PIXELS = 400


def finding_from_axes(normal_map: NormalMap) -> str | None:
    """Return a line where the map makes a surface only with its y axis flipped, else None."""
    if int(normal_map.mask.sum()) < _FEWEST_PIXELS:
        return None
    normals = np.asarray(normal_map.normals_in_camera, dtype=np.float64)
    as_read = curl_share(normals, normal_map.mask)
    flipped = curl_share(normals * np.array([1.0, -1.0, 1.0]), normal_map.mask)
    if not flipped < min(_MARGIN * as_read, _WORST_AS_FLIPPED):
        return None
    return (
        f"the green axis looks flipped: as read the slopes contradict each other (curl share {as_read:.2f}), "
        f"flipped they fit ({flipped:.2f}); read it with the other convention, opengl or directx"
    )
