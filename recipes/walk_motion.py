"""The walk that the project ships, written anew: `data/walk.bvh`.

    python recipes/walk_motion.py --out data        # 1 s

Sines, no captured person: four strides of a figure 1.73 m tall, in centimetres, at 60 Hz. The joints turn
with the first two harmonics of the stride, the lower foot stands on the floor, and the figure advances by
what that foot is swept back.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray
from vntoolkit.geometry.motion import Motion, Skeleton, forward_kinematics
from vntoolkit.io.motion.bvh import write_bvh

# joint, its parent, and the way from there in centimetres (x to the figure's left, y up, z forwards)
_JOINTS = (
    ("Hips", -1, (0, 95, 0)), ("Spine", 0, (0, 10, -1)), ("Chest", 1, (0, 20, 0)),
    ("Neck", 2, (0, 22, -1)), ("Head", 3, (0, 10, 2)),
    ("LeftShoulder", 2, (3, 17, 0)), ("LeftArm", 5, (14, 0, 0)),
    ("LeftForeArm", 6, (20, -20, 0)), ("LeftHand", 7, (17, -17, 3)),
    ("RightShoulder", 2, (-3, 17, 0)), ("RightArm", 9, (-14, 0, 0)),
    ("RightForeArm", 10, (-20, -20, 0)), ("RightHand", 11, (-17, -17, 3)),
    ("LeftUpLeg", 0, (9, -4, 0)), ("LeftLeg", 13, (0, -42, 1)), ("LeftFoot", 14, (0, -41, -2)),
    ("RightUpLeg", 0, (-9, -4, 0)), ("RightLeg", 16, (0, -42, 1)), ("RightFoot", 17, (0, -41, -2)),
)  # fmt: skip
_TIPS = {"Head": (0, 18, 0), "LeftHand": (6, -6, 2), "RightHand": (-6, -6, 2),
         "LeftFoot": (0, -6, 16), "RightFoot": (0, -6, 16)}  # fmt: skip
_CAMERA_FROM_FIGURE = np.diag([1.0, -1.0, -1.0])
_CENTIMETRE_M = 0.01
_STRIDE_S = 1.2  # of a double step at a comfortable pace


def main(out: Path) -> None:
    """Write `walk.bvh` into the folder `out`."""
    write_bvh(out / "walk.bvh", walking_motion())


def walking_motion(strides: int = 4, frame_rate_hz: float = 60.0) -> Motion:
    """Return a walk in centimetres (the figure is 1.73 m tall), camera axes, towards the camera.

    strides: number of double steps.
    """
    count = round(strides * _STRIDE_S * frame_rate_hz) + 1
    phase = 2 * np.pi * np.arange(count) / (_STRIDE_S * frame_rate_hz)
    skeleton = _figure()
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (count, len(skeleton.names), 1))
    for name, angles in _angles_deg(phase).items():
        turns = Rotation.from_euler("zxy", angles, degrees=True)
        rotations[:, skeleton.names.index(name)] = turns.as_quat()
    motion = Motion(
        skeleton=skeleton,
        rotations=rotations,
        root_positions=_root_positions(skeleton, rotations),
        frame_rate_hz=frame_rate_hz,
        metres_per_unit=_CENTIMETRE_M,
    )
    return motion.turned(_CAMERA_FROM_FIGURE)


def _figure() -> Skeleton:
    names = tuple(name for name, _, _ in _JOINTS)
    return Skeleton(
        names=names,
        parents=np.array([parent for _, parent, _ in _JOINTS]),
        offsets=np.array([offset for _, _, offset in _JOINTS], dtype=np.float64),
        tip_joints=np.array([names.index(name) for name in _TIPS]),
        tip_offsets=np.array(list(_TIPS.values()), dtype=np.float64),
    )


def _angles_deg(phase: FloatArray) -> dict[str, FloatArray]:
    """Return joint → (frames, 3) angles about z, x, y; negative x swings a limb forwards."""
    angles: dict[str, FloatArray] = {
        "Hips": np.stack([2 * np.sin(phase), 0 * phase, 6 * np.sin(phase)], axis=1),
        "Spine": np.stack([-2 * np.sin(phase), 3 + 0 * phase, -8 * np.sin(phase)], axis=1),
        "Chest": np.stack([0 * phase, 2 + np.sin(2 * phase), -6 * np.sin(phase)], axis=1),
    }
    for side, sign, own in (("Left", 1.0, phase), ("Right", -1.0, phase + np.pi)):
        swing = np.sin(own)
        bend = 5 + 55 * np.maximum(0, np.cos(own + 0.35)) ** 2  # the knee bends while its leg comes forwards
        angles[f"{side}UpLeg"] = np.stack([0 * own, -4 - 24 * swing, 0 * own], axis=1)
        angles[f"{side}Leg"] = np.stack([0 * own, bend, 0 * own], axis=1)
        angles[f"{side}Foot"] = np.stack([0 * own, 24 * swing + 4 - 0.75 * bend, 0 * own], axis=1)
        lowered = -sign * 28 + 0 * own  # from the rest pose's 45° towards the body
        angles[f"{side}Arm"] = np.stack([lowered, 25 * swing, 0 * own], axis=1)
        angles[f"{side}ForeArm"] = np.stack([0 * own, -22 + 14 * swing, 0 * own], axis=1)
    return angles


def _root_positions(skeleton: Skeleton, rotations: FloatArray) -> FloatArray:
    """Put the lower foot on the floor, and advance by what it moves backwards under the hips."""
    still = np.zeros((len(rotations), 3))
    poses = forward_kinematics(skeleton, rotations, still)
    feet = [skeleton.names.index("LeftFoot"), skeleton.names.index("RightFoot")]
    soles = poses[:, :, :3, 3][:, feet].copy()
    for place, foot in enumerate(feet):
        tip = skeleton.tip_offsets[skeleton.tip_joints == foot][0]
        toe = soles[:, place] + poses[:, foot, :3, :3] @ tip
        soles[:, place, 1] = np.minimum(soles[:, place, 1] - 8.0, toe[:, 1])  # heel: 8 cm below the ankle
    standing = np.argmin(soles[..., 1], axis=1)
    frames = np.arange(len(rotations))
    still[:, 1] = -soles[frames, standing, 1]
    steps = soles[frames[:-1], standing[:-1], 2] - soles[frames[1:], standing[:-1], 2]
    still[1:, 2] = np.cumsum(np.maximum(steps, 0.0))
    return still


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("data"), help="folder to write")
    main(parser.parse_args().out)
