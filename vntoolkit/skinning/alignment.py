"""Arms in their sleeves: the pose of attachment, and the way of every captured frame into that pose.

Rest poses differ between files, and so do the proportions of bodies. Each arm is turned bone by bone onto
the axis of its sleeve, and the cloth over a bone is stretched along it to the bone's length. The cloth over
each bone moved in the capture as well; its rigid motion is taken out, so that the arm of the figure alone
moves the sleeve.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import Faces, FloatArray, IntArray, Mask, Points, Vector3
from vntoolkit.geometry.mesh import edges_from_faces
from vntoolkit.geometry.motion import Skeleton
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.dressing import Anchor
from vntoolkit.skinning.anatomy import Anatomy, Arm, longest_bone_of
from vntoolkit.skinning.blending import blended_vertices
from vntoolkit.skinning.sleeves import Sleeve
from vntoolkit.skinning.stretch import drawn_together
from vntoolkit.skinning.weights import SkinWeights

_LONG = 0.6  # of the arm: sleeves that end before that are short, and stay so
_MOST_REACH = 0.95  # of a sleeve's length: its cuff follows the arm alone
_STRETCH = (0.5, 2.0)  # a sleeve that differs more from its arm was not made for such a body


@dataclass(frozen=True, kw_only=True, eq=False)
class SleevedArm:
    """An arm with its sleeve, on the figure.

    turns: joint → (3, 3) in the axes of the figure, for the upper arm, then for the forearm. elbow, wrist:
    (3,) where the sleeve has them; rest_elbow, rest_wrist: where the turned arm does. elbow_along: how far
    the elbow is from the armhole. is_short: the sleeve ends before the wrist.
    """

    arm: Arm
    sleeve: Sleeve
    shoulder: Vector3
    elbow: Vector3
    wrist: Vector3
    rest_elbow: Vector3
    rest_wrist: Vector3
    elbow_along: float
    is_short: bool

    def transforms(self, skeleton: Skeleton) -> dict[int, FloatArray]:
        """Return joint → (4, 4): what takes the cloth over it from the sleeve to the arm."""
        upper = _along_bone(self.shoulder, self.elbow, self.shoulder, self.rest_elbow)
        fore = _along_bone(self.elbow, self.wrist, self.rest_elbow, self.rest_wrist)
        hand = RigidTransform(translation=self.rest_wrist - self.wrist).matrix
        groups = self.arm.moved_with(skeleton)
        return {
            joint: matrix
            for joints, matrix in zip(groups, (upper, fore, hand), strict=True)
            for joint in joints
        }

    @property
    def own_cloth(self) -> Mask:
        """(n,) which cloth of the sleeve follows the arm alone: beyond the elbow, and farther than the armpit
        is from the shoulder, for over less cloth than that a raised arm would stretch it to a web.
        """
        depth = float(np.linalg.norm(self.sleeve.armpit - self.shoulder))
        reach = min(max(self.elbow_along, depth), _MOST_REACH * self.sleeve.length)
        return np.asarray(self.sleeve.along >= reach)


def arms_in_sleeves(
    arms: Sequence[Arm], sleeves: Sequence[Sleeve], skeleton: Skeleton, pose: FloatArray
) -> tuple[SleevedArm, ...]:
    """Lay each arm into the sleeve on its side: elbow and wrist on the axis, the wrist at the cuff.

    pose: (j, 4, 4), in which the shoulders stay. The elbow divides the way from the shoulder to the cuff as
    it divides the arm. Sleeves are long or short together: one that comes forwards only looks short.
    """
    pairs = [(arm, sleeve) for arm in arms for sleeve in sleeves if arm.side == sleeve.side]
    ways = [_way(arm, sleeve, skeleton, pose) for arm, sleeve in pairs]
    shares = [
        (gap + sleeve.length - start) / length
        for (_, sleeve), (start, gap, length) in zip(pairs, ways, strict=True)
    ]
    is_short = bool(pairs) and float(np.mean(shares)) < _LONG
    return tuple(
        _arm_in_sleeve(arm, sleeve, skeleton, pose, way, is_short)
        for (arm, sleeve), way in zip(pairs, ways, strict=True)
    )


def _way(arm: Arm, sleeve: Sleeve, skeleton: Skeleton, pose: FloatArray) -> tuple[float, float, float]:
    """Return where along the sleeve the shoulder is nearest, how far it is from there, the arm's length."""
    shoulder, elbow, wrist = arm.points(skeleton, pose)
    gaps = np.linalg.norm(sleeve.axis - shoulder, axis=1)
    nearest = int(np.argmin(gaps))
    length = float(np.linalg.norm(elbow - shoulder) + np.linalg.norm(wrist - elbow))
    return float(sleeve.stations[nearest]), float(gaps[nearest]), length


def _arm_in_sleeve(
    arm: Arm,
    sleeve: Sleeve,
    skeleton: Skeleton,
    pose: FloatArray,
    way: tuple[float, float, float],
    is_short: bool,
) -> SleevedArm:
    start, gap, length = way
    shoulder, elbow, wrist = arm.points(skeleton, pose)
    upper, fore = float(np.linalg.norm(elbow - shoulder)), float(np.linalg.norm(wrist - elbow))
    reach = length if is_short else gap + sleeve.length - start
    elbow_along = start - gap + reach * upper / length
    at_elbow, at_wrist = sleeve.point_at(elbow_along), sleeve.point_at(start - gap + reach)
    rest_elbow = shoulder + upper * _unit(at_elbow - shoulder)
    rest_wrist = rest_elbow + fore * _unit(at_wrist - at_elbow)
    if is_short:
        at_elbow, at_wrist = rest_elbow, rest_wrist
    return SleevedArm(
        arm=arm,
        sleeve=sleeve,
        shoulder=shoulder,
        elbow=at_elbow,
        wrist=at_wrist,
        rest_elbow=rest_elbow,
        rest_wrist=rest_wrist,
        elbow_along=elbow_along,
        is_short=is_short,
    )


def turned_into_sleeve(
    sleeved: SleevedArm, skeleton: Skeleton, rotations: FloatArray, pose: FloatArray
) -> FloatArray:
    """Return joint rotations (j, 4) that put elbow and wrist where the sleeve wants them."""
    arm, rotations = sleeved.arm, np.array(rotations)
    shoulder, elbow, wrist = arm.points(skeleton, pose)
    first = rotation_between(elbow - shoulder, sleeved.rest_elbow - shoulder)
    second = rotation_between(first @ (wrist - elbow), sleeved.rest_wrist - sleeved.rest_elbow)
    above = np.eye(3)
    for joint, turn in ((arm.upper, first), (arm.fore, second)):
        parent = Rotation.from_matrix(above @ pose[skeleton.parents[joint], :3, :3])
        rotations[joint] = (
            parent.inv() * Rotation.from_matrix(turn) * parent * Rotation.from_quat(rotations[joint])
        ).as_quat()
        above = turn @ above
    return rotations


def _unit(vector: Vector3) -> Vector3:
    return vector / max(float(np.linalg.norm(vector)), 1e-300)


def _along_bone(start: Vector3, end: Vector3, new_start: Vector3, new_end: Vector3) -> FloatArray:
    """Return (4, 4): start to new_start, lengths along the bone times the ratio of lengths, none across."""
    axis = _unit(end - start)
    length = float(np.linalg.norm(end - start))
    factor = float(np.clip(np.linalg.norm(new_end - new_start) / max(length, 1e-300), *_STRETCH))
    linear = rotation_between(end - start, new_end - new_start) @ (
        np.eye(3) + (factor - 1) * np.outer(axis, axis)
    )
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, new_start - linear @ start
    return matrix


def rotation_between(start: Vector3, end: Vector3) -> FloatArray:
    """Return the smallest rotation (3, 3) from one direction to another."""
    a, b = _unit(start), _unit(end)
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.eye(3)
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, float(a @ b))).as_matrix()


# The captured motion, taken out bone by bone.


_MAX_POINTS = 5000  # a rigid motion needs no more, and the fit then takes no time
_MOSTLY = 0.5  # of a part's greatest weight: vertices above it are the part's own
# Of the captured cloth: where a track slips, it pulls cloth farther apart than cloth bears.
_MOST_STRAIN = 1.5
_LEAST_POINTS = 12  # a part with fewer moves with the one it hangs from


class CapturedMotion:
    """Takes captured cloth, frame by frame, into the pose of attachment."""

    def __init__(
        self,
        first: Points,
        weights: SkinWeights,
        parts: Sequence[Sequence[int]],
        rest_from_first: FloatArray,
        faces: Faces,
    ) -> None:
        """first: (n, 3) the frame of attachment, on the figure. parts: joints that move as one, the trunk's
        first; the joints of no part follow the trunk. rest_from_first: (j, 4, 4), what fits the cloth over
        each joint. faces: what the capture stretches too far of them is drawn together.
        """
        self._weights, self._rest_from_first = weights, rest_from_first
        first = np.asarray(first, dtype=np.float64)
        self._first, self._parts = first, parts
        self._fits: list[tuple[list[int], IntArray, FloatArray, Points]] = []
        for joints in parts:
            own = np.where(np.isin(weights.joints, joints), weights.weights, 0).sum(axis=1)
            chosen = np.flatnonzero(own > _MOSTLY * max(float(own.max(initial=0.0)), 0.2))
            if len(chosen) >= _LEAST_POINTS:
                chosen = chosen[:: max(1, len(chosen) // _MAX_POINTS)]
                self._fits.append((list(joints), chosen, own[chosen], first[chosen]))
        is_plain = np.allclose(rest_from_first, np.eye(4), atol=1e-12)
        self._is_identity = is_plain and not self._fits
        self._edges = edges_from_faces(faces)
        ends = self.first_at_rest(first)[self._edges]
        self._longest = _MOST_STRAIN * np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)

    def at_rest(self, vertices: Points) -> Points:
        """Return captured vertices (n, 3), on the figure, in the pose of attachment."""
        placed = self._apply(vertices, self._first_from_now(vertices))
        return drawn_together(placed, self._edges, self._longest)

    def first_at_rest(self, vertices: Points) -> Points:
        """Return the vertices of the frame of attachment in its pose: nothing has moved yet."""
        return self._apply(vertices, np.broadcast_to(np.eye(4), self._rest_from_first.shape))

    def _apply(self, vertices: Points, first_from_now: FloatArray) -> Points:
        if self._is_identity:
            return np.asarray(vertices, dtype=np.float64)
        return blended_vertices(vertices, self._weights, self._rest_from_first @ first_from_now)

    def _first_from_now(self, vertices: Points) -> FloatArray:
        vertices = np.asarray(vertices, dtype=np.float64)
        matrices = np.tile(np.eye(4), (len(self._rest_from_first), 1, 1))
        for index, (joints, chosen, weights, first) in enumerate(self._fits):
            matrix = fit_rigid(vertices[chosen], first, weights).matrix
            if index == 0:
                matrices[:] = matrix
            matrices[joints] = matrix
        return matrices


def parts_of(
    anchor: Anchor,
    anatomy: Anatomy,
    sleeved: Sequence[SleevedArm],
    skeleton: Skeleton,
    legs: Sequence[Sequence[int]] = (),
) -> list[list[int]]:
    """Return the joints of each part of the cloth whose captured motion is taken out.

    legs: those that trousers cover, from the hip to the toes.
    """
    if anchor is Anchor.NONE:
        return []
    parts = [list(anatomy.trunk)]
    if anchor is Anchor.BONES:
        for one in sleeved:
            upper, fore, hand = one.arm.moved_with(skeleton)
            parts += [upper, fore + hand]
        for leg in legs:
            knee = list(leg).index(longest_bone_of(skeleton, tuple(leg))) + 1
            parts += [list(leg[:knee]), list(leg[knee:])]
    return parts


def fit_rigid(source: Points, target: Points, weights: FloatArray) -> RigidTransform:
    """Return the rigid motion from points (n, 3) to points (n, 3) that fits best, kabsch1976."""
    share = weights / weights.sum()
    centre_s, centre_t = share @ source, share @ target
    covariance = (target - centre_t).T @ ((source - centre_s) * share[:, None])
    u, _, vt = np.linalg.svd(covariance)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * signs) @ vt
    return RigidTransform(rotation=rotation, translation=centre_t - rotation @ centre_s)
