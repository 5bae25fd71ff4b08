"""Pairs of normal and colour from a head whose shape and motion are known."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, Float32Array, FloatArray, IntArray, Mask, Points, Vectors, read_only
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.geometry.rays import RayScene
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.head import SampleOptions
from vntoolkit.photometry.frame import LinearFrame

_OFF_SURFACE = 0.004  # of the diagonal: rays start so far out, beyond the mesh's own roughness
RIM_PX = 4  # closer to the silhouette's edge, colours are not trusted
LEAST_FACING = 0.35  # cosine to the viewer below which colour and normal no longer belong together


@dataclass(frozen=True, kw_only=True, eq=False)
class LightFrame:
    """A frame that colours are taken from. mask: (h, w) silhouette."""

    frame: LinearFrame
    camera_from_head: RigidTransform
    mask: Mask


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadSamples:
    """Samples of skin: (n,) each. point: which vertex. frame: which light frame.

    normals_in_camera: (n, 3). rgb: (n, 3) linear. position_px: (n, 2). camera_from_head: of every light
    frame.
    """

    point: IntArray
    frame: IntArray
    normals_in_camera: Points
    rgb: Points
    position_px: FloatArray
    camera_from_head: tuple[RigidTransform, ...]

    def __post_init__(self) -> None:
        for name in ("point", "frame", "normals_in_camera", "rgb", "position_px"):
            object.__setattr__(self, name, read_only(np.asarray(getattr(self, name))))


class HeadRays:
    """Asks whether a point of the head sees a direction or is covered by the head itself."""

    def __init__(self, mesh: Mesh) -> None:
        self._scene = RayScene((mesh.vertices, mesh.faces), threads=1)
        normals = vertex_normals(mesh.vertices, mesh.faces)
        self._starts = mesh.vertices + _OFF_SURFACE * mesh.diagonal * normals

    def free(self, vertex: IntArray, directions_in_head: Vectors) -> BoolArray:
        """Return for vertices (n,) whether nothing lies in their directions (n, 3)."""
        return ~self._scene.blocked(self._starts[vertex], directions=directions_in_head)


def sample_head(
    mesh: Mesh,
    camera: Camera,
    frames: Sequence[LightFrame],
    options: SampleOptions,
    rng: np.random.Generator,
) -> HeadSamples:
    """Take the colours of points of the mesh (head frame) in every frame that sees them.

    Raises `BadCalibration` where almost no point is seen unclipped.
    """
    rays = HeadRays(mesh)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    chosen = spread_over_orientations(normals, options.light_points, rng)
    parts = []
    for number, each in enumerate(frames):
        pose = each.camera_from_head
        position = pose.apply(mesh.vertices[chosen])
        towards = -position / np.linalg.norm(position, axis=1, keepdims=True)
        normal = pose.rotate(normals[chosen])
        pixel = camera.project(position)
        seen = ((normal * towards).sum(axis=1) > LEAST_FACING) & _within(each, pixel)
        seen[seen] = rays.free(chosen[seen], pose.inverse().rotate(towards[seen]))
        colours = _colours_at(each.frame, pixel[seen])
        parts.append((chosen[seen], np.full(seen.sum(), number), normal[seen], colours, pixel[seen]))
    point, frame, normal, rgb, pixel = (np.concatenate(column) for column in zip(*parts, strict=True))
    if len(point) < 300:
        raise BadCalibration(
            f"light: only {len(point)} unclipped samples of skin; expose so that the skin is bright but not "
            "white, and fill more of the picture"
        )
    return HeadSamples(
        point=point,
        frame=frame,
        normals_in_camera=normal,
        rgb=rgb,
        position_px=pixel,
        camera_from_head=tuple(each.camera_from_head for each in frames),
    )


def spread_over_orientations(normals: Points, count: int, rng: np.random.Generator) -> IntArray:
    """Choose about `count` of the normals (n, 3), evenly over the directions that occur."""
    cells = np.round(normals * 6.0).astype(int) @ np.array([1, 100, 10000])
    order = rng.permutation(len(normals))
    _, cell = np.unique(cells[order], return_inverse=True)
    by_cell = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[by_cell], np.arange(cell.max() + 1))
    rank = np.empty(len(cell), dtype=np.int64)
    rank[by_cell] = np.arange(len(cell)) - first[cell[by_cell]]
    return np.sort(order[np.argsort(rank, kind="stable")[:count]])


def _within(each: LightFrame, pixel: FloatArray) -> BoolArray:
    """True where a pixel lies well inside the silhouette and is not clipped."""
    usable = (each.mask & ~each.frame.clipped).astype(np.uint8)
    kernel = np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), np.uint8)
    inner = np.asarray(cv2.erode(each.mask.astype(np.uint8), kernel)) > 0
    inner &= np.asarray(cv2.erode(usable, np.ones((3, 3), np.uint8))) > 0
    column, row = np.round(pixel).astype(int).T
    inside = (row > 0) & (row < inner.shape[0] - 1) & (column > 0) & (column < inner.shape[1] - 1)
    inside[inside] = inner[row[inside], column[inside]]
    return np.asarray(inside)


def _colours_at(frame: LinearFrame, pixel: FloatArray) -> FloatArray:
    """Return the mean colour (n, 3) about each pixel, over three by three."""
    column, row = np.round(pixel).astype(int).T
    total = np.zeros((len(pixel), 3))
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            total += frame.rgb[row + down, column + right]
    return total / 9.0


_ROW = 1024  # OpenCV resamples images, no lists: points are laid out in rows


def sampled(image: Float32Array, pixel: FloatArray, outside: float = 0.0) -> Float32Array:
    """Return the image (h, w) or (h, w, c) at pixels (n, 2), bilinear."""
    count = len(pixel)
    padded = np.full((max(1, -(-count // _ROW)) * _ROW, 2), -9.0, np.float32)
    padded[:count] = pixel
    u, v = (np.ascontiguousarray(padded[:, k].reshape(-1, _ROW)) for k in range(2))
    sampled = cv2.remap(np.asarray(image), u, v, cv2.INTER_LINEAR, borderValue=outside)
    return np.asarray(sampled.reshape(-1, *image.shape[2:])[:count])
