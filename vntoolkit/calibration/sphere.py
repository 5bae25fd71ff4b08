"""Calibration on a matte ball of the material: its outline gives every normal on it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Points2, Vector3
from vntoolkit.calibration.fit import FitOptions, ResponseFit, fit_response
from vntoolkit.calibration.quality import angles_deg
from vntoolkit.calibration.sphere_outline import Circle, find_ball_outline, outline_from_mask
from vntoolkit.checks import require_mask, require_shape, require_some
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.photometry.frame import LinearFrame


@dataclass(frozen=True, kw_only=True)
class SphereOptions:
    """How a ball calibrates.

    rim_share: outer share of the ball's radius that is left out, where a pixel of error in the outline turns
    the normal by tens of degrees. fit: how M is fitted.
    """

    rim_share: float = 0.02
    fit: FitOptions = field(default_factory=FitOptions)

    def __post_init__(self) -> None:
        if not 0 <= self.rim_share < 0.5:
            raise BadInput(f"rim share: expected 0 to 0.5, got {self.rim_share:g}")


@dataclass(frozen=True, kw_only=True, eq=False)
class SphereCalibration:
    """fit: M and its quality. outline: the circle in the image. normal_map: the ball's normals from geometry.

    residual_deg: (h, w) float32, angle between the ball's normals and those that M gives back; NaN off the
    ball and where a pixel was left out.
    """

    fit: ResponseFit
    outline: Circle
    normal_map: NormalMap
    residual_deg: npt.NDArray[np.float32]


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
    require_shape(frame.rgb, (camera.height, camera.width, 3), "frame of the ball")
    if frame.clipped.all():
        raise BadCalibration("calibrate sphere: every pixel is clipped; lower the exposure")
    if mask is None:
        outline = find_ball_outline(frame)
    else:
        require_mask(mask, frame.shape)
        require_some(mask, "mask")
        outline = outline_from_mask(mask)
    normal_map = sphere_normals(outline, camera, options.rim_share)
    chosen = normal_map.mask if mask is None else normal_map.mask & mask
    normals, rgb = normal_map.normals_in_camera[chosen], frame.rgb[chosen]
    fit = fit_response(normals, rgb, options.fit, clipped=frame.clipped[chosen], verb="sphere", rng=rng)
    residual_deg = np.full(frame.shape, np.nan, np.float32)
    recovered = (rgb - fit.response.ambient) @ fit.response.inverse.T
    residual_deg[chosen] = np.where(fit.inliers, angles_deg(recovered, normals), np.nan)
    return SphereCalibration(fit=fit, outline=outline, normal_map=normal_map, residual_deg=residual_deg)


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
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
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
