"""Normals for every pixel of a frame with self-shadows (brostow2011, Section VI-B, and past it)."""

import numpy as np

from vntoolkit.arrays import Mask, VisibilityLabels
from vntoolkit.checks import checks_kinds, require_mask, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame, count_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import albedo_from_lit
from vntoolkit.shadows.contributions import (
    contributions_from_frame,
    frame_in_window,
    in_whole_image,
    window_around,
)
from vntoolkit.shadows.roots import normals_from_labels

_WEIGHT_BY_LIGHTS = np.array([0.05, 0.2, 0.5, 1.0], np.float32)  # of a pixel that 0, 1, 2, 3 lights reach


@checks_kinds
def recover_normals(
    frame: LinearFrame, labels: VisibilityLabels, response: LightResponse, mask: Mask | None = None
) -> NormalMap:
    """Return a normal and a weight for every pixel of `mask`, whichever lights reach it.

    labels: (h, w), bit k set where light k arrives. Where all three do the normal is plain inversion's.
    """
    inside = np.ones(frame.shape, dtype=np.bool_) if mask is None else np.asarray(mask)
    require_mask(inside, frame.shape)
    require_shape(labels, frame.shape, "visibility labels")
    if labels.dtype != np.uint8 or labels.max(initial=0) > ALL_LIT:
        raise BadInput("visibility labels: expected bytes from 0 to 7")
    window = window_around(inside)
    label, here = np.array(labels[window]), np.array(inside[window])
    light = contributions_from_frame(frame_in_window(frame, window), response)
    albedo = albedo_from_lit(light.length, here & (label == ALL_LIT))
    normals = normals_from_labels(light, albedo, label, here)
    weight = np.where(here, _WEIGHT_BY_LIGHTS[count_lit(label)], np.float32(0.0))
    return NormalMap(
        normals_in_camera=in_whole_image(normals, window, frame.shape),
        mask=inside,
        weight=in_whole_image(weight, window, frame.shape),
    )
