"""The outline of a ball: a circle detected in an image, or fitted to a mask."""

from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import Float32Array, Float64Array, FloatArray, Mask, Points2
from vntoolkit.errors import BadCalibration
from vntoolkit.photometry.frame import LinearFrame

_LEVELS = (0.03, 0.06, 0.12, 0.25, 0.5)  # of the brightest: low for a dark side, high for a grey wall
_SMALLEST_ARC = 0.4  # of the full circle that must be seen
_RADII = 360
_REACH_PX = 4.0  # beyond the blur and the threshold's error, within the rim
_DRAWS = 400
_TOLERANCE_SHARE = 0.01  # of the radius: how far an outline point may lie from the circle
_SMALLEST_RADIUS_PX = 8.0
_SECTORS = 90


@dataclass(frozen=True, kw_only=True, eq=False)
class Circle:
    """A circle in an image, with what supports it.

    centre_px: (u, v). points_px: (n, 2) outline points on it. arc: share of the turn that they cover.
    """

    centre_px: Points2
    radius_px: float
    points_px: Points2
    arc: float


def find_ball_outline(frame: LinearFrame) -> Circle:
    """Find the ball that fills most of a circle in an image, brighter than what is behind it.

    Thresholds the image at several levels and keeps the circle with the most complete outline. Raises
    `BadCalibration` where no outline covers 40 % of a circle.
    """
    grey = cv2.GaussianBlur(frame.rgb.max(axis=2), (0, 0), 1.0)
    floor, top = np.percentile(grey, [5.0, 99.5])
    if not top > 0.004:
        raise BadCalibration("calibrate sphere: the image is black; are the lights on, the lens cap off?")
    candidates = []
    for level in _LEVELS:
        candidates += _circles_in(grey > floor + level * (top - floor))
    best = max(candidates, key=lambda circle: circle.arc * np.sqrt(circle.radius_px), default=None)
    if best is None or best.arc < _SMALLEST_ARC:
        raise BadCalibration(
            "calibrate sphere: no ball found; film one matte ball, whole and brighter than what is behind "
            "it, or give its outline with --mask"
        )
    return _refine_on_edges(grey, best)


def outline_from_mask(mask: Mask) -> Circle:
    """Fit a circle to the outline of a mask's largest region; refuses one that is no circle."""
    circles = _circles_in(mask)
    best = max(circles, key=lambda circle: circle.radius_px, default=None)
    if best is None or best.arc < _SMALLEST_ARC:
        raise BadCalibration(
            "calibrate sphere: the mask's outline is not a circle; white where the ball is, black elsewhere"
        )
    return best


def _refine_on_edges(grey: Float32Array, rough: Circle) -> Circle:
    """Move the outline to where the brightness along each radius is halfway between ball and background.

    A low threshold on a blurred image finds the outline a pixel too far out. Radii without an edge (a dark
    side, a neighbour) are left out, and those whose edge is off the circle after the fit.
    """
    turn = 2 * np.pi * np.arange(_RADII) / _RADII
    directions = np.column_stack([np.cos(turn), np.sin(turn)])
    offsets = np.arange(-_REACH_PX, _REACH_PX + 0.05, 0.1)
    at = rough.centre_px + (rough.radius_px + offsets)[None, :, None] * directions[:, None]
    at = at.astype(np.float32)
    profiles = cv2.remap(grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inner, outer = profiles[:, 0], profiles[:, -1]
    edge = np.argmax(profiles < 0.5 * (inner + outer)[:, None], axis=1)
    height, width = grey.shape
    inside = ((at[:, -1] >= 0) & (at[:, -1] <= [width - 1, height - 1])).all(axis=1)
    clear = inside & (edge > 0) & (inner - outer > 0.25 * np.percentile(inner - outer, 90))
    points = at[np.arange(_RADII), edge].astype(np.float64)[clear]
    if len(points) < _SMALLEST_ARC * _RADII:
        return rough
    for _ in range(5):
        centre, radius = _least_squares_circle(points)
        off = np.abs(np.linalg.norm(points - centre, axis=1) - radius)
        kept = off <= max(0.3, 3 * float(np.median(off)))
        if kept.all():
            break
        points = points[kept]
    return Circle(centre_px=centre, radius_px=radius, points_px=points, arc=_arc(points - centre))


def _circles_in(region: Mask) -> list[Circle]:
    """Circles through the outlines of the larger connected regions."""
    contours, _ = cv2.findContours(region.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    height, width = region.shape
    circles = []
    for contour in sorted(contours, key=len, reverse=True)[:4]:
        points = contour[:, 0].astype(np.float64)
        inner = (points > 0).all(axis=1) & (points < [width - 1, height - 1]).all(axis=1)
        circle = _fit_circle(points[inner])  # where the image cuts the ball, the outline is the image's
        if circle is not None:
            circles.append(circle)
    return circles


def _fit_circle(points: Points2) -> Circle | None:
    """Fit a circle robustly to pixels (n, 2) of the ball; the edge lies half a pixel further out."""
    if len(points) < 16:
        return None
    rng = np.random.default_rng(0)  # the triples only start a least-squares fit; the outline decides
    centres, radii = _circles_through(points[rng.integers(0, len(points), (_DRAWS, 3))])
    sound = np.isfinite(radii) & (radii >= _SMALLEST_RADIUS_PX) & (radii < 2 * np.ptp(points, axis=0).max())
    if not sound.any():
        return None
    centres, radii = centres[sound], radii[sound]
    distances = np.abs(np.linalg.norm(points[None] - centres[:, None], axis=2) - radii[:, None])
    tolerances = np.maximum(_TOLERANCE_SHARE * radii, 1.0)
    best = int(np.argmin(np.minimum(distances / tolerances[:, None], 1.0).sum(axis=1)))
    centre, radius, tolerance = centres[best], float(radii[best]), float(tolerances[best])
    on_circle = distances[best] < tolerance
    for _ in range(10):
        if np.count_nonzero(on_circle) < 8:
            return None
        centre, radius = _least_squares_circle(points[on_circle])
        update = np.abs(np.linalg.norm(points - centre, axis=1) - radius) < tolerance
        if np.array_equal(update, on_circle):
            break
        on_circle = update
    chosen = points[on_circle]
    outward = (chosen - centre) / radius
    return Circle(
        centre_px=centre, radius_px=radius + 0.5, points_px=chosen + 0.5 * outward, arc=_arc(chosen - centre)
    )


def _circles_through(triples: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centres (k, 2), radii (k,) of the circles through triples (k, 3, 2); not finite where collinear."""
    a, b, c = triples[:, 0], triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0]
    cross = 2 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        bb, cc = (b**2).sum(axis=1), (c**2).sum(axis=1)
        offset = np.stack([c[:, 1] * bb - b[:, 1] * cc, b[:, 0] * cc - c[:, 0] * bb], axis=1) / cross[:, None]
    return a + offset, np.linalg.norm(offset, axis=1)


def _least_squares_circle(points: Points2) -> tuple[Points2, float]:
    """Algebraic circle fit (Kåsa): u² + v² = 2 u c_u + 2 v c_v + d, centred for the digits."""
    mean = points.mean(axis=0)
    local = points - mean
    system = np.column_stack([2 * local, np.ones(len(local))])
    (c_u, c_v, d), *_ = np.linalg.lstsq(system, (local**2).sum(axis=1), rcond=None)
    return mean + np.array([c_u, c_v]), float(np.sqrt(d + c_u**2 + c_v**2))


def _arc(offsets: Float64Array) -> float:
    """Share of the turn, in sectors, that the points about the centre cover."""
    sectors = np.floor((np.arctan2(offsets[:, 1], offsets[:, 0]) / (2 * np.pi) + 0.5) * _SECTORS)
    return len(np.unique(np.clip(sectors, 0, _SECTORS - 1))) / _SECTORS
