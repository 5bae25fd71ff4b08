"""Tracks against the simulator's vertices, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Faces, Points
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.track_error import TrackError, TrackErrorOptions, anchors_on_mesh, track_errors
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.atomic import write_text
from vntoolkit.io.files import require_file
from vntoolkit.io.meshes import read_mesh
from vntoolkit.io.rigs import read_rig
from vntoolkit.io.sequences import read_mesh_sequence
from vntoolkit.pipeline.tracked_folder import read_track_record


@dataclass(frozen=True, kw_only=True)
class TrackTruth:
    """vertices: (frames, n, 3) in the camera frame, mapped from disk; faces: (m, 3); camera: that filmed."""

    vertices: Points
    faces: Faces
    camera: Camera


def read_track_truth(folder: Path) -> TrackTruth:
    """Open DIR/truth (or DIR) as `vntoolkit simulate` writes it. Raises `BadInput`."""
    truth = folder / "truth" if (folder / "truth").is_dir() else folder
    vertices = np.load(require_file(truth / "vertices.npy"), mmap_mode="r", allow_pickle=False)
    faces = read_mesh(truth / "template.ply").faces
    if vertices.ndim != 3 or vertices.shape[2] != 3 or int(faces.max(initial=0)) >= vertices.shape[1]:
        raise BadInput(f"{truth / 'vertices.npy'}: expected (frames, vertices, 3) of the mesh template.ply")
    return TrackTruth(vertices=vertices, faces=faces, camera=read_rig(truth / "rig.json").camera)


def evaluate_tracks(
    track_folder: Path, truth_folder: Path, every: int = 1, options: TrackErrorOptions | None = None
) -> list[TrackError]:
    """Judge every `every`-th tracked frame and the last. Raises BadInput where tracks and truth differ."""
    truth, record = read_track_truth(truth_folder), read_track_record(track_folder)
    sequence = read_mesh_sequence(track_folder)
    numbers: list[int] = record["frames"][: len(sequence)]
    if not numbers or max(numbers) >= len(truth.vertices):
        raise BadInput(
            f"{track_folder}: its frames reach {max(numbers, default=0)}, the truth has {len(truth.vertices)}"
        )
    if record["template"] not in numbers:
        raise BadInput(f"{track_folder}: the template frame {record['template']} is not tracked yet")
    camera = truth.camera.without_distortion()
    template = np.array(sequence.vertices[numbers.index(record["template"])])
    anchors = anchors_on_mesh(
        camera.project(template), np.array(truth.vertices[record["template"]]), truth.faces, camera
    )
    rows = sorted({*range(0, len(numbers), every), len(numbers) - 1})

    def of(values: Points, at: list[int]) -> Iterator[tuple[int, Points]]:
        return ((numbers[row], np.array(values[i])) for row, i in zip(rows, at, strict=True))

    return list(
        track_errors(
            of(sequence.vertices, rows), of(truth.vertices, [numbers[row] for row in rows]), anchors,
            truth.faces, camera, options,
        )
    )  # fmt: skip


def write_track_errors(path: Path, errors: list[TrackError]) -> None:
    """Write a table of tab-separated values, one frame a line."""
    lines = ["frame\tmedian_px\tp95_px\tlost\tvertices"]
    lines += [f"{e.frame}\t{e.median_px:.4f}\t{e.p95_px:.4f}\t{e.lost:.4f}\t{e.vertices}" for e in errors]
    write_text(path, "\n".join(lines) + "\n")
