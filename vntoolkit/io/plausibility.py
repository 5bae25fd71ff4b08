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
    transfer = capture.options.transfer
    chosen = frames_to_compare(capture, numbers)
    middle = chosen[len(chosen) // 2]
    compared = []
    for number in chosen:
        for encoded in capture.encoded_frames(number, number + 1):
            compared.append(linear_frame_from_encoded(encoded, transfer))
            if number == middle:
                findings += findings_from_rig(encoded, rig, transfer, mask, capture.background)
    if len(compared) > 1:
        drift = drift_of_static_part(compared)
        findings += [] if drift is None else [drift.to_text()]
    return findings


def frames_to_compare(capture: Capture, numbers: range) -> list[int]:
    """Return a few numbers, evenly spread, moved to key frames nearby, which are quick to reach."""
    first, last = numbers[0], numbers[-1]
    within = (last - first) // (2 * (_FRAMES_COMPARED - 1))
    chosen = set()
    for place in np.linspace(0, len(numbers) - 1, _FRAMES_COMPARED).round().astype(int):
        quick = capture.readable_alone(numbers[place], within)
        chosen.add(quick if first <= quick <= last else numbers[place])
    return sorted(chosen)


def findings_from_quality(rig: Rig) -> list[str]:
    """Return a line where the rig was fitted on normals that lean too little."""
    quality = rig.quality
    if quality is None or quality.samples == 0 or quality.cone_deg >= _NARROW_CONE_DEG:
        return []
    return [
        f"the rig was fitted on normals within {quality.cone_deg:.0f} degrees of their mean: steeper are "
        f"a guess; calibrate again with the target tilted by {_NARROW_CONE_DEG:.0f} degrees and more"
    ]
