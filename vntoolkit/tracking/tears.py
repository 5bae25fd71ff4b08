"""Occlusion boundaries in the template frame; the template is cut along them.

A surface that hides another turns away from the viewer towards its rim, and beyond the rim the normals face
the viewer again, all within a few pixels. That is measured across every pixel in eight directions: how
steeply the near side falls towards the far side, and by how much the far side falls less. Ridges of that
measure are followed as edges are in an image (`canny1986`): strong somewhere, not weak anywhere, and long.
The pixels on them, which show a mixture of both surfaces, are left out.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.geometry.maps import NormalMap

_DIRECTIONS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))  # towards the far side
_REACH_PX = 2  # beyond the pixels that the lens mixes
_SMOOTHING_PX = 0.7
_WEAK_DEG, _STRONG_DEG = 35.0, 50.0
_SHORTEST_PX = 12
_EIGHT = np.ones((3, 3), dtype=bool)


def tear_pixels(normal_map: NormalMap) -> Mask:
    """Return (h, w) True on the pixels along which the surface is torn."""
    steepness, ridge = _steepness(normal_map)
    labels, count = ndimage.label(ridge & (steepness > _WEAK_DEG), structure=_EIGHT)
    numbers = np.arange(count + 1)
    strongest = np.asarray(ndimage.maximum(steepness, labels, numbers))
    keep = (strongest > _STRONG_DEG) & (np.bincount(labels.ravel(), minlength=count + 1) >= _SHORTEST_PX)
    keep[0] = False
    return np.asarray(keep[labels])


def _steepness(normal_map: NormalMap) -> tuple[FloatArray, Mask]:
    """(h, w) degrees that the steepest direction's near side falls, or falls more than its far side, the
    lesser of both; and where that is a ridge across the direction.
    """
    mask = normal_map.mask
    weighted = normal_map.normals_in_camera.astype(np.float64) * mask[..., None]
    normals = ndimage.gaussian_filter(weighted, (_SMOOTHING_PX, _SMOOTHING_PX, 0))
    best = np.zeros(mask.shape)
    direction = np.full(mask.shape, -1, dtype=np.int8)
    for number, step in enumerate(_DIRECTIONS):
        reach = max(1, round(_REACH_PX / float(np.hypot(*step))))
        near, far = (_shifted(normals, step, sign * reach) for sign in (-1, 1))
        valid = mask & _shifted(mask, step, -reach) & _shifted(mask, step, reach)
        fall, beyond = _fall_deg(near, step), _fall_deg(far, step)
        value = np.where(valid, np.minimum(fall, fall - beyond), 0.0)
        better = value > best
        best[better], direction[better] = value[better], number
    ridge = np.zeros(mask.shape, dtype=bool)
    for number, step in enumerate(_DIRECTIONS):
        highest = (best >= _shifted(best, step, 1)) & (best > _shifted(best, step, -1))
        ridge |= (direction == number) & highest
    return best, ridge


def _fall_deg(normals: FloatArray, step: tuple[int, int]) -> npt.NDArray[np.float64]:
    """Angle in degrees by which a surface with normals (h, w, 3) falls away along a direction."""
    along = (normals[..., 0] * step[0] + normals[..., 1] * step[1]) / np.hypot(*step)
    return np.asarray(np.degrees(np.arctan2(along, -normals[..., 2])))


def _shifted(image: npt.NDArray, step: tuple[int, int], pixels: int) -> npt.NDArray:  # type: ignore[type-arg]
    """The image as seen `pixels` further along the direction; 0 beyond the border."""
    columns, rows = step[0] * pixels, step[1] * pixels
    out = np.zeros_like(image)
    h, w = image.shape[:2]
    to_rows, to_columns = slice(max(0, -rows), h - max(0, rows)), slice(max(0, -columns), w - max(0, columns))
    from_rows, from_columns = (
        slice(max(0, rows), h + min(0, rows)),
        slice(max(0, columns), w + min(0, columns)),
    )
    out[to_rows, to_columns] = image[from_rows, from_columns]
    return out
