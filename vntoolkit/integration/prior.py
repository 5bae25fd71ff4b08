"""Depth that is known beside the normals: of stereo, a sensor, or heights at an outline.

Each known pixel is a measurement of its own variance in the same least squares as the slopes: a screened
Poisson equation. Slopes are exact between neighbours and drift over long ways; a depth sensor is the reverse.
"""

from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import Float64Array, FloatArray, Mask
from vntoolkit.checks import require_mask, require_same_size, require_some
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.spread import NINE_OF_TEN


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthPrior:
    """Known depth, (h, w), in metres for a perspective camera, else in the camera's unit.

    mask: (h, w), where it is known. error: (h, w) or one number, what nine of ten errors stay within, in the
    unit of the depth.
    """

    depth: FloatArray
    mask: Mask
    error: FloatArray | float

    def __post_init__(self) -> None:
        require_mask(self.mask, np.shape(self.depth))
        require_some(self.mask, "prior depth")
        error = np.broadcast_to(np.asarray(self.error, np.float64), np.shape(self.error) or self.mask.shape)
        require_same_size(error, "error of the prior", self.mask, "prior depth")
        if not (np.isfinite(self.depth[self.mask]).all() and (error[self.mask] > 0).all()):
            raise BadInput("prior: expected finite depths with errors above 0; leave others out of its mask")
        object.__setattr__(self, "error", error)

    def measurements(self, pixels_per_unit: float, perspective: bool) -> tuple[Float64Array, Float64Array]:
        """Return (h, w) of solutions, in pixels, and their information, 1 / variance, 0 where not known."""
        value, information = np.zeros((2, *self.mask.shape))
        known, at = np.asarray(self.depth, np.float64)[self.mask], self.mask
        if perspective and known.min() <= 0:
            raise BadInput("prior: expected depths above 0, in metres from the camera")
        value[at] = (np.log(known) if perspective else known) * pixels_per_unit
        deviation = np.asarray(self.error)[at] / NINE_OF_TEN * pixels_per_unit
        deviation /= known if perspective else 1.0
        information[at] = 1.0 / deviation**2
        return value, information


def with_prior_error(depth_map: DepthMap, prior: DepthPrior) -> DepthMap:
    """Return depth whose expected error, of the normals alone, is less where the prior is known."""
    if depth_map.error_percent is None:
        return depth_map
    span = float(np.ptp(depth_map.depth[depth_map.mask]))
    of_prior = 100.0 / span * np.asarray(prior.error) if span > 0 else np.full(prior.mask.shape, np.inf)
    both = 1.0 / np.hypot(1.0 / np.maximum(depth_map.error_percent, 1e-9), 1.0 / of_prior)
    known = prior.mask & depth_map.mask
    return replace(depth_map, error_percent=np.where(known, both, depth_map.error_percent))
