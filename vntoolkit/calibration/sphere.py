"""Calibration on a matte ball: its outline in the image gives the normal at every pixel."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import BoolArray, Float32Array, FloatArray, Mask, Points, Points2, Vector3
from vntoolkit.calibration.ball_lamps import NEAREST_USUAL, LitBall, fit_lamps_to_ball
from vntoolkit.calibration.ball_outline import Circle, find_ball_outline, outline_from_mask
from vntoolkit.calibration.fit import ResponseFit, fit_response
from vntoolkit.calibration.lights import with_light_colours
from vntoolkit.checks import require_mask, require_shape, require_some
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.options.calibration import ResponseFitOptions
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import with_near_lamps

logger = logging.getLogger(__name__)
_BRIGHTEST = 99.9  # percentile; a lamp's mirror image covers some thousandths of a ball
_FAR_OFF = 0.05  # of the radius
_RIM_SHARE = 0.02  # of the radius is left out: there a pixel's error turns the normal by tens of degrees
_WHOLE_ARC = 0.6  # of the circle: then its place is known to a percent


@dataclass(frozen=True, kw_only=True, eq=False)
class SphereCalibration:
    """fit: M and its quality. outline: the circle in the image. normal_map: the ball's normals from geometry.

    residual_deg: (h, w) float32, angle between the ball's normals and those that M gives back; NaN off the
    ball and where a pixel was left out. lit: the fit of each lamp alone; None where none was.
    """

    fit: ResponseFit
    outline: Circle
    normal_map: NormalMap
    residual_deg: Float32Array
    lit: LitBall | None = None


def fit_response_to_sphere(
    frame: LinearFrame,
    camera: Camera,
    mask: Mask | None = None,
    options: ResponseFitOptions | None = None,
    rng: np.random.Generator | None = None,
) -> SphereCalibration:
    """Fit M to one image of a ball; outline from `mask` where given, else found in the image.

    rng: draws samples where `options` say MSAC. Raises `BadCalibration` where no ball is found or
    its pixels do not determine M.
    """
    options = options or ResponseFitOptions()
    ball = _ball_in(frame, camera, mask, options)
    return _fit(frame, *ball, mask, options, rng)


def fit_response_to_switched_sphere(
    alone: Sequence[LinearFrame],
    camera: Camera,
    mask: Mask | None = None,
    options: ResponseFitOptions | None = None,
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
    options = options or ResponseFitOptions()
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
            "calibrate sphere: every visible part of the ball is lit by a lamp, so the light of the room "
            "cannot be measured; if the room is not dark, film some frames with all lamps off"
        )
    nearest = max(lamp.closeness for lamp in lit.lamps)
    if nearest > NEAREST_USUAL:
        logger.warning(
            "calibrate sphere: the shading places a lamp %.1f radii of the ball from its centre (expected "
            "more than %.1f); if it is farther away, the transfer curve is wrong: give it with --transfer",
            1.0 / nearest, 1.0 / NEAREST_USUAL,
        )  # fmt: skip


def _ball_in(
    frame: LinearFrame, camera: Camera, mask: Mask | None, options: ResponseFitOptions
) -> tuple[Circle, NormalMap]:
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
    return outline, sphere_normals(outline, camera, _RIM_SHARE)


def _require_on_ball(outline: Circle, frame: LinearFrame) -> None:
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
    frame: LinearFrame,
    outline: Circle,
    normal_map: NormalMap,
    mask: Mask | None,
    options: ResponseFitOptions,
    rng: np.random.Generator | None,
) -> SphereCalibration:
    chosen = normal_map.mask if mask is None else normal_map.mask & mask
    normals, rgb = normal_map.normals_in_camera[chosen], frame.rgb[chosen]
    try:
        fit = fit_response(normals, rgb, options, clipped=frame.clipped[chosen], verb="sphere", rng=rng)
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


def sphere_normals(outline: Circle, camera: Camera, rim_share: float = 0.0) -> NormalMap:
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
