"""How sure the positions of stereo and the normals of the skin are, measured on the head itself."""

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Points
from vntoolkit.calibration.head.positions import areas
from vntoolkit.calibration.head.skin import SkinNormals
from vntoolkit.geometry.mesh import Mesh

PATCH_PX = 16.0  # side: larger than the windows of stereo blur, smaller than a nose
SHARED_NOISE = 0.03  # rad, of all normals: what errors of M and of poses left on a scanned head
LEAST_SEEN = 0.5  # of a patch's area, in a frame
_MEDIAN_OF_ONE, _MEDIAN_OF_TWO = 0.455, 0.693  # of χ² with so many components, over its mean


def measured_noise(mesh: Mesh, stereo: Points, skin: SkinNormals, pixel: float) -> tuple[float, float]:
    """Measure on the refined mesh how sure stereo and normals are: density and shared error.

    What patches of skin were moved by is stereo's noise; its density is the variance times the area over
    which it is the same, length units⁴. What the mean of their normals still turns from the mesh's is the
    error, in radians, that normals of a region share.
    """
    assert mesh.normals is not None
    area = np.where(np.isfinite(skin.noise), areas(stereo, mesh.faces), 0.0)

    def mean_square(values: FloatArray, side: float) -> float:
        patch, _ = patches_of(mesh, side)
        total = np.bincount(patch, area)
        kept = total > LEAST_SEEN * side**2
        means = [np.bincount(patch, area * column)[kept] / total[kept] for column in values.T]
        return float(np.median(np.square(means).sum(axis=0))) if kept.any() else 0.0

    moved = ((mesh.vertices - stereo) * mesh.normals).sum(axis=1)
    side = PATCH_PX * pixel
    density = mean_square(moved[:, None], side) / _MEDIAN_OF_ONE * side**2
    shared = mean_square(skin.normals - mesh.normals, 3.0 * side) / _MEDIAN_OF_TWO
    return density, float(np.sqrt(max(shared, SHARED_NOISE**2)))


def patches_of(mesh: Mesh, side: float) -> tuple[IntArray, IntArray]:
    """Return the patch of every vertex (n,), of one cube and one side of the head, and a vertex of each."""
    assert mesh.normals is not None
    axis = np.abs(mesh.normals).argmax(axis=1)
    sign = np.take_along_axis(mesh.normals, axis[:, None], axis=1)[:, 0] > 0
    cells = np.column_stack([np.round(mesh.vertices / side).astype(np.int64), 2 * axis + sign])
    _, first, patch = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    return patch.ravel(), first


def mean_edge(mesh: Mesh) -> float:
    """Return the mean length of an edge."""
    corners = mesh.vertices[mesh.faces]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())
