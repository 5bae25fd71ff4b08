"""Pairs of normal and colour from a head whose shape and motion are known."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, Float32Array, FloatArray, IntArray, Mask, Points, Vectors, read_only
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.geometry.rays import RayScene
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.head import HeadSteps
from vntoolkit.photometry.frame import LinearFrame

_FEWEST_SAMPLES = 300
_OFF_SURFACE = 0.004  # of the diagonal: rays start so far out, beyond the mesh's own roughness
_RIM_PX = 4  # closer to the silhouette's edge, colours are not trusted
_LEAST_FACING = 0.35  # cosine to the viewer below which colour and normal no longer belong together


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


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinColours:
    """Colours of the vertices of a mesh in frames. rgb: (f, n, 3) float32. weight: (f, n) float32.

    weight: cosine to the viewer, 0 where a frame does not show the vertex unclipped. vertices: (n, 3), head
    frame. camera_from_head: of every frame.
    """

    rgb: Float32Array
    weight: Float32Array
    vertices: Points
    camera_from_head: tuple[RigidTransform, ...]

    @property
    def rotations(self) -> FloatArray:
        """(f, 3, 3)."""
        return np.stack([pose.rotation for pose in self.camera_from_head])

    @property
    def offsets(self) -> FloatArray:
        """(f, 3): where the head frame's origin is in each camera frame, from its mean place."""
        places = np.stack([pose.translation for pose in self.camera_from_head])
        middle = self.rotations @ self.vertices.mean(axis=0) + places
        return np.asarray(places - middle.mean(axis=0))

    def __post_init__(self) -> None:
        object.__setattr__(self, "rgb", read_only(self.rgb))
        object.__setattr__(self, "weight", read_only(self.weight))


def skin_colours(mesh: Mesh, camera: Camera, frames: Iterable[LightFrame]) -> SkinColours:
    """Take the colours of the vertices of a mesh (head frame, with normals) in every frame."""
    assert mesh.normals is not None
    rays = HeadRays(mesh)
    rgb, weight, poses = [], [], []
    for each in frames:
        pose = each.camera_from_head
        position = pose.apply(mesh.vertices)
        towards = -position / np.linalg.norm(position, axis=1, keepdims=True)
        facing = (pose.rotate(mesh.normals) * towards).sum(axis=1)
        pixel = camera.project(position).astype(np.float32)
        trusted = sampled(_trusted(each).astype(np.float32), pixel)
        seen = np.flatnonzero((facing > _LEAST_FACING) & (trusted > 0.99))
        seen = seen[rays.free(seen, pose.inverse().rotate(towards[seen]))]
        shown = np.zeros(len(pixel), np.float32)
        shown[seen] = facing[seen]
        rgb.append(sampled(each.frame.rgb, pixel))
        weight.append(shown)
        poses.append(pose)
    return SkinColours(
        rgb=np.stack(rgb), weight=np.stack(weight), vertices=mesh.vertices, camera_from_head=tuple(poses)
    )


def _trusted(each: LightFrame) -> Mask:
    """True well inside the silhouette, where no pixel is clipped."""
    kernel = np.ones((2 * _RIM_PX + 1, 2 * _RIM_PX + 1), np.uint8)
    inner = np.asarray(cv2.erode(each.mask.astype(np.uint8), kernel)) > 0
    clipped = np.asarray(cv2.dilate(each.frame.clipped.astype(np.uint8), np.ones((3, 3), np.uint8))) > 0
    return inner & ~clipped


def sample_head(
    mesh: Mesh,
    camera: Camera,
    frames: Iterable[LightFrame],
    steps: HeadSteps,
    rng: np.random.Generator,
) -> HeadSamples:
    """Take the colours of points of the mesh (head frame, with normals) in every frame that sees them.

    Raises `BadCalibration` where almost no point is seen unclipped.
    """
    assert mesh.normals is not None
    chosen = spread_over_orientations(mesh.normals, steps.light_points, rng)
    colours = skin_colours(mesh, camera, frames)
    frame, place = np.nonzero(colours.weight[:, chosen])
    if len(frame) < _FEWEST_SAMPLES:
        raise BadCalibration(
            f"light: only {len(frame)} unclipped samples of skin; expose so that the skin is bright but not "
            "white, and fill more of the picture"
        )
    point, poses = chosen[place], colours.camera_from_head
    turned = np.stack([pose.rotate(mesh.normals[chosen]) for pose in poses])
    pixel = np.stack([camera.project(pose.apply(mesh.vertices[chosen])) for pose in poses])
    return HeadSamples(
        point=point,
        frame=frame,
        normals_in_camera=turned[frame, place],
        rgb=colours.rgb[frame, point].astype(np.float64),
        position_px=pixel[frame, place],
        camera_from_head=poses,
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


_ROW = 1024  # OpenCV resamples images, no lists: points are laid out in rows


def sampled(image: Float32Array, pixel: FloatArray, outside: float = 0.0) -> Float32Array:
    """Return the image (h, w) or (h, w, c) at pixels (n, 2), bilinear."""
    count = len(pixel)
    padded = np.full((max(1, -(-count // _ROW)) * _ROW, 2), -9.0, np.float32)
    padded[:count] = pixel
    u, v = (np.ascontiguousarray(padded[:, k].reshape(-1, _ROW)) for k in range(2))
    sampled = cv2.remap(np.asarray(image), u, v, cv2.INTER_LINEAR, borderValue=outside)
    return np.asarray(sampled.reshape(-1, *image.shape[2:])[:count])
