"""Acclaim motion capture: a skeleton in ASF, its motion in AMC (no maintained library reads them).

A bone's channels turn it about axes C of its own: R = C E(rx, ry, rz) C⁻¹, with both C and E taken in
the order that `axis` names, first letter first about fixed axes. A joint sits where its bone begins.
The length unit: 1 in the file is 1/`length` inches, as the CMU library documents its files.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, Vector3
from vntoolkit.errors import BadMotion
from vntoolkit.geometry.motion import Motion, Skeleton
from vntoolkit.io.conventions import motion_with_axes_turned
from vntoolkit.io.files import read_text, require_file
from vntoolkit.io.motion.bvh import require_motion_size

CMU_FRAME_RATE_HZ = 120.0  # AMC carries no rate; the CMU library's takes are recorded at 120 Hz
_INCH_M = 0.0254
_DEG_PER_RAD = 180.0 / np.pi
_MAX_LINE = 65536
_FRAME = re.compile(r"[0-9]{1,9}")
MAX_ASF_BYTES = 4 * 2**20  # the CMU skeletons have 7 kB


def read_asf_amc(asf_path: Path, amc_path: Path) -> Motion:
    """Read an ASF skeleton with its AMC motion; lengths stay in the file's unit. Raises `BadMotion`."""
    asf = read_asf(asf_path)
    require_motion_size(amc_path)
    values, degrees = _read_amc(amc_path, asf)
    angle_unit = 1.0 if degrees else _DEG_PER_RAD
    rotations = np.empty((len(values), len(asf.bones), 4))
    column = 0
    root_positions = np.tile(asf.root_position, (len(values), 1))
    for index, bone in enumerate(asf.bones):
        channels = values[:, column : column + len(bone.channels)]
        column += len(bone.channels)
        rotations[:, index] = _bone_rotations(bone, channels, angle_unit)
        for channel, name in enumerate(bone.channels):
            if name.startswith("t"):
                root_positions[:, "xyz".index(name[1])] += channels[:, channel]
    return motion_with_axes_turned(
        Motion(
            skeleton=_skeleton_of(asf),
            rotations=rotations,
            root_positions=root_positions,
            frame_rate_hz=CMU_FRAME_RATE_HZ,
            metres_per_unit=_INCH_M / asf.length,
        )
    )


def _bone_rotations(bone: AsfBone, channels: FloatArray, angle_unit: float) -> FloatArray:
    """Return (frames, 4) quaternions of one bone from its channels (frames, c)."""
    angles = np.zeros((len(channels), 3))
    for channel, name in enumerate(bone.channels):
        if name.startswith("r"):
            angles[:, bone.order.index(name[1])] = channels[:, channel] * angle_unit
    own_axes = Rotation.from_euler(bone.order, bone.axis_deg, degrees=True)
    return (own_axes * Rotation.from_euler(bone.order, angles, degrees=True) * own_axes.inv()).as_quat()


def _skeleton_of(asf: AsfSkeleton) -> Skeleton:
    ends: list[Vector3] = [bone.direction * bone.length for bone in asf.bones]
    parents = np.array([bone.parent for bone in asf.bones])
    leaves = [index for index in range(1, len(asf.bones)) if index not in set(parents.tolist())]
    offsets = np.array([asf.root_position if p < 0 else ends[p] for p in parents])
    return Skeleton(
        names=tuple(bone.name for bone in asf.bones),
        parents=parents,
        offsets=offsets,
        tip_joints=np.array(leaves, dtype=np.int64),
        tip_offsets=np.array([ends[leaf] for leaf in leaves]).reshape(-1, 3),
    )


def _read_amc(path: Path, asf: AsfSkeleton) -> tuple[FloatArray, bool]:
    """Return the values (frames, channels) in the order of the bones, and whether angles are degrees."""
    moving = {bone.name: bone for bone in asf.bones if bone.channels}
    rows = array("d")
    values: dict[str, list[float]] = {}
    frame, count, degrees = 0, 0, asf.degrees
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(iter(lambda: file.readline(_MAX_LINE), ""), start=1):
            words = line.split()
            if not words or words[0].startswith("#"):
                continue
            where = f"{path.name}, line {number}"
            if words[0].startswith(":"):
                degrees = {":DEGREES": True, ":RADIANS": False}.get(words[0].upper(), degrees)
            elif len(words) == 1 and _FRAME.fullmatch(words[0]):
                if frame:
                    rows.extend(_whole_frame(values, moving, f"{where}: frame {frame}"))
                    if int(words[0]) != frame + 1:
                        raise BadMotion(f"{where}: expected frame {frame + 1}, got {words[0][:20]}")
                frame, count, values = int(words[0]), count + 1, {}
            elif not frame:
                raise BadMotion(f"{where}: expected a frame number, got {words[0][:40]!r}")
            else:
                values[words[0]] = _bone_values(words, moving, where)
    if not frame:
        raise BadMotion(f"{path.name}: no frame found: the file is empty or not AMC")
    rows.extend(_whole_frame(values, moving, f"{path.name}, last frame: frame {frame}"))
    width = sum(len(bone.channels) for bone in moving.values())
    return np.frombuffer(rows, dtype=np.float64).reshape(count, width), degrees


def _bone_values(words: list[str], moving: dict[str, AsfBone], where: str) -> list[float]:
    """Return the values of one bone's line: its name and a number for each of its channels."""
    name = words[0]
    if name not in moving:
        raise BadMotion(f"{where}: the skeleton has no moving bone {name[:40]!r}")
    count = len(moving[name].channels)
    if len(words) - 1 != count:
        raise BadMotion(f"{where}: {name} has {count} channels, got {len(words) - 1} values")
    try:
        values = [float(word) for word in words[1:]]
    except ValueError as error:
        raise BadMotion(f"{where}: expected numbers for {name} ({str(error)[:200]})") from error
    if not np.isfinite(values).all():
        raise BadMotion(f"{where}: {name} holds NaN or infinity")
    return values


def _whole_frame(values: dict[str, list[float]], moving: dict[str, AsfBone], where: str) -> list[float]:
    """Return the values of a frame in the order of the bones, or raise where some are missing."""
    missing = [bone for bone in moving.values() if bone.name not in values]
    if missing:
        lacks, of = (sum(len(bone.channels) for bone in bones) for bones in (missing, moving.values()))
        raise BadMotion(
            f"{where} lacks {lacks} of {of} values (first: {missing[0].name}): the file is truncated or "
            "belongs to another skeleton"
        )
    return [value for name in moving for value in values[name]]


@dataclass(frozen=True, kw_only=True, eq=False)
class AsfBone:
    """One bone as the file has it (y up).

    direction, length: where the bone points in the rest pose, and how far. axis_deg, order: its own axes.
    channels: what the motion gives it, as ("rx", "rz"). parent: index into the bones, −1 for the root.
    """

    name: str
    direction: Vector3
    length: float
    axis_deg: Vector3
    order: str
    channels: tuple[str, ...]
    parent: int = -1


@dataclass(frozen=True, kw_only=True, eq=False)
class AsfSkeleton:
    """bones: depth first, the root before all. root_position: (3,). length: of `:units`."""

    bones: tuple[AsfBone, ...]
    root_position: Vector3
    length: float
    degrees: bool


_LONGEST_REASON = 200


def read_asf(path: Path) -> AsfSkeleton:
    """Read an ASF skeleton; raises `BadMotion` on anything malformed, cycles included."""
    size = require_file(path, BadMotion).stat().st_size
    if size > MAX_ASF_BYTES:
        raise BadMotion(f"{path.name}: {size / 2**20:.0f} MiB is no ASF skeleton")
    text = read_text(path, BadMotion)
    try:
        return _skeleton_from_sections(_sections(text))
    except BadMotion as error:
        raise BadMotion(f"{path.name}: {str(error)[:_LONGEST_REASON]}") from error
    except (KeyError, IndexError, ValueError) as error:
        raise BadMotion(
            f"{path.name}: malformed ASF ({type(error).__name__}: {str(error)[:_LONGEST_REASON]})"
        ) from error


def _skeleton_from_sections(sections: dict[str, list[list[str]]]) -> AsfSkeleton:
    units = {words[0]: words[1] for words in sections["units"]}
    degrees = units.get("angle", "deg").startswith("deg")
    length = float(units.get("length", "1"))
    if not 0 < length < np.inf:
        raise BadMotion(f"expected a positive length unit, got {length}")
    angle_unit = 1.0 if degrees else _DEG_PER_RAD
    root, position = _root(sections["root"], angle_unit)
    bones = {"root": root}
    for block in _blocks(sections["bonedata"]):
        bone = _bone(block, angle_unit)
        if bone.name in bones:
            raise BadMotion(f"bone {bone.name} occurs twice")
        bones[bone.name] = bone
    children = _children(sections["hierarchy"], bones)
    return AsfSkeleton(
        bones=_depth_first(bones, children), root_position=position, length=length, degrees=degrees
    )


def _sections(text: str) -> dict[str, list[list[str]]]:
    """Split into {section: lines of words}; comments and empty lines fall away."""
    sections: dict[str, list[list[str]]] = {}
    lines: list[list[str]] = []
    for line in text.splitlines():
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        if words[0].startswith(":"):
            lines = sections.setdefault(words[0][1:].lower(), [])
            words = words[1:]
        if words:
            lines.append(words)
    missing = [name for name in ("units", "root", "bonedata", "hierarchy") if name not in sections]
    if missing:
        raise BadMotion(f"no section :{missing[0]}: the file is truncated or not ASF")
    return sections


def _blocks(lines: list[list[str]]) -> Iterator[dict[str, list[str]]]:
    """Yield each `begin … end` block as {keyword: values}; the brackets of `limits` are not needed."""
    block: dict[str, list[str]] | None = None
    for words in lines:
        if words[0] == "begin":
            if block is not None:
                raise BadMotion("a bone begins inside another one")
            block = {}
        elif block is None:
            raise BadMotion(f"expected begin, got {words[0]!r}")
        elif words[0] == "end":
            yield block
            block = None
        elif not words[0].startswith("("):
            block[words[0]] = words[1:]
    if block is not None:
        raise BadMotion("the last bone has no end: the file is truncated")


_LARGEST = 1e12  # of a length or an angle


def _vector(words: list[str], what: str) -> Vector3:
    vector = np.array([float(word) for word in words[:3]])
    if vector.shape != (3,) or not (np.abs(vector) < _LARGEST).all():
        raise BadMotion(f"{what}: expected three finite numbers, got {' '.join(words[:4])!r}")
    return vector


def _order(word: str, what: str) -> str:
    if sorted(word.lower()) != ["x", "y", "z"]:
        raise BadMotion(f"{what}: expected an order of axes such as XYZ, got {word!r}")
    return word.lower()


def _channels(words: list[str], allowed: tuple[str, ...], what: str) -> tuple[str, ...]:
    channels = tuple(word.lower() for word in words)
    if len(set(channels)) != len(channels) or not set(channels) <= set(allowed):
        raise BadMotion(f"{what}: expected channels among {' '.join(allowed)}, got {' '.join(words)!r}")
    return channels


_CHANNELS = ("rx", "ry", "rz", "tx", "ty", "tz")


def _root(lines: list[list[str]], angle_unit: float) -> tuple[AsfBone, Vector3]:
    values = {words[0]: words[1:] for words in lines}
    bone = AsfBone(
        name="root",
        direction=np.zeros(3),
        length=0.0,
        axis_deg=_vector(values["orientation"], "root orientation") * angle_unit,
        order=_order(values["axis"][0], "root axis"),
        channels=_channels(values["order"], _CHANNELS, "root order"),
    )
    return bone, _vector(values["position"], "root position")


def _bone(block: dict[str, list[str]], angle_unit: float) -> AsfBone:
    name = block["name"][0]
    length = float(block["length"][0])
    if not 0 <= length < _LARGEST:
        raise BadMotion(f"bone {name}: expected a length, got {length}")
    return AsfBone(
        name=name,
        direction=_vector(block["direction"], f"bone {name}, direction"),
        length=length,
        axis_deg=_vector(block["axis"], f"bone {name}, axis") * angle_unit,
        order=_order(block["axis"][3], f"bone {name}, axis"),
        channels=_channels(block.get("dof", []), _CHANNELS[:3], f"bone {name}, dof"),
    )


def _children(lines: list[list[str]], bones: dict[str, AsfBone]) -> dict[str, list[str]]:
    """Return {bone: its children}; every bone but the root must be somebody's child, once."""
    children: dict[str, list[str]] = {name: [] for name in bones}
    owned = {"root"}
    if not lines or lines[-1][0] != "end":
        raise BadMotion("the hierarchy has no end: the file is truncated")
    for parent, *names in lines:
        if parent in ("begin", "end"):
            continue
        for name in (parent, *names):
            if name not in bones:
                raise BadMotion(f"the hierarchy names {name!r}, which has no bone data")
        for name in names:
            if name in owned:
                raise BadMotion(f"cyclic hierarchy: {name!r} has two parents")
            owned.add(name)
        children[parent] += names
    return children


def _depth_first(bones: dict[str, AsfBone], children: dict[str, list[str]]) -> tuple[AsfBone, ...]:
    """Order the bones so that parents come first; bones the root does not reach hang in a cycle."""
    ordered: list[AsfBone] = []
    waiting = [("root", -1)]
    while waiting:
        name, parent = waiting.pop()
        waiting += [(child, len(ordered)) for child in reversed(children[name])]
        ordered.append(replace(bones[name], parent=parent))
    lost = set(bones) - {bone.name for bone in ordered}
    if lost:
        raise BadMotion(f"cyclic hierarchy: the root does not reach {', '.join(sorted(lost)[:5])}")
    return tuple(ordered)
