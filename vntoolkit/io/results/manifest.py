"""reconstruction.json: inputs, options and versions of a result folder.

It is written (`reconstruction.py`) when a run starts and when it ends. Finished frames are appended to
frames.log beside it (`frame_log`), one short line each, so that 10,000 frames cost no more each than one.
"""

import hashlib
import json
import os
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from vntoolkit.arrays import FloatArray
from vntoolkit.errors import BadInput
from vntoolkit.io.files import read_json
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.results.frame_log import FRAMES_NAME, FrameLog
from vntoolkit.io.results.numbered_files import numbers_in_words, numbers_on_disk
from vntoolkit.io.rigs import Entry, RigFile, SourceEntry, rig_from_entry
from vntoolkit.photometry.frame import LABEL_LEGEND
from vntoolkit.photometry.response import with_near_lamps
from vntoolkit.photometry.rig import Rig

MANIFEST_NAME = "reconstruction.json"
# folder -> suffix of a frame's file in it
FRAME_FILES = {
    "normals": ".exr", "depth": ".exr", "mesh": ".ply",
    "shadows": ".png", "contact": ".png", "materials": ".png",
}  # fmt: skip
MANIFEST_VERSION = 2
_STILLS_RATE_HZ = 30.0


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

    @model_validator(mode="after")
    def _require_a_time_a_frame(self) -> "InputEntry":
        rise = np.diff(self.times_s) > 0  # NaN does not
        if self.times_s and (len(self.times_s) != self.frame_count or not rise.all()):
            raise ValueError(f"times_s: expected a time for each of {self.frame_count} frames, rising")
        return self

    @property
    def playing_rate_hz(self) -> float:
        """Frames per second to play the result at: the footage's, or a usual rate for stills."""
        return self.frame_rate_hz or _STILLS_RATE_HZ

    def times_of(self, numbers: Sequence[int]) -> FloatArray:
        """Return when these frames were filmed, (n,) seconds from the first of them."""
        chosen = np.array(numbers, dtype=np.int64)
        times = np.array(self.times_s)[chosen] if self.times_s else chosen / self.playing_rate_hz
        return np.asarray(times - times[:1])

    def rate_of(self, numbers: Sequence[int]) -> float:
        """Return the frames per second of these frames alone: of every second one, half the footage's."""
        steps = np.diff(np.array(numbers))
        return self.playing_rate_hz / (int(steps.min()) if steps.size else 1)


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
    """What was found wrong with footage, rig or result."""

    check: str = Field(description="Name of the check, which --allow takes where it is fatal.")
    level: Literal["note", "warning", "fatal"] = Field(description="Fatal: the run was allowed to go on.")
    text: str = Field(description="The finding on one line, with its number and remedy.")
    frame: int | None = Field(default=None, description="The frame it is of; null for the whole capture.")

    @property
    def line(self) -> str:
        """The finding with its frame."""
        return self.text if self.frame is None else f"frame {self.frame}: {self.text}"


_Triple = tuple[float, float, float]


class Known(Entry):
    """What a run found once, on a few frames, before the first: it holds for the whole capture."""

    frames: list[str] = Field(
        default_factory=list,
        description="Frames that it was found among, start:stop:step: all ever asked for.",
    )
    reference_frame: int = Field(
        default=0, ge=0, description="The frame that depth is tied to, and that tells noise and blur."
    )
    light_colours: tuple[_Triple, _Triple, _Triple] | None = Field(
        default=None,
        description="Colours of the lamps, one row each, where shadows told them; null for the rig's.",
    )
    light_doubts_deg: _Triple | None = Field(
        default=None, description="Standard deviations of the lamps' directions that shadows told."
    )
    nearness: float = Field(
        default=0.0, description="By which M was made to change over the picture, as lamps are near; 0: not."
    )
    blur_px: float = Field(
        default=0.0, description="Standard deviation of the picture's blur, which expected errors count."
    )
    relative_albedo: float | None = Field(
        default=None, description="Brightness of the subject against the rig's material; null for a gel's."
    )
    materials: list[MaterialEntry] = Field(
        default_factory=list, description="Materials that were found; empty for the rig's alone."
    )
    findings: list[FindingEntry] = Field(default_factory=list, description="What was found wrong.")

    def with_rig(self, asked: Rig) -> Rig:
        """Return the rig that was asked for, with what was found of its lamps."""
        response = asked.response
        if self.light_colours is not None:
            doubts_deg = None if self.light_doubts_deg is None else np.array(self.light_doubts_deg)
            colours = np.array(self.light_colours)
            response = replace(response, light_colours=colours, light_doubts_deg=doubts_deg)
        if self.nearness:
            size = (asked.camera.width, asked.camera.height)
            response = with_near_lamps(response, self.nearness, size)
        return replace(asked, response=response)

    def shapes(self) -> dict[str, Any]:
        """Return what results depend on."""
        return self.model_dump(mode="json", exclude={"frames", "findings"})


class Manifest(Entry):
    """What a result folder holds."""

    version: int = Field(default=MANIFEST_VERSION, description="Version of this schema.")
    input: InputEntry
    extra_files: dict[str, SourceEntry] = Field(
        default_factory=dict, description="Mask, background and the like, by option."
    )
    rig: RigFile = Field(description="The rig that was given, whole.")
    options: dict[str, Any] = Field(
        default_factory=dict, description="Every option that shapes the result, by its name, as asked for."
    )
    known: Known = Field(default_factory=Known, description="What was found before the first frame.")
    findings: list[FindingEntry] = Field(
        default_factory=list, description="What was found wrong with frames, and with all of them at the end."
    )
    frames: str = Field(default="0::1", description="Frames asked for, start:stop:step.")
    outputs: list[str] = Field(default_factory=list, description="Folders written: normals, depth, …")
    versions: dict[str, str] = Field(default_factory=dict, description="Program and libraries.")
    label_legend: dict[str, str] = Field(
        default_factory=lambda: dict(LABEL_LEGEND), description="Meaning of the values in shadows/*.png."
    )
    error_deg: float | None = Field(
        default=None,
        description="Expected error of the normals: median over the pixels of a frame, and of the frames the "
        "least of the worst tenth; null where it is not known.",
    )
    started: str = Field(default="", description="When the run began, UTC, ISO 8601.")
    finished: str = Field(default="", description="When the last frame was done; empty while it runs.")
    timings: dict[str, float] = Field(
        default_factory=dict, description="Seconds per frame, median, by stage; wall_s is the whole run."
    )


@dataclass(frozen=True, kw_only=True)
class ReconstructionFolder:
    """The folder DIR that `reconstruct` writes and every later verb reads."""

    root: Path

    def file(self, kind: str, number: int) -> Path:
        """Return the file of a frame in one of the folders of `FRAME_FILES`."""
        return self.root / kind / f"{number:06d}{FRAME_FILES[kind]}"

    def has(self, number: int, *kinds: str) -> bool:
        """Whether a frame has a file in each of these folders."""
        return all(self.file(kind, number).exists() for kind in kinds)


def has_manifest(folder: Path | str) -> bool:
    """Tell whether a folder holds results; False for a folder that cannot be read (writing will raise)."""
    return os.access(Path(folder) / MANIFEST_NAME, os.F_OK)


def read_manifest(folder: Path | str) -> Manifest:
    """Read reconstruction.json; raise `BadInput` with one line."""
    path = Path(folder) / MANIFEST_NAME
    if not has_manifest(folder):
        found = f"holds no {MANIFEST_NAME}" if Path(folder).is_dir() else "is no folder"
        raise BadInput(f"{folder}: {found}; give a folder that `vntoolkit reconstruct` wrote")
    content = read_json(path)
    stated = content.get("version") if isinstance(content, dict) else MANIFEST_VERSION
    if stated != MANIFEST_VERSION or isinstance(stated, bool):
        raise BadInput(
            f"{path}: is of version {stated}, this program reads {MANIFEST_VERSION}; reconstruct again, "
            "with --overwrite"
        )
    return Manifest.read(content, str(path))


def request_of_manifest(manifest: Manifest) -> dict[str, Any]:
    """Return what shapes a reconstruction, by names for messages.

    Frames asked for, folders written, names of files, versions and times do not.
    """
    asked: dict[str, Any] = {"the input files": [entry.sha256 for entry in manifest.input.files]}
    asked |= {f"the file of --{name}": entry.sha256 for name, entry in manifest.extra_files.items()}
    rig = manifest.rig.model_dump(mode="json", exclude={"quality", "sources"})
    asked |= {f"the rig's {section}": content for section, content in rig.items()}
    return asked | manifest.options


def rig_of_result(manifest: Manifest) -> Rig:
    """Return the rig that a result was made with: as given, with what was found of its lamps."""
    return manifest.known.with_rig(rig_from_entry(manifest.rig))


def result_digest(manifest: Manifest) -> str:
    """Return the SHA-256 of what shapes a reconstruction; frames may be added."""
    content: list[Any] = [
        request_of_manifest(manifest),
        manifest.known.shapes(),
        manifest.input.frame_rate_hz,
    ]
    content += [manifest.input.times_s] if manifest.input.times_s else []
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def numbers_of_ranges(ranges: Iterable[str], frame_count: int) -> tuple[int, ...]:
    """Return the frames of ranges start:stop:step together, in order."""
    numbers: set[int] = set()
    for text in ranges:
        numbers.update(FrameRange.from_text(text).numbers(frame_count))
    return tuple(sorted(numbers))


def missing_files(folder: Path, manifest: Manifest, wanted: Container[int]) -> list[str]:
    """Return, a line each, which of the wanted frames are recorded as done while their files are gone."""
    log, remedy = FrameLog(folder), "run `vntoolkit reconstruct` again: it makes what is missing"
    if manifest.finished and not log.path.exists():
        return [f"{FRAMES_NAME} is gone, so that nothing says which frames are done; {remedy}"]
    done = {number for number in log.done() if number in wanted}
    kinds_by_gone: dict[tuple[int, ...], list[str]] = {}
    for kind in sorted(set(manifest.outputs) & set(FRAME_FILES)):
        gone = done.difference(numbers_on_disk(folder / kind, FRAME_FILES[kind]))
        if gone:
            kinds_by_gone.setdefault(tuple(sorted(gone)), []).append(kind)
    return [
        f"{numbers_in_words(gone)} {'is' if len(gone) == 1 else 'are'} recorded as done, but files in "
        f"{', '.join(kinds)} are gone; {remedy}"
        for gone, kinds in kinds_by_gone.items()
    ]


def now_utc() -> str:
    """Return the present moment, UTC, ISO 8601; fixed by SOURCE_DATE_EPOCH for reproducible output."""
    fixed = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        moment = datetime.fromtimestamp(int(fixed), UTC) if fixed else datetime.now(UTC)
    except (ValueError, OverflowError, OSError) as problem:
        raise BadInput(f"SOURCE_DATE_EPOCH: expected seconds since 1970, got '{fixed}'") from problem
    return moment.isoformat(timespec="seconds")
