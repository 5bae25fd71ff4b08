"""One recording of a result: for the Rerun viewer, or of ROS 2 messages."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import Float32Array
from vntoolkit.errors import VntError
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.maps_and_meshes.masks import read_mask
from vntoolkit.io.recordings.recorded import RecordedFrame, Stamp
from vntoolkit.options.export import ExportFormat
from vntoolkit.pipeline.export import ExportSource, ExportSummary
from vntoolkit.pipeline.gel_motion import read_displacement_mm

_NS = 1_000_000_000
_MM = 1000.0  # per metre


def export_recording(source: ExportSource, out: Path) -> ExportSummary:
    """Write all opened frames into one file; of footage that is gone, without its pictures."""
    frames = progress.counted(_Frames(source).recorded(), "export", len(source.result.numbers))
    if source.options.to is ExportFormat.RRD:
        from vntoolkit.io.recordings.rerun_file import write_rrd

        count = write_rrd(out, frames, source.options.up)
        return ExportSummary(out=out, frames=count, kept=0, is_tracked=source.track is not None)
    from vntoolkit.io.recordings.mcap_messages import write_mcap

    return ExportSummary(out=out, frames=write_mcap(out, frames), kept=0)


class _Frames:
    """Frames of a result as recordings hold them."""

    def __init__(self, source: ExportSource) -> None:
        self._source, self._up = source, source.options.up
        self._factor = source.lengths.factor if source.options.to is ExportFormat.RRD else 1.0
        try:
            self._stamps = source.result.capture.stamps
        except VntError:
            self._stamps = ()
        self._motions = self._motions_of_object()

    def recorded(self) -> Iterator[RecordedFrame]:
        """Yield the opened frames in order."""
        result, is_rrd = self._source.result, self._source.options.to is ExportFormat.RRD
        times = result.manifest.input.times_of(result.numbers)
        for number, time_s in zip(result.numbers, times.tolist(), strict=True):
            entry = result.entries.get(number)
            since_start = round(time_s * _NS)
            stamp = Stamp(logged_ns=since_start, filmed_ns=since_start, frame_id="camera")
            touched = result.folder.has(number, "contact")
            yield RecordedFrame(
                number=number,
                time_s=time_s,
                stamp=self._stamps[number] if self._stamps else stamp,
                picture=result.picture(number) if is_rrd else None,
                normals=result.normals(number),
                depth=result.depth(number),
                contact=read_mask(result.folder.file("contact", number)) if touched else None,
                contact_mm2=None if entry is None else entry.contact_mm2,
                contact_depth_mm=None if entry is None else entry.contact_depth_mm,
                moved_px=self._moved_px(number) if is_rrd else None,
                mesh=self._mesh(number) if is_rrd else None,
                object_from_first=self._motions.get(number),
            )

    def _moved_px(self, number: int) -> Float32Array | None:
        track = self._source.track
        moved_mm = None if track is None else read_displacement_mm(track.folder, number)
        scale = self._source.result.camera.matrix[0, 0] / _MM
        return None if moved_mm is None else moved_mm * np.float32(scale)

    def _mesh(self, number: int) -> Mesh | None:
        source = self._source
        is_tracked = source.track is not None and number in source.track.numbers
        if not is_tracked and (source.track is not None or not source.result.folder.has(number, "mesh")):
            return None
        mesh = source.mesh(number)
        normals = None if mesh.normals is None else graphics_from_camera(mesh.normals, self._up)
        return replace(mesh, vertices=graphics_from_camera(mesh.vertices, self._up), normals=normals)

    def _motions_of_object(self) -> dict[int, RigidTransform]:
        """Motions of what touches a gel by frame, where `track --object` wrote them and they are known."""
        path = self._source.result.folder.root / "track" / "object.csv"
        if not path.exists():
            return {}
        flip = graphics_from_camera(np.eye(3), self._up).T
        found = {}
        with path.open(newline="") as stream:
            for row in csv.DictReader(stream):
                if row["lost"] == "0":
                    turn = np.radians([float(row[f"turn_{axis}_deg"]) for axis in "xyz"])
                    shift = np.array([float(row[f"{axis}_mm"]) for axis in "xyz"]) / _MM * self._factor
                    motion = RigidTransform.from_rotation_vector(turn)
                    found[int(row["frame"])] = RigidTransform(
                        rotation=flip @ motion.rotation @ flip.T, translation=flip @ shift
                    )
        return found
