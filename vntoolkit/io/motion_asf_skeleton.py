"""The skeleton half of Acclaim motion capture: ASF files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Vector3
from vntoolkit.errors import BadMotion
from vntoolkit.io.files import read_text, require_file

MAX_ASF_BYTES = 4 * 2**20  # the CMU skeletons have 7 kB
_LONGEST_REASON = 200
_LARGEST = 1e12  # of a length or an angle
_CHANNELS = ("rx", "ry", "rz", "tx", "ty", "tz")


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
    root, position = _root(sections["root"], degrees)
    bones = {"root": root}
    for block in _blocks(sections["bonedata"]):
        bone = _bone(block, degrees)
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


def _root(lines: list[list[str]], degrees: bool) -> tuple[AsfBone, Vector3]:
    values = {words[0]: words[1:] for words in lines}
    factor = 1.0 if degrees else 180.0 / np.pi
    bone = AsfBone(
        name="root",
        direction=np.zeros(3),
        length=0.0,
        axis_deg=_vector(values["orientation"], "root orientation") * factor,
        order=_order(values["axis"][0], "root axis"),
        channels=_channels(values["order"], _CHANNELS, "root order"),
    )
    return bone, _vector(values["position"], "root position")


def _bone(block: dict[str, list[str]], degrees: bool) -> AsfBone:
    name = block["name"][0]
    length = float(block["length"][0])
    if not 0 <= length < _LARGEST:
        raise BadMotion(f"bone {name}: expected a length, got {length}")
    factor = 1.0 if degrees else 180.0 / np.pi
    direction = _vector(block["direction"], f"bone {name}, direction")
    return AsfBone(
        name=name,
        direction=direction,
        length=length,
        axis_deg=_vector(block["axis"], f"bone {name}, axis") * factor,
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
