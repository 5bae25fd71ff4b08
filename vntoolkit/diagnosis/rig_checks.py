"""Can a rig be right? What M, its lamps and its calibration say without any footage of the subject."""

from __future__ import annotations

import numpy as np

from vntoolkit.diagnosis.finding import Finding, Level
from vntoolkit.photometry.rig import Rig

_NARROW_CONE_DEG = 20.0  # as calibration warns
_LARGE_CONDITION_NUMBER = 30.0  # noise of one grey level turns a normal by some ten degrees
# Balls, boards and heads calibrate to 1 to 5 degrees, a gel under near lamps to 11, a jumper taken for a
# ball to 30.
_NOTED_RESIDUAL_DEG = 8.0
_FATAL_RESIDUAL_DEG = 15.0


def check_lamps(rig: Rig) -> list[Finding]:
    """Find lamps behind the surface that they should light."""
    response = rig.response
    lit = response.matrix @ np.array([0.0, 0.0, -1.0])
    towards = response.light_directions[:, 2] if response.light_colours is not None else np.full(3, -1.0)
    behind = [name for name, z in zip(("first", "second", "third"), towards, strict=True) if z >= 0]
    if not behind and lit.min() > 0:
        return []
    what = f"the {' and the '.join(behind)} lamp" if behind else "the light as a whole"
    share = lit / max(float(np.abs(response.matrix).max()), 1e-12)
    return [
        Finding(
            check="lamps",
            level=Level.FATAL,
            problem=f"{what} shines from behind a surface that faces the camera",
            measured="light of "
            + ", ".join(f"{value:.2f}" for value in share)
            + " in red, green, blue on it",
            expected="more than 0 in each",
            remedy="a lamp file has x right, y up, z towards the viewer; M has z forward and "
            "a row per channel: check the sign of z, and whether M is transposed",
        )
    ]


def check_residual(rig: Rig) -> list[Finding]:
    """Find a calibration that its own samples contradict."""
    quality = rig.quality
    if quality is not None and quality.samples and quality.residual_deg > _NOTED_RESIDUAL_DEG:
        fatal = quality.residual_deg > _FATAL_RESIDUAL_DEG
        return [
            Finding(
                check="residual",
                level=Level.FATAL if fatal else Level.WARNING,
                problem="the calibration contradicts its own samples",
                measured=f"a median residual of {quality.residual_deg:.0f} degrees",
                expected=f"less than {_NOTED_RESIDUAL_DEG:g}",
                remedy="was this the calibration object, matte, of one colour, alone in the mask?",
            )
        ]
    return []


def check_coverage(rig: Rig) -> list[Finding]:
    """Find a calibration that saw too few directions, and an M that multiplies noise."""
    quality, findings = rig.quality, []
    if quality is not None and quality.samples and quality.cone_deg < _NARROW_CONE_DEG:
        findings.append(
            Finding(
                check="cone",
                level=Level.WARNING,
                problem=f"the rig was fitted on normals within {quality.cone_deg:.0f} degrees of their mean: "
                "steeper are a guess",
                measured=f"a cone of {quality.cone_deg:.0f} degrees",
                expected=f"{_NARROW_CONE_DEG:g} or more",
                remedy=f"calibrate again with the target tilted by {_NARROW_CONE_DEG:.0f} degrees and more",
            )
        )
    condition = rig.response.condition_number
    if condition > _LARGE_CONDITION_NUMBER:
        findings.append(
            Finding(
                check="condition",
                level=Level.WARNING,
                problem="M multiplies noise",
                measured=f"a condition number of {condition:.0f}",
                expected="less than 10",
                remedy="move the lamps further apart or make their colours purer, and calibrate again",
            )
        )
    return findings
