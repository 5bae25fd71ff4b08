"""What equation 8 must do whatever the garment: rigid motions, the rest pose, weights, twisted joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recipes.walk_motion import walking_motion
from vntoolkit.errors import BadInput
from vntoolkit.geometry.motion import Motion, Skeleton, bone_segments, pose_of_frame, rest_pose
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.dressing import Blend, Falloff, WeightOptions
from vntoolkit.skinning.blending import dual_quaternions, skinned_vertices
from vntoolkit.skinning.weights import SkinWeights, weights_from_distances

PUBLISHED = WeightOptions(falloff=Falloff.INVERSE)
BOTH = pytest.mark.parametrize("blend", list(Blend))


@pytest.fixture
def motion() -> Motion:
    return walking_motion().in_metres(1.7)


@pytest.fixture
def cloud(rng: np.random.Generator, motion: Motion) -> np.ndarray:
    return rng.uniform([-0.5, -1.8, -0.3], [0.5, 0.1, 0.3], (5000, 3))


@pytest.fixture
def weights(cloud: np.ndarray, motion: Motion) -> SkinWeights:
    return weights_from_distances(cloud, motion.skeleton, rest_pose(motion.skeleton), PUBLISHED)


@BOTH
def test_one_rigid_motion_of_all_joints_is_that_motion(blend, cloud, motion, weights) -> None:
    rest = rest_pose(motion.skeleton)
    moved = RigidTransform.from_rotation_vector([0.7, -1.9, 0.4], [3.0, -2.0, 11.0])
    skinned = skinned_vertices(cloud, weights, moved.matrix @ rest, rest, blend)
    np.testing.assert_allclose(skinned, moved.apply(cloud), rtol=0, atol=1e-9)


@BOTH
def test_one_rigid_motion_over_a_pose_moves_the_dressed_mesh_by_it(blend, cloud, motion, weights) -> None:
    rest = rest_pose(motion.skeleton)
    pose = pose_of_frame(motion, 40)
    moved = RigidTransform.from_rotation_vector([0.1, 2.9, 0.4], [3.0, -2.0, 11.0])
    before = skinned_vertices(cloud, weights, pose, rest, blend)
    after = skinned_vertices(cloud, weights, moved.matrix @ pose, rest, blend)
    np.testing.assert_allclose(after, moved.apply(before), rtol=0, atol=1e-9)


@BOTH
def test_the_pose_of_attachment_returns_the_captured_mesh(blend, cloud, motion, weights) -> None:
    pose = pose_of_frame(motion, 17)  # any pose may be that of attachment
    np.testing.assert_allclose(skinned_vertices(cloud, weights, pose, pose, blend), cloud, rtol=0, atol=1e-9)


def test_linear_blending_is_equation_8(cloud, motion, weights) -> None:
    rest, pose = rest_pose(motion.skeleton), pose_of_frame(motion, 55)
    homogeneous = np.column_stack([cloud, np.ones(len(cloud))])
    expected = np.zeros_like(cloud)
    for slot in range(weights.joints.shape[1]):
        matrices = pose[weights.joints[:, slot]] @ np.linalg.inv(rest)[weights.joints[:, slot]]
        expected += (
            weights.weights[:, slot : slot + 1] * np.einsum("nij,nj->ni", matrices, homogeneous)[:, :3]
        )
    skinned = skinned_vertices(cloud, weights, pose, rest, Blend.LINEAR)
    np.testing.assert_allclose(skinned, expected, rtol=0, atol=1e-9)


def test_both_blends_agree_on_a_single_bone(cloud, motion) -> None:
    rest, pose = rest_pose(motion.skeleton), pose_of_frame(motion, 55)
    one = weights_from_distances(cloud, motion.skeleton, rest, replace(PUBLISHED, neighbours=1))
    linear, dual = (skinned_vertices(cloud, one, pose, rest, blend) for blend in Blend)
    np.testing.assert_allclose(dual, linear, rtol=0, atol=1e-9)


@pytest.mark.parametrize("neighbours", [1, 3, 4, 100])
def test_weights_sum_to_one_and_are_not_negative(neighbours, cloud, motion) -> None:
    on_bones = np.concatenate([cloud, motion.skeleton.rest_positions])  # distance 0 too
    options = WeightOptions(neighbours=neighbours, falloff=Falloff.INVERSE)
    weights = weights_from_distances(on_bones, motion.skeleton, rest_pose(motion.skeleton), options)
    assert weights.weights.min() >= 0
    np.testing.assert_allclose(weights.weights.sum(axis=1), 1, rtol=0, atol=1e-12)
    assert weights.joints.shape[1] <= neighbours
    ordered = np.sort(weights.joints, axis=1)
    assert np.all(np.diff(ordered, axis=1) > 0)  # no bone twice


def test_published_weights_are_inverse_to_the_distance_to_the_nearest_bones(cloud, motion) -> None:
    rest = rest_pose(motion.skeleton)
    weights = weights_from_distances(cloud[:200], motion.skeleton, rest, replace(PUBLISHED, neighbours=3))
    joints, starts, ends = bone_segments(motion.skeleton, rest)
    for vertex, found, values in zip(cloud[:200], weights.joints, weights.weights, strict=True):
        along = np.clip(((vertex - starts) * (ends - starts)).sum(1) / ((ends - starts) ** 2).sum(1), 0, 1)
        gaps = np.linalg.norm(starts + along[:, None] * (ends - starts) - vertex, axis=1)
        of_joint = {joint: gaps[joints == joint].min() for joint in joints}
        nearest = sorted(of_joint, key=of_joint.get)[:3]
        np.testing.assert_allclose(
            sorted(of_joint[j] for j in found), [of_joint[j] for j in nearest], rtol=1e-12
        )
        inverse = np.array([1 / of_joint[j] for j in found])
        np.testing.assert_allclose(values, inverse / inverse.sum(), rtol=1e-9)


def test_dual_quaternions_keep_the_radius_where_linear_blending_collapses() -> None:
    skeleton = Skeleton(
        names=("upper", "lower"),
        parents=np.array([-1, 0]),
        offsets=np.array([[0, 0, 0], [1.0, 0, 0]]),
        tip_joints=np.array([1]),
        tip_offsets=np.array([[1.0, 0, 0]]),
    )
    rest = rest_pose(skeleton)
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = np.column_stack([np.ones(16), 0.3 * np.cos(angles), 0.3 * np.sin(angles)])
    weights = SkinWeights(joints=np.tile(np.int32([0, 1]), (16, 1)), weights=np.full((16, 2), 0.5))
    twisted = rest.copy()
    twisted[1, :3, :3] = Rotation.from_euler("x", 170, degrees=True).as_matrix()
    radius = {}
    for blend in Blend:
        skinned = skinned_vertices(ring, weights, twisted, rest, blend)
        radius[blend] = np.linalg.norm(skinned[:, 1:], axis=1)
    np.testing.assert_allclose(radius[Blend.LINEAR], 0.3 * np.cos(np.deg2rad(85)), rtol=1e-9)
    np.testing.assert_allclose(radius[Blend.DUAL_QUATERNION], 0.3, rtol=1e-9)


def test_dual_quaternions_take_the_short_way_wherever_the_figure_faces(cloud, motion, weights) -> None:
    rest, pose = rest_pose(motion.skeleton), pose_of_frame(motion, 40)
    before = skinned_vertices(cloud, weights, pose, rest, Blend.DUAL_QUATERNION)
    mixed_signs = 0
    for angle in np.linspace(0, 2 * np.pi, 48, endpoint=False):
        turned = RigidTransform.from_rotation_vector([0.3 * angle, angle, 0])
        signs = np.sign(dual_quaternions(turned.matrix @ pose @ np.linalg.inv(rest))[:, 1])
        mixed_signs += len(np.unique(signs)) > 1  # some joints' quaternions lie in the other hemisphere
        after = skinned_vertices(cloud, weights, turned.matrix @ pose, rest, Blend.DUAL_QUATERNION)
        np.testing.assert_allclose(after, turned.apply(before), rtol=0, atol=1e-9)
    assert mixed_signs > 3


def test_excluded_bones_attract_nothing(cloud, motion) -> None:
    options = replace(PUBLISHED, exclude=("*Leg", "*Foot"))
    weights = weights_from_distances(cloud, motion.skeleton, rest_pose(motion.skeleton), options)
    names = {motion.skeleton.names[joint] for joint in np.unique(weights.joints)}
    assert names
    assert not {name for name in names if name.endswith(("Leg", "Foot"))}
    with pytest.raises(BadInput, match="no bone is left"):
        weights_from_distances(
            cloud, motion.skeleton, rest_pose(motion.skeleton), replace(PUBLISHED, exclude=("*",))
        )


def test_refusals(cloud, motion, weights) -> None:
    with pytest.raises(BadInput, match="vertices to skin: expected shape 5000"):
        skinned_vertices(cloud[:7], weights, rest_pose(motion.skeleton), rest_pose(motion.skeleton))
    with pytest.raises(BadInput, match="sum to 1"):
        SkinWeights(joints=np.zeros((2, 2), np.int32), weights=np.ones((2, 2)))
