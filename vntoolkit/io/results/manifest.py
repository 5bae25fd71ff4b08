"""reconstruction.json: inputs, options and versions of a result folder.

The manifest is written when a run starts and when it ends; finished frames are appended to frames.log
beside it (`frame_log`), one short line each, so that 10,000 frames cost no more each than the first.
"""

import hashlib
import json
import os
import platform
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

import vntoolkit
from vntoolkit.errors import BadInput
from vntoolkit.io.atomic import write_text
from vntoolkit.io.files import parse_json, read_text, require_file, sha256_of_file
from vntoolkit.io.maps_and_meshes.label_images import LABEL_LEGEND
from vntoolkit.io.rigs import Entry, RigFile, SourceEntry, one_line_from_validation, text_from_model
from vntoolkit.native import open3d_distribution

MANIFEST_NAME = "reconstruction.json"
MANIFEST_VERSION = 1
_STILLS_RATE_HZ = 30.0
_LIBRARIES = ("numpy", "scipy", "numba", "opencv-contrib-python-headless", "av", "OpenEXR")


class InputEntry(Entry):
    """The capture that was read."""

    source: str = Field(description="What was given on the command line.")
    files: list[SourceEntry] = Field(description="Every file read, in order, with the SHA-256 of its bytes.")
    width: int = Field(gt=0, description="Frame width in pixels.")
    height: int = Field(gt=0, description="Frame height in pixels.")
    frame_count: int = Field(ge=0, description="Frames in the capture.")
    frame_rate_hz: float | None = Field(
        default=None, gt=0, allow_inf_nan=False, description="Frames per second; null for stills."
    )
    numbers: list[int] = Field(
        default_factory=list, description="Number of the frame that each file of an image sequence is."
    )
    declared_frame_count: int | None = Field(
        default=None, ge=0, description="Frames that a video declares, where fewer came."
    )

    times_s: list[float] = Field(
        default_factory=list,
        description="When each frame of a video of varying rate is shown, seconds from the first.",
    )

    @property
    def playing_rate_hz(self) -> float:
        """Frames per second to play the result at: the footage's, or a usual rate for stills."""
        return self.frame_rate_hz or _STILLS_RATE_HZ


class MaterialEntry(Entry):
    """A material of the subject; its place in the list is its value in materials/*.png."""

    reflectance: tuple[float, float, float] = Field(
        description="What it returns of lamps 0, 1, 2, relative to the calibration material."
    )
    error_deg: float = Field(
        description="Angle by which normals turn, root mean square, by what is not known of the reflectance "
        "and, where shadows told them, of the lamps' directions."
    )
    residual: float = Field(
        description="Robust standard deviation of the normals' lengths, which should be 1."
    )
    share: float = Field(description="Share of the lit pixels of the first frames.")
    pigment: tuple[float, float, float] | None = Field(
        default=None,
        description="Line of log reflectance, of length 1, along which the material changes; null for none.",
    )


class FindingEntry(Entry):
    """What the run found wrong with footage or rig before its first frame."""

    check: str = Field(description="Name of the check, which --allow takes.")
    level: Literal["note", "warning", "fatal"] = Field(description="Fatal: the run was allowed to go on.")
    text: str = Field(description="The finding on one line, with its number and remedy.")


class Manifest(Entry):
    """What a result folder holds."""

    version: int = Field(default=MANIFEST_VERSION, description="Version of this schema.")
    input: InputEntry
    extra_files: dict[str, SourceEntry] = Field(
        default_factory=dict, description="Mask, background and the like, by option."
    )
    rig: RigFile = Field(description="The rig that was used, whole.")
    options: dict[str, Any] = Field(
        default_factory=dict, description="Every option that shapes the result, by its name."
    )
    materials: list[MaterialEntry] = Field(
        default_factory=list, description="Materials that were found; empty for the rig's alone."
    )
    findings: list[FindingEntry] | None = Field(
        default=None, description="What was found wrong before the first frame; null where none was kept."
    )
    frames: str = Field(default="0::1", description="Frames asked for, start:stop:step.")
    outputs: list[str] = Field(default_factory=list, description="Folders written: normals, depth, …")
    versions: dict[str, str] = Field(default_factory=dict, description="Program and libraries.")
    label_legend: dict[str, str] = Field(
        default_factory=lambda: dict(LABEL_LEGEND), description="Meaning of the values in shadows/*.png."
    )
    error_deg: float | None = Field(
        default=None,
        description="Expected error of the normals: median over the pixels of a frame, then over the frames; "
        "null where it is not known.",
    )
    started: str = Field(default="", description="When the run began, UTC, ISO 8601.")
    finished: str = Field(default="", description="When the last frame was done; empty while it runs.")
    timings: dict[str, float] = Field(
        default_factory=dict, description="Seconds per frame, median, by stage; wall_s is the whole run."
    )


def write_manifest(folder: Path | str, manifest: Manifest) -> None:
    """Write reconstruction.json into `folder`, atomically."""
    write_text(Path(folder) / MANIFEST_NAME, text_from_model(manifest))


def has_manifest(folder: Path | str) -> bool:
    """Tell whether a folder holds results; False for a folder that cannot be read (writing will raise)."""
    return os.access(Path(folder) / MANIFEST_NAME, os.F_OK)


def read_manifest(folder: Path | str) -> Manifest:
    """Read reconstruction.json; raise `BadInput` with one line."""
    path = Path(folder) / MANIFEST_NAME
    if not has_manifest(folder):
        found = f"holds no {MANIFEST_NAME}" if Path(folder).is_dir() else "is no folder"
        raise BadInput(f"{folder}: {found}; give a folder that `vntoolkit reconstruct` wrote")
    content = parse_json(read_text(path), str(path))
    try:
        stated = content.get("version") if isinstance(content, dict) else MANIFEST_VERSION
        if stated != MANIFEST_VERSION or isinstance(stated, bool):
            raise BadInput(f"{path}: is of version {stated}, this program reads {MANIFEST_VERSION}")
        if isinstance(content, dict):
            content.pop("surface", None)  # of a flag that is no more; older folders hold it, mostly null
        return Manifest.model_validate(content)
    except ValidationError as problem:
        raise BadInput(f"{path}: {one_line_from_validation(problem, Manifest)}") from problem


def changes_between(before: Manifest, now: Manifest) -> list[str]:
    """Return the differences of two runs, one phrase each; empty if their results may be mixed.

    Frames asked for, folders written, versions and times may differ; inputs, rig and options may not.
    """
    changes = []
    if before.input.files != now.input.files:
        changes.append(f"the input files ({before.input.source} → {now.input.source})")
    for name in sorted(set(before.extra_files) | set(now.extra_files)):
        if before.extra_files.get(name) != now.extra_files.get(name):
            changes.append(f"the file of --{name}")
    for section in RigFile.model_fields:
        if section not in ("quality", "sources") and getattr(before.rig, section) != getattr(
            now.rig, section
        ):
            changes.append(f"the rig's {section}")
    now_options = json.loads(json.dumps(now.options))
    for name in sorted(set(before.options) | set(now_options)):
        old, new = before.options.get(name), now_options.get(name)
        if old != new:
            changes.append(f"{name} ({old} → {new})")
    return changes


def require_resumable(folder: Path | str, now: Manifest) -> None:
    """Raise `BadInput` if `folder` holds results of other inputs or options; the message names the change."""
    if not has_manifest(folder):
        return
    changes = changes_between(read_manifest(folder), now)
    if changes:
        raise BadInput(
            f"{folder}: holds results made differently: {'; '.join(changes)}; add --overwrite to replace "
            "them, or choose another --out"
        )


def hashed(files: tuple[Path, ...] | list[Path]) -> list[SourceEntry]:
    """Return name and SHA-256 of each file, in order."""
    return [SourceEntry(file=path.name, sha256=sha256_of_file(require_file(path))) for path in files]


def entry_of_files(name: Path, files: tuple[Path, ...]) -> SourceEntry:
    """Return one entry for an input of one file or many: of many, the SHA-256 of their names and SHA-256s."""
    entries = hashed(files)
    if len(entries) == 1:
        return entries[0]
    listed = "".join(f"{entry.sha256}  {entry.file}\n" for entry in entries)
    return SourceEntry(file=name.name, sha256=hashlib.sha256(listed.encode()).hexdigest())


def library_versions() -> dict[str, str]:
    """Return the versions of the program, Python and the libraries that shape results."""
    versions = {"vntoolkit": vntoolkit.__version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "absent"
    distribution, its_version = open3d_distribution()
    return {**versions, distribution: its_version}


def now_utc() -> str:
    """Return the present moment, UTC, ISO 8601; fixed by SOURCE_DATE_EPOCH for reproducible output."""
    fixed = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        moment = datetime.fromtimestamp(int(fixed), UTC) if fixed else datetime.now(UTC)
    except (ValueError, OverflowError, OSError) as problem:
        raise BadInput(f"SOURCE_DATE_EPOCH: expected seconds since 1970, got '{fixed}'") from problem
    return moment.isoformat(timespec="seconds")


def result_digest(manifest: Manifest) -> str:
    """Return the SHA-256 of what shapes a reconstruction: footage, mask, background, rig and options.

    Frames may be added and the footage may be named otherwise, as for `changes_between`.
    """
    content = [
        [file.model_dump() for file in manifest.input.files],
        manifest.input.frame_rate_hz,
        {name: file.model_dump() for name, file in manifest.extra_files.items()},
        manifest.rig.model_dump(exclude={"quality", "sources"}),
        manifest.options,
    ]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
