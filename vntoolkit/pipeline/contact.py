"""What touches a tactile gel, from its depth: where, over what area and how deep.

The gel bulges towards the camera where it is touched, so that a touched pixel is nearer than the gel at rest.
The gel beside a contact is drawn along and rises with no wall between: where the contact ends is a matter of
a share of the dent's depth. Hertz's half-space has it at a half under a ball (hertz1882), a layer thin
against the contact at none. A third lies between, and under the ball of 2.42 mm that gels are pressed with
it meets the circles that people draw.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from vntoolkit.arrays import Mask
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap

_RIM_SHARE = 1 / 3  # of a dent's depth, at which its contact ends
_SHALLOWEST_M = 1e-4  # what the drift of lamps leaves of depth on an untouched gel
_REST_ROUNDS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Contact:
    """What touches the gel in one frame.

    mask: (h, w), True in contact. area_mm2: of all contacts, seen from the camera. depth_mm: of the deepest
    point below the gel at rest; 0 where nothing touches.
    """

    mask: Mask
    area_mm2: float
    depth_mm: float


def rested(depth_map: DepthMap) -> DepthMap:
    """Return the depth of a gel, in metres, shifted so that the gel at rest has 0 and dents are negative."""
    values = depth_map.depth[depth_map.mask]
    level = float(np.median(values))
    for _ in range(_REST_ROUNDS):  # dents pull the median: left out, it comes to rest
        flat = values[np.abs(values - level) < 2 * _SHALLOWEST_M]
        if len(flat) < len(values) / 10:
            break
        level = float(np.median(flat))
    return replace(depth_map, depth=depth_map.depth - level)


def contact_from_depth(depth_map: DepthMap, camera: Camera) -> Contact:
    """Find the contacts in the depth of a gel whose rest is 0, metres."""
    dent = np.where(depth_map.mask, -np.asarray(depth_map.depth), 0.0)
    labels, count = ndimage.label(dent > _SHALLOWEST_M)
    mask: Mask = np.zeros(dent.shape, dtype=np.bool_)
    if count:
        deepest = np.concatenate([[0.0], ndimage.maximum(dent, labels, np.arange(1, count + 1))])
        deepest[deepest < 2 * _SHALLOWEST_M] = np.inf  # no deeper than what drift leaves
        mask = (labels > 0) & (dent > _RIM_SHARE * deepest[labels])
    pixel_mm = 1000.0 / float(camera.matrix[0, 0])
    touched = bool(mask.any())
    return Contact(
        mask=mask,
        area_mm2=float(np.count_nonzero(mask)) * pixel_mm**2,
        depth_mm=1000.0 * float(dent[mask].max()) if touched else 0.0,
    )
