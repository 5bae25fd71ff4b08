"""Smooth implicit bodies: ellipsoids and tapered capsules blended one after another.

Each part is added to, or carved from, what came before with a polynomial smooth minimum (quilez2013); its
width is the part's blend. Distances are approximate away from the surface and exact in sign.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import Faces, FloatArray, IntArray, Points
from vntoolkit.geometry.mesh import isosurface
from vntoolkit.native import njit

_ELLIPSOID, _CAPSULE = 0, 1
_SKIP_SHARE = 0.6  # an ellipsoid's approximate distance may fall below the true one by this much


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """One piece of a body, in the body's length unit.

    numbers: of an ellipsoid its centre, radii and rotation vector; of a capsule its start, end, both radii
    and a 0. blend: how far it melts into the rest; negative carves it out.
    """

    kind: int
    numbers: tuple[float, ...]
    blend: float

    def mirrored(self) -> "Part":
        """Return the part on the other side of the plane x = 0."""
        n = self.numbers
        if self.kind == _CAPSULE:
            numbers = (-n[0], n[1], n[2], -n[3], n[4], n[5], *n[6:])
        else:
            numbers = (-n[0], n[1], n[2], *n[3:6], n[6], -n[7], -n[8])
        return Part(kind=self.kind, numbers=numbers, blend=self.blend)


def ellipsoid(
    centre: tuple[float, float, float],
    radii: tuple[float, float, float],
    blend: float,
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Part:
    """Return an ellipsoid turned by the rotation vector `turn`, radians."""
    return Part(kind=_ELLIPSOID, numbers=(*centre, *radii, *turn), blend=blend)


def capsule(
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    radii: tuple[float, float],
    blend: float,
) -> Part:
    """Return a tapered capsule."""
    return Part(kind=_CAPSULE, numbers=(*start, *end, *radii, 0.0), blend=blend)


def both_sides(*parts: Part) -> list[Part]:
    """Return the parts and their mirror images, pair by pair."""
    return [side for part in parts for side in (part, part.mirrored())]


@dataclass(frozen=True, kw_only=True, eq=False)
class ImplicitBody:
    """The table of parts in the form that the kernel reads."""

    kinds: IntArray
    numbers: FloatArray
    rotations: FloatArray
    blends: FloatArray
    bounds: FloatArray

    @classmethod
    def from_parts(cls, parts: list[Part]) -> "ImplicitBody":
        """Collect the parts, in the order in which they are blended."""
        numbers = np.array([part.numbers for part in parts], dtype=np.float64)
        return cls(
            kinds=np.array([part.kind for part in parts], dtype=np.int64),
            numbers=numbers,
            rotations=np.stack([_rotation(row[6:9]) if part.kind == _ELLIPSOID else np.eye(3)
                                for part, row in zip(parts, numbers, strict=True)]),
            blends=np.array([part.blend for part in parts], dtype=np.float64),
            bounds=np.array([_bound(part) for part in parts], dtype=np.float64),
        )  # fmt: skip

    def signed_distance(self, points: Points) -> FloatArray:
        """Return (n,) about the distance to the surface, negative inside."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        return _distances(points, self.kinds, self.numbers, self.rotations, self.blends, self.bounds)

    def gradient(self, points: Points, step: float) -> Points:
        """Return (n, 3) the outward gradient by differences over the corners of a tetrahedron."""
        corners = np.array([[1.0, -1.0, -1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, 1.0, 1.0]])
        values = np.stack([self.signed_distance(points + step * corner) for corner in corners], axis=1)
        return values @ corners / (4.0 * step)


def _bound(part: Part) -> FloatArray:
    """Return (4,) centre and radius of a sphere round the part."""
    n = np.array(part.numbers)
    if part.kind == _ELLIPSOID:
        return np.append(n[:3], n[3:6].max())
    return np.append((n[:3] + n[3:6]) / 2, np.linalg.norm(n[3:6] - n[:3]) / 2 + n[6:8].max())


def _rotation(vector: FloatArray) -> FloatArray:
    """Return body_from_part (3, 3) of a rotation vector."""
    return Rotation.from_rotvec(vector).as_matrix()


@njit(cache=True)
def _distances(
    points: Points,
    kinds: IntArray,
    numbers: FloatArray,
    rotations: FloatArray,
    blends: FloatArray,
    bounds: FloatArray,
) -> FloatArray:
    distances = np.empty(len(points))
    for i in range(len(points)):
        total = 1e9
        for k in range(len(kinds)):
            away = 0.0
            for a in range(3):
                away += (points[i, a] - bounds[k, a]) ** 2
            reach = total if blends[k] >= 0.0 else -total
            if _SKIP_SHARE * (np.sqrt(away) - bounds[k, 3]) > reach + abs(blends[k]):
                continue  # too far to touch the blend
            if kinds[k] == _ELLIPSOID:
                part = _ellipsoid_distance(points[i], numbers[k], rotations[k])
            else:
                part = _capsule_distance(points[i], numbers[k])
            width = abs(blends[k])
            if blends[k] < 0.0:  # carve: a smooth maximum with the part's outside
                total = -_smooth_minimum(-total, part, width)
            else:
                total = _smooth_minimum(total, part, width)
        distances[i] = total
    return distances


@njit(cache=True)
def _smooth_minimum(a: float, b: float, width: float) -> float:
    h = max(width - abs(a - b), 0.0) / max(width, 1e-9)
    return min(a, b) - 0.25 * h * h * width


@njit(cache=True)
def _ellipsoid_distance(p: FloatArray, n: FloatArray, rotation: FloatArray) -> float:
    scaled, squared = 0.0, 0.0
    for a in range(3):
        q = 0.0
        for c in range(3):
            q += rotation[c, a] * (p[c] - n[c])
        q /= n[3 + a]
        scaled += q * q
        squared += (q / n[3 + a]) ** 2
    length = np.sqrt(scaled)
    return length * (length - 1.0) / max(np.sqrt(squared), 1e-9) if length > 1e-9 else -min(n[3], n[4], n[5])


@njit(cache=True)
def _capsule_distance(p: FloatArray, n: FloatArray) -> float:
    along, squared = 0.0, 0.0
    for a in range(3):
        axis = n[3 + a] - n[a]
        along += (p[a] - n[a]) * axis
        squared += axis * axis
    along = min(1.0, max(0.0, along / max(squared, 1e-12)))
    distance = 0.0
    for a in range(3):
        distance += (p[a] - n[a] - along * (n[3 + a] - n[a])) ** 2
    return np.sqrt(distance) - (n[6] + along * (n[7] - n[6]))


# A triangle mesh of a body: an isosurface, smoothed and pulled onto the surface in turns.


_ROUNDS = 3  # of smoothing and pulling back
_COARSE = 4  # cells of the search grid per side, in cells of the mesh


def mesh_from_implicit(
    body: ImplicitBody, low: FloatArray, high: FloatArray, cell: float
) -> tuple[Points, Faces]:
    """Return vertices (n, 3) and outward faces (m, 3) of the surface inside the box, cells of size `cell`."""
    counts = _COARSE * np.ceil((np.asarray(high) - low) / (_COARSE * cell)).astype(int) + 1
    values = _values_near_surface(body, np.asarray(low, dtype=np.float64), counts, cell)
    vertices, faces = isosurface(-values)
    vertices = low + cell * vertices
    for _ in range(_ROUNDS):
        vertices = _pull_onto_surface(body, _relaxed(vertices, faces), cell)
    return _pull_onto_surface(body, vertices, cell), faces


def _relaxed(vertices: Points, faces: Faces) -> Points:
    """Return every vertex moved half-way to the mean of its neighbours; a rim stays where it is."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = np.sort(edges, axis=1).astype(np.int64) @ [len(vertices), 1]
    _, place, times = np.unique(key, return_inverse=True, return_counts=True)
    count = np.bincount(edges[:, 0], minlength=len(vertices))
    mean = (
        np.stack(
            [np.bincount(edges[:, 0], vertices[edges[:, 1], a], minlength=len(vertices)) for a in range(3)],
            axis=1,
        )
        / np.maximum(count, 1)[:, None]
    )
    on_rim = np.zeros(len(vertices), dtype=bool)
    on_rim[edges[times[place] == 1]] = True
    return np.where(on_rim[:, None], vertices, 0.5 * (vertices + mean))


def _pull_onto_surface(body: ImplicitBody, vertices: Points, cell: float) -> Points:
    """Return the vertices after one Newton step along the gradient."""
    slope = body.gradient(vertices, 0.25 * cell)
    step = body.signed_distance(vertices) / np.maximum(np.sum(slope**2, axis=1), 0.1)
    return vertices - np.clip(step, -cell, cell)[:, None] * slope


def _values_near_surface(body: ImplicitBody, low: FloatArray, counts: IntArray, cell: float) -> FloatArray:
    """Return the grid of signed distances, in cells; exact only in blocks that the surface can cross."""
    blocks = (counts - 1) // _COARSE
    centres = _grid(blocks) * (_COARSE * cell) + low + 0.5 * _COARSE * cell
    distance = body.signed_distance(centres) / cell
    values = np.empty(tuple(counts))
    near = np.flatnonzero(np.abs(distance) < 1.3 * _COARSE)
    coarse = np.kron(distance.reshape(blocks), np.ones((_COARSE,) * 3))
    values[:-1, :-1, :-1] = coarse
    values[-1], values[:, -1], values[:, :, -1] = values[-2], values[:, -2], values[:, :, -2]
    corner = np.stack(np.unravel_index(near, blocks), axis=1) * _COARSE
    nodes = (corner[:, None] + _grid(np.full(3, _COARSE + 1)).astype(int)).reshape(-1, 3)
    flat = np.unique(np.ravel_multi_index(tuple(nodes.T), tuple(counts)))
    places = np.stack(np.unravel_index(flat, tuple(counts)), axis=1)
    values.ravel()[flat] = body.signed_distance(low + cell * places) / cell
    return values


def _grid(counts: IntArray) -> Points:
    return np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), -1).reshape(-1, 3) * 1.0
