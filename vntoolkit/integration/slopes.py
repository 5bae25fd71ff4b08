"""Slopes from normals: how fast depth (orthographic) or log depth (perspective) changes per pixel.

With r the ray of a pixel, (x, y, 1) or (0, 0, 1), and r_u its change per column in units of the surface
point's, the surface's tangent is orthogonal to its normal: (r_u + r s_u) · n = 0, so s_u = -(n·r_u)/(n·r),
where s is depth for an orthographic camera and log depth for a perspective one. Log depth makes the
perspective case as linear as the other (Durou, Aujol and Courteille 2009, `durou2009`).
"""

from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import Float32Array, FloatArray, Normals
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.native import njit


@dataclass(frozen=True, kw_only=True, eq=False)
class RayField:
    """The rays of a camera, ready for slopes.

    affine: (6,) float32: x = a0 u + a1 v + a2, y = a3 u + a4 v + a5. depth_scales_ray: 1 for perspective, 0
    for orthographic. table: (h, w, 6) float32 of (x, y, x_u, y_u, x_v, y_v) where distortion makes the
    affine form wrong, else None.
    """

    affine: Float32Array
    depth_scales_ray: float
    table: Float32Array | None = None

    @property
    def pixels_per_unit(self) -> float:
        """Focal length, or scale of an orthographic camera: turns slopes into pixels per pixel."""
        return 1.0 / float(self.affine[0])

    def cropped(self, rows: slice, columns: slice) -> "RayField":
        """Return the rays of a window of the image."""
        affine = self.affine.copy()
        affine[2::3] += affine[0::3] * np.float32(columns.start) + affine[1::3] * np.float32(rows.start)
        table = None if self.table is None else np.ascontiguousarray(self.table[rows, columns])
        return replace(self, affine=affine, table=table)


def rays_from_camera(camera: Camera) -> RayField:
    """Prepare the rays of a camera; once per camera, not per frame."""
    inverse = np.linalg.inv(camera.matrix[:2, :2])
    offset = -inverse @ camera.matrix[:2, 2]
    affine = np.column_stack([inverse, offset]).ravel().astype(np.float32)
    table = _ray_table(camera) if camera.model is CameraModel.OPENCV else None
    return RayField(affine=affine, depth_scales_ray=float(camera.is_perspective), table=table)


def _ray_table(camera: Camera) -> Float32Array:
    """Undistorted ray and its central differences for every pixel, (h, w, 6)."""
    grid = camera.pixel_grid()
    one = np.ones(grid.shape[:2])

    def ray(du: float, dv: float) -> FloatArray:
        return camera.unproject(grid + np.array([du, dv]), one)[..., :2]

    along_u = ray(0.5, 0.0) - ray(-0.5, 0.0)
    along_v = ray(0.0, 0.5) - ray(0.0, -0.5)
    return np.concatenate([ray(0.0, 0.0), along_u, along_v], axis=-1).astype(np.float32)


def slopes_from_normals(
    normals_in_camera: Normals, rays: RayField, steepest_slope_deg: float = 89.0
) -> tuple[Float32Array, Float32Array]:
    """Return (s_u, s_v), each (h, w) float32, per pixel, from normals (h, w, 3) in the camera frame.

    Where the surface leans more than `steepest_slope_deg` from facing its ray, or away from the camera,
    -n·r is held at the cosine of that angle, which bounds the slope and keeps its direction. An invalid
    pixel (normal 0) gets slope 0, which nobody may use.
    """
    normals = np.ascontiguousarray(normals_in_camera, dtype=np.float32)
    least_facing = np.float32(np.cos(np.deg2rad(steepest_slope_deg)))
    p = np.empty(normals.shape[:2], dtype=np.float32)
    q = np.empty_like(p)
    if rays.table is None:
        flat = normals.reshape(len(normals), -1)
        _slopes_affine(flat, rays.affine, np.float32(rays.depth_scales_ray), least_facing, p, q)
    else:
        _slopes_table(normals, rays.table, least_facing, p, q)
    return p, q


@njit
def _slopes_affine(normals, affine, perspective, least_facing, p, q):  # type: ignore[no-untyped-def]
    height, width = p.shape
    x_u, x_v, x_0 = affine[0], affine[1], affine[2]
    y_u, y_v, y_0 = affine[3], affine[4], affine[5]
    one = np.float32(1.0)
    for v in range(height):
        line, to_p, to_q = normals[v], p[v], q[v]
        for u in range(width):
            nx, ny, nz = line[3 * u], line[3 * u + 1], line[3 * u + 2]
            x = perspective * (x_u * np.float32(u) + x_v * np.float32(v) + x_0)
            y = perspective * (y_u * np.float32(u) + y_v * np.float32(v) + y_0)
            facing = -(nx * x + ny * y + nz)
            least = least_facing * np.sqrt(x * x + y * y + one)
            inverse = one / max(facing, least)
            to_p[u] = (nx * x_u + ny * y_u) * inverse
            to_q[u] = (nx * x_v + ny * y_v) * inverse


@njit
def _slopes_table(normals, table, least_facing, p, q):  # type: ignore[no-untyped-def]
    height, width = p.shape
    one = np.float32(1.0)
    for v in range(height):
        for u in range(width):
            nx, ny, nz = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
            x, y = table[v, u, 0], table[v, u, 1]
            facing = -(nx * x + ny * y + nz)
            least = least_facing * np.sqrt(x * x + y * y + one)
            inverse = one / max(facing, least)
            p[v, u] = (nx * table[v, u, 2] + ny * table[v, u, 3]) * inverse
            q[v, u] = (nx * table[v, u, 4] + ny * table[v, u, 5]) * inverse
