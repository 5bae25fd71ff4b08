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

from vntoolkit.arrays import Array, Mask
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.native import njit

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
    mask = depth_map.mask
    given = np.ascontiguousarray(depth_map.depth)
    step = max(1, round(float(np.sqrt(mask.size / _VOTES))))
    depth = np.empty_like(given)
    _less_plane(given, mask, _plane_at_rest(given, mask, step), depth)
    return replace(depth_map, depth=depth)


@njit
def _plane_at_rest(depth: Array, mask: Mask, step: int) -> Array:
    """Height and slopes (3,) along x and y, which run from −1 to 1 over the picture."""
    height, width = mask.shape
    most = ((height + step - 1) // step) * ((width + step - 1) // step)
    values, terms = np.empty(most), np.ones((most, 3))
    count = 0
    for v in range(0, height, step):
        for u in range(0, width, step):
            if mask[v, u]:
                values[count] = depth[v, u]
                terms[count, 1] = 2.0 * u / max(width - 1, 1) - 1.0
                terms[count, 2] = 2.0 * v / max(height - 1, 1) - 1.0
                count += 1
    plane: Array = np.zeros(3)
    if count == 0:
        return plane
    values, terms = values[:count], terms[:count]
    plane[0] = np.median(values)
    for _ in range(_REST_ROUNDS):  # dents pull the median: left out, it comes to rest
        rest = values - terms @ plane
        flat = np.abs(rest) < 2 * _SHALLOWEST_M
        share = np.count_nonzero(flat) / count
        if share > _RESTING_SHARE:
            resting = terms[flat]
            plane = np.linalg.solve(resting.T @ resting, resting.T @ values[flat])
        elif share > _RESTING_SHARE / 3:
            plane[0] += np.median(rest[flat])
    return plane


@njit
def _less_plane(depth: Array, mask: Mask, plane: Array, out: Array) -> None:
    """Put the depth less the plane into `out`; outside the mask it stays."""
    height, width = mask.shape
    for v in range(height):
        across = plane[0] + plane[2] * (2.0 * v / max(height - 1, 1) - 1.0)
        slope = 2.0 * plane[1] / max(width - 1, 1)
        for u in range(width):
            out[v, u] = depth[v, u] - (across - plane[1] + slope * u) * mask[v, u]


def contact_from_depth(depth_map: DepthMap, camera: Camera) -> Contact:
    """Find the contacts in the depth of a gel whose rest is 0, metres."""
    depth = np.ascontiguousarray(depth_map.depth)
    mask: Mask = np.zeros(depth.shape, dtype=np.bool_)
    top, bottom, left, right = _box_of_dents(depth, depth_map.mask, _SHALLOWEST_M)
    count, deepest = 0, 0.0
    if bottom > top:
        window = slice(top, bottom), slice(left, right)
        dented = (depth[window] < -_SHALLOWEST_M) & depth_map.mask[window]
        labels, dents = ndimage.label(dented)
        count, deepest = _mark_contacts(depth[window], labels, dents, mask[window])
    pixel_mm = 1000.0 / float(camera.matrix[0, 0])
    return Contact(mask=mask, area_mm2=float(count) * pixel_mm**2, depth_mm=1000.0 * float(deepest))


@njit
def _box_of_dents(depth: Array, mask: Mask, shallowest: float) -> tuple[int, int, int, int]:
    """First and last row, first and last column (the last ones exclusive) of what is dented."""
    height, width = mask.shape
    top, bottom, left, right = height, 0, width, 0
    for v in range(height):
        for u in range(width):
            if depth[v, u] < -shallowest and mask[v, u]:
                top, bottom = min(top, v), v + 1
                left, right = min(left, u), max(right, u + 1)
    return top, bottom, left, right


@njit
def _mark_contacts(depth: Array, labels: Array, count: int, mask: Mask) -> tuple[int, float]:
    """Mark in `mask` what lies deeper than a share of its dent's depth; pixels marked, and the deepest."""
    deepest = np.zeros(count + 1, depth.dtype)
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            deepest[labels[v, u]] = max(deepest[labels[v, u]], -depth[v, u])
    marked, most = 0, 0.0
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            dent = deepest[labels[v, u]]
            enough = dent >= 2 * _SHALLOWEST_M  # no deeper than what drift leaves
            if labels[v, u] > 0 and enough and -depth[v, u] > _RIM_SHARE * dent:
                mask[v, u] = True
                marked, most = marked + 1, max(most, -depth[v, u])
    return marked, most
