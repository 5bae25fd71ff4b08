"""Calibration on a matte ball: its outline in the image gives the normal at every pixel."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, Float32Array, Float64Array, FloatArray, Mask, Points, Points2, Vector3
from vntoolkit.calibration.ball_lamps import NEAREST_USUAL, LitBall, fit_lamps_to_ball
from vntoolkit.calibration.fit import ResponseFit, fit_response
from vntoolkit.calibration.lights import with_light_colours
from vntoolkit.checks import require_mask, require_shape, require_some
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.options.calibration import SphereOptions
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import with_near_lamps

logger = logging.getLogger(__name__)
_LEVELS = (0.03, 0.06, 0.12, 0.25, 0.5)  # of the brightest: low for a dark side, high for a grey wall
_BRIGHTEST = 99.9  # percentile; a lamp's mirror image covers some thousandths of a ball
_FAR_OFF = 0.05  # of the radius
_WHOLE_ARC = 0.6  # of the circle: then its place is known to a percent
_SMALLEST_ARC = 0.4  # of the full circle that must be seen


@dataclass(frozen=True, kw_only=True, eq=False)
class SphereCalibration:
    """fit: M and its quality. outline: the circle in the image. normal_map: the ball's normals from geometry.

    residual_deg: (h, w) float32, angle between the ball's normals and those that M gives back; NaN off the
    ball and where a pixel was left out. lit: the fit of each lamp alone; None where none was.
    """

    fit: ResponseFit
    outline: "Circle"
    normal_map: NormalMap
    residual_deg: Float32Array
    lit: LitBall | None = None


def fit_response_to_sphere(
    frame: LinearFrame,
    camera: Camera,
    mask: Mask | None = None,
    options: SphereOptions | None = None,
    rng: np.random.Generator | None = None,
) -> SphereCalibration:
    """Fit M to one image of a ball; outline from `mask` where given, else found in the image.

    rng: draws samples where `options.fit` says MSAC. Raises `BadCalibration` where no ball is found or
    its pixels do not determine M.
    """
    options = options or SphereOptions()
    ball = _ball_in(frame, camera, mask, options)
    return _fit(frame, *ball, mask, options, rng)


def fit_response_to_switched_sphere(
    alone: Sequence[LinearFrame],
    camera: Camera,
    mask: Mask | None = None,
    options: SphereOptions | None = None,
    rng: np.random.Generator | None = None,
    dark: LinearFrame | None = None,
) -> SphereCalibration:
    """Fit M to a ball that the red, the green and the blue lamp light alone; alone: three images.

    Each lamp's distance and the light of the room are separated from M (`fit_lamps_to_ball`): M is that
    of the place where the ball's centre is, and changes over the picture where the lamps are near. An
    orthographic camera leaves the latter out: a ball seen in perspective and taken for one seen from afar
    makes lamps seem far, and footage tells it better. dark: the ball under no lamp, None for none. Else as
    `fit_response_to_sphere`.
    """
    options = options or SphereOptions()
    total = LinearFrame(
        rgb=np.sum([each.rgb for each in alone], axis=0),
        clipped=np.any([each.clipped for each in alone], axis=0),
    )
    outline, normal_map = _ball_in(total, camera, mask, options)
    seen = normal_map if mask is None else replace(normal_map, mask=normal_map.mask & mask)
    lit = fit_lamps_to_ball(alone, seen, dark)
    _warn_of_lamps(lit)
    result = _fit(lit.under_far_lamps(alone, normal_map), outline, normal_map, mask, options, rng)
    colours = np.array([lamp.colour / np.linalg.norm(lamp.colour) for lamp in lit.lamps])
    response = replace(with_light_colours(result.fit.response, colours), ambient=lit.room)
    closeness = np.array([lamp.closeness for lamp in lit.lamps])
    if closeness.any() and camera.is_perspective:
        size = (camera.width, camera.height)
        nearness = closeness * max(size) / 2.0 / outline.radius_px
        response = with_near_lamps(response, nearness, size, outline.centre_px)
    return replace(result, fit=replace(result.fit, response=response), lit=lit)


def _warn_of_lamps(lit: LitBall) -> None:
    if not lit.is_room_known:
        logger.warning(
            "calibrate sphere: the lamps reach all of the ball that is seen, so that it does not tell the "
            "light of the room; unless the room is dark, M has it three times: film frames with all lamps off"
        )
    nearest = max(lamp.closeness for lamp in lit.lamps)
    if nearest > NEAREST_USUAL:
        logger.warning(
            "calibrate sphere: by the ball's shading a lamp stands %.1f of its radii from its centre "
            "(expected over %.1f); if it does not, the transfer curve is another: give it with --transfer",
            1.0 / nearest, 1.0 / NEAREST_USUAL,
        )  # fmt: skip


def _ball_in(
    frame: LinearFrame, camera: Camera, mask: Mask | None, options: SphereOptions
) -> tuple["Circle", NormalMap]:
    require_shape(frame.rgb, (camera.height, camera.width, 3), "frame of the ball")
    if frame.clipped.all():
        raise BadCalibration("calibrate sphere: every pixel is clipped; lower the exposure")
    if mask is None:
        outline = find_ball_outline(frame)
    else:
        require_mask(mask, frame.shape)
        require_some(mask, "mask")
        outline = outline_from_mask(mask)
        _require_on_ball(outline, frame)
    return outline, sphere_normals(outline, camera, options.rim_share)


def _require_on_ball(outline: "Circle", frame: LinearFrame) -> None:
    """Raise `BadCalibration` for a mask's outline beside the ball that the picture shows.

    A ball found whole, and nearly as large, is the same one. A centre that is off by a twentieth of the
    radius turns every normal by 3 degrees or more.
    """
    try:
        seen = find_ball_outline(frame)
    except BadCalibration:
        return
    off = seen.centre_px - outline.centre_px
    same = abs(seen.radius_px - outline.radius_px) < _FAR_OFF * outline.radius_px and seen.arc > _WHOLE_ARC
    if same and np.linalg.norm(off) > _FAR_OFF * outline.radius_px:
        u, v = seen.centre_px
        raise BadCalibration(
            f"calibrate sphere: the mask lies beside the ball by ({off[0]:.0f}, {off[1]:.0f}) pixels: "
            f"what is lit is a ball about {u:.0f} {v:.0f}, {seen.radius_px:.0f} pixels in radius; move the "
            "mask, or leave it out"
        )


def _fit(
    frame: LinearFrame, outline: "Circle", normal_map: NormalMap, mask: Mask | None, options: SphereOptions,
    rng: np.random.Generator | None,
) -> SphereCalibration:  # fmt: skip
    chosen = normal_map.mask if mask is None else normal_map.mask & mask
    normals, rgb = normal_map.normals_in_camera[chosen], frame.rgb[chosen]
    try:
        fit = fit_response(normals, rgb, options.fit, clipped=frame.clipped[chosen], verb="sphere", rng=rng)
    except BadCalibration as problem:
        if _mirrors(rgb):
            raise BadCalibration(
                "calibrate sphere: the ball is shiny: it mirrors its lamps in small spots and is dark "
                "between them; use a matte ball"
            ) from problem
        raise
    residual_deg = np.full(frame.shape, np.nan, np.float32)
    recovered = (rgb - fit.response.ambient) @ fit.response.inverse.T
    residual_deg[chosen] = np.where(fit.inliers, angles_deg(recovered, normals), np.nan)
    return SphereCalibration(fit=fit, outline=outline, normal_map=normal_map, residual_deg=residual_deg)


def _mirrors(rgb: Points) -> bool:
    """True where less of a ball is bright than a matte one shows under any lamp: colours (n, 3) of the ball.

    Within 60 degrees of a lamp a matte ball is brighter than half of its brightest. A lamp beside it, the
    worst case, shows the camera (π/3 − √3/4) / π = 20 % of the ball so.
    """
    bright = rgb > 0.5 * np.percentile(rgb, _BRIGHTEST, axis=0)
    return bool((bright.mean(axis=0) < 0.5 * (np.pi / 3 - np.sqrt(3) / 4) / np.pi).any())


def sphere_normals(outline: "Circle", camera: Camera, rim_share: float = 0.0) -> NormalMap:
    """Normals of the ball behind an outline, at every pixel inside it but the rim.

    Orthographic: the outline is the ball's equator. Perspective: the outline's rays form a cone that touches
    the ball; its image is an ellipse, so only the outline's points are used, not the circle.
    """
    if camera.is_perspective:
        normals, inside = _perspective_normals(outline.points_px, camera, rim_share)
    else:
        offsets = (camera.pixel_grid() - outline.centre_px) / outline.radius_px
        squared = np.sum(offsets**2, axis=-1)
        inside = squared < (1.0 - rim_share) ** 2
        z = -np.sqrt(np.maximum(1.0 - squared, 0.0))
        normals = np.concatenate([offsets, z[..., None]], axis=-1)
    if not inside.any():
        raise BadCalibration("calibrate sphere: the ball lies outside the image")
    return NormalMap(normals_in_camera=np.where(inside[..., None], normals, 0.0), mask=inside)


def _perspective_normals(
    outline_px: Points2, camera: Camera, rim_share: float
) -> tuple[FloatArray, BoolArray]:
    axis, sine = _tangent_cone(_rays(outline_px, camera))
    rays = _rays(camera.pixel_grid(), camera)
    along = rays @ axis  # ball's centre at distance 1, so its radius is the cone's sine
    from_centre = np.sqrt(np.maximum(1.0 - along**2, 0.0)) / sine
    inside = (from_centre < 1.0 - rim_share) & (along > 0)
    distance = along - np.sqrt(np.maximum(sine**2 - (1.0 - along**2), 0.0))
    return (distance[..., None] * rays - axis) / sine, inside


def _tangent_cone(rays: FloatArray) -> tuple[Vector3, float]:
    """Axis (unit) and sine of the half-angle of the cone through unit rays (n, 3): d · axis = cosine."""
    solution, *_ = np.linalg.lstsq(rays, np.ones(len(rays)), rcond=None)
    cosine = 1.0 / float(np.linalg.norm(solution))
    if not 0 < cosine < 1:
        raise BadCalibration("calibrate sphere: the outline is not that of a ball seen by this camera")
    return solution * cosine, float(np.sqrt(1.0 - cosine**2))


def _rays(pixels: FloatArray, camera: Camera) -> FloatArray:
    points = camera.unproject(pixels, np.ones(pixels.shape[:-1]))
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Circle:
    """A circle in an image, with what supports it.

    centre_px: (u, v). points_px: (n, 2) outline points on it. arc: share of the turn that they cover.
    """

    centre_px: Points2
    radius_px: float
    points_px: Points2
    arc: float


# The outline of the ball: detected in the image, or from a mask.


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


_RADII = 360
_REACH_PX = 4.0  # beyond the blur and the threshold's error, within the rim


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


_DRAWS = 400
_TOLERANCE_SHARE = 0.01  # of the radius: how far an outline point may lie from the circle
_SMALLEST_RADIUS_PX = 8.0


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


_SECTORS = 90


def _arc(offsets: Float64Array) -> float:
    """Share of the turn, in sectors, that the points about the centre cover."""
    sectors = np.floor((np.arctan2(offsets[:, 1], offsets[:, 0]) / (2 * np.pi) + 0.5) * _SECTORS)
    return len(np.unique(np.clip(sectors, 0, _SECTORS - 1))) / _SECTORS
