"""A tactile gel: its normals from the change of colour, and what touches it from its depth."""

import numpy as np

from vntoolkit.arrays import LinearImage, Mask
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.io.footage.decoding import resampler_of
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.gel import GelResponse
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig
from vntoolkit.tactile.contact import Contact, contact_from_depth, rested
from vntoolkit.tactile.dots import DotFilter
from vntoolkit.tactile.inversion import GelInverter, drift_of_change
from vntoolkit.tactile.motion import Membrane


class PressedGel:
    """untouched: linear (h, w, 3), without distortion. with_errors: whether normals carry expected errors."""

    def __init__(
        self, response: LightResponse, gel: GelResponse, untouched: LinearImage, *, with_errors: bool
    ) -> None:
        self._inverter = GelInverter(response, gel)
        self._dots = DotFilter(untouched)
        self._with_errors = with_errors

    def normals(self, linear: LinearFrame, mask: Mask) -> NormalMap:
        """Return the normals of a frame from which the untouched gel is subtracted. mask: (h, w)."""
        change, filled = self._dots.filled(linear.rgb, linear.clipped)
        drift = drift_of_change(change, mask & ~filled)
        normal_map = self._inverter.normals(change, drift, mask)
        return self._inverter.with_expected_error(normal_map) if self._with_errors else normal_map

    def contact(self, depth_map: DepthMap, camera: Camera) -> tuple[DepthMap, Contact]:
        """Return the depth below the gel at rest, and what touches it."""
        depth_map = rested(depth_map)
        return depth_map, contact_from_depth(depth_map, camera)


def membrane_of(rig: Rig, background: LinearImage) -> Membrane:
    """The membrane of a rig's gel. background: the untouched gel, linear (h, w, 3), as filmed."""
    nothing: Mask = np.zeros(background.shape[:2], np.bool_)
    untouched = resampler_of(rig).frame(LinearFrame(rgb=background, clipped=nothing)).rgb
    return Membrane(untouched, DotFilter(untouched).dots)
