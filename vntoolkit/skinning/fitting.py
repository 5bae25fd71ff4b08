"""Fit of a garment to a skeleton: where it hangs, how large it is, and how the arms are held."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.errors import BadInput
from vntoolkit.geometry.garment_fit import GarmentFit, fit_similarity
from vntoolkit.geometry.mesh import Mesh, face_normals
from vntoolkit.geometry.motion import Motion, Skeleton, forward_kinematics
from vntoolkit.geometry.rigid import RigidTransform, Similarity
from vntoolkit.options.dressing import Garment, GarmentFitOptions
from vntoolkit.skinning import alignment
from vntoolkit.skinning import anatomy as anatomies
from vntoolkit.skinning.sleeves import GarmentRegions, regions_of_garment

_WAIST_RISE = 0.1  # of the way from feet to hips: trousers reach above the joints of the hips
_COLLAR_RISE = 0.12  # of the way from hips to shoulders: a collar lies above the shoulders' joints


# Height of a garment over that of what it covers: hips to neck, hips to feet, or neck to feet.
_FULLNESS = {Garment.TROUSERS: 1.05, Garment.SKIRT: 0.65, Garment.OVERALL: 1.0}
_UPPER_FULLNESS = 1.3


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitting:
    """A garment on a figure.

    garment: what it was taken for, never AUTO. rest_from_cloth: puts it onto the figure. rest_from_model: R
    of equation 8, (j, 4, 4). regions: of the garment, there. arms: of the figure. sleeved: those that lie in
    a sleeve. rest_from_first: (j, 4, 4), what then fits the cloth over each joint to the bone's length.
    """

    garment: Garment
    rest_from_cloth: Similarity
    rest_from_model: FloatArray
    regions: GarmentRegions
    arms: tuple[anatomies.Arm, ...]
    sleeved: tuple[alignment.SleevedArm, ...]
    rest_from_first: FloatArray


def fit_garment_to_figure(
    garment: Mesh,
    motion: Motion,
    fit: GarmentFit,
    options: GarmentFitOptions,
    named: Mapping[str, str] | None = None,
) -> Fitting:
    """Bring garment and skeleton into one pose, the pose of attachment, in which the root is not turned.

    named: joints of the arms by role, where their names do not tell.
    """
    skeleton = motion.skeleton
    rotations = _binding_rotations(motion, fit)
    pose = forward_kinematics(skeleton, rotations[None], skeleton.offsets[:1])[0]
    regions = regions_of_garment(garment)
    options = replace(options, garment=_kind_of(regions, options.garment))
    kind = options.garment
    rest_from_cloth = fit_garment(garment, skeleton, pose, fit, options)
    anatomy = anatomies.anatomy_of(skeleton)
    arms = () if kind.is_lower else anatomies.arms_of(skeleton, anatomy, named)
    regions = regions.moved(rest_from_cloth)
    if kind.is_lower or kind is Garment.SLEEVELESS:
        regions = replace(regions, sleeves=())
    missing = [sleeve.side for sleeve in regions.sleeves if sleeve.side not in {arm.side for arm in arms}]
    if missing:
        side = "left" if missing[0] > 0 else "right"
        raise BadInput(
            f"the figure has no arm for the garment's {side} sleeve: name its joints, as --map "
            f"{side}-upper-arm=JOINT --map {side}-forearm=JOINT; there are {', '.join(skeleton.names)}"
        )
    sleeved = alignment.arms_in_sleeves(arms, regions.sleeves, skeleton, pose)
    rest_from_first = np.tile(np.eye(4), (len(skeleton.names), 1, 1))
    is_given = bool(fit.pose) or fit.bind_frame is not None or bool(fit.landmarks)
    if not is_given:
        for one in sleeved:
            rotations = alignment.turned_into_sleeve(one, skeleton, rotations, pose)
            for joint, matrix in one.transforms(skeleton).items():
                rest_from_first[joint] = matrix
        turns: dict[int, FloatArray] = {}
        if kind is Garment.TROUSERS and regions.hems is not None:
            turns = legs_aimed_at_hems(regions.hems, skeleton, pose, anatomy)
        elif not sleeved and not kind.is_lower and kind is not Garment.SLEEVELESS:
            vertices = rest_from_cloth.apply(garment.vertices)
            turns = arms_aimed_at_sleeves(vertices, skeleton, pose, anatomy)
        if turns:
            for joint, turn in turns.items():
                above = Rotation.from_matrix(pose[skeleton.parents[joint], :3, :3])
                own = Rotation.from_quat(rotations[joint])
                rotations[joint] = (above.inv() * Rotation.from_matrix(turn) * above * own).as_quat()
        pose = forward_kinematics(skeleton, rotations[None], skeleton.offsets[:1])[0]
    return Fitting(
        garment=kind,
        rest_from_cloth=rest_from_cloth,
        rest_from_model=pose,
        regions=regions,
        arms=arms,
        sleeved=sleeved,
        rest_from_first=rest_from_first,
    )


def _kind_of(regions: GarmentRegions, asked: Garment) -> Garment:
    """Return what the garment is. Raises `BadInput` where its outline lacks what was asked for."""
    if asked is Garment.AUTO:
        return Garment.TROUSERS if regions.hems is not None else Garment.SWEATER
    if asked is Garment.TROUSERS and regions.hems is None:
        raise BadInput(
            "trousers: the garment's outline has no gap between two legs: film them apart, or "
            "take --garment skirt"
        )
    if asked is Garment.SWEATER and not regions.sleeves:
        raise BadInput(
            "sweater: no sleeve stands out from the garment's outline: film both "
            "apart from the trunk, or take --garment sleeveless"
        )
    return asked


def _binding_rotations(motion: Motion, fit: GarmentFit) -> FloatArray:
    """Return (j, 4): the rest pose or a frame's, with the turns that the fit asks for."""
    skeleton = motion.skeleton
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (len(skeleton.names), 1))
    if fit.bind_frame is not None:
        if fit.bind_frame >= len(motion):
            raise BadInput(f"fit: bind_frame {fit.bind_frame} is not among the {len(motion)} frames")
        rotations = np.array(motion.rotations[fit.bind_frame])
        rotations[0] = [0.0, 0.0, 0.0, 1.0]
    for name, turn in fit.pose.items():
        joint = skeleton.index_of(name)
        rotations[joint] = (Rotation.from_quat(rotations[joint]) * Rotation.from_quat(turn)).as_quat()
    return rotations


def fit_garment(
    garment: Mesh, skeleton: Skeleton, pose: FloatArray, fit: GarmentFit, options: GarmentFitOptions
) -> Similarity:
    """Return rest_from_cloth: the similarity that puts the garment onto the figure in `pose` (j, 4, 4)."""
    if fit.landmarks:
        placed = _by_landmarks(garment, skeleton, pose, fit)
    else:
        placed = _by_bounding_box(garment, skeleton, pose, options)
    vertices = placed.apply(garment.vertices)
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    turn, move = fit.adjustment.rotation, fit.adjustment.translation
    # centre + move + s T (S R x + t − centre), as one similarity
    return Similarity(
        scale=fit.scale * placed.scale,
        rigid=RigidTransform(
            rotation=turn @ placed.rigid.rotation,
            translation=centre + move + fit.scale * turn @ (placed.rigid.translation - centre),
        ),
    )


def _by_landmarks(garment: Mesh, skeleton: Skeleton, pose: FloatArray, fit: GarmentFit) -> Similarity:
    vertices = np.array([mark.vertex for mark in fit.landmarks])
    if vertices.max() >= len(garment.vertices):
        raise BadInput(f"landmark vertex {vertices.max()}: the garment has {len(garment.vertices)} vertices")
    joints = [skeleton.index_of(mark.joint) for mark in fit.landmarks]
    targets = pose[joints, :3, 3] + np.array([mark.offset for mark in fit.landmarks])
    return fit_similarity(garment.vertices[vertices], targets)


def _by_bounding_box(
    garment: Mesh, skeleton: Skeleton, pose: FloatArray, options: GarmentFitOptions
) -> Similarity:
    """Scale the garment's height to the region's, hang it from its top, facing as the figure does."""
    low, high = garment.vertices.min(axis=0), garment.vertices.max(axis=0)
    height = float(high[1] - low[1])
    if not height > 0:
        raise BadInput("fit: the garment has no height (its vertices share one y)")
    anatomy = anatomies.anatomy_of(skeleton)
    facing = anatomies.facing_of(skeleton, anatomy.legs)
    yaw = np.arctan2(-facing[0], -facing[2])  # turns −z, towards the camera, into the facing
    rotation = Rotation.from_euler("y", yaw).as_matrix()
    trunk = pose[list(anatomy.trunk), :3, 3]
    bottom, top = _vertical_span(pose, anatomy, anatomies.shoulders_of(skeleton, anatomy), options.garment)
    fullness = options.fullness or _FULLNESS.get(options.garment, _UPPER_FULLNESS)
    scale = fullness * (bottom - top) / height
    anchor = np.array([(low[0] + high[0]) / 2, low[1], _anchor_depth(garment)])
    target = np.array([trunk[:, 0].mean(), top, trunk[:, 2].mean()])
    translation = target - scale * rotation @ anchor
    return Similarity(scale=scale, rigid=RigidTransform(rotation=rotation, translation=translation))


def _vertical_span(
    pose: FloatArray, anatomy: anatomies.Anatomy, shoulders: tuple[int, ...], garment: Garment
) -> tuple[float, float]:
    """Return y of bottom and top of what is covered (y down); a waist lies above the hips."""
    heights = pose[:, 1, 3]
    hips = float(heights[anatomy.trunk[0]])
    feet = float(heights[list(anatomy.legs)].max()) if anatomy.legs else hips
    bottom = feet if garment.is_lower or garment is Garment.OVERALL else hips
    collar = [heights[shoulder] - _COLLAR_RISE * (hips - heights[shoulder]) for shoulder in shoulders]
    top = float(min([heights[anatomy.trunk[-1]], *collar]))
    if garment.is_lower:
        top = hips - _WAIST_RISE * (feet - hips)
    if not bottom > top:
        lacks = "lower body" if garment.is_lower else "body"
        raise BadInput(f"fit: the figure has no {lacks} for the {garment.value}; use landmarks")
    return bottom, top


_OPEN_ABOVE = 0.3  # |Σ area vectors| / Σ areas: 0 for a closed garment, near 1 for a flat sheet


def _anchor_depth(garment: Mesh) -> float:
    """Return where the bones lie: at the rear of an open sheet, else in the centre."""
    areas = face_normals(garment.vertices, garment.faces)
    total = float(np.linalg.norm(areas, axis=1).sum())
    covered = garment.vertices[np.unique(garment.faces)] if len(garment.faces) else garment.vertices
    if np.linalg.norm(areas.sum(axis=0)) > _OPEN_ABOVE * total:
        return _rear(covered)
    return float(covered[:, 2].min() + covered[:, 2].max()) / 2


_LEVELS = 64  # heights at which the garment's depth is looked at


def _rear(vertices: Points) -> float:
    """Return how far back the garment reaches at most heights, by the median: it passes over a collar."""
    y = vertices[:, 1]
    level = np.minimum((y - y.min()) / max(np.ptp(y), 1e-300) * _LEVELS, _LEVELS - 1).astype(np.int64)
    rearmost = np.full(_LEVELS, -np.inf)
    np.maximum.at(rearmost, level, vertices[:, 2])
    return float(np.median(rearmost[np.isfinite(rearmost)]))


# Arms of a garment whose sleeves do not stand out from its outline: aimed at its outermost cloth.


_CUFF_SHARE = 0.02  # of the vertices on one side: the outermost ones are its cuff
_LEAST_REACH = 0.4  # of the arm: a garment that ends nearer to the shoulder has no sleeve to aim at


def arms_aimed_at_sleeves(
    vertices: Points, skeleton: Skeleton, pose: FloatArray, anatomy: anatomies.Anatomy
) -> dict[int, FloatArray]:
    """Return joint → (3, 3): the turn, in the axes of the figure, that aims an arm at its cuff.

    vertices: (n, 3) of the garment, already on the figure in `pose` (j, 4, 4). A cuff is the middle of the
    outermost vertices on the arm's side of the trunk. Arms without a sleeve, or without length, stay.
    """
    turns = {}
    middle = float(pose[list(anatomy.trunk), 0, 3].mean())
    for arm, shoulder in zip(anatomy.arms, anatomies.shoulders_of(skeleton, anatomy), strict=True):
        start = pose[shoulder, :3, 3]
        end = anatomies.tip_of(skeleton, pose, arm[-1])
        reach = np.linalg.norm(end - start)
        side = np.sign(end[0] - middle)
        outward = side * (vertices[:, 0] - middle)
        if side == 0 or reach == 0 or not (outward > 0).any():
            continue
        threshold = np.quantile(outward[outward > 0], 1 - _CUFF_SHARE)
        cuff = vertices[outward >= threshold].mean(axis=0)
        if side * (cuff - start)[0] > 0 and np.linalg.norm(cuff - start) > _LEAST_REACH * reach:
            turns[shoulder] = alignment.rotation_between(end - start, cuff - start)
    return turns


def legs_aimed_at_hems(
    hems: Points, skeleton: Skeleton, pose: FloatArray, anatomy: anatomies.Anatomy
) -> dict[int, FloatArray]:
    """Return joint → (3, 3): the turn that aims each leg at the hem on its side, seen from the front.

    hems: (2, 3), at smaller and at greater x, already on the figure in `pose` (j, 4, 4).
    """
    turns = {}
    for leg in anatomies.legs_of(skeleton, anatomy):
        hip = anatomies.longest_bone_of(skeleton, leg)
        end = pose[leg[min(leg.index(hip) + 2, len(leg) - 1)], :3, 3]
        start = pose[hip, :3, 3]
        side = int(start[0] > pose[0, 0, 3])
        target = np.array([*(hems[side][:2] - start[:2]), (end - start)[2]])
        if target[1] > 0:
            turns[hip] = alignment.rotation_between(end - start, target)
    return turns
