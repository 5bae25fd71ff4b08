"""Skinning weights of a garment by heat diffusion; removal of triangles that join sleeve and trunk."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from vntoolkit.arrays import Faces, FloatArray, IntArray, Mask, Points, Vector3
from vntoolkit.geometry.mesh import (
    Mesh,
    edge_cotangents,
    face_normals,
    factored,
    graph_laplacian,
    vertex_normals,
)
from vntoolkit.geometry.motion import Skeleton
from vntoolkit.options.dressing import Falloff, WeightOptions
from vntoolkit.skinning import weights as skin_weights
from vntoolkit.skinning.alignment import SleevedArm
from vntoolkit.skinning.blending import skinned_vertices
from vntoolkit.skinning.stretch import STRETCHED, edge_lengths, greatest_growth

_HOLD = 2.0  # heat that a vertex takes from its bone: 1 blends wider, 4 stretches arms raised high
_LEAST_COTANGENT, _MOST_COTANGENT = 0.01, 100.0  # a negative one could make a weight negative
_GUESSED = 1e-3  # how a vertex that covers no bone holds the nearest, beside one that covers its own
_NEAREST = 1e-2  # of the skeleton's height: nearer counts as this near
_CLOSER = 1 - 1e-9  # of the ball so far: bones meet at joints, where the first of them is taken


@dataclass(frozen=True, kw_only=True, eq=False)
class GarmentCover:
    """Which part of a garment covers what.

    sleeves: the arms that have one. trunk: (n,) what no arm may move. bones_from_pose: (j, 4, 4), takes the
    bones of an arm to where its sleeve has them; without sleeves, neither counts. bare: joints that the
    garment does not cover, such as of arms that have no sleeve; they move no cloth.
    """

    sleeves: tuple[SleevedArm, ...]
    trunk: Mask
    bones_from_pose: FloatArray
    bare: tuple[int, ...] = ()


_WITHOUT_SLEEVES = GarmentCover(sleeves=(), trunk=np.zeros(0, np.bool_), bones_from_pose=np.zeros((0, 4, 4)))


def weights_of_garment(
    garment: Mesh,
    skeleton: Skeleton,
    pose: FloatArray,
    options: WeightOptions,
    cover: GarmentCover = _WITHOUT_SLEEVES,
    stiffness: FloatArray | None = None,
) -> skin_weights.SkinWeights:
    """Weigh a garment, on the skeleton in the pose (j, 4, 4), by the rule that the options name.

    By bone heat, −Δw + H w = H p (baran2007), p is 1 where a vertex covers the bone, H is 2 / d² of its
    distance. The bone is the one on the inner side of the cloth, which a sheet seen from the front has too; a
    test of visibility would need a closed garment.

    Where sleeves are known, no arm moves the trunk below the armpits. First each vertex's share s of an arm:
    0 on the trunk, 1 on the arm's own cloth. Between them it is the one that stretches least when the arm
    turns: a point at ρ from the shoulder then moves by a length that grows with ρ, so that the cloth
    stretches by ρ |∇s|, and div(ρ² ∇s) = 0 makes its square least. On the shoulders the trunk takes hold by
    heat. Within its share each arm, and the rest of the body, weighs its bones by heat.

    stiffness: (n,) where it is greater, the share of an arm changes more slowly along the cloth.
    """
    if options.falloff is not Falloff.HEAT:
        return skin_weights.weights_from_distances(garment.vertices, skeleton, pose, options)
    allowed = set(skin_weights.attracting_joints(skeleton, options.exclude))
    sleeves = [one for one in cover.sleeves if allowed & set(one.arm.joints)]
    taken = {joint for one in sleeves for joint in one.arm.joints} | set(cover.bare)
    body = [joint for joint in range(len(skeleton.names)) if joint not in taken]
    joints, distances, hold = _own_bones(garment, skeleton, pose, options, body)
    even = np.ones(len(joints)) if stiffness is None else stiffness
    cloth = _Cloth.of(garment)
    shares = _arm_shares(garment.vertices, cloth, cover.trunk, sleeves, distances, even)
    left = 1.0 - shares.sum(axis=1)
    parts = [(left, *_spread_within(left > 0, cloth, joints, distances, hold))]
    for one, share in zip(sleeves, shares.T, strict=True):
        turning, *ends = skin_weights.attracting_bones(skeleton, pose, options.exclude, one.arm.joints)
        placed = cover.bones_from_pose[turning]
        bones = (
            turning,
            *(np.einsum("bij,bj->bi", placed[:, :3, :3], end) + placed[:, :3, 3] for end in ends),
        )
        nearest, gaps = skin_weights.nearest_joints(garment.vertices, *bones, count=1)
        gaps = np.maximum(gaps[:, 0], _least_distance(skeleton, bones[1]))
        sure = np.ones(len(gaps))
        parts.append((share, *_spread_within(share > 0, cloth, nearest[:, 0], gaps, sure)))
    used = np.concatenate([joints for _, joints, _ in parts])
    weights = np.concatenate([share[:, None] * within for share, _, within in parts], axis=1)
    return _heaviest(used, weights, options.bones)


def weights_without_web(
    garment: Mesh,
    skeleton: Skeleton,
    pose: FloatArray,
    options: WeightOptions,
    *,
    poses: FloatArray,
    max_stretch: float,
    cover: GarmentCover = _WITHOUT_SLEEVES,
) -> tuple[skin_weights.SkinWeights, Faces]:
    """Weigh a garment, see where the poses (f, j, 4, 4) overstretch it, and weigh again; return what is left.

    Where cloth is stretched, it is made stiffer by the square of its stretch, so that the shares of the arms
    change more slowly there, and cloth beside it takes its part. A triangle is web where two parts of the
    garment meet, each mostly one bone's, and a pose stretches an edge of it beyond `max_stretch`: cloth never
    bears that, so the capture joined what only touched. Weights by distance know no triangles: they would
    stay, web and all, so nothing is cut for them, nor at 0.
    """
    weights = weights_of_garment(garment, skeleton, pose, options, cover)
    faces = garment.faces
    if options.falloff is not Falloff.HEAT or not max_stretch:
        return weights, faces
    growth, longest = np.ones(len(faces)), edge_lengths(garment.vertices, faces)
    for now in poses:
        moved = skinned_vertices(garment.vertices, weights, now, pose)
        growth = np.maximum(growth, greatest_growth(moved, faces, longest))
    heaviest = weights.joints[np.arange(len(weights.joints)), weights.weights.argmax(axis=1)]
    web = (growth > max_stretch) & (np.ptp(heaviest[faces], axis=1) > 0)
    if not web.any() and not (cover.sleeves and growth.max(initial=1.0) > STRETCHED):
        return weights, faces
    most = np.ones(len(garment.vertices))
    np.maximum.at(most, faces.ravel(), np.repeat(np.minimum(growth, max_stretch), 3))
    left = Mesh(vertices=garment.vertices, faces=faces[~web])
    return weights_of_garment(left, skeleton, pose, options, cover, most**2), left.faces


def _arm_shares(
    vertices: Points,
    cloth: _Cloth,
    trunk: Mask,
    sleeves: Sequence[SleevedArm],
    distances: FloatArray,
    stiffness: FloatArray,
) -> FloatArray:
    """Return (n, arms): how much each vertex follows an arm. distances: (n,) to the bones of the rest."""
    if not sleeves:
        return np.zeros((len(distances), 0))
    beyond = np.column_stack([one.own_cloth for one in sleeves])
    on_sleeve = np.isfinite([one.sleeve.along for one in sleeves]).any(axis=0)
    shares = beyond.astype(np.float64)
    free = ~trunk & ~beyond.any(axis=1)
    if not free.any():
        return shares
    held = np.where(on_sleeve, 1e-9, _HOLD) * cloth.areas / distances**2
    for arm, one in enumerate(sleeves):
        turning = np.linalg.norm(vertices - one.shoulder, axis=1)
        stiff = stiffness * turning**2
        matrix = sp.csr_array(cloth.laplacian(stiff) + sp.diags_array(held * turning**2))
        sources = -(matrix[free][:, ~free] @ shares[~free, arm])
        shares[free, arm] = np.clip(factored(matrix[free][:, free]).solve(sources), 0.0, 1.0)
    return shares / np.maximum(shares.sum(axis=1, keepdims=True), 1.0)


def _spread_within(
    inside: Mask, cloth: _Cloth, joints: IntArray, distances: FloatArray, hold: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Let heat spread over a part (n,) of the garment alone; elsewhere the shares are 0."""
    used, within = _spread(cloth.part(inside), joints[inside], distances[inside], hold[inside])
    shares = np.zeros((len(inside), len(used)))
    shares[inside] = within
    return used, shares


def _spread(
    cloth: _Cloth, joints: IntArray, distances: FloatArray, hold: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Let heat spread from each vertex's joint, (n,); return the joints and their shares (n, used)."""
    used, column = np.unique(joints, return_inverse=True)
    if len(used) == 1:
        return used, np.ones((len(joints), 1))
    heat = _HOLD * hold * cloth.areas / distances**2
    sources = np.zeros((len(joints), len(used)))
    sources[np.arange(len(joints)), column] = heat
    solved = factored(cloth.laplacian() + sp.diags_array(heat)).solve(sources)
    return used, np.maximum(solved, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Cloth:
    """Areas (m,) of faces (m, 3), pairs (3 m, 2) as `edge_cotangents` has, weights: half cotangents."""

    count: int
    faces: Faces
    area: FloatArray
    pairs: IntArray
    weights: FloatArray

    @classmethod
    def of(cls, garment: Mesh) -> _Cloth:
        pairs, cosines, sines = edge_cotangents(garment.vertices, garment.faces)
        cotangents = np.nan_to_num(cosines / np.maximum(sines, 1e-300))
        return cls(
            count=len(garment.vertices),
            faces=garment.faces,
            area=np.linalg.norm(face_normals(garment.vertices, garment.faces), axis=1) / 2,
            pairs=pairs,
            weights=0.5 * np.clip(cotangents, _LEAST_COTANGENT, _MOST_COTANGENT),
        )

    def part(self, inside: Mask) -> _Cloth:
        """Return the cloth of some vertices (n,), with the faces between them."""
        place, kept = np.cumsum(inside) - 1, inside[self.faces].all(axis=1)
        return _Cloth(
            count=int(inside.sum()),
            faces=place[self.faces[kept]].astype(np.int32),
            area=self.area[kept],
            pairs=place[self.pairs[np.tile(kept, 3)]],
            weights=self.weights[np.tile(kept, 3)],
        )

    @cached_property
    def areas(self) -> FloatArray:
        """(n,): a third of the faces around each vertex, never 0."""
        shares = np.bincount(self.faces.ravel(), np.repeat(self.area / 3, 3), self.count)
        return np.maximum(shares, 1e-9 * (shares.mean() or 1.0))  # a vertex without area keeps to its bone

    def laplacian(self, stiffness: FloatArray | None = None) -> sp.csr_array:
        """Return the cotangent Laplacian (n, n); stiffness: (n,), of the cloth about each vertex."""
        weights = self.weights
        if stiffness is not None:
            weights = weights * stiffness[self.pairs].mean(axis=1)
        return graph_laplacian(self.pairs, self.count, weights)


def _own_bones(
    garment: Mesh,
    skeleton: Skeleton,
    pose: FloatArray,
    options: WeightOptions,
    among: Collection[int] | None = None,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return for every vertex its joint, the distance to it, and how sure that is, (n,) each."""
    bones = skin_weights.attracting_bones(skeleton, pose, options.exclude, among)
    normals = vertex_normals(garment.vertices, garment.faces)
    joints, distances = covered_bones(garment.vertices, normals, *bones)
    lost = joints < 0
    if lost.any():
        guessed, gaps = skin_weights.nearest_joints(garment.vertices[lost], *bones, count=1)
        joints[lost], distances[lost] = guessed[:, 0], gaps[:, 0]
    floor = _least_distance(skeleton, bones[1])
    return joints, np.maximum(distances, floor), np.where(lost, _GUESSED, 1.0)


def _least_distance(skeleton: Skeleton, starts: Points) -> float:
    return _NEAREST * max(skeleton.height, float(np.linalg.norm(np.ptp(starts, axis=0))))


def _heaviest(joints: IntArray, weights: FloatArray, count: int) -> skin_weights.SkinWeights:
    """Keep the `count` heaviest bones less the weight of the next, so that none drops out (franke1980)."""
    order = np.argsort(-weights, axis=1, kind="stable")[:, : count + 1]
    kept: Points = np.take_along_axis(weights, order, axis=1)
    if order.shape[1] > count:
        order, kept = order[:, :-1], kept[:, :-1] - kept[:, -1:]
        kept[kept.sum(axis=1) <= 0] = 1.0
    return skin_weights.SkinWeights(
        joints=joints[order].astype(np.int32), weights=kept / kept.sum(axis=1, keepdims=True)
    )


# The bone under a vertex: the first one met by a ball that grows on the inner side of the cloth.


def covered_bones(
    vertices: Points, normals: Points, joints: IntArray, starts: Points, ends: Points
) -> tuple[IntArray, FloatArray]:
    """Return the joint that each vertex covers (n,), −1 for none, and its distance to that bone (n,), inf.

    vertices, normals: (n, 3), outward. joints, starts, ends: bones as `bone_segments` gives them. The ball
    touches the cloth at the vertex from within, so |p − v|² / (2 n·(v − p)) is its radius when it reaches
    a point p: a flank covers the spine, although an arm that hangs beside it is nearer.
    """
    covered, distances = np.full(len(vertices), -1, np.int32), np.full(len(vertices), np.inf)
    least = np.full(len(vertices), np.inf)
    for joint, start, end in zip(joints, starts, ends, strict=True):
        radius, along = _ball_radius(vertices, normals, start, end)
        met = radius < _CLOSER * least
        least[met], covered[met] = radius[met], joint
        feet = start + along[met, None] * (end - start)
        distances[met] = np.linalg.norm(feet - vertices[met], axis=1)
    return covered, distances


def _ball_radius(
    vertices: Points, normals: Points, start: Vector3, end: Vector3
) -> tuple[FloatArray, FloatArray]:
    """Minimise (A t² + 2 B t + C) / (2 (D + E t)) over 0 ≤ t ≤ 1; convex where D + E t > 0; (n,) each."""
    bone, away = end - start, start - vertices
    a, b, c = bone @ bone, away @ bone, np.sum(away * away, axis=1)
    d, e = -np.sum(normals * away, axis=1), -(normals @ bone)
    # The derivative vanishes where A E t² + 2 A D t + 2 B D − E C = 0, or B / A behind it where E = 0.
    level = np.abs(e) < 1e-12 * np.sqrt(a)
    root = np.sqrt(np.maximum(a * a * d * d - a * e * (2 * b * d - e * c), 0.0))
    twice = np.where(level, 1.0, a * e)
    least, place = np.full(len(vertices), np.inf), np.zeros(len(vertices))
    for t in (
        np.zeros(len(vertices)),
        np.ones(len(vertices)),
        np.where(level, -b / a, (root - a * d) / twice),
        np.where(level, -b / a, -(root + a * d) / twice),
    ):
        depth = d + e * t
        radius = np.where(
            (t >= 0) & (t <= 1) & (depth > 0),
            (a * t * t + 2 * b * t + c) / np.where(depth > 0, 2 * depth, 1),
            np.inf,
        )
        place, least = np.where(radius < least, t, place), np.minimum(radius, least)
    return least, place
