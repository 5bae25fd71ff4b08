"""Animated USD: one moving surface with its skeleton, or a new mesh every frame; streamed.

Vertices come in the camera frame (y down) and leave with y up, as every file, or z up. Houdini, Maya and
usdview take scale, up axis and frame rate from the file. Blender 5.0.1 takes scale, axis and the range of
frames but keeps the frame rate of its own scene, 24: set it there, or write the file at that rate, else the
motion plays too slowly. `scripts/check_in_blender.py` shows what arrives there.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import Points, read_only
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.mesh_sequence import MeshSequence
from vntoolkit.geometry.motion import Motion
from vntoolkit.io.conventions import UpAxis, graphics_from_camera
from vntoolkit.io.files import require_file
from vntoolkit.io.usd_material import add_colour_material
from vntoolkit.io.usd_skeleton import add_skeleton
from vntoolkit.io.usd_stage import ROOT, new_stage, vec3f_from_camera

SURFACE = f"{ROOT}/Surface"
FIGURE = f"{ROOT}/Figure"
CLOTH = f"{ROOT}/Cloth"


def write_usd_sequence(
    path: Path | str,
    template: Mesh,
    frames: Iterable[Points],
    *,
    frame_rate_hz: float,
    metres_per_unit: float = 1.0,
    motion: Motion | None = None,
    up: UpAxis = UpAxis.Y,
) -> int:
    """Write one surface of fixed topology, its vertices (n, 3) a time sample a frame; return the frames.

    Colours become `displayColor`, texture coordinates `st`. With `motion` (one frame a frame, in the same
    unit) the file also holds the skeleton as UsdSkel; the surface is not bound to it, its vertices move
    already. Memory does not grow with the number of frames.
    """
    if motion is not None and up is not UpAxis.Y:
        raise BadInput(f"{path}: a skeleton is written with y up only")
    count = 0
    with new_stage(path, frame_rate_hz=frame_rate_hz, metres_per_unit=metres_per_unit, up=up) as stage:
        mesh = _define_mesh(stage.stage)
        _set_topology(mesh, template, None)
        _set_attributes(mesh, template, None)
        if template.colours is not None:
            add_colour_material(stage.stage, CLOTH, mesh)
        if motion is not None:
            add_skeleton(stage.stage, FIGURE, motion)
        for count, vertices in enumerate(frames, start=1):
            require_shape(vertices, (len(template.vertices), 3), f"frame {count - 1}", BadMesh)
            require_finite(vertices, f"frame {count - 1}", BadMesh)
            stage.wrote(_set_points(mesh, vertices, float(count - 1), up))
    return count


def write_usd_meshes(
    path: Path | str,
    meshes: Iterable[Mesh],
    *,
    frame_rate_hz: float,
    metres_per_unit: float = 1.0,
    up: UpAxis = UpAxis.Y,
) -> int:
    """Write a mesh of its own topology for every frame; return the number of frames.

    Memory does not grow with the number of frames. Colours and texture coordinates are written where a
    mesh has them.
    """
    count = 0
    with new_stage(path, frame_rate_hz=frame_rate_hz, metres_per_unit=metres_per_unit, up=up) as stage:
        surface = _define_mesh(stage.stage)
        for count, mesh in enumerate(meshes, start=1):
            time = float(count - 1)
            size = _set_points(surface, mesh.vertices, time, up)
            size += _set_topology(surface, mesh, time)
            size += _set_attributes(surface, mesh, time)
            if mesh.colours is not None and not stage.stage.GetPrimAtPath(CLOTH):
                add_colour_material(stage.stage, CLOTH, surface)
            stage.wrote(size)
    return count


def _define_mesh(stage: Any) -> Any:
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh.Define(stage, SURFACE)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)  # else viewers smooth the capture away
    mesh.CreateDoubleSidedAttr(True)  # captured cloth is one layer, seen from both sides
    return mesh


def _time(time: float | None) -> Any:
    from pxr import Usd

    return Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)


def _set_points(mesh: Any, vertices: Points, time: float, up: UpAxis) -> int:
    """Author positions and their bounding box; return the bytes."""
    from pxr import Vt

    points = vec3f_from_camera(vertices, up)
    mesh.CreatePointsAttr().Set(points, time)
    box = np.zeros((2, 3))
    if len(vertices):
        columns = [vertices[:, axis] for axis in range(3)]  # numpy is ten times slower along the first axis
        ends = [[column.min() for column in columns], [column.max() for column in columns]]
        turned = graphics_from_camera(np.array(ends), up)
        box = np.stack([turned.min(axis=0), turned.max(axis=0)])  # turning swaps least and greatest
    mesh.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(box.astype(np.float32)), time)
    return len(vertices) * 12


def _set_topology(surface: Any, mesh: Mesh, time: float | None) -> int:
    from pxr import Vt

    counts = np.full(len(mesh.faces), 3, dtype=np.int32)
    surface.CreateFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(counts), _time(time))
    indices = np.ascontiguousarray(mesh.faces, dtype=np.int32).ravel()
    surface.CreateFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(indices), _time(time))
    return counts.nbytes + indices.nbytes


def _set_attributes(surface: Any, mesh: Mesh, time: float | None) -> int:
    """Author colours and texture coordinates where there are any; return the bytes."""
    from pxr import Sdf, UsdGeom, Vt

    size = 0
    primvars = UsdGeom.PrimvarsAPI(surface)
    if mesh.colours is not None:
        colours = np.ascontiguousarray(mesh.colours, dtype=np.float32)
        primvar = primvars.CreatePrimvar(
            "displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.vertex
        )
        primvar.Set(Vt.Vec3fArray.FromNumpy(colours), _time(time))
        size += colours.nbytes
    if mesh.uv is not None:
        uv = np.ascontiguousarray(mesh.uv, dtype=np.float32)
        primvar = primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
        primvar.Set(Vt.Vec2fArray.FromNumpy(uv), _time(time))
        size += uv.nbytes
    return size


def read_usd_sequence(path: Path | str) -> MeshSequence:
    """Read a surface that `write_usd_sequence` wrote, back in the camera frame, whole in memory.

    Raises `BadMesh` where the file is no USD, holds no frame or other polygons than triangles, or where its
    topology changes from frame to frame.
    """
    path = require_file(path, BadMesh)
    from pxr import Tf, Usd, UsdGeom

    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise BadMesh(f"{path}: cannot be read as USD") from error
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(SURFACE))
    if not mesh:
        raise BadMesh(f"{path}: expected a mesh at {SURFACE}: not a file of this toolkit")
    if mesh.GetFaceVertexIndicesAttr().GetNumTimeSamples():
        raise BadMesh(f"{path}: the topology changes from frame to frame: this is no registered surface")
    points, counts = mesh.GetPointsAttr(), np.array(mesh.GetFaceVertexCountsAttr().Get())
    frames = [np.array(points.Get(time)) for time in points.GetTimeSamples()]
    if len({frame.shape for frame in frames}) != 1 or not (counts == 3).all():
        raise BadMesh(f"{path}: expected a frame or more of one triangle mesh at {SURFACE}")
    vertices = graphics_from_camera(np.stack(frames))
    primvars = UsdGeom.PrimvarsAPI(mesh)
    colours, uv = (
        primvars.GetPrimvar(name).Get() if primvars.HasPrimvar(name) else None
        for name in ("displayColor", "st")
    )
    template = Mesh(
        vertices=vertices[0],
        faces=np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3),
        colours=None if colours is None else np.array(colours),
        uv=None if uv is None else np.array(uv),
    )
    return MeshSequence(
        template=template, vertices=read_only(vertices), frame_rate_hz=stage.GetTimeCodesPerSecond()
    )
