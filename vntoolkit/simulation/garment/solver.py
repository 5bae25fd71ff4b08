"""A position-based cloth solver with compliant constraints and small steps (macklin2016, macklin2019).

The cloth is worn by a body of tapered capsules.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from vntoolkit.arrays import Faces, FloatArray, IntArray, Points, Points2, Vectors
from vntoolkit.geometry.mesh import edges_from_faces
from vntoolkit.native import njit
from vntoolkit.simulation.lights import FRAME_RATE_HZ

FRONT, BACK = 0, 1
_GRAVITY = 9.81
# the material of a heavy knit, and the numerics; tests bound the stretch and the distance to the body
THICKNESS_M = 0.010  # least distance of two layers
AIR_DRAG = 1.5  # 1/s
_DENSITY = 0.35  # kg/m²
_STRETCH_COMPLIANCE = 5e-4  # m/N of an edge; edges run in three directions, so they resist shear too
_BENDING_STIFFNESS, _RIB_STIFFENING = 1.5e-5, 12.0  # N m; times as much in the ribbing
_INNER_FRICTION = 0.02  # share of the velocity difference between neighbours that a step takes away
_BODY_MARGIN_M = 0.006  # least distance to the body
_BODY_FRICTION = 0.3  # tangential hold per depth of contact
_STEPS_PER_FRAME = 12  # small steps, one sweep over the constraints each


@dataclass(frozen=True, kw_only=True, eq=False)
class Garment:
    """A sewn garment at rest.

    flat: (n, 2) position in the pattern, metres; its metric gives every rest length.
    gather: (n,) factor on the rest lengths there, below 1 in the ribbing. panel: (n,) 0 on the front and on
    seams, 1 on the back. faces: (m, 3), counter-clockwise from outside.
    """

    flat: Points2
    gather: FloatArray
    panel: IntArray
    faces: Faces


@dataclass(frozen=True, kw_only=True, eq=False)
class Capsules:
    """Spheres swept from `starts` to `ends` (k, 3) with radii (k, 2) that change linearly; metres."""

    starts: Points
    ends: Points
    radii: FloatArray

    def signed_distance(self, points: Points) -> FloatArray:
        """Return (n,) the distance to the union's surface, negative inside."""
        return _signed_distances(
            np.ascontiguousarray(points, dtype=np.float64), self.starts, self.ends, self.radii
        )


@njit
def closest_capsule(
    x: float, y: float, z: float, starts: Points, ends: Points, radii: FloatArray
) -> tuple[int, float, float]:
    """Return the nearest capsule, the place along it from 0 to 1, and the signed distance to it."""
    best, best_along, best_distance = 0, 0.0, 1e9
    for k in range(len(starts)):
        ax, ay, az = ends[k, 0] - starts[k, 0], ends[k, 1] - starts[k, 1], ends[k, 2] - starts[k, 2]
        px, py, pz = x - starts[k, 0], y - starts[k, 1], z - starts[k, 2]
        along = (px * ax + py * ay + pz * az) / max(ax * ax + ay * ay + az * az, 1e-12)
        along = min(1.0, max(0.0, along))
        dx, dy, dz = px - along * ax, py - along * ay, pz - along * az
        radius = radii[k, 0] + along * (radii[k, 1] - radii[k, 0])
        distance = np.sqrt(dx * dx + dy * dy + dz * dz) - radius
        if distance < best_distance:
            best, best_along, best_distance = k, along, distance
    return best, best_along, best_distance


@njit
def _signed_distances(points: Points, starts: Points, ends: Points, radii: FloatArray) -> Vectors:
    distances = np.empty(len(points))
    for i in range(len(points)):
        _, _, distances[i] = closest_capsule(points[i, 0], points[i, 1], points[i, 2], starts, ends, radii)
    return distances


class ClothSolver:
    """Steps one garment through time; the state is `positions` and `velocities`, (n, 3) float64."""

    def __init__(
        self,
        garment: Garment,
        body: Capsules,
        thickness_m: float = THICKNESS_M,
    ) -> None:
        self.thickness_m = thickness_m
        self.positions = _drawn_over(garment, body, _BODY_MARGIN_M)
        self.velocities = np.zeros_like(self.positions)
        self.step_s = 1.0 / (FRAME_RATE_HZ * _STEPS_PER_FRAME)
        count = len(garment.flat)
        area = 0.5 * np.abs(_doubled_areas(garment)).sum()
        self.inverse_mass = count / (_DENSITY * area)
        self.edges = edges_from_faces(garment.faces).astype(np.int64)
        cut = np.linalg.norm(np.diff(garment.flat[self.edges], axis=1)[:, 0], axis=1)
        self._cut_lengths, self._gather = cut, garment.gather[self.edges].mean(axis=1)
        self.rest_lengths = cut
        self.hinges, self.stencils, areas = _hinges(garment)
        in_rib = garment.gather[self.hinges].mean(axis=1) < 1.0
        stiffness = _BENDING_STIFFNESS * np.where(in_rib, _RIB_STIFFENING, 1.0)
        self.hinge_compliance = areas / (6.0 * stiffness * self.step_s**2)
        self._near_in_rest = _neighbourhood(garment.faces, count, rings=3)

    def draw_ribbing(self, share: float) -> None:
        """Contract hem and cuffs from the cut (0) to their gathered length (1)."""
        self.rest_lengths = self._cut_lengths * (1.0 + share * (self._gather - 1.0))

    def settle(self, body: Capsules) -> None:
        """Step one frame without inertia: what was drawn over the body contracts without recoil."""
        self.advance(body, body, gravity=0.0)
        self.velocities *= 0.3

    def advance(self, body: Capsules, next_body: Capsules, gravity: float = 1.0) -> None:
        """Step one frame while the body moves evenly from one pose to the next."""
        x, v = self.positions, self.velocities
        pairs = self._close_pairs()
        starts_step = (next_body.starts - body.starts) / _STEPS_PER_FRAME
        ends_step = (next_body.ends - body.ends) / _STEPS_PER_FRAME
        compliance = _STRETCH_COMPLIANCE / self.step_s**2
        for step in range(1, _STEPS_PER_FRAME + 1):
            share = step / _STEPS_PER_FRAME
            starts, ends = body.starts + step * starts_step, body.ends + step * ends_step
            radii = body.radii + share * (next_body.radii - body.radii)
            v *= np.exp(-AIR_DRAG * self.step_s)
            v[:, 1] -= gravity * _GRAVITY * self.step_s
            before = x.copy()
            x += self.step_s * v
            project_edges(x, self.edges, self.rest_lengths, self.inverse_mass, compliance)
            project_hinges(x, self.hinges, self.stencils, self.hinge_compliance, self.inverse_mass)
            separate_pairs(x, pairs, self.thickness_m)
            collide(x, before, starts, ends, radii, starts_step, ends_step, _BODY_MARGIN_M, _BODY_FRICTION)
            v[:] = (x - before) / self.step_s
            damp_edges(v, self.edges, _INNER_FRICTION)

    def _close_pairs(self) -> IntArray:
        """Return (p, 2) the points that may touch within this frame though the cloth does not join them."""
        pairs = cKDTree(self.positions).query_pairs(1.5 * self.thickness_m, output_type="ndarray")
        keys = pairs.min(axis=1).astype(np.int64) * len(self.positions) + pairs.max(axis=1)
        place = np.minimum(np.searchsorted(self._near_in_rest, keys), len(self._near_in_rest) - 1)
        apart = self._near_in_rest[place] != keys
        order = np.argsort(keys[apart])
        return np.ascontiguousarray(pairs[apart][order])


def _drawn_over(garment: Garment, body: Capsules, margin: float) -> Points:
    """Return the two panels lying flat, moved forwards and backwards until they clear the body."""
    side = np.where(garment.panel == BACK, -1.0, 1.0)
    positions = np.column_stack([garment.flat, 0.002 * side]).astype(np.float64)
    for _ in range(200):
        depth = margin - body.signed_distance(positions)
        positions[:, 2] += np.clip(depth, 0.0, 0.01) * side
    return positions


def _doubled_areas(garment: Garment) -> FloatArray:
    a, b, c = (garment.flat[garment.faces[:, i]] for i in range(3))
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


def _hinges(garment: Garment) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return per inner edge its four vertices (edge, edge, opposite, opposite), their k_i, both areas."""
    faces = garment.faces.astype(np.int64)
    corner = np.concatenate([faces[:, [1, 2, 0]], faces[:, [2, 0, 1]], faces[:, [0, 1, 2]]])
    area = np.tile(0.5 * np.abs(_doubled_areas(garment)), 3)
    low, high = corner[:, :2].min(axis=1), corner[:, :2].max(axis=1)
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    first, second = order[:-1][same], order[1:][same]
    hinges = np.stack([low[first], high[first], corner[first, 2], corner[second, 2]], axis=1)
    x0, x1, x2, x3 = (garment.flat[hinges[:, i]] for i in range(4))
    c01, c02 = _cotangent(x0, x1, x2), _cotangent(x0, x1, x3)
    c03, c04 = _cotangent(x1, x0, x2), _cotangent(x1, x0, x3)
    stencils = np.stack([c03 + c04, c01 + c02, -c01 - c03, -c02 - c04], axis=1)
    return hinges, stencils, area[first] + area[second]


def _cotangent(apex: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the cotangent of the (unsigned) angle at `apex`."""
    a, b = first - apex, second - apex
    return np.sum(a * b, axis=1) / np.maximum(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), 1e-12)


def _neighbourhood(faces: Faces, count: int, rings: int) -> IntArray:
    """Return the sorted keys low * count + high of all pairs within that many edges of each other."""
    edges = edges_from_faces(faces).astype(np.int64)
    ones = np.ones(len(edges), dtype=np.int8)
    step = sparse.coo_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(count, count)).tocsr()
    step = ((step + step.T + sparse.eye(count)) > 0).astype(np.int32)
    reach = step
    for _ in range(rings - 1):
        reach = ((reach @ step) > 0).astype(np.int32)
    pairs = sparse.triu(reach, k=1).tocoo()
    return np.sort(pairs.row.astype(np.int64) * count + pairs.col)


# Compiled constraints, projected one after another (Gauss–Seidel).


@njit
def project_edges(
    x: Points, edges: IntArray, rest: FloatArray, inverse_mass: float, compliance: float
) -> None:
    """Bring every edge to its rest length. compliance: over dt² (macklin2016)."""
    share = inverse_mass / (2.0 * inverse_mass + compliance)
    count = len(edges)
    for sweep in range(2 * count):  # there and back, so that the order favours no direction
        e = sweep if sweep < count else 2 * count - 1 - sweep
        i, j = edges[e, 0], edges[e, 1]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        correction = share * (length - rest[e]) / max(length, 1e-9)
        x[i, 0] += correction * dx
        x[i, 1] += correction * dy
        x[i, 2] += correction * dz
        x[j, 0] -= correction * dx
        x[j, 1] -= correction * dy
        x[j, 2] -= correction * dz


@njit
def project_hinges(
    x: Points, hinges: IntArray, stencils: FloatArray, compliance: FloatArray, inverse_mass: float
) -> None:
    """Flatten every pair of triangles: the constraint is |Σ k_i x_i|, their mean curvature (bergou2006)."""
    for h in range(len(hinges)):
        cx, cy, cz, weight = 0.0, 0.0, 0.0, 0.0
        for c in range(4):
            k, i = stencils[h, c], hinges[h, c]
            cx += k * x[i, 0]
            cy += k * x[i, 1]
            cz += k * x[i, 2]
            weight += k * k
        share = inverse_mass / (inverse_mass * weight + compliance[h])
        for c in range(4):
            step, i = share * stencils[h, c], hinges[h, c]
            x[i, 0] -= step * cx
            x[i, 1] -= step * cy
            x[i, 2] -= step * cz


@njit
def separate_pairs(x: Points, pairs: IntArray, thickness: float) -> None:
    """Push two parts of the cloth apart that come closer than its thickness."""
    for p in range(len(pairs)):
        i, j = pairs[p, 0], pairs[p, 1]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        squared = dx * dx + dy * dy + dz * dz
        if squared < thickness * thickness and squared > 1e-16:
            push = 0.5 * (1.0 - thickness / np.sqrt(squared))
            x[i, 0] += push * dx
            x[i, 1] += push * dy
            x[i, 2] += push * dz
            x[j, 0] -= push * dx
            x[j, 1] -= push * dy
            x[j, 2] -= push * dz


@njit
def collide(
    x: Points,
    before: Points,
    starts: Points,
    ends: Points,
    radii: FloatArray,
    starts_step: Points,
    ends_step: Points,
    margin: float,
    friction: float,
) -> None:
    """Push points out of the body to `margin`; friction drags them along with the body's motion.

    starts_step, ends_step: how far the capsules' ends moved in this step.
    """
    for i in range(len(x)):
        k, along, distance = closest_capsule(x[i, 0], x[i, 1], x[i, 2], starts, ends, radii)
        depth = margin - distance
        if depth <= 0.0:
            continue
        n = np.empty(3)
        for a in range(3):
            n[a] = x[i, a] - (starts[k, a] + along * (ends[k, a] - starts[k, a]))
        n /= max(np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2), 1e-9)
        slip, normal_slip = np.empty(3), 0.0
        for a in range(3):
            x[i, a] += depth * n[a]
            body = starts_step[k, a] + along * (ends_step[k, a] - starts_step[k, a])
            slip[a] = x[i, a] - before[i, a] - body
            normal_slip += slip[a] * n[a]
        slip -= normal_slip * n
        length = np.sqrt(slip[0] ** 2 + slip[1] ** 2 + slip[2] ** 2)
        held = min(1.0, friction * depth / max(length, 1e-12))
        for a in range(3):
            x[i, a] -= held * slip[a]


@njit
def damp_edges(v: Points, edges: IntArray, share: float) -> None:
    """Take `share` of the velocity difference out of every edge: the yarn's inner friction."""
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        for a in range(3):
            change = 0.5 * share * (v[j, a] - v[i, a])
            v[i, a] += change
            v[j, a] -= change
