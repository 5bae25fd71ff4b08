"""Forward kinematics against a second computation: text to positions, joint by joint, sines and cosines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recipes.walk_motion import walking_motion
from vntoolkit.geometry.motion import Motion, bone_segments, forward_kinematics, pose_of_frame
from vntoolkit.io.motion.asf import read_asf_amc
from vntoolkit.io.motion.bvh import read_bvh, write_bvh

DISK_FROM_MEMORY = np.array([1.0, -1.0, -1.0])
OF_HEIGHT = 1e-6
DATA = Path(__file__).parents[2] / "data"


def turn(axis: str, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis.lower()]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def bvh_positions(path: Path, frames: range) -> dict[str, np.ndarray]:
    """Walk the text once a frame, recursively, as the format's description has it."""
    words = path.read_text().split()
    motion = words.index("MOTION")
    count = int(words[motion + 2])
    values = np.array(words[motion + 6 :], dtype=float).reshape(count, -1)
    found: dict[str, list[np.ndarray]] = {}

    def joint(at: int, frame, channel: int, rotation, position) -> tuple[int, int]:
        name = words[at + 1]
        at += 3
        position = position + rotation @ np.array(words[at + 1 : at + 4], dtype=float)
        at += 4
        number = int(words[at + 1])
        for kind in words[at + 2 : at + 2 + number]:
            value = frame[channel]
            channel += 1
            if kind.endswith("position"):
                position = position.copy()
                position["XYZ".index(kind[0])] = value
            else:
                rotation = rotation @ turn(kind[0], value)
        at += 2 + number
        found.setdefault(name, []).append(position)
        while words[at] != "}":
            if words[at] == "End":
                offset = np.array(words[at + 4 : at + 7], dtype=float)
                found.setdefault(f"{name} tip", []).append(position + rotation @ offset)
                at += 8
            else:
                at, channel = joint(at, frame, channel, rotation, position)
        return at + 1, channel

    for index in frames:
        joint(words.index("ROOT"), values[index], 0, np.eye(3), np.zeros(3))
    return {name: np.array(positions) for name, positions in found.items()}


def acclaim_starts(asf: Path, amc: Path, frames: range) -> dict[str, np.ndarray]:
    """Return where every bone begins, computed bone by bone from the text."""
    text = asf.read_text()
    bones = {}
    for block in text.split(":bonedata")[1].split(":hierarchy")[0].split("begin")[1:]:
        lines = [line.split() for line in block.splitlines() if line.split()]
        entry = {words[0]: words[1:] for words in lines}
        bones[entry["name"][0]] = (
            np.array(entry["direction"][:3], float) * float(entry["length"][0]),
            np.array(entry["axis"][:3], float),
            entry.get("dof", []),
        )
    children = {
        words[0]: words[1:]
        for words in (line.split() for line in text.split(":hierarchy")[1].splitlines())
        if words and words[0] not in ("begin", "end")
    }
    takes, take = [], {}
    for line in amc.read_text().splitlines():
        words = line.split()
        if words and words[0].isdigit():
            take = {}
            takes.append(take)
        elif takes:
            take[words[0]] = [float(word) for word in words[1:]]
    found: dict[str, list[np.ndarray]] = {}

    def bone(name: str, take, above, start) -> None:
        span, axis, dof = bones[name]
        found.setdefault(name, []).append(start)
        own = turn("z", axis[2]) @ turn("y", axis[1]) @ turn("x", axis[0])
        angles = dict.fromkeys("xyz", 0.0) | {d[1]: v for d, v in zip(dof, take.get(name, []), strict=True)}
        moved = turn("z", angles["z"]) @ turn("y", angles["y"]) @ turn("x", angles["x"])
        rotation = above @ own @ moved @ own.T
        for child in children.get(name, []):
            bone(child, take, rotation, start + rotation @ span)

    for index in frames:
        tx, ty, tz, rx, ry, rz = takes[index]["root"]
        rotation = turn("z", rz) @ turn("y", ry) @ turn("x", rx)
        found.setdefault("root", []).append(np.array([tx, ty, tz]))
        for child in children["root"]:
            bone(child, takes[index], rotation, np.array([tx, ty, tz]))
    return {name: np.array(positions) for name, positions in found.items()}


def positions_of(motion: Motion, frames: range) -> np.ndarray:
    chosen = list(frames)
    poses = forward_kinematics(motion.skeleton, motion.rotations[chosen], motion.root_positions[chosen])
    return poses[..., :3, 3] * DISK_FROM_MEMORY


def require_agreement(motion: Motion, independent: dict[str, np.ndarray], frames: range) -> None:
    ours = positions_of(motion, frames)
    for joint, name in enumerate(motion.skeleton.names):
        error = np.abs(ours[:, joint] - independent[name]).max()
        assert error < OF_HEIGHT * motion.skeleton.height, (name, error)


def test_bvh_agrees_with_a_second_computation(real_data: Path) -> None:
    path = real_data / "mocap" / "131_01.bvh"
    motion = read_bvh(path)
    assert len(motion) == 994
    assert motion.frame_rate_hz == pytest.approx(120.0)
    assert len(motion.skeleton.names) == 31
    frames = range(0, 994, 71)
    independent = bvh_positions(path, frames)
    require_agreement(motion, independent, frames)
    pose = pose_of_frame(motion, 71)
    _, _, ends = bone_segments(motion.skeleton, pose)
    tips = np.array([independent[f"{motion.skeleton.names[j]} tip"][1] for j in motion.skeleton.tip_joints])
    gaps = np.linalg.norm(tips[:, None] - ends[None] * DISK_FROM_MEMORY, axis=-1).min(axis=1)
    assert gaps.max() < OF_HEIGHT * motion.skeleton.height


def test_acclaim_agrees_with_a_second_computation(real_data: Path) -> None:
    folder = real_data / "mocap"
    motion = read_asf_amc(folder / "lambada.asf", folder / "lambada.amc")
    frames = range(0, len(motion), 200)
    require_agreement(motion, acclaim_starts(folder / "lambada.asf", folder / "lambada.amc", frames), frames)
    # the library's unit is 1/0.45 inch: an adult comes out
    assert motion.metres_per_unit == pytest.approx(0.0254 / 0.45)
    assert 1.4 < motion.skeleton.height * motion.metres_per_unit < 2.0


def test_the_second_acclaim_take_reads_too(real_data: Path) -> None:
    folder = real_data / "mocap"
    motion = read_asf_amc(folder / "charleston.asf", folder / "charleston1.amc")
    frames = range(0, len(motion), 100)
    require_agreement(
        motion, acclaim_starts(folder / "charleston.asf", folder / "charleston1.amc", frames), frames
    )


def test_shipped_walk_agrees_and_is_what_the_generator_makes() -> None:
    motion = read_bvh(DATA / "walk.bvh")
    frames = range(0, len(motion), 40)
    require_agreement(motion, bvh_positions(DATA / "walk.bvh", frames), frames)
    generated = walking_motion()
    assert motion.skeleton.names == generated.skeleton.names
    theirs, ours = positions_of(motion, frames), positions_of(generated, frames)
    # four decimals of a degree over a chain of 2 m, and of a centimetre
    assert np.abs(theirs - ours).max() < 1e-3


def test_walker_stands_on_the_floor_and_advances() -> None:
    motion = walking_motion()
    frames = range(len(motion))
    feet = [motion.skeleton.names.index(f"{side}Foot") for side in ("Left", "Right")]
    positions = positions_of(motion, frames)[:, feet]
    assert positions[..., 1].min() > 0
    assert positions[..., 1].min(axis=1).max() < 20  # one ankle is near the floor in every frame
    assert np.all(np.diff(motion.root_positions[:, 2]) <= 1e-9)  # towards the camera
    assert -motion.root_positions[-1, 2] / motion.duration_s == pytest.approx(140, abs=40)  # cm/s, a walk


def test_bvh_round_trip_keeps_the_motion(tmp_path: Path) -> None:
    motion = walking_motion()
    write_bvh(tmp_path / "walk.bvh", motion)
    again = read_bvh(tmp_path / "walk.bvh")
    frames = range(0, len(motion), 30)
    assert np.abs(positions_of(again, frames) - positions_of(motion, frames)).max() < 1e-3
    assert again.frame_rate_hz == pytest.approx(motion.frame_rate_hz)


def test_rest_pose_is_no_turn() -> None:
    skeleton = walking_motion().skeleton
    still = np.tile([0.0, 0, 0, 1], (1, len(skeleton.names), 1))
    pose = forward_kinematics(skeleton, still, skeleton.offsets[:1])[0]
    np.testing.assert_allclose(pose[:, :3, 3], skeleton.rest_positions, atol=1e-12)
    np.testing.assert_allclose(pose[:, :3, :3], np.tile(np.eye(3), (len(skeleton.names), 1, 1)), atol=0)
