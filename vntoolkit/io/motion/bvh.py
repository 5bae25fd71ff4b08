"""BVH motion capture: checked here, read and written by pybvh.

pybvh is maintained, computes in float64 and reads a CMU take of a thousand frames in 8 ms. Of the
others, bvhio loops for ever at the end of a truncated file and computes in single precision, and bvh
and bvhtoolbox have had no release for years. pybvh refuses most malformed files
by itself; the guards add what it lets through: they bound the memory before anything is parsed, and
refuse unbalanced braces, joints named twice (a cycle, as far as BVH can express one), NaN and infinity.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.checks import require_finite
from vntoolkit.errors import BadMotion
from vntoolkit.geometry.motion import Motion, Skeleton
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.conventions import motion_with_axes_turned
from vntoolkit.io.files import require_file

if TYPE_CHECKING:
    import pybvh

MAX_MOTION_BYTES = 256 * 2**20  # ten minutes at 120 Hz of 31 joints are 50 MB
MAX_JOINTS = 4096
MAX_DEPTH = 256  # of joints one below the other; pybvh's time grows with the square of it
_MAX_HEADER_LINE = 4096
_LONGEST_REASON = 200
_WRITTEN_ORDER = "ZXY"


def read_bvh(path: Path) -> Motion:
    """Read a BVH file; no joint is turned in the rest pose, lengths stay in the file's own unit.

    The root's position channels are its position (they replace its OFFSET). Raises `BadMotion`.
    """
    require_motion_size(path)
    names = _require_sound_hierarchy(path)
    import pybvh

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about empty motions, which are refused below
            bvh = pybvh.read_bvh_file(path, world_up="+y")
    except (ValueError, IndexError, OSError) as error:
        reason = " ".join(str(error).split()).replace(f" in file {path}", "").replace(f" in {path}", "")
        reason = reason if len(reason) < _LONGEST_REASON else reason[:_LONGEST_REASON] + " …"
        raise BadMotion(f"{path.name}: {reason}") from error
    require_finite(bvh.root_pos, f"{path.name}: root positions", BadMotion)
    require_finite(bvh.joint_angles, f"{path.name}: joint angles", BadMotion)
    skeleton = _skeleton_of(bvh, names)
    joints = [node for node in bvh.nodes if not node.is_end_site()]
    rotations = np.empty((bvh.frame_count, len(joints), 4))
    for index, joint in enumerate(joints):
        order = "".join(joint.rot_channels)  # listed outermost first: intrinsic, capital letters in scipy
        rotations[:, index] = Rotation.from_euler(order, bvh.joint_angles[:, index]).as_quat()
    listed = list(bvh.nodes[0].pos_channels)
    return motion_with_axes_turned(
        Motion(
            skeleton=skeleton,
            rotations=rotations,
            root_positions=bvh.root_pos[:, ([listed.index(axis) for axis in "XYZ"])],
            frame_rate_hz=1.0 / bvh.frame_time,
        )
    )


def require_motion_size(path: Path) -> None:
    """Raise unless the file exists and is small enough to be read in bounded memory."""
    size = require_file(path, BadMotion).stat().st_size
    if size > MAX_MOTION_BYTES:
        raise BadMotion(
            f"{path.name}: {size / 2**20:.0f} MiB; motion files over {MAX_MOTION_BYTES // 2**20} MiB are "
            "refused: cut the recording into takes"
        )


def _require_sound_hierarchy(path: Path) -> list[str]:
    """Scan the header line by line, in constant memory, and return the joint names in file order."""
    names: list[str] = []
    seen: set[str] = set()
    depth = 0
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in iter(lambda: file.readline(_MAX_HEADER_LINE), ""):
            words = line.split()
            if words and words[0] in ("ROOT", "JOINT"):
                if len(line) == _MAX_HEADER_LINE:
                    raise BadMotion(f"{path.name}: the name of a joint has {_MAX_HEADER_LINE} characters")
                name = words[1] if len(words) > 1 else ""
                if not name or name in seen:
                    raise BadMotion(f"{path.name}: joint {name!r} occurs twice or has no name (a cycle?)")
                names.append(name)
                seen.add(name)
            elif words and words[0] == "MOTION":
                break
            depth += words.count("{") - words.count("}")
            if depth > MAX_DEPTH:
                raise BadMotion(f"{path.name}: a chain of more than {MAX_DEPTH} joints: this is no figure")
            if len(names) > MAX_JOINTS:
                raise BadMotion(f"{path.name}: more than {MAX_JOINTS} joints: this is no figure")
        else:
            raise BadMotion(f"{path.name}: no MOTION section: the file is truncated or not BVH")
        if depth != 0:
            raise BadMotion(f"{path.name}: {abs(depth)} unmatched braces in the hierarchy")
        if not names:
            raise BadMotion(f"{path.name}: no ROOT in the hierarchy")
    return names


def _skeleton_of(bvh: pybvh.Bvh, names: list[str]) -> Skeleton:
    index_of = {name: index for index, name in enumerate(names)}
    joints = [node for node in bvh.nodes if not node.is_end_site()]
    tips = [node for node in bvh.nodes if node.is_end_site()]
    return Skeleton(
        names=tuple(names),
        parents=np.array([-1 if n.parent is None else index_of[n.parent.name] for n in joints]),
        offsets=np.array([n.offset for n in joints], dtype=np.float64),
        tip_joints=np.array([index_of[n.parent.name] for n in tips], dtype=np.int64),
        tip_offsets=np.array([n.offset for n in tips], dtype=np.float64).reshape(-1, 3),
    )


def write_bvh(path: Path, motion: Motion) -> None:
    """Write a motion as BVH with channels Zrotation Xrotation Yrotation, rounded to four decimals, y up.

    The unit of length is the motion's; BVH has no place to say which that is. Raises `BadMotion` where other
    joints come between a joint and its descendants: the file lists them in that order.
    """
    import pybvh
    from pybvh.bvhnode import BvhEndSite, BvhJoint, BvhNode, BvhRoot

    turned = motion_with_axes_turned(motion)
    skeleton = turned.skeleton
    joints: list[BvhJoint] = []
    nodes: list[BvhNode] = []
    line_of_descent: list[int] = []
    for index, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
        if parent >= 0 and parent not in line_of_descent:
            raise BadMotion("BVH needs a joint's descendants to follow it without interruption")
        line_of_descent = [*line_of_descent[: line_of_descent.index(parent) + 1 if parent >= 0 else 0], index]
        offset = skeleton.offsets[index] + 0.0  # no −0
        if parent < 0:
            joints.append(BvhRoot(name, offset, list("XYZ"), list(_WRITTEN_ORDER)))
        else:
            joints.append(BvhJoint(name, offset, list(_WRITTEN_ORDER), parent=joints[parent]))
            joints[parent].children.append(joints[-1])
        nodes.append(joints[-1])
        for tip in skeleton.tip_offsets[skeleton.tip_joints == index]:
            nodes.append(BvhEndSite(f"End{name}", tip + 0.0, joints[-1]))
            joints[-1].children.append(nodes[-1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about a right angle, where any such pair of others is right
        angles = [
            Rotation.from_quat(turned.rotations[:, joint]).as_euler(_WRITTEN_ORDER, degrees=True)
            for joint in range(len(joints))
        ]
        written = pybvh.Bvh(
            nodes,
            np.round(turned.root_positions, 4) + 0.0,
            np.deg2rad(np.round(np.stack(angles, axis=1), 4) + 0.0),
            frame_time=1 / turned.frame_rate_hz,
            world_up="+y",
        )
    with atomic_path(path) as temporary:
        written.write(temporary)
