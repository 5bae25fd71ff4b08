"""What touches a tactile gel, from its depth: where, over what area and how deep.

The gel bulges towards the camera where it is touched, so that a touched pixel is nearer than the gel at rest.
The gel beside a contact is drawn along and rises with no wall between: where the contact ends is a matter of
a share of the dent's depth. Hertz's half-space has it at a half under a ball (hertz1882), a layer thin
against the contact at none. A third lies between, and under the ball of 2.42 mm that gels are pressed with
it meets the circles that people draw.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from vntoolkit.arrays import FloatArray, Mask, Points, Vector3, box_of
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap

_RIM_SHARE = 1 / 3  # of a dent's depth, at which its contact ends
_SHALLOWEST_M = 1e-4  # what the drift of lamps leaves of depth on an untouched gel
_REST_ROUNDS = 4
_RESTING_SHARE = 1 / 3  # of the gel, to tell a tilt from
_VOTES = 1000  # pixels that the plane is fitted to, evenly spread


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
    """Return the depth of a gel, in metres, less the plane of the gel at rest; dents are negative.

    The rest is a plane, square to the camera by construction. A colour cast that is left of the lamps' drift
    tilts every normal by parts of a degree, which adds up across the gel. Where less than a third of the gel
    rests, its height alone is taken out.
    """
    depth, mask = depth_map.depth, depth_map.mask
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in depth.shape), indexing="ij", sparse=True)
    step = max(1, round(float(np.sqrt(mask.size / _VOTES))))
    chosen = mask[::step, ::step]
    terms = np.stack(np.broadcast_arrays(1.0, x[:, ::step], y[::step]), axis=-1)[chosen]
    height, along_x, along_y = _plane_at_rest(depth[::step, ::step][chosen].astype(np.float64), terms)
    plane = height + along_x * x + along_y * y
    return replace(depth_map, depth=(depth - plane * mask).astype(depth.dtype))


def _plane_at_rest(values: FloatArray, terms: Points) -> Vector3:
    """Fit height and slopes along x and y to depths (n,). terms: (n, 3), 1, x, y."""
    plane: Vector3 = np.zeros(3)
    if not len(values):
        return plane
    plane[0] = np.median(values)
    for _ in range(_REST_ROUNDS):  # dents pull the median: left out, it comes to rest
        rest = values - terms @ plane
        flat = np.abs(rest) < 2 * _SHALLOWEST_M
        share = np.count_nonzero(flat) / len(flat)
        if share > _RESTING_SHARE:
            resting = terms[flat]
            plane = np.linalg.solve(resting.T @ resting, resting.T @ values[flat])
        elif share > _RESTING_SHARE / 3:
            plane[0] += np.median(rest[flat])
    return plane


def contact_from_depth(depth_map: DepthMap, camera: Camera) -> Contact:
    """Find the contacts in the depth of a gel whose rest is 0, metres."""
    dented = (depth_map.depth < -_SHALLOWEST_M) & depth_map.mask
    box = box_of(dented)
    labels, count = ndimage.label(dented[box])
    depth = -depth_map.depth[box]
    deepest = np.zeros(count + 1, depth.dtype)
    np.maximum.at(deepest, labels, depth)
    deepest[deepest < 2 * _SHALLOWEST_M] = np.inf  # no deeper than what drift leaves
    touching = dented[box] & (depth > _RIM_SHARE * deepest[labels])
    mask: Mask = np.zeros(dented.shape, np.bool_)
    mask[box] = touching
    pixel_mm = 1000.0 / float(camera.matrix[0, 0])
    return Contact(
        mask=mask,
        area_mm2=float(np.count_nonzero(touching)) * pixel_mm**2,
        depth_mm=1000.0 * float(depth[touching].max(initial=0.0)),
    )
