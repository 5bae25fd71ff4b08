"""Can a rig be right, and is it of this footage's zoom? What M, its lamps and its calibration say.

Lamps that stand near make M change over the picture, in a way that the rig knows for one focal length. At
another zoom the change is stretched: then the lengths |M⁻¹(r − a)|, equal on one material, are most equal
with M read from places scaled by the ratio of the two focal lengths.
"""

import math

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.evidence import FEWEST_PIXELS, Evidence
from vntoolkit.diagnosis.finding import CLEAR_Z, Finding, Level
from vntoolkit.diagnosis.surface_pixels import SurfacePixels, surface_pixels
from vntoolkit.photometry.fit_quality import LARGE_CONDITION_NUMBER, NARROW_CONE_DEG
from vntoolkit.photometry.rig import Rig

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
    return [Finding.of("lamps", what=what, red=share[0], green=share[1], blue=share[2])]


def check_residual(rig: Rig) -> list[Finding]:
    """Find a calibration that its own samples contradict."""
    quality = rig.quality
    if quality is not None and quality.samples and quality.residual_deg > _NOTED_RESIDUAL_DEG:
        level = Level.FATAL if quality.residual_deg > _FATAL_RESIDUAL_DEG else Level.WARNING
        return [Finding.of("residual", level=level, residual_deg=quality.residual_deg)]
    return []


def check_coverage(rig: Rig) -> list[Finding]:
    """Find a calibration that saw too few directions, and an M that multiplies noise."""
    quality, findings = rig.quality, []
    if quality is not None and quality.samples and quality.cone_deg < NARROW_CONE_DEG:
        findings.append(Finding.of("cone", cone_deg=quality.cone_deg))
    condition = rig.response.condition_number
    if condition > LARGE_CONDITION_NUMBER:
        findings.append(Finding.of("condition", condition=condition))
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
        findings.append(_impossible("its rows and columns are skewed", measured, "0"))
    if camera.is_perspective and camera.folds:
        measured = "k1, k2, p1, p2, … = " + ", ".join(f"{value:.3g}" for value in camera.distortion)
        findings.append(_impossible("its distortion folds the picture", measured, "one place a pixel"))
    off = np.abs(matrix[:2, 2] / ((camera.width - 1) or 1, (camera.height - 1) or 1) - 0.5)
    if camera.is_perspective and off.max() > _FURTHEST_CENTRE:
        u, v = matrix[:2, 2]
        at = f"at {u:.1f} {v:.1f} of {camera.width}×{camera.height} pixels"
        where = "its principal point lies near the border"
        findings.append(_impossible(where, at, "near the middle", Level.WARNING))
    return findings


def _impossible(problem: str, measured: str, expected: str, level: Level = Level.FATAL) -> Finding:
    return Finding.of("camera", level=level, problem=problem, measured=measured, expected=expected)


_ZOOMS = np.exp(np.linspace(-math.log(2.5), math.log(2.5), 41))  # of the footage against the rig
_NOTED = 1.15
_LEFT = 0.85  # of the spread of lengths that the other zoom must leave
_STATED_NOTED = 1.2  # equivalents of 35 mm are rounded, and refer to the diagonal or to the width


def check_zoom(evidence: Evidence) -> list[Finding]:
    """Find footage that fits the rig's variation over the picture only at another zoom."""
    variation = evidence.rig.response.variation
    if variation is None:
        return []
    pixels = surface_pixels(evidence)
    if len(pixels) < FEWEST_PIXELS:
        return []
    residuals = np.stack([_residuals(evidence.rig, pixels, zoom) for zoom in _ZOOMS])
    spreads = residuals.mean(axis=1)
    best, own = int(spreads.argmin()), int(np.abs(np.log(_ZOOMS)).argmin())
    zoom = float(_ZOOMS[best])
    if max(zoom, 1 / zoom) < _NOTED or spreads[best] > _LEFT * spreads[own]:
        return []
    gain = residuals[own] - residuals[best]
    parts = np.array([gain[pixels.blocks == block].mean() for block in np.unique(pixels.blocks)])
    z = float(parts.mean() / max(parts.std() / math.sqrt(len(parts)), 1e-9))
    if z < CLEAR_Z:
        return []
    because = f"the lengths spread {spreads[own] / spreads[best]:.2f} times as much at 1"
    return [Finding.of("zoom", zoom=zoom, because=because)]


def _residuals(rig: Rig, pixels: SurfacePixels, zoom: float) -> FloatArray:
    """Return how far each log length lies from the median, (n,), with M read at places scaled by 1 / zoom."""
    assert rig.response.variation is not None
    camera = rig.camera
    size = np.array([camera.width, camera.height])
    positions_px = pixels.positions * size.max() / 2 + (size - 1) / 2
    centre = camera.matrix[:2, 2] if camera.is_perspective else rig.response.variation.centre_px
    matrices, ambient = rig.response.at(centre + (positions_px - centre) / zoom)
    scaled = np.linalg.solve(matrices, (pixels.rgb - ambient)[..., None])[..., 0]
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
    because = f"the file states {stated_focal_px:.0f} pixels, the rig's is {own:.0f}"
    return [Finding.of("zoom", zoom=zoom, because=because)]


RIG_CHECKS = (check_camera, check_lamps, check_residual, check_coverage)


def findings_from_rig(rig: Rig) -> list[Finding]:
    """Return what a rig tells by itself."""
    return [finding for check in RIG_CHECKS for finding in check(rig)]
