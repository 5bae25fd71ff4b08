"""Does the mask cover the subject?"""

from __future__ import annotations

import numpy as np

from vntoolkit.diagnosis.evidence import Evidence, brightest_channel
from vntoolkit.diagnosis.finding import Finding, Level

_LIT = 0.15  # of the brightest hundredth of the picture
_LEAST_LIT = 0.3
_FEWEST_PIXELS = 50


def check_mask(evidence: Evidence) -> list[Finding]:
    """Find a mask that covers the dark and leaves out what is lit."""
    if not evidence.masked:
        return []
    brightest = brightest_channel(evidence.light)
    lit = brightest > _LIT * np.percentile(brightest, 99)
    inside, outside = evidence.inside, ~evidence.inside
    if min(int(inside.sum()), int(outside.sum())) < _FEWEST_PIXELS:
        return []
    within, without = float(lit[inside].mean()), float(lit[outside].mean())
    if within >= _LEAST_LIT or without <= 2 * within:
        return []
    return [
        Finding(
            check="mask",
            level=Level.FATAL,
            problem="the mask covers the dark and leaves out what is lit",
            measured=f"{within:.0%} lit inside the mask, {without:.0%} outside",
            expected=f"{_LEAST_LIT:.0%} or more inside",
            remedy="the mask is inverted or of other footage: white is the subject; invert it",
        )
    ]
