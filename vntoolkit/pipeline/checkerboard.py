"""The checkerboard video of a tracked folder, and a sheet of frames from it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vntoolkit.arrays import ByteArray
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.io.footage.images import write_png
from vntoolkit.io.footage.video import write_video
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.options.tracking import CheckerboardOptions
from vntoolkit.pipeline.tracked_folder import TrackSource, open_track_source, read_track_record
from vntoolkit.tracking.checkerboard import checkerboard_frame

_SHEET_COLUMNS, _SHEET_ROWS = 4, 2


@dataclass(frozen=True, kw_only=True)
class CheckerboardFiles:
    """What was written. moments: the pictures (h, w, 3) on the sheet, by their places in the sequence."""

    video: Path
    sheet: Path
    moments: Mapping[int, ByteArray]


def write_checkerboard(
    folder: Path, track_folder: Path | None = None, options: CheckerboardOptions | None = None
) -> CheckerboardFiles:
    """Write checkerboard.mkv (lossless) and checkerboard.png (eight frames) into the track folder."""
    target = track_folder or folder / "track"
    frames = _frames(open_track_source(folder), target, options or CheckerboardOptions())
    sheet = _Sheet(len(read_track_record(target)["frames"]))
    rate = read_mesh_sequence(target).frame_rate_hz
    write_video(target / "checkerboard.mkv", sheet.passing(frames), rate)
    write_png(target / "checkerboard.png", sheet.image())
    return CheckerboardFiles(
        video=target / "checkerboard.mkv", sheet=target / "checkerboard.png", moments=sheet.kept
    )


def _frames(source: TrackSource, target: Path, options: CheckerboardOptions) -> Iterator[ByteArray]:
    record, sequence = read_track_record(target), read_mesh_sequence(target)
    camera: Camera = source.camera
    at = record["frames"].index(record["template"])
    pixels = np.rint(camera.project(np.array(sequence.vertices[at])))
    drawn = np.zeros((camera.height, camera.width, 3), dtype=np.uint8)
    for row, number in enumerate(record["frames"][: len(sequence)]):
        if source.has(number):
            drawn = checkerboard_frame(
                np.array(sequence.vertices[row]), sequence.template.faces, pixels, camera,
                source.normals(number), options,
            )  # fmt: skip
        yield drawn


class _Sheet:
    """Keeps a few frames, evenly spread, of those that pass."""

    def __init__(self, frame_count: int) -> None:
        self._wanted = set(sampled(range(frame_count), _SHEET_COLUMNS * _SHEET_ROWS))
        self.kept: dict[int, ByteArray] = {}

    def passing(self, frames: Iterator[ByteArray]) -> Iterator[ByteArray]:
        for row, frame in enumerate(frames):
            if row in self._wanted:
                self.kept[row] = frame
            yield frame

    def image(self) -> ByteArray:
        kept = list(self.kept.values())
        columns = min(_SHEET_COLUMNS, len(kept))
        cells = kept + [np.zeros_like(kept[0])] * (-len(kept) % columns)
        rows = [np.concatenate(cells[i : i + columns], axis=1) for i in range(0, len(cells), columns)]
        return np.concatenate(rows)
