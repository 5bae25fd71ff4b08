"""How far footage of a turning head carries its calibration: numbers, and plain words where it is weak."""

from __future__ import annotations

import numpy as np

from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.calibrate_head import HeadCalibration
from vntoolkit.report.calibration_section import graded
from vntoolkit.report.page import PageNotice, PageNumber

# Bounds between good, fair and poor, by experience with simulated turns.
_TURN_DEG = (100.0, 60.0)
_AGREEING = (0.65, 0.4)
_ERROR_PX = (0.4, 0.7)
_RESIDUAL_DEG = (4.0, 7.0)
_CONDITION = (12.0, 30.0)


def numbers_of_head(rig: Rig, result: HeadCalibration) -> tuple[PageNumber, ...]:
    """Return turn, errors, agreement and condition, graded."""
    motion, quality = result.motion, result.light.quality
    agreeing = float(result.light.inliers.mean())
    return (
        PageNumber(
            value=f"{motion.turn_deg:.0f}°",
            label="turn of the head",
            grade=graded(-motion.turn_deg, (-_TURN_DEG[0], -_TURN_DEG[1])),
            remark="between the two ends",
        ),
        PageNumber(
            value=f"{motion.error_px:.2f} px",
            label="reprojection error",
            grade=graded(motion.error_px, _ERROR_PX),
            remark=f"{len(motion.point):,} tracks, {motion.observations:,} observations",
        ),
        PageNumber(
            value=f"{agreeing:.0%}",
            label="samples that agree",
            grade=graded(-agreeing, (-_AGREEING[0], -_AGREEING[1])),
            remark=f"of {len(result.samples.point):,} on one M",
        ),
        PageNumber(
            value=f"{quality.residual_deg:.1f}°",
            label="median residual",
            grade=graded(quality.residual_deg, _RESIDUAL_DEG),
            remark="normal by colour against normal by shape",
        ),
        PageNumber(
            value=f"{rig.response.condition_number:.1f}",
            label="condition number of M",
            grade=graded(rig.response.condition_number, _CONDITION),
            remark="set by the lights' directions and colours",
        ),
    )


def notices_of_head(result: HeadCalibration) -> tuple[PageNotice, ...]:
    """Say plainly what is weak; what carries no calibration at all was refused before."""
    motion = result.motion
    found = []
    if motion.turn_deg < _TURN_DEG[0]:
        found.append(
            f"The head turns by only {motion.turn_deg:.0f}°. Depth and lights grow surer with 60° to both "
            "sides."
        )
    if motion.interpolated.any():
        missing = ", ".join(str(result.footage.numbers[k]) for k in np.flatnonzero(motion.interpolated)[:8])
        found.append(
            f"{np.count_nonzero(motion.interpolated)} of the frames were not placed but interpolated: "
            f"{missing}."
        )
    if result.light.inliers.mean() < _AGREEING[0]:
        found.append(
            f"Only {result.light.inliers.mean():.0%} of the samples agree on one M. Look for stray light, "
            "gloss or a wrong transfer curve."
        )
    if motion.error_px > _ERROR_PX[0]:
        found.append(
            f"Tracks miss the rigid head by {motion.error_px:.2f} px. Look for a moving expression or blur."
        )
    if not found:
        return (PageNotice(severity="note", text="Turn, tracks and samples carry the calibration."),)
    return tuple(PageNotice(severity="warning", text=text) for text in found)
