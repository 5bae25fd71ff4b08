"""Fewer vertices of a moving surface, the same ones in every frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import IntArray
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.native import import_open3d


@dataclass(frozen=True, kw_only=True, eq=False)
class ThinnedTemplate:
    """kept: indices of the vertices of the full template that remain, in the order of `mesh`."""

    kept: IntArray
    mesh: Mesh


def thinned_template(template: Mesh, largest: int) -> ThinnedTemplate:
    """Return at most about `largest` vertices of a template, cuts and borders kept.

    Quadric decimation chooses triangles; each of their corners then moves to the nearest true vertex, which
    has a position in every frame. Triangles that lose a corner by that are dropped.
    """
    count = len(template.vertices)
    if count <= largest:
        return ThinnedTemplate(kept=np.arange(count), mesh=template)
    o3d = import_open3d()
    plain = Mesh(vertices=template.vertices, faces=template.faces).to_open3d()
    target = max(4, round(len(template.faces) * largest / count))
    few = plain.simplify_quadric_decimation(target)
    tree = o3d.geometry.KDTreeFlann(plain)
    nearest = np.array([tree.search_knn_vector_3d(point, 1)[1][0] for point in few.vertices], dtype=np.int64)
    faces = nearest[np.asarray(few.triangles)]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    kept, renumbered = np.unique(faces, return_inverse=True)
    attributes = {
        name: None if getattr(template, name) is None else np.asarray(getattr(template, name))[kept]
        for name in ("normals", "colours", "uv")
    }
    mesh = replace(
        template,
        vertices=np.asarray(template.vertices)[kept],
        faces=renumbered.reshape(-1, 3).astype(np.int32),
        **attributes,
    )
    return ThinnedTemplate(kept=kept, mesh=mesh)
