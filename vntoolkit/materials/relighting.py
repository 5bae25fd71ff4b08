"""What a frame would look like if the calibration material were everywhere.

The light on a pixel is divided by the reflectance of its material, lamp by lamp. In a blurred picture of
several materials it is then weighed (`likeliest_light`). Where a material has a pigment, the pixel's place on
the pigment's line counts.
"""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, MaterialLabels, Points
from vntoolkit.materials.likeliest_light import likeliest_light
from vntoolkit.materials.mixtures import Seams, near_seams, reach_of_blur
from vntoolkit.materials.pigment import without_pigment
from vntoolkit.materials.reflectance import lamps_from_response
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse


def relit(
    frame: LinearFrame,
    response: LightResponse,
    labels: MaterialLabels,
    reflectances: Points,
    pigments: Points | None = None,
    seams: Seams | None = None,
    mask: Mask | None = None,
    box: tuple[slice, slice] | None = None,
) -> LinearFrame:
    """Return the frame as it would be with the calibration material everywhere: r' = Cᵀ (C⁻ᵀ r ∘ 1/ρ).

    labels: (h, w), numbers of the reflectances (m, 3). pigments: (m, 3), the lines of log ρ along which
    materials change, 0 for none. seams: how pixels beside seams are mixtures; without it they are of one
    material. mask: (h, w), the subject, whose pixels tell each other's light and may have pigment; None for
    everywhere. box: rows and columns beyond which the result is 0; None for none. Ambient light falls on the
    material too: it is divided by ρ with the rest.
    """
    lamps, values = lamps_from_response(response, np.zeros(3)), np.asarray(reflectances, np.float32)
    box = (slice(None), slice(None)) if box is None else box
    labels = np.ascontiguousarray(labels[box])
    inside = np.ones(labels.shape, np.bool_) if mask is None else np.ascontiguousarray(mask[box])
    s = frame.rgb[box] @ lamps.split.T.astype(np.float32)
    pigmented = inside.copy()
    if seams is not None and seams.blur_px > 0.0 and len(values) > 1:
        light = likeliest_light(s, labels, inside, lamps, values, seams)
        pigmented &= ~near_seams(labels, reach_of_blur(seams.blur_px))  # beside seams a mixture counts
    else:
        light = s / values[labels]
    for m, line in enumerate(() if pigments is None else np.asarray(pigments, np.float64)):
        chosen = pigmented & (labels == m)
        if line.any() and chosen.any():
            of_normals = lamps.inverse / values[m], lamps.inverse @ lamps.ambient
            light[chosen] = without_pigment(s[chosen].astype(np.float64), *of_normals, line) / values[m]
    rgb = np.zeros(frame.rgb.shape, np.float32)
    rgb[box] = light @ np.linalg.inv(lamps.split).T.astype(np.float32)
    return LinearFrame(rgb=rgb, clipped=frame.clipped, number=frame.number)


def colours_of(reflectances: Points, response: LightResponse) -> FloatArray:
    """(m, 3), linear colour 0 to 1 of each material in the light of all three lamps, balanced to white.

    White is the calibration material, or the strongest material where one returns more.
    """
    colours = np.abs(np.linalg.inv(response.contributions_from_rgb).T)
    seen = np.asarray(reflectances) @ colours / colours.sum(axis=0)
    return np.asarray(seen / max(1.0, float(seen.max())))
