"""The checkerboard video of a tracked folder, and a sheet of frames from it."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from vntoolkit.arrays import ByteArray
from vntoolkit.errors import BadInput
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.pipeline.opened_result import OpenedResult, read_result
from vntoolkit.pipeline.tracked_folder import Tracks, read_tracks
from vntoolkit.tracking.checkerboard import checkerboard_frame

_SHEET_COLUMNS, _SHEET_ROWS = 4, 2


def write_checkerboard(folder: Path, track_folder: Path | None = None) -> Mapping[int, ByteArray]:
    """Write checkerboard.mkv (lossless) and checkerboard.png (eight frames) into the track folder.

    Return the pictures (h, w, 3) on the sheet, by their places in the sequence.
    """
    from vntoolkit.io.footage.video import write_video

    target = track_folder or folder / "track"
    tracks, result = read_tracks(target), read_result(folder, says_missing=False)
    wanted = set(sampled(range(len(tracks.numbers)), _SHEET_COLUMNS * _SHEET_ROWS))
    moments: dict[int, ByteArray] = {}

    def frames() -> Iterator[ByteArray]:
        for row, frame in enumerate(_frames(result, tracks)):
            if row in wanted:
                moments[row] = frame
            yield frame

    write_video(target / "checkerboard.mkv", frames(), tracks.sequence.frame_rate_hz)
    write_png(target / "checkerboard.png", _sheet(list(moments.values())))
    return moments


def _frames(result: OpenedResult, tracks: Tracks) -> Iterator[ByteArray]:
    camera, sequence, vertices = result.camera, tracks.sequence, tracks.template_vertices
    if vertices is None:
        raise BadInput(f"{tracks.folder}: the template's frame {tracks.template} is not tracked yet")
    pixels = np.rint(camera.project(vertices))
    drawn = np.zeros((camera.height, camera.width, 3), dtype=np.uint8)
    for row, number in enumerate(tracks.numbers):
        if result.folder.has(number, "normals", "depth"):
            drawn = checkerboard_frame(
                np.array(sequence.vertices[row]), sequence.template.faces, pixels, camera,
                result.normals(number),
            )  # fmt: skip
        yield drawn


def _sheet(kept: list[ByteArray]) -> ByteArray:
    """Return the frames as one picture, row by row."""
    columns = min(_SHEET_COLUMNS, len(kept))
    cells = kept + [np.zeros_like(kept[0])] * (-len(kept) % columns)
    rows = [np.concatenate(cells[i : i + columns], axis=1) for i in range(0, len(cells), columns)]
    return np.concatenate(rows)
