"""The surfaces that the viewer shows of a result: each frame's own, the registered one, wires and colours."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum

import numpy as np
import numpy.typing as npt

from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.meshing.surface import MeshOptions, mesh_from_depth
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.report.pictures import picture_of_normals
from vntoolkit.report.thinning import ThinnedTemplate, thinned_template

_WIRE_VERTICES = 3000  # a wire a pixel would look solid
_CHECKS = (32, 24)  # cells across and down the template's picture
_CHECK_COLOURS = np.array([[0.85, 0.82, 0.78], [0.62, 0.13, 0.08]], np.float32)


class Look(Enum):
    """How the mesh is painted; plaster and checkerboard are lit by the light that one drags."""

    PLASTER = "relit plaster"
    CAPTURED = "captured colours"
    NORMALS = "normals"
    CHECKERBOARD = "checkerboard"


class Surface(Enum):
    """Before and after registration."""

    OWN = "of each frame"
    REGISTERED = "registered"


class ResultSurfaces:
    """Reads the meshes of an opened result, one frame at a time."""

    def __init__(self, result: OpenedResult) -> None:
        self._result = result
        self._thinned: ThinnedTemplate | None = None

    def kinds(self) -> list[Surface]:
        """Return which surfaces there are."""
        own, track = self._result.length_unit is not None, self._result.track is not None
        return [s for s, there in ((Surface.OWN, own), (Surface.REGISTERED, track)) if there]

    def mesh(self, number: int, surface: Surface) -> Mesh:
        """Return the surface in a frame; its own one where the registered one has none. Raises `BadInput`."""
        track = self._result.track
        if surface is Surface.REGISTERED and track is not None and number in track.numbers:
            return track.mesh(number)
        mesh = self._result.mesh(number)
        if mesh is not None:
            return mesh
        depth_map = self._result.depth(number)
        if depth_map is None:
            root = self._result.folder.root
            raise BadInput(f"{root}: frame {number} has no depth; run `vntoolkit reconstruct --to depth`")
        return mesh_from_depth(depth_map, self._result.camera)

    def wires(self, number: int, surface: Surface) -> Mesh:
        """Return a mesh coarse enough to see through."""
        track, depth_map = self._result.track, self._result.depth(number)
        if surface is Surface.REGISTERED and track is not None and number in track.numbers:
            if self._thinned is None:
                self._thinned = thinned_template(track.sequence.template, _WIRE_VERTICES)
            return replace(
                self._thinned.mesh, vertices=track.mesh(number).vertices[self._thinned.kept], normals=None
            )
        if depth_map is None:
            return self.mesh(number, surface)
        stride = max(1, int(np.ceil(np.sqrt(depth_map.mask.sum() / _WIRE_VERTICES))))
        return mesh_from_depth(depth_map, self._result.camera, options=MeshOptions(stride=stride))

    def colours(self, mesh: Mesh, number: int, surface: Surface, look: Look) -> npt.NDArray[np.float32]:
        """Return linear vertex colours; texture coordinates say which pixel of the picture a vertex shows."""
        camera, track = self._result.camera, self._result.track
        uv = mesh.uv
        if uv is None:  # meshes read back carry none: project
            pixels = camera.project(mesh.vertices)
            uv = np.stack([(pixels[:, 0] + 0.5) / camera.width, 1 - (pixels[:, 1] + 0.5) / camera.height], -1)
        if look is Look.CHECKERBOARD:
            cells = np.floor(np.asarray(uv) * _CHECKS).astype(int).sum(axis=1)
            return np.asarray(_CHECK_COLOURS[cells % 2])
        source = track.template if surface is Surface.REGISTERED and track is not None else number
        normal_map = self._result.normals(source)
        picture = self._result.picture(source) if look is Look.CAPTURED else None
        if picture is None:
            assert normal_map is not None
            picture = picture_of_normals(normal_map)
        u = np.clip(np.rint(uv[:, 0] * camera.width - 0.5).astype(int), 0, camera.width - 1)
        v = np.clip(np.rint((1 - uv[:, 1]) * camera.height - 0.5).astype(int), 0, camera.height - 1)
        return np.asarray((picture[v, u] / np.float32(255)) ** np.float32(2.2), dtype=np.float32)
