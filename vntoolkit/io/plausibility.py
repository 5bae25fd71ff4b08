"""What a user may have got wrong, told by the footage itself: a finding is a line that names the remedy."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import Mask
from vntoolkit.io.captures import Capture
from vntoolkit.io.decoding import linear_frame_from_encoded
from vntoolkit.io.exposure_drift import drift_of_static_part
from vntoolkit.io.rig_match import findings_from_rig
from vntoolkit.photometry.rig import Rig

_FRAMES_COMPARED = 6
_NARROW_CONE_DEG = 20.0  # as calibration warns


def findings_from_capture(
    capture: Capture, rig: Rig, mask: Mask | None = None, numbers: range | None = None
) -> list[str]:
    """Check a capture against its rig: calibrated cone, channel order, curve, white balance, drift.

    mask: (h, w) where the surface is. numbers: the frames that matter, default all; a few of them are read.
    """
    numbers = numbers or range(len(capture))
    findings = findings_from_quality(rig)
    middle = numbers[len(numbers) // 2]
    encoded = next(capture.encoded_frames(middle, middle + 1))
    findings += findings_from_rig(encoded, rig, capture.options.transfer, mask, capture.background)
    if len(numbers) > 1:
        chosen = sorted({numbers[round(i)] for i in np.linspace(0, len(numbers) - 1, _FRAMES_COMPARED)})
        frames = [
            linear_frame_from_encoded(next(capture.encoded_frames(n, n + 1)), capture.options.transfer)
            for n in chosen
        ]
        drift = drift_of_static_part(frames)
        findings += [] if drift is None else [drift.to_text()]
    return findings


def findings_from_quality(rig: Rig) -> list[str]:
    """Return a line where the rig was fitted on normals that lean too little."""
    quality = rig.quality
    if quality is None or quality.samples == 0 or quality.cone_deg >= _NARROW_CONE_DEG:
        return []
    return [
        f"the rig was fitted on normals within {quality.cone_deg:.0f} degrees of their mean: steeper are "
        f"a guess; calibrate again with the target tilted by {_NARROW_CONE_DEG:.0f} degrees and more"
    ]
