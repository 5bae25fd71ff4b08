"""Moving meshes on disk: a folder written frame by frame, resumable, and read as a memory map.

The folder holds template.ply (topology, colours, texture coordinates; graphics frame, like every PLY),
vertices.npy (float32, (frames, n, 3), **camera frame**, so that it can be mapped as it is),
uncertainty_px.npy (float32, (frames, n)) where there is any, and sequence.json.
"""

import json
import logging
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.checks import require_finite, require_positive, require_shape
from vntoolkit.errors import BadMesh
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.io.atomic import cannot_write, require_writable_folder, write_text
from vntoolkit.io.files import read_json, require_file
from vntoolkit.io.maps_and_meshes.arrays import map_npy
from vntoolkit.io.maps_and_meshes.meshes import read_mesh, write_mesh

_VERSION = 1
SEQUENCE_FILES = ("template.ply", "vertices.npy", "uncertainty_px.npy", "sequence.json")

_logger = logging.getLogger(__name__)


class MeshSequenceWriter(AbstractContextManager["MeshSequenceWriter"]):
    """Append frames to a moving mesh on disk; after every frame the folder is complete and readable.

    times_s: of all frames to come, as `MeshSequence` has them. With `resume`, a folder of the same template
    size goes on where it stopped (`frame_count` tells where). Use as a context manager. Raises `CannotWrite`.
    """

    def __init__(
        self,
        folder: Path | str,
        template: Mesh,
        *,
        frame_rate_hz: float = 60.0,
        times_s: FloatArray | None = None,
        resume: bool = False,
    ) -> None:
        require_positive(frame_rate_hz, "moving mesh: frame rate")
        self.folder = require_writable_folder(folder)
        self._vertex_count = len(template.vertices)
        going_on = resume and (self.folder / "sequence.json").exists()
        if going_on:
            _require_same_template(self.folder, self._vertex_count)
        else:
            (self.folder / "uncertainty_px.npy").unlink(missing_ok=True)
            write_mesh(self.folder / "template.ply", template)
        self._write_meaning(frame_rate_hz, times_s)
        self._vertices = _GrowingArray(self.folder / "vertices.npy", (self._vertex_count, 3), keep=going_on)
        self._uncertainty_px: _GrowingArray | None = None
        uncertainty = self.folder / "uncertainty_px.npy"
        if going_on and uncertainty.exists():
            self._uncertainty_px = _GrowingArray(uncertainty, (self._vertex_count,), keep=True)
            self.truncate(min(self._vertices.count, self._uncertainty_px.count))

    def _write_meaning(self, frame_rate_hz: float, times_s: FloatArray | None) -> None:
        meaning = {
            "version": _VERSION,
            "frame_rate_hz": frame_rate_hz,
            "vertices": self._vertex_count,
            "frame": "camera: x right, y down, z forward",
            "arrays": "(frame, vertex, xyz)",
        }
        times = {} if times_s is None else {"times_s": np.round(times_s, 6).tolist()}
        write_text(self.folder / "sequence.json", json.dumps(meaning | times, indent=2) + "\n")

    @property
    def frame_count(self) -> int:
        """Frames written so far."""
        return self._vertices.count

    def append(self, vertices_in_camera: FloatArray, uncertainty_px: FloatArray | None = None) -> None:
        """Write one frame: (n, 3) vertices, and (n,) expected errors in pixels for all frames or for none."""
        require_shape(vertices_in_camera, (self._vertex_count, 3), "moving vertices", BadMesh)
        require_finite(vertices_in_camera, f"vertices of frame {self.frame_count}", BadMesh)
        if uncertainty_px is not None:
            require_shape(uncertainty_px, (self._vertex_count,), "uncertainty in pixels", BadMesh)
            if self._uncertainty_px is None and self.frame_count == 0:
                self._uncertainty_px = _GrowingArray(
                    self.folder / "uncertainty_px.npy", (self._vertex_count,), keep=False
                )
        if (self._uncertainty_px is None) != (uncertainty_px is None):
            raise BadMesh("moving mesh: uncertainty must come with every frame or with none")
        if self._uncertainty_px is not None and uncertainty_px is not None:
            self._uncertainty_px.append(uncertainty_px)
        self._vertices.append(vertices_in_camera)

    def truncate(self, frame_count: int) -> None:
        """Forget the frames from `frame_count` on."""
        self._vertices.truncate(frame_count)
        if self._uncertainty_px is not None:
            self._uncertainty_px.truncate(frame_count)

    def close(self) -> None:
        """Close the files."""
        self._vertices.close()
        if self._uncertainty_px is not None:
            self._uncertainty_px.close()

    def __exit__(self, *_: object) -> None:
        self.close()


def read_mesh_sequence(folder: Path | str) -> MeshSequence:
    """Open a moving mesh; vertices and uncertainty stay on disk as memory maps. Raises `BadMesh`.

    Where a run was killed between writing the one and the other, the frames that both have are read.
    """
    folder = Path(folder)
    template = read_mesh(require_file(folder / "template.ply", BadMesh))
    meaning = read_json(folder / "sequence.json", BadMesh)
    try:
        rate = float(meaning["frame_rate_hz"])
        times_s = None if meaning.get("times_s") is None else np.array(meaning["times_s"], dtype=np.float64)
    except (ValueError, KeyError, TypeError, OverflowError, AttributeError) as problem:
        raise BadMesh(
            f"{folder / 'sequence.json'}: expected JSON with frame_rate_hz, and numbers as times_s"
        ) from problem
    vertices, uncertainty_px = np.atleast_1d(map_npy(folder / "vertices.npy", BadMesh)), None
    if (folder / "uncertainty_px.npy").exists():
        uncertainty_px = np.atleast_1d(map_npy(folder / "uncertainty_px.npy", BadMesh))
        whole = min(len(vertices), len(uncertainty_px))
        vertices, uncertainty_px = vertices[:whole], uncertainty_px[:whole]
    elif (folder / "track.json").exists():  # `track` writes them with every frame
        _logger.warning(
            "%s: uncertainty_px.npy is missing, so no vertex has an expected error; track again, with "
            "--overwrite, to have them",
            folder,
        )
    sequence = MeshSequence(
        template=template,
        vertices=vertices,
        frame_rate_hz=rate,
        times_s=None if times_s is None else np.atleast_1d(times_s)[: len(vertices)],
        uncertainty_px=uncertainty_px,
    )
    sequence.require_finite(str(folder / "vertices.npy"))
    return sequence


class _GrowingArray:
    """A .npy file of float32 that grows along its first axis; its header is right after every append."""

    def __init__(self, path: Path, row_shape: tuple[int, ...], *, keep: bool) -> None:
        self.path = path
        self.row_shape = row_shape
        self.count = 0
        with self._errors():
            if keep and path.exists():
                mapped = map_npy(path, BadMesh)
                require_shape(mapped, (None, *row_shape), str(path), BadMesh)
                self.count = len(mapped)
                self._start = int(mapped.offset)
                del mapped
                self._stream: BinaryIO = path.open("r+b")
            else:
                self._stream = path.open("w+b")
                self._start = self._write_header()
            self.truncate(self.count)

    def append(self, row: FloatArray) -> None:
        with self._errors():
            try:
                self._stream.write(np.ascontiguousarray(row, dtype="<f4").tobytes())
                self._stream.flush()
            except OSError:
                self.truncate(self.count)
                raise
            self.count += 1
            self._write_header()

    def truncate(self, count: int) -> None:
        with self._errors():
            self.count = min(count, self.count)
            self._stream.truncate(self._start + self.count * 4 * int(np.prod(self.row_shape)))
            self._write_header()

    def close(self) -> None:
        with self._errors():
            self._stream.close()

    def _write_header(self) -> int:
        """Write the header, whose length numpy keeps constant while the first axis grows; go to the end."""
        self._stream.seek(0)
        header = {"descr": "<f4", "fortran_order": False, "shape": (self.count, *self.row_shape)}
        np.lib.format.write_array_header_1_0(self._stream, header)
        length = self._stream.tell()
        self._stream.seek(0, 2)
        self._stream.flush()
        return length

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise cannot_write(self.path, error) from error


def _require_same_template(folder: Path, vertex_count: int) -> None:
    have = len(read_mesh(folder / "template.ply").vertices)
    if have != vertex_count:
        raise BadMesh(f"{folder}: holds a moving mesh of {have} vertices, not {vertex_count}; overwrite it")
