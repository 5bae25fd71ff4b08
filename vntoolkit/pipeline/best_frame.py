"""The frame of a result that a template is best made from: most of the surface, lit well, sharp."""

from collections.abc import Sequence

import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.io.results.frame_log import FrameEntry
from vntoolkit.pipeline.opened_result import OpenedResult

_COMPARED = 12  # frames that are read: those that show most, evenly spread
_FINE_PX, _COARSE_PX = 1, 4  # over which normals change


def best_frame(result: OpenedResult, numbers: Sequence[int]) -> int:
    """Return the frame of these that shows most that is lit and sharp; of equals, the first.

    Frames are equal that differ by no more than most do from the next.
    """
    lit = np.array([_lit_share(result.entries.get(number)) for number in numbers])
    places = sampled(np.flatnonzero(lit >= np.median(lit)).tolist(), _COMPARED)
    worth = np.array([lit[k] * sharpness_of(result.normals(numbers[k])) for k in places])
    alike = float(np.median(np.abs(np.diff(worth)))) if len(worth) > 1 else 0.0
    return numbers[places[int(np.argmax(worth >= worth.max() - alike))]]


def _lit_share(entry: FrameEntry | None) -> float:
    """Return the share of the pixels that have a normal, which all lamps reach and no light clips."""
    if entry is None:  # a log that is gone
        return 1.0
    return entry.valid_share * (1.0 - entry.shadowed_share) * (1.0 - entry.clipped_share)


def sharpness_of(normal_map: NormalMap) -> float:
    """Return how much of the change of normals over pixels is left over single ones; 0 to about 1.

    Changes at two places are multiplied, so that noise, which they do not share, cancels.
    """
    coarse = _change(normal_map.normals_in_camera, normal_map.mask, _COARSE_PX)
    fine = _change(normal_map.normals_in_camera, normal_map.mask, _FINE_PX)
    return float(np.clip(fine / coarse, 0.0, 1.0)) if coarse > 0 else 1.0


def _change(normals: FloatArray, mask: Mask, step: int) -> float:
    """Return the mean product of changes a pixel over `step` pixels, at neighbouring places."""
    total = count = 0.0
    for axis in (0, 1):
        places = [np.roll(normals, -k * step, axis) for k in range(4)]
        seen = np.logical_and.reduce([np.roll(mask, -k * step, axis) for k in range(4)])
        seen[tuple(slice(-3 * step, None) if a == axis else slice(None) for a in (0, 1))] = False
        products = ((places[1] - places[0]) * (places[3] - places[2])).sum(axis=2)
        total, count = total + float(products[seen].sum()), count + float(seen.sum())
    return total / max(count, 1.0) / step**2
