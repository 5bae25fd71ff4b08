"""BVH motion capture: read as exporters write it, written with three rotations a joint.

A joint may have any channels, from none to three positions and three rotations. Words are told apart by white
space, so that lines may be wrapped or joined; numbers may have decimal commas, and the text may be UTF-8 or
UTF-16.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray
from vntoolkit.errors import BadMotion
from vntoolkit.geometry.motion import Motion, Skeleton
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.conventions import motion_with_axes_turned
from vntoolkit.io.files import require_size

MAX_MOTION_BYTES = 256 * 2**20  # ten minutes at 120 Hz of 31 joints are 50 MB
MAX_DEPTH = 256  # of joints one below the other; a figure's fingers are a dozen deep
MAX_JOINTS = 4096
_LONGEST_HIERARCHY = 1 << 20  # characters
_MOVED = 1e-3  # of the skeleton's size: less is the rounding of files
_WRITTEN_ORDER = "ZXY"
_CHANNELS = {f"{axis}{kind}" for axis in "xyz" for kind in ("position", "rotation")}
_WORD = re.compile(r"[{}]|[^\s{}]+")
_TIMING = re.compile(r"\s*Frames\s*:\s*(\S+)\s+Frame\s*Time\s*:\s*(\S+)", re.IGNORECASE)


@dataclass(kw_only=True)
class _Joint:
    """A joint as its lines are read; `line` is where it begins, parent −1 the root's."""

    name: str
    line: int
    parent: int
    offset: list[float] | None = None
    channels: list[str] | None = None
    tips: list[list[float]] = field(default_factory=list)


class _Words:
    """The words of a text from one place on; `line` is that of the last one taken."""

    def __init__(self, text: str, name: str, at: int = 0) -> None:
        self.text, self.name, self.at = text, name, at
        self._found = _WORD.finditer(text, at)

    @property
    def line(self) -> int:
        return self.text.count("\n", 0, self.at) + 1

    def fault(self, what: str) -> BadMotion:
        return BadMotion(f"{self.name}: line {self.line}: {what}")

    def next(self) -> str:
        found = next(self._found, None)
        if found is None:
            raise self.fault("no MOTION section: the file is truncated or not BVH")
        self.at = found.end()
        return found[0]

    def numbers(self, count: int) -> list[float]:
        return [self.number() for _ in range(count)]

    def number(self) -> float:
        word = self.next()
        try:
            value = float(word.replace(",", "."))
        except ValueError:
            raise self.fault(f"expected a number, got '{word[:40]}'") from None
        if not np.isfinite(value):
            raise self.fault(f"expected a finite number, got '{word[:40]}'")
        return value

    def name_of_joint(self) -> str:
        """Return the words before the opening brace."""
        words: list[str] = []
        while (word := self.next()) != "{":
            words.append(word)
            if word in ("}", "OFFSET", "MOTION"):
                raise self.fault(f"expected {{ after a joint's name, got '{word}'")
        return " ".join(words)


def read_bvh(path: Path) -> Motion:
    """Read a BVH file; no joint is turned in the rest pose, lengths stay in the file's own unit.

    Position channels replace the OFFSET of their joint. Below the root they may not move, since bones keep
    their length. Raises `BadMotion`.
    """
    require_motion_file(path)
    with path.open("rb") as start:
        marks = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        encoding = "utf-16" if start.read(2) in marks else "utf-8-sig"
    with path.open(encoding=encoding, errors="replace") as file:
        words = _Words(file.read(_LONGEST_HIERARCHY), path.name)
        joints = _read_hierarchy(words)
        words.text += file.read()
    width = sum(len(joint.channels or ()) for joint in joints)
    values, frame_s = _read_frames(words, width)
    offsets = np.array([joint.offset for joint in joints])
    rotations = np.empty((len(values), len(joints), 4))
    root_positions = np.tile(offsets[0], (len(values), 1))
    size = float(np.ptp(offsets, axis=0).max() + np.abs(offsets[1:]).sum())
    column = 0
    for index, joint in enumerate(joints):
        channels = joint.channels or []
        own = values[:, column : column + len(channels)]
        column += len(channels)
        turns = [k for k, channel in enumerate(channels) if channel.endswith("rotation")]
        order = "".join(channels[k][0].upper() for k in turns)  # outermost first: scipy's capital letters
        rotations[:, index] = (
            Rotation.from_euler(order, own[:, turns], degrees=True).as_quat() if turns else [0, 0, 0, 1]
        )
        places = {"xyz".index(c[0]): k for k, c in enumerate(channels) if c.endswith("position")}
        if index == 0:
            for axis, k in places.items():
                root_positions[:, axis] = own[:, k]
        elif places:
            _require_a_rigid_bone(own[:, list(places.values())], joint, size, path.name)
            offsets[index, list(places)] = own[:, list(places.values())].mean(axis=0)
    skeleton = Skeleton(
        names=tuple(joint.name for joint in joints),
        parents=np.array([joint.parent for joint in joints]),
        offsets=offsets,
        tip_joints=np.array([k for k, joint in enumerate(joints) for _ in joint.tips], dtype=np.int64),
        tip_offsets=np.array([tip for joint in joints for tip in joint.tips]).reshape(-1, 3),
    )
    return motion_with_axes_turned(
        Motion(
            skeleton=skeleton,
            rotations=rotations,
            root_positions=root_positions,
            frame_rate_hz=1.0 / frame_s,
        )
    )


def require_motion_file(path: Path) -> Path:
    """Return the path of a file that exists and is small enough to be read in bounded memory."""
    return require_size(path, MAX_MOTION_BYTES, "a motion; cut the recording into takes", BadMotion)


def _read_hierarchy(words: _Words) -> list[_Joint]:
    """Read up to the word MOTION."""
    joints: list[_Joint] = []
    open_joints: list[int] = []
    names: set[str] = set()
    if (word := words.next()).upper() != "HIERARCHY":
        raise words.fault(f"expected HIERARCHY, got '{word[:40]}'")
    while (word := words.next()).upper() != "MOTION":
        match word.upper():
            case "ROOT" | "JOINT":
                joints.append(_begin_joint(words, word.upper(), joints, open_joints, names))
                open_joints.append(len(joints) - 1)
            case "END" if open_joints:
                words.name_of_joint()
                joints[open_joints[-1]].tips.append(_read_tip(words))
            case "OFFSET" if open_joints:
                joints[open_joints[-1]].offset = words.numbers(3)
            case "CHANNELS" if open_joints:
                joints[open_joints[-1]].channels = _read_channels(words)
            case "}" if open_joints:
                closed = joints[open_joints.pop()]
                if closed.offset is None:
                    raise words.fault(f"joint '{closed.name}' has no OFFSET")
            case _:
                raise words.fault(
                    f"expected ROOT, JOINT, End Site, OFFSET, CHANNELS or }}, got '{word[:40]}'"
                )
    if open_joints:
        raise words.fault(f"{len(open_joints)} unmatched braces in the hierarchy")
    if not joints:
        raise words.fault("no ROOT in the hierarchy")
    return joints


def _begin_joint(
    words: _Words, kind: str, joints: list[_Joint], open_joints: list[int], names: set[str]
) -> _Joint:
    """Read a joint's name and check its place in the tree."""
    line = words.line
    if kind == "ROOT" and joints:
        raise words.fault("a second ROOT: expected one figure a file; write each figure as a file of its own")
    if kind == "JOINT" and not open_joints:
        raise words.fault("a JOINT outside any ROOT")
    name = words.name_of_joint()
    if not name or name in names:
        raise words.fault(f"joint '{name}' occurs twice or has no name (a cycle?)")
    names.add(name)
    if len(open_joints) >= MAX_DEPTH:
        raise words.fault(f"a chain of more than {MAX_DEPTH} joints: this is no figure")
    if len(joints) >= MAX_JOINTS:
        raise words.fault(f"more than {MAX_JOINTS} joints: this is no figure")
    return _Joint(name=name, line=line, parent=open_joints[-1] if open_joints else -1)


def _read_tip(words: _Words) -> list[float]:
    """Read the OFFSET of an End Site and its closing brace."""
    if (word := words.next()).upper() != "OFFSET":
        raise words.fault(f"expected the OFFSET of an End Site, got '{word[:40]}'")
    offset = words.numbers(3)
    if (word := words.next()) != "}":
        raise words.fault(f"expected }} after an End Site, got '{word[:40]}'")
    return offset


def _read_channels(words: _Words) -> list[str]:
    """Read a count and as many names of channels."""
    count = words.next()
    if not count.isdigit() or int(count) > len(_CHANNELS):
        raise words.fault(f"expected 0 to {len(_CHANNELS)} channels, got '{count[:40]}'")
    channels: list[str] = []
    for _ in range(int(count)):
        channel = words.next()
        if channel.lower() not in _CHANNELS or channel.lower() in channels:
            raise words.fault(
                f"expected {count} different channels such as Xposition and Zrotation, got '{channel[:40]}'"
            )
        channels.append(channel.lower())
    return channels


def _read_frames(words: _Words, channels: int) -> tuple[FloatArray, float]:
    """Return the values (f, channels) below MOTION, and the time of a frame in seconds."""
    timing = _TIMING.match(words.text, words.at)
    if timing is None:
        raise words.fault("expected 'Frames: N' and 'Frame Time: SECONDS' after MOTION")
    count, frame_s = timing[1], _Words(words.text, words.name, timing.start(2)).number()
    if not count.isdigit() or int(count) == 0:
        raise words.fault(f"expected at least one frame, got 'Frames: {count[:40]}'")
    if frame_s <= 0:
        raise words.fault(f"expected a frame time above 0 s, got {frame_s:g}")
    numbers = words.text[timing.end() :]
    if "," in numbers and "." in numbers:
        raise words.fault("the frames hold both commas and points: which of them is decimal?")
    try:
        values = np.fromstring(numbers.replace(",", ".").strip(), sep=" ")
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all():
        rest = _Words(words.text, words.name, timing.end())
        while True:
            rest.number()  # the first that is none raises
    if len(values) != int(count) * channels:
        raise words.fault(
            f"expected {count} frames of {channels} numbers, got {len(values)} numbers, "
            f"{len(values) / max(channels, 1):.4g} frames"
        )
    return values.reshape(int(count), channels), _whole_rate(timing[2], frame_s)


def _whole_rate(written: str, frame_s: float) -> float:
    """Return the time of a frame, in seconds, of the whole rate that was rounded to the written decimals."""
    decimals = len(re.split("[.,]", written)[-1]) if re.fullmatch(r"\d*[.,]\d+", written) else 0
    rate = max(round(1.0 / frame_s), 1)
    return 1.0 / rate if decimals and abs(1.0 / rate - frame_s) <= 0.5 * 10.0**-decimals else frame_s


def _require_a_rigid_bone(positions: FloatArray, joint: _Joint, size: float, name: str) -> None:
    """Raise where the position channels (f, n) of a joint below the root move, or collapse its bone."""
    moved = float(np.ptp(positions, axis=0).max())
    if moved > _MOVED * size:
        raise BadMotion(
            f"{name}: line {joint.line}: joint '{joint.name}' moves by {moved:.3g} against its parent, "
            "and bones keep their length here; bake the motion into rotations, with positions at the root"
        )
    if not positions.any() and any(joint.offset or ()):
        raise BadMotion(
            f"{name}: line {joint.line}: the positions of joint '{joint.name}' are all 0, and its OFFSET is "
            "not; leave out the position channels below the root"
        )


def write_bvh(path: Path, motion: Motion) -> None:
    """Write a motion as BVH with channels Zrotation Xrotation Yrotation, rounded to four decimals, y up.

    The unit of length is the motion's; BVH has no place to say which that is. Raises `BadMotion` where other
    joints come between a joint and its descendants: the file lists them in that order.
    """
    turned = motion_with_axes_turned(motion)
    # not about a right angle, where any such pair of others is right
    turns = Rotation.from_quat(turned.rotations)
    angles = turns.as_euler(_WRITTEN_ORDER, degrees=True, suppress_warnings=True).reshape(len(motion), -1)
    values = np.round(np.concatenate([turned.root_positions, angles], axis=1), 4) + 0.0  # no −0
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write("HIERARCHY\n")
        file.writelines(_hierarchy_lines(turned.skeleton))
        file.write(f"MOTION\nFrames: {len(values)}\nFrame Time: {1 / turned.frame_rate_hz:.8g}\n")
        np.savetxt(file, values, fmt="%.4f")


def _hierarchy_lines(skeleton: Skeleton) -> Iterator[str]:
    """Yield the lines of the tree of joints; the root's channels are positions and rotations."""
    rotations = " ".join(f"{axis}rotation" for axis in _WRITTEN_ORDER)
    line_of_descent: list[int] = []
    for index, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
        if parent >= 0 and parent not in line_of_descent:
            raise BadMotion(
                "skeleton: expected every joint before its children without interruption, as BVH needs"
            )
        depth = line_of_descent.index(parent) + 1 if parent >= 0 else 0
        yield from _closing_lines(len(line_of_descent), depth)
        line_of_descent = [*line_of_descent[:depth], index]
        tab = "\t" * depth
        channels = f"3 {rotations}" if depth else f"6 Xposition Yposition Zposition {rotations}"
        yield f"{tab}{'JOINT' if depth else 'ROOT'} {name}\n{tab}{{\n"
        yield f"{tab}\tOFFSET {_coordinates(skeleton.offsets[index])}\n{tab}\tCHANNELS {channels}\n"
        for tip in skeleton.tip_offsets[skeleton.tip_joints == index]:
            yield f"{tab}\tEnd Site\n{tab}\t{{\n{tab}\t\tOFFSET {_coordinates(tip)}\n{tab}\t}}\n"
    yield from _closing_lines(len(line_of_descent), 0)


def _closing_lines(depth: int, down_to: int) -> Iterator[str]:
    """Yield the closing braces from one depth of joints to a lower one."""
    return ("\t" * level + "}\n" for level in range(depth - 1, down_to - 1, -1))


def _coordinates(point: FloatArray) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in point)
