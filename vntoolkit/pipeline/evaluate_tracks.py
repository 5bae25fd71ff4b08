"""Tracks against the simulator's vertices, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Faces, Points
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.track_error import (
    TrackedPixels,
    TrackError,
    TrackErrorOptions,
    anchors_on_mesh,
    track_errors,
)
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh_sequence import MeshSequence
from vntoolkit.io.atomic import write_text
from vntoolkit.io.maps_and_meshes.arrays import map_npy
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.io.rigs import read_rig
from vntoolkit.pipeline.tracked_folder import read_track_record, recorded_camera


@dataclass(frozen=True, kw_only=True)
class TrackTruth:
    """vertices: (frames, n, 3) in the camera frame, mapped from disk; faces: (m, 3); camera: that filmed."""

    vertices: Points
    faces: Faces
    camera: Camera


def read_track_truth(folder: Path) -> TrackTruth:
    """Open DIR/truth (or DIR) as `vntoolkit simulate` writes it. Raises `BadInput`."""
    truth = folder / "truth" if (folder / "truth").is_dir() else folder
    if not (truth / "vertices.npy").exists():
        raise BadInput(f"{folder}: holds no truth; give the folder that `vntoolkit simulate` wrote")
    vertices = map_npy(truth / "vertices.npy")
    faces = read_mesh(truth / "template.ply").faces
    if vertices.ndim != 3 or vertices.shape[2] != 3 or int(faces.max(initial=0)) >= vertices.shape[1]:
        raise BadInput(f"{truth / 'vertices.npy'}: expected (frames, vertices, 3) of the mesh template.ply")
    return TrackTruth(vertices=vertices, faces=faces, camera=read_rig(truth / "rig.json").camera)


def evaluate_tracks(
    track_folder: Path, truth_folder: Path, every: int = 1, options: TrackErrorOptions | None = None
) -> list[TrackError]:
    """Evaluate every `every`-th tracked frame and the last. Raises BadInput where tracks and truth differ."""
    truth, record = read_track_truth(truth_folder), read_track_record(track_folder)
    sequence = read_mesh_sequence(track_folder)
    numbers: list[int] = record["frames"][: len(sequence)]
    if not numbers or max(numbers) >= len(truth.vertices):
        raise BadInput(
            f"{track_folder}: its frames reach {max(numbers, default=0)}, the truth has {len(truth.vertices)}"
        )
    if record["template"] not in numbers:
        raise BadInput(f"{track_folder}: the template frame {record['template']} is not tracked yet")
    options = options or TrackErrorOptions(lost_px=record.get("lost_px", TrackErrorOptions.lost_px))
    believed = recorded_camera(record)
    template = believed.project(sequence.vertices[numbers.index(record["template"])])
    anchors = anchors_on_mesh(
        template, np.array(truth.vertices[record["template"]]), truth.faces, truth.camera
    )
    rows = sorted({*range(0, len(numbers), every), len(numbers) - 1})
    return list(
        track_errors(
            (_pixels(sequence, row, numbers[row], believed) for row in rows),
            ((numbers[row], np.array(truth.vertices[numbers[row]])) for row in rows),
            anchors, truth.faces, truth.camera, options,
        )
    )  # fmt: skip


def _pixels(sequence: MeshSequence, row: int, number: int, camera: Camera) -> TrackedPixels:
    uncertainty = None if sequence.uncertainty_px is None else np.array(sequence.uncertainty_px[row])
    positions = camera.project(sequence.vertices[row])
    return TrackedPixels(frame=number, positions_px=positions, uncertainty_px=uncertainty)


def write_track_errors(path: Path, errors: list[TrackError]) -> None:
    """Write a table of tab-separated values, one frame a line; its columns are `TrackError`'s."""
    lines = ["\t".join(field.name for field in fields(TrackError))]
    for error in errors:
        cells = (f"{v:.4f}" if isinstance(v, float) else str(v) for v in vars(error).values())
        lines.append("\t".join(cells))
    write_text(path, "\n".join(lines) + "\n")
