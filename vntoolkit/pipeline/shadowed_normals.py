"""Normals where the subject shadows itself: which lamps reach each pixel, then what the others tell."""

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.options.normals import InversionOptions, ShadowMethod
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.contributions import brighter_than
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.shadows.lamp_directions import LampDirections, directions_from_shadows, unlit_by_lamp
from vntoolkit.shadows.recovery import recover_normals
from vntoolkit.shadows.surface import Surface


class ShadowedNormals:
    """Finds the shadows of frames, each alone, and the normals that they leave.

    Frames come twice: `level`, as the M of the centre forms them, and `by_strength`, with every lamp as
    strong as there.
    """

    def __init__(
        self, response: LightResponse, method: ShadowMethod, camera: Camera, inversion: InversionOptions
    ) -> None:
        self._response, self._central = response, response.central
        self._method, self._camera, self._inversion = method, camera, inversion

    def normals(
        self, level: LinearFrame, by_strength: LinearFrame, mask: Mask
    ) -> tuple[NormalMap, VisibilityLabels, LampDirections | None]:
        """Return normals, labels (h, w), and lamps where shadows were found by a surface. mask: (h, w)."""
        labels, mask, surface = self._labels(level, by_strength, mask)
        if surface is None and not np.any(labels != ALL_LIT):
            return normals_from_frame(level, self._central, mask, options=self._inversion), labels, None
        lamps = directions_from_shadows(level, labels, self._response, mask)
        is_same = (self._central.light_colours is None) is (lamps.separated.light_colours is None)
        start = surface if is_same and by_strength is level else None
        found = recover_normals(level, labels, lamps.separated, mask, self._camera, start=start)
        return found, labels, lamps

    def unlit_by_lamp(self, level: LinearFrame, by_strength: LinearFrame, mask: Mask) -> list[FloatArray]:
        """Return for each lamp (n, 3), what tells its direction: see `shadows/lamp_directions.py`."""
        labels, mask, _ = self._labels(level, by_strength, mask)
        return unlit_by_lamp(level, labels, self._central, mask)

    def _labels(
        self, level: LinearFrame, by_strength: LinearFrame, mask: Mask
    ) -> tuple[VisibilityLabels, Mask, Surface | None]:
        """Return labels, where they hold, and the surface that they were found by."""
        darkest = self._inversion.darkest * self._inversion.relative_albedo
        mask = brighter_than(level, self._central, darkest, mask)
        if self._inversion.clipped_factor == 0.0:
            mask &= ~level.clipped
        detector = ShadowDetector(self._central, self._method, self._camera)
        return detector.labels(by_strength, mask), mask, detector.surface
