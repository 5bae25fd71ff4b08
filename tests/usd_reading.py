"""Reads back a surface that `write_usd_sequence` wrote."""

from pathlib import Path

import numpy as np

from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.maps_and_meshes.usd import SURFACE


def read_usd_sequence(path: Path) -> MeshSequence:
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(SURFACE))
    assert mesh
    assert not mesh.GetFaceVertexIndicesAttr().GetNumTimeSamples()
    assert set(mesh.GetFaceVertexCountsAttr().Get()) == {3}
    points = mesh.GetPointsAttr()
    vertices = graphics_from_camera(np.stack([np.array(points.Get(t)) for t in points.GetTimeSamples()]))
    primvars = UsdGeom.PrimvarsAPI(mesh)
    colours, uv = (
        np.array(primvars.GetPrimvar(name).Get()) if primvars.GetPrimvar(name).HasValue() else None
        for name in ("displayColor", "st")
    )
    template = Mesh(
        vertices=vertices[0],
        faces=np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3),
        colours=colours,
        uv=uv,
    )
    return MeshSequence(template=template, vertices=vertices, frame_rate_hz=stage.GetTimeCodesPerSecond())


def complaints(path: Path) -> list[str]:
    """Return what USD's own validator finds wrong."""
    from pxr import Usd, UsdValidation

    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    return [error.GetMessage() for error in context.Validate(Usd.Stage.Open(str(path)))]
