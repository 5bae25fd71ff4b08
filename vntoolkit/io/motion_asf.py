"""Acclaim motion capture: a skeleton in ASF, its motion in AMC (no maintained library reads them).

A bone's channels turn it about axes C of its own: R = C E(rx, ry, rz) C⁻¹, with both C and E taken in
the order that `axis` names, first letter first about fixed axes. A joint sits where its bone begins.
The length unit: 1 in the file is 1/`length` inches, as the CMU library documents its files.
"""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, Vector3
from vntoolkit.errors import BadMotion
from vntoolkit.geometry.motion import Motion
from vntoolkit.geometry.skeleton import Skeleton
from vntoolkit.io.motion_asf_skeleton import AsfBone, AsfSkeleton, read_asf
from vntoolkit.io.motion_axes import motion_with_axes_turned
from vntoolkit.io.motion_bvh import require_motion_size

CMU_FRAME_RATE_HZ = 120.0  # AMC carries no rate; the CMU library's takes are recorded at 120 Hz
_INCH_M = 0.0254
_MAX_LINE = 65536
_FRAME = re.compile(r"[0-9]{1,9}")


@dataclass(frozen=True, kw_only=True)
class AmcOptions:
    """What an AMC file does not say. frame_rate_hz: its frames per second."""

    frame_rate_hz: float = CMU_FRAME_RATE_HZ


def read_asf_amc(asf_path: Path, amc_path: Path, options: AmcOptions | None = None) -> Motion:
    """Read an ASF skeleton with its AMC motion; lengths stay in the file's unit. Raises `BadMotion`."""
    options = options or AmcOptions()
    asf = read_asf(asf_path)
    require_motion_size(amc_path)
    values, degrees = _read_amc(amc_path, asf)
    angle_unit = 1.0 if degrees else 180.0 / np.pi
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
            frame_rate_hz=options.frame_rate_hz,
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
    starts = np.cumsum([0, *(len(bone.channels) for bone in asf.bones)]).tolist()
    slots = {b.name: (s, len(b.channels)) for b, s in zip(asf.bones, starts, strict=False) if b.channels}
    width = starts[-1]
    row = np.full(width, np.nan)
    rows = array("d")
    frame, frames, degrees = 0, 0, asf.degrees
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(iter(lambda: file.readline(_MAX_LINE), ""), start=1):
            words = line.split()
            if not words or words[0].startswith("#"):
                continue
            where = f"{path.name}, line {number}"
            if words[0].startswith(":"):
                degrees = {":DEGREES": True, ":RADIANS": False}.get(words[0].upper(), degrees)
            elif len(words) == 1 and _FRAME.fullmatch(words[0]):
                frames += _close_frame(rows, row, frame, where, asf)
                if frame and int(words[0]) != frame + 1:
                    raise BadMotion(f"{where}: expected frame {frame + 1}, got {words[0][:20]}")
                frame = int(words[0])
            else:
                _fill(row, slots, words, frame, where)
        frames += _close_frame(rows, row, frame, f"{path.name}, last frame", asf)
    if not frames:
        raise BadMotion(f"{path.name}: no frame found: the file is empty or not AMC")
    return np.frombuffer(rows, dtype=np.float64).reshape(frames, width), degrees


def _fill(
    row: FloatArray, slots: dict[str, tuple[int, int]], words: list[str], frame: int, where: str
) -> None:
    """Put one bone's values into the row of the frame."""
    name = words[0]
    if not frame:
        raise BadMotion(f"{where}: expected a frame number, got {name[:40]!r}")
    if name not in slots:
        raise BadMotion(f"{where}: the skeleton has no moving bone {name[:40]!r}")
    start, count = slots[name]
    if len(words) - 1 != count:
        raise BadMotion(f"{where}: {name} has {count} channels, got {len(words) - 1} values")
    try:
        values = np.array([float(word) for word in words[1:]])
    except ValueError as error:
        raise BadMotion(f"{where}: expected numbers for {name} ({str(error)[:200]})") from error
    if not np.isfinite(values).all():
        raise BadMotion(f"{where}: {name} holds NaN or infinity")
    row[start : start + count] = values


def _close_frame(rows: array[float], row: FloatArray, frame: int, where: str, asf: AsfSkeleton) -> int:
    """Append a complete frame and empty the row; return how many frames that added."""
    if not frame:
        return 0
    missing = int(np.isnan(row).sum())
    if missing:
        owners = np.repeat([b.name for b in asf.bones], [len(b.channels) for b in asf.bones])
        raise BadMotion(
            f"{where}: frame {frame} lacks {missing} of {row.size} values (first: {owners[np.isnan(row)][0]})"
            ": the file is truncated or belongs to another skeleton"
        )
    rows.frombytes(row.tobytes())
    row[:] = np.nan
    return 1
