"""Pictures of meshes without a graphics card: four rays a pixel by Open3D, one light at the camera's side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Colours, FloatArray, Points, Vector3
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rays import RayScene

BACKGROUND = (0.93, 0.94, 0.96)
PLAIN = (0.66, 0.65, 0.62)  # of a mesh without colours
_AMBIENT = 0.12
_ROOM = 1.15  # height of a picture over its subject's
_FINER = 2  # rays along each side of a pixel, averaged: smooth edges
_LIGHT = np.array([-0.35, -0.55, -0.76])  # from the surface, in the axes of the view (y down)
_DISPLAY_GAMMA = 1 / 2.2


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """An orthographic view. centre: (3,) point in the middle. height: of the picture, length units.

    azimuth_deg, elevation_deg: the viewer's place around the centre; 0, 0 looks along +z, as the camera does;
    90° looks from the figure's left (+x), positive elevation from above. width_px, height_px: picture size.
    """

    centre: Vector3
    height: float
    azimuth_deg: float = 0.0
    elevation_deg: float = 0.0
    width_px: int = 320
    height_px: int = 480

    @classmethod
    def around(cls, mesh: Mesh, width_px: int, height_px: int, **angles: float) -> View:
        """Return the view of these angles in which the mesh, unturned, fills the picture."""
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        width, height = (high - low)[:2]
        tall = _ROOM * max(float(height), float(width) * height_px / width_px)
        return cls(centre=(low + high) / 2, height=tall, width_px=width_px, height_px=height_px, **angles)

    @property
    def view_from_world(self) -> FloatArray:
        """(3, 3) rotation into the axes of the view: x right, y down, z away from the viewer."""
        a, e = np.deg2rad([self.azimuth_deg, self.elevation_deg])
        around = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        tilt = np.array([[1, 0, 0], [0, np.cos(e), -np.sin(e)], [0, np.sin(e), np.cos(e)]])
        return tilt @ around


def picture_of(meshes: Sequence[Mesh], view: View) -> npt.NDArray[np.uint8]:
    """Render meshes in the camera frame; returns (h, w, 3) uint8 RGB. Both sides of a face are lit."""
    turned = [(mesh.vertices - view.centre) @ view.view_from_world.T for mesh in meshes]
    scene = RayScene(*((vertices, mesh.faces) for vertices, mesh in zip(turned, meshes, strict=True)))
    finer = replace(view, width_px=_FINER * view.width_px, height_px=_FINER * view.height_px)
    hits = scene.first_hits(_rays(finer, turned).reshape(-1, 6))
    picture = np.tile(np.array(BACKGROUND, np.float32), (finer.height_px * finer.width_px, 1))
    for index, mesh in enumerate(meshes):
        seen = hits.surfaces == index
        corners = hits.barycentric[seen]
        shares = np.column_stack([1 - corners.sum(axis=1), corners])
        colours = _colours_at(mesh, mesh.faces[hits.faces[seen]], shares)
        picture[hits.rays[seen]] = _shaded(colours, hits.normals[seen])
    cells = picture.reshape(view.height_px, _FINER, view.width_px, _FINER, 3)
    return (np.clip(cells.mean(axis=(1, 3)), 0, 1) * 255 + 0.5).astype(np.uint8)


def _rays(view: View, turned: Sequence[Points]) -> npt.NDArray[np.float32]:
    nearest = min((float(vertices[:, 2].min()) for vertices in turned if len(vertices)), default=0.0)
    pixel = view.height / view.height_px
    u = (np.arange(view.width_px) - (view.width_px - 1) / 2) * pixel
    v = (np.arange(view.height_px) - (view.height_px - 1) / 2) * pixel
    rays = np.zeros((view.height_px, view.width_px, 6), dtype=np.float32)
    rays[..., 0], rays[..., 1] = np.meshgrid(u, v)
    rays[..., 2] = nearest - view.height
    rays[..., 5] = 1
    return rays


def _colours_at(mesh: Mesh, faces: npt.NDArray[np.int32], shares: FloatArray) -> Colours:
    if mesh.colours is None:
        return np.tile(np.array(PLAIN, np.float32), (len(faces), 1))
    return np.einsum("pk,pkc->pc", shares, mesh.colours[faces]).astype(np.float32)


def _shaded(colours: Colours, normals: Points) -> Colours:
    normals = np.where(normals[:, 2:3] > 0, -normals, normals)
    light = _LIGHT / np.linalg.norm(_LIGHT)
    brightness = _AMBIENT + (1 - _AMBIENT) * np.maximum(normals @ light, 0)
    return (np.clip(colours * brightness[:, None], 0, 1) ** _DISPLAY_GAMMA).astype(np.float32)


def capsules(starts: Points, ends: Points, radius: float, colour: tuple[float, float, float]) -> Mesh:
    """Return one mesh of eight-sided spindles from starts to ends, (b, 3) each: bones to look at."""
    sides = 8
    angles = 2 * np.pi * np.arange(sides) / sides
    vertices: list[Points] = []
    faces: list[list[int]] = []
    for start, end in zip(starts, ends, strict=True):
        axis = end - start
        across = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 * np.linalg.norm(axis) else [0, 1.0, 0])
        across /= np.linalg.norm(across)
        other = np.cross(axis, across) / np.linalg.norm(axis)
        ring = (
            start + 0.2 * axis + radius * (np.outer(np.cos(angles), across) + np.outer(np.sin(angles), other))
        )
        base = len(vertices) * (sides + 2)
        vertices.append(np.concatenate([ring, [start, end]]))
        for side in range(sides):
            here, there = base + side, base + (side + 1) % sides
            faces += [[here, there, base + sides + 1], [there, here, base + sides]]
    points = np.concatenate(vertices) if vertices else np.zeros((0, 3))
    return Mesh(
        vertices=points,
        faces=np.array(faces, dtype=np.int32).reshape(-1, 3),
        colours=np.tile(np.array(colour, np.float32), (len(points), 1)),
    )
