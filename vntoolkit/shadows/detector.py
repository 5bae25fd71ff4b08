"""Which lights reach each pixel: the published detector, the robust one, or none."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum

import numpy as np

from vntoolkit.arrays import Mask, VisibilityLabels
from vntoolkit.checks import checks_kinds, require_mask
from vntoolkit.geometry.camera import Camera
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame, labels_from_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.contributions import (
    Window,
    contributions_from_frame,
    frame_in_window,
    in_whole_image,
    window_around,
)
from vntoolkit.shadows.published import lit_by_edges
from vntoolkit.shadows.robust import FrameMemory, labels_by_surface
from vntoolkit.shadows.surface import Surface


class ShadowMethod(Enum):
    """How self-shadows are found."""

    NONE = "none"  # every pixel counts as lit by all three lights
    PUBLISHED = "published"  # edges and flood fill, brostow2011
    ROBUST = "robust"  # comparison with a surface, graph cut, memory from frame to frame


class ShadowDetector:
    """Finds shadows frame after frame; the robust method remembers the frame before.

    response: with light colours known, a light is told from a channel; else a channel stands for a light.
    camera: for perspective; None for orthographic.
    """

    @checks_kinds
    def __init__(
        self,
        response: LightResponse,
        method: ShadowMethod = ShadowMethod.ROBUST,
        camera: Camera | None = None,
    ) -> None:
        self._method = method
        self._response = response
        self._camera = camera
        self._memory: FrameMemory | None = None
        self._shape = (0, 0)
        self.surface: Surface | None = None  # of the last frame, for `recover_normals`; None without one

    def forget(self) -> None:
        """Drop what the previous frame left, so that a sequence may start anywhere."""
        self._memory = None

    def go_on_from(self, surface: Surface | None) -> None:
        """Let the next frame's recovery go on from the surface that `recover_surface` found of this one."""
        if self._memory is not None:
            recovered = None if surface is None else surface.normals
            self._memory = replace(self._memory, recovered=recovered)

    @checks_kinds
    def labels(self, frame: LinearFrame, mask: Mask | None = None) -> VisibilityLabels:
        """Return (h, w) labels, bit k set where light k arrives; 7 outside `mask`, where nobody may look."""
        inside = np.ones(frame.shape, dtype=np.bool_) if mask is None else np.asarray(mask)
        if frame.shape != self._shape:
            self._shape, self._memory = frame.shape, None
        require_mask(inside, frame.shape)
        self.surface = None
        if self._method is ShadowMethod.NONE or not inside.any():
            return np.full(frame.shape, ALL_LIT, dtype=np.uint8)
        window = window_around(inside)
        near: Mask = np.array(inside[window])
        labels = np.where(near, self._labels(frame_in_window(frame, window), near, window), ALL_LIT)
        return in_whole_image(labels.astype(np.uint8), window, frame.shape, ALL_LIT)

    def _labels(self, frame: LinearFrame, mask: Mask, window: Window) -> VisibilityLabels:
        if self._method is ShadowMethod.PUBLISHED:
            contributions = contributions_from_frame(frame, self._response).contributions
            return labels_from_lit(lit_by_edges(contributions, mask))
        camera = None if self._camera is None else self._camera.cropped(*window)
        last = self._memory
        labels, self._memory = labels_by_surface(frame, self._response, mask, window, camera, last)
        if self._memory.start is not None:
            self.surface = replace(self._memory.start, settled=last is not None)
        return labels
