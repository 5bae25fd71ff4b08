"""Occluding contours within the figure: where one part of the surface ends before another.

A smooth body turns away from the viewer at its contour: its slope grows until it is seen edge-on, and beside
it another surface goes on that is less steep. So a contour is where the surface recedes steeply towards a
side, and within a few pixels no longer. It is the outline of what lies before: it moves with that and tells
nothing of what lies behind, and across it nothing holds the two together.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from vntoolkit.arrays import Mask
from vntoolkit.native import njit
from vntoolkit.tracking.slopes import Slopes

_STEEP, _TURN = np.radians((45.0, 30.0))  # by which a surface recedes there, and by which it then turns back
_SURELY_STEEP, _SURE_TURN = np.radians((65.0, 45.0))  # the same, of a contour that is surely one
_REACH_PX = 3  # to either side: the picture and its slopes are blurred by a pixel each
_LEAST_WEIGHT = 0.05  # of a slope: by less its normal may be off by 45° and more, as in a shadow
_TWO_SIDES_PX = 2.0  # between the nearest pixels beside a contour: those on one side of it are nearer


def occluding_contours(slopes: Slopes, mask: Mask) -> Mask:
    """Return (h, w) True within reach of an occluding contour.

    A faint one counts where it prolongs a sure one.
    """
    faint, sure = _receding(slopes, mask)
    if not sure.any():
        return np.zeros_like(mask)
    count, labels = cv2.connectedComponents(faint.astype(np.uint8), connectivity=8)
    kept = np.zeros(count, dtype=np.bool_)
    kept[labels[sure]] = True
    return np.asarray(kept[labels] & faint)


def edges_beside(
    edges: npt.NDArray[np.int32], pixels: npt.NDArray[np.int32], contours: Mask
) -> npt.NDArray[np.int32]:
    """Return the edges (e, 2) of adjacent pixels (n, 2) that do not cross the middle of a contour (h, w)."""
    if not contours.any():
        return edges
    u, v = pixels.T
    elsewhere: Mask = np.ones(contours.shape, dtype=np.bool_)
    elsewhere[v, u] = contours[v, u]
    near = ndimage.distance_transform_edt(elsewhere, return_distances=False, return_indices=True)
    beside = near[:, v, u].T.astype(np.float64)
    first, second = edges.T
    return edges[np.linalg.norm(beside[first] - beside[second], axis=1) <= _TWO_SIDES_PX]


@njit(cache=True)
def _receding(slopes, mask):  # type: ignore[no-untyped-def]
    """(h, w) pixels between two, of which one recedes towards the other: at least faintly, and surely."""
    h, w = mask.shape
    faint, sure = np.zeros((h, w), dtype=np.bool_), np.zeros((h, w), dtype=np.bool_)
    steep = np.tan(_STEEP)
    for v in range(h):
        for u in range(w):
            if not mask[v, u]:
                continue
            for c in range(2):
                for k in range(1, _REACH_PX + 1):
                    left, right = (u - k, u + k - 1) if c == 0 else (u, u)
                    above, below = (v, v) if c == 0 else (v - k, v + k - 1)
                    if left < 0 or above < 0 or right >= w or below >= h:
                        continue
                    a, b = slopes[above, left], slopes[below, right]
                    if min(a[2], b[2]) < _LEAST_WEIGHT or max(a[c] / a[2], -b[c] / b[2]) < steep:
                        continue
                    before, after = np.arctan(a[c] / a[2]), np.arctan(b[c] / b[2])
                    faint[v, u] |= before - after > _TURN
                    sure[v, u] |= before - after > _SURE_TURN and max(before, -after) > _SURELY_STEEP
    return faint, sure
