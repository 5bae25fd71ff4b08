"""Motion at its edges: a joint turned by a right angle, joints named like paths."""

import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.motion import Motion, Skeleton
from vntoolkit.io.maps_and_meshes.usd import FIGURE, write_usd_sequence
from vntoolkit.io.motion.bvh import read_bvh, write_bvh


def _motion(names=("hips", "knee")):
    """Two joints for two frames; in the second one the knee is bent by exactly a right angle about x."""
    skeleton = Skeleton(names=names, parents=np.array([-1, 0]), offsets=np.array([[0, 0, 0], [0, 1.0, 0]]))
    turns = Rotation.from_euler("ZXY", [[0, 0, 0], [30, 90, 20]], degrees=True).as_quat()
    rotations = np.stack([np.tile([0, 0, 0, 1.0], (2, 1)), turns], axis=1)
    return Motion(skeleton=skeleton, rotations=rotations, root_positions=np.zeros((2, 3)), frame_rate_hz=30.0)


def test_a_right_angle_is_written_without_a_warning_and_comes_back(tmp_path):
    motion = _motion()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_bvh(tmp_path / "a.bvh", motion)
    back = Rotation.from_quat(read_bvh(tmp_path / "a.bvh").rotations[:, 1])
    assert (back * Rotation.from_quat(motion.rotations[:, 1]).inv()).magnitude() == pytest.approx(0, abs=1e-5)


def test_a_joint_named_like_a_path_stays_one_joint(tmp_path):
    from pxr import Usd, UsdSkel

    cloth = Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]]))
    motion = _motion(("hips/left", "knee 1"))
    write_usd_sequence(tmp_path / "a.usdc", cloth, [np.eye(3)] * 2, frame_rate_hz=30.0, motion=motion)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    joints = UsdSkel.Skeleton(stage.GetPrimAtPath(f"{FIGURE}/Skeleton")).GetJointsAttr().Get()
    assert list(joints) == ["hips_2f_left", "hips_2f_left/knee_20_1"]
    assert list(UsdSkel.Topology(joints).GetParentIndices()) == [-1, 0]
