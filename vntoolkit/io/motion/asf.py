"""Acclaim motion capture: a skeleton in ASF, its motion in AMC (no maintained library reads them).

A bone's channels turn it about axes C of its own: R = C E(rx, ry, rz) C⁻¹, with both C and E taken in
the order that `axis` names, first letter first about fixed axes. A joint sits where its bone begins.
The length unit: 1 in the file is 1/`length` inches, as the CMU library documents its files.
"""

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, Vector3
from vntoolkit.errors import BadMotion
from vntoolkit.geometry.motion import Motion, Skeleton
from vntoolkit.io.conventions import motion_with_axes_turned
from vntoolkit.io.files import read_text, text_lines
from vntoolkit.io.motion.bvh import require_motion_file

CMU_FRAME_RATE_HZ = 120.0  # AMC carries no rate; the CMU library's takes are recorded at 120 Hz
_INCH_M = 0.0254
_DEG_PER_RAD = 180.0 / np.pi
_LONGEST_REASON = 200
_LARGEST = 1e12  # of a length or an angle
_FRAME = re.compile(r"[0-9]{1,9}")
_CHANNELS = ("rx", "ry", "rz", "tx", "ty", "tz")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Bone:
    """One bone as the file has it (y up).

    end: where it ends from where it begins, in the rest pose. own_axes: C, by angles in `order`. channels:
    what the motion gives it, as ("rx", "rz").
    """

    end: Vector3
    own_axes: Rotation
    order: str
    channels: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Figure:
    """bones: depth first, the root before all. parents: the place of each one's. length: of `:units`."""

    bones: dict[str, _Bone]
    parents: list[int]
    root_position: Vector3
    length: float
    degrees: bool


def read_asf_amc(asf_path: Path, amc_path: Path) -> Motion:
    """Read an ASF skeleton with its AMC motion; lengths stay in the file's unit. Raises `BadMotion`."""
    figure = _read_asf(asf_path)
    values, degrees = _read_amc(require_motion_file(amc_path), figure)
    angle_unit = 1.0 if degrees else _DEG_PER_RAD
    rotations = np.empty((len(values), len(figure.bones), 4))
    root_positions = np.tile(figure.root_position, (len(values), 1))
    columns = iter(values.T)
    for index, bone in enumerate(figure.bones.values()):
        angles = np.zeros((len(values), 3))
        for name, column in zip(bone.channels, columns, strict=False):
            if name.startswith("r"):
                angles[:, bone.order.index(name[1])] = column * angle_unit
            else:
                root_positions[:, "xyz".index(name[1])] += column
        turns = Rotation.from_euler(bone.order, angles, degrees=True)
        rotations[:, index] = (bone.own_axes * turns * bone.own_axes.inv()).as_quat()
    return motion_with_axes_turned(
        Motion(
            skeleton=_skeleton_of(figure),
            rotations=rotations,
            root_positions=root_positions,
            frame_rate_hz=CMU_FRAME_RATE_HZ,
            metres_per_unit=_INCH_M / figure.length,
        )
    )


def _skeleton_of(figure: _Figure) -> Skeleton:
    ends = [bone.end for bone in figure.bones.values()]
    leaves = [index for index in range(1, len(ends)) if index not in figure.parents]
    return Skeleton(
        names=tuple(figure.bones),
        parents=np.array(figure.parents),
        offsets=np.array([figure.root_position if p < 0 else ends[p] for p in figure.parents]),
        tip_joints=np.array(leaves, dtype=np.int64),
        tip_offsets=np.array([ends[leaf] for leaf in leaves]).reshape(-1, 3),
    )


def _read_amc(path: Path, figure: _Figure) -> tuple[FloatArray, bool]:
    """Return the values (frames, channels) in the order of the bones, and whether angles are degrees."""
    channels = {name: len(bone.channels) for name, bone in figure.bones.items() if bone.channels}
    rows = array("d")
    values: dict[str, list[float]] = {}
    frame, degrees = 0, figure.degrees
    for number, line in enumerate(text_lines(path, BadMotion), start=1):
        words = line.split()
        where = f"{path.name}, line {number}"
        if not words or words[0].startswith("#"):
            continue
        if words[0].startswith(":"):
            degrees = {":DEGREES": True, ":RADIANS": False}.get(words[0].upper(), degrees)
        elif len(words) == 1 and _FRAME.fullmatch(words[0]):
            if frame:
                rows.extend(_whole_frame(values, channels, f"{where}: frame {frame}"))
                if int(words[0]) != frame + 1:
                    raise BadMotion(f"{where}: expected frame {frame + 1}, got {words[0][:20]}")
            frame, values = int(words[0]), {}
        elif not frame:
            raise BadMotion(f"{where}: expected a frame number, got {words[0][:40]!r}")
        else:
            values[words[0]] = _bone_values(words, channels, where)
    if not frame:
        raise BadMotion(f"{path.name}: no frame found: the file is empty or not AMC")
    rows.extend(_whole_frame(values, channels, f"{path.name}, last frame: frame {frame}"))
    return np.frombuffer(rows, dtype=np.float64).reshape(-1, sum(channels.values())), degrees


def _bone_values(words: list[str], channels: dict[str, int], where: str) -> list[float]:
    """Return the values of one bone's line: its name and a number for each of its channels."""
    name = words[0]
    if name not in channels:
        raise BadMotion(f"{where}: the skeleton has no moving bone {name[:40]!r}")
    if len(words) - 1 != channels[name]:
        raise BadMotion(f"{where}: {name} has {channels[name]} channels, got {len(words) - 1} values")
    try:
        values = [float(word) for word in words[1:]]
    except ValueError as error:
        raise BadMotion(f"{where}: expected numbers for {name} ({str(error)[:_LONGEST_REASON]})") from error
    if not np.isfinite(values).all():
        raise BadMotion(f"{where}: {name} holds NaN or infinity")
    return values


def _whole_frame(values: dict[str, list[float]], channels: dict[str, int], where: str) -> list[float]:
    """Return the values of a frame in the order of the bones, or raise where some are missing."""
    missing = [name for name in channels if name not in values]
    if missing:
        lacks, of = sum(channels[name] for name in missing), sum(channels.values())
        raise BadMotion(
            f"{where} lacks {lacks} of {of} values (first: {missing[0]}): the file is truncated or belongs "
            "to another skeleton"
        )
    return [value for name in channels for value in values[name]]


def _read_asf(path: Path) -> _Figure:
    """Read an ASF skeleton; raises `BadMotion` on anything malformed, cycles included."""
    text = read_text(path, BadMotion)
    try:
        return _figure_from_sections(_sections(text))
    except BadMotion as error:
        raise BadMotion(f"{path.name}: {str(error)[:_LONGEST_REASON]}") from error
    except (KeyError, IndexError, ValueError) as error:
        raise BadMotion(
            f"{path.name}: malformed ASF ({type(error).__name__}: {str(error)[:_LONGEST_REASON]})"
        ) from error


def _figure_from_sections(sections: dict[str, list[list[str]]]) -> _Figure:
    units = {words[0]: words[1] for words in sections["units"]}
    degrees = units.get("angle", "deg").startswith("deg")
    length = float(units.get("length", "1"))
    if not 0 < length < np.inf:
        raise BadMotion(f"expected a positive length unit, got {length}")
    angle_unit = 1.0 if degrees else _DEG_PER_RAD
    root = {words[0]: words[1:] for words in sections["root"]}
    axes_deg = _vector(root["orientation"], "root orientation") * angle_unit
    order = _order(root["axis"][0], "root axis")
    bones = {
        "root": _Bone(
            end=np.zeros(3),
            own_axes=Rotation.from_euler(order, axes_deg, degrees=True),
            order=order,
            channels=_channels(root["order"], _CHANNELS, "root order"),
        )
    }
    for block in _blocks(sections["bonedata"]):
        name = block["name"][0]
        if name in bones:
            raise BadMotion(f"bone {name} occurs twice")
        bones[name] = _bone(name, block, angle_unit)
    parents = _parents(sections["hierarchy"], bones)
    return _Figure(
        bones={name: bones[name] for name in parents},
        parents=list(parents.values()),
        root_position=_vector(root["position"], "root position"),
        length=length,
        degrees=degrees,
    )


def _sections(text: str) -> dict[str, list[list[str]]]:
    """Split into {section: lines of words}; comments and empty lines fall away."""
    sections: dict[str, list[list[str]]] = {}
    lines: list[list[str]] = []
    for line in text.splitlines():
        words = line.split("#", 1)[0].split()
        if words and words[0].startswith(":"):
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
        if (words[0] == "begin") == (block is not None):
            raise BadMotion(f"expected {'begin' if block is None else 'end'} of a bone, got {words[0]!r}")
        if block is None:
            block = {}
        elif words[0] == "end":
            yield block
            block = None
        elif not words[0].startswith("("):
            block[words[0]] = words[1:]
    if block is not None:
        raise BadMotion("the last bone has no end: the file is truncated")


def _bone(name: str, block: dict[str, list[str]], angle_unit: float) -> _Bone:
    length = float(block["length"][0])
    if not 0 <= length < _LARGEST:
        raise BadMotion(f"bone {name}: expected a length, got {length}")
    axes_deg = _vector(block["axis"], f"bone {name}, axis") * angle_unit
    order = _order(block["axis"][3], f"bone {name}, axis")
    return _Bone(
        end=_vector(block["direction"], f"bone {name}, direction") * length,
        own_axes=Rotation.from_euler(order, axes_deg, degrees=True),
        order=order,
        channels=_channels(block.get("dof", []), _CHANNELS[:3], f"bone {name}, dof"),
    )


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


def _parents(lines: list[list[str]], bones: dict[str, _Bone]) -> dict[str, int]:
    """Return the place of each bone's parent, −1 for the root's; parents come first, depth first.

    Every bone but the root must be somebody's child, once.
    """
    children: dict[str, list[str]] = {name: [] for name in bones}
    if not lines or lines[-1][0] != "end":
        raise BadMotion("the hierarchy has no end: the file is truncated")
    for words in lines:
        for name in words if words[0] not in ("begin", "end") else ():
            if name not in bones:
                raise BadMotion(f"the hierarchy names {name!r}, which has no bone data")
        children.get(words[0], []).extend(words[1:])
    parents: dict[str, int] = {}
    waiting = [("root", -1)]
    while waiting:
        name, parent = waiting.pop()
        if name in parents:
            raise BadMotion(f"cyclic hierarchy: {name!r} has two parents")
        waiting += [(child, len(parents)) for child in reversed(children[name])]
        parents[name] = parent
    lost = set(bones) - set(parents)  # which hang in a cycle
    if lost:
        raise BadMotion(f"cyclic hierarchy: the root does not reach {', '.join(sorted(lost)[:5])}")
    return parents
