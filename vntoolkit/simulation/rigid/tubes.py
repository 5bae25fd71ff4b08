"""Tubes of cloth about a centre line, with cloth coordinates in metres and relief along the normal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from vntoolkit.arrays import Faces, FloatArray, Points
from vntoolkit.geometry.mesh import vertex_normals
from vntoolkit.simulation.grids import closed_columns, grid_faces, grid_uv


@dataclass(frozen=True, kw_only=True, eq=False)
class Tube:
    """A tube before its relief.

    vertices: (n, 3), row by row, from the first ring down. faces: (m, 3). uv: (m, 3, 2), u round, v along.
    s: (n,) metres round the tube from its front line, −half to half; t: (n,) metres along it.
    girth, length: its mean extent in metres.
    """

    vertices: Points
    faces: Faces
    uv: FloatArray
    s: FloatArray
    t: FloatArray
    girth: float
    length: float

    def raised(self, height: FloatArray) -> Points:
        """Return the vertices moved outwards by `height` (n,)."""
        return self.vertices + height[:, None] * vertex_normals(self.vertices, self.faces)


def tube_along(
    centres: FloatArray, across: FloatArray, forward: FloatArray, radii: FloatArray, spacing_m: float
) -> Tube:
    """Sweep ellipses along a curve given by control rows.

    centres: (k, 3). across, forward: (3,) unit vectors roughly square to the curve; the front line lies at
    `forward`. radii: (k, 2) half widths along across and forward. spacing_m: between vertices.
    """
    control = np.column_stack([centres, radii])
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(control[:, :4], axis=0), axis=1))])
    rows = round(knots[-1] / spacing_m) + 1
    at = np.linspace(0.0, knots[-1], rows)
    swept = PchipInterpolator(knots, control)(at)
    girth = float(2 * np.pi * np.sqrt(np.mean(np.square(radii))))
    columns = 2 * round(girth / spacing_m / 2)
    angle = (np.arange(columns) / columns - 0.5) * 2 * np.pi  # 0 in front, the cut at the back
    down = np.gradient(swept[:, :3], axis=0)
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    side = across - (down @ across)[:, None] * down
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    front = np.cross(side, down)
    front *= np.sign(front @ forward)[:, None]
    wide, deep = swept[:, 3, None, None], swept[:, 4, None, None]
    ring = (
        wide * np.sin(angle)[None, :, None] * side[:, None]
        + deep * np.cos(angle)[None, :, None] * front[:, None]
    )
    vertices = (swept[:, None, :3] + ring).reshape(-1, 3)
    return Tube(
        vertices=vertices,
        faces=grid_faces(closed_columns(rows, columns)),
        uv=grid_uv(rows, columns + 1),
        s=np.tile(angle / (2 * np.pi) * girth, rows),
        t=np.repeat(at, columns),
        girth=girth,
        length=float(knots[-1]),
    )
