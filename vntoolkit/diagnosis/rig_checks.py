"""Can a rig be right, and is it of this footage's zoom? What M, its lamps and its calibration say.

Lamps that stand near make M change over the picture, in a way that the rig knows for one focal length. At
another zoom the change is stretched: then the lengths |M⁻¹(r − a)|, equal on one material, are most equal
with M read from places scaled by the ratio of the two focal lengths.
"""

import math
from dataclasses import replace

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.evidence import Evidence
from vntoolkit.diagnosis.finding import Finding, Level, certainty_from_z
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


_WIDEST_PIXEL = 2.0  # an anamorphic lens, unstretched
_FURTHEST_CENTRE = 0.25  # of the picture, from its middle: beyond it the picture is a crop
_LARGEST_SKEW_DEG = 1.0  # between a sensor's rows and columns


def check_camera(rig: Rig) -> list[Finding]:
    """Find a camera that no lens can be: pixels far from square, skewed, off the axis, or folded."""
    camera = rig.camera
    matrix = camera.matrix
    aspect, skew = matrix[0, 0] / matrix[1, 1], matrix[0, 1] / matrix[0, 0]
    skew_deg = float(np.degrees(np.arctan(abs(skew))))
    findings = []
    if max(aspect, 1 / aspect) > _WIDEST_PIXEL:
        measured = f"fx {matrix[0, 0]:.0f}, fy {matrix[1, 1]:.0f} pixels"
        findings.append(_impossible("the focal lengths differ too much", measured, "nearly the same"))
    if skew_deg > _LARGEST_SKEW_DEG:
        measured = f"a skew of {matrix[0, 1]:.0f} pixels, {skew_deg:.0f} degrees"
        findings.append(_impossible("the camera's rows and columns are skewed", measured, "0"))
    if camera.is_perspective and camera.folds:
        measured = "k1, k2, p1, p2, … = " + ", ".join(f"{value:.3g}" for value in camera.distortion)
        findings.append(_impossible("the lens distortion folds the picture", measured, "one place a pixel"))
    off = np.abs(matrix[:2, 2] / ((camera.width - 1) or 1, (camera.height - 1) or 1) - 0.5)
    if camera.is_perspective and off.max() > _FURTHEST_CENTRE:
        u, v = matrix[:2, 2]
        at = f"at {u:.1f} {v:.1f} of {camera.width}×{camera.height} pixels"
        findings.append(
            replace(
                _impossible("the camera's principal point lies near the border", at, "near the middle"),
                level=Level.WARNING,
            )
        )
    return findings


def _impossible(problem: str, measured: str, expected: str) -> Finding:
    return Finding(
        check="camera",
        level=Level.FATAL,
        problem=problem,
        measured=measured,
        expected=expected,
        remedy="check K and distortion in rig.json: is this the camera of this picture, uncropped?",
    )


_PIXELS_A_FRAME = 3000
_FEWEST_PIXELS = 400
_ZOOMS = np.exp(np.linspace(-math.log(2.5), math.log(2.5), 41))  # of the footage against the rig
_NOTED = 1.15
_LEFT = 0.85  # of the spread of lengths that the other zoom must leave
_Z = 4.0
_STATED_NOTED = 1.2  # equivalents of 35 mm are rounded, and refer to the diagonal or to the width


def check_zoom(evidence: Evidence) -> list[Finding]:
    """Find footage that fits the rig's variation over the picture only at another zoom."""
    variation = evidence.rig.response.variation
    if variation is None:
        return []
    light, positions, blocks = [], [], []
    for frame, used in zip(evidence.light, evidence.surface, strict=True):
        places = np.flatnonzero(used)
        places = places[:: max(1, len(places) // _PIXELS_A_FRAME)]
        light.append(frame.reshape(-1, 3)[places])
        positions.append(evidence.positions_px.reshape(-1, 2)[places])
        blocks.append(evidence.blocks.ravel()[places])
    rgb, where, block = (np.concatenate(parts) for parts in (light, positions, blocks))
    if len(rgb) < _FEWEST_PIXELS:
        return []
    departures = np.stack([_departures(evidence.rig, rgb, where, zoom) for zoom in _ZOOMS])
    spreads = departures.mean(axis=1)
    best, own = int(spreads.argmin()), int(np.abs(np.log(_ZOOMS)).argmin())
    zoom = float(_ZOOMS[best])
    if max(zoom, 1 / zoom) < _NOTED or spreads[best] > _LEFT * spreads[own]:
        return []
    gain = departures[own] - departures[best]
    names = np.unique(block)
    parts = np.array([gain[block == name].mean() for name in names])
    z = float(parts.mean() / max(parts.std() / math.sqrt(len(parts)), 1e-9))
    if z < _Z:
        return []
    return [_finding(zoom, f"the lengths spread {spreads[own] / spreads[best]:.2f} times as much at 1", z)]


def _departures(rig: Rig, rgb: FloatArray, positions: FloatArray, zoom: float) -> FloatArray:
    """Return how far each log length lies from the median, (n,), with M read at places scaled by 1 / zoom."""
    assert rig.response.variation is not None
    centre = rig.camera.matrix[:2, 2] if rig.camera.is_perspective else rig.response.variation.centre_px
    matrices, ambient = rig.response.at(centre + (positions - centre) / zoom)
    scaled = np.linalg.solve(matrices, (rgb - ambient)[..., None])[..., 0]
    logs = np.log(np.maximum(np.linalg.norm(scaled, axis=1), 1e-9))
    return np.minimum(np.abs(logs - np.median(logs)), 1.0)


def check_stated_focal(rig: Rig, stated_focal_px: float | None) -> list[Finding]:
    """Find footage whose file states another focal length than the rig's. stated_focal_px: None for none."""
    if stated_focal_px is None or not rig.camera.is_perspective:
        return []
    own = math.sqrt(rig.camera.matrix[0, 0] * rig.camera.matrix[1, 1])
    zoom = stated_focal_px / own
    if max(zoom, 1 / zoom) < _STATED_NOTED:
        return []
    return [_finding(zoom, f"the file states {stated_focal_px:.0f} pixels, the rig's is {own:.0f}", None)]


def _finding(zoom: float, because: str, z: float | None) -> Finding:
    return Finding(
        check="zoom",
        level=Level.WARNING,
        problem=f"the footage looks filmed at another zoom than the rig was calibrated at ({because})",
        measured=f"{zoom:.2f} times its focal length",
        expected=f"1 within {_NOTED - 1:.0%}",
        remedy="film at the zoom of the calibration, or calibrate again at this one",
        certainty=1.0 if z is None else certainty_from_z(z),
    )
