"""What `--to npz` holds: the named arrays of a frame, and those of the registered surface."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.npz import StreamedArray, write_npz
from vntoolkit.pipeline.export_options import ExportOptions
from vntoolkit.pipeline.opened_result import OpenedResult, TrackedSurface


def arrays_of_frame(
    result: OpenedResult, number: int, options: ExportOptions, factor: float
) -> Mapping[str, npt.NDArray[Any]]:
    """Return what `--to npz` holds of a frame.

    normals (h, w, 3) in the asked convention, mask, confidence; depth along the optical axis, depth_mask;
    labels; vertices, faces, vertex_normals, vertex_colours, uv of the frame's own mesh in the frame of files;
    camera_matrix. factor: of lengths. Parts that the frame lacks are left out.
    """
    normal_map, depth_map = result.normals(number), result.depth(number)
    assert normal_map is not None
    signs = np.array(options.normal_convention.signs, np.float32)
    arrays: dict[str, Any] = {
        "normals": normal_map.normals_in_camera * signs,
        "mask": normal_map.mask,
        "confidence": normal_map.weight,
        "labels": result.labels(number),
        "camera_matrix": result.camera.matrix,
        "normal_convention": np.array(options.normal_convention.value),
        "up": np.array(options.up.value),
    }
    if depth_map is not None:
        arrays |= {"depth": (depth_map.depth * factor).astype(np.float32), "depth_mask": depth_map.mask}
    mesh = result.mesh(number)
    if mesh is not None:
        arrays |= _mesh_arrays(mesh, factor, options)
    return {name: np.asarray(values) for name, values in arrays.items() if values is not None}


def _mesh_arrays(mesh: Mesh, factor: float, options: ExportOptions) -> dict[str, Any]:
    normals = None if mesh.normals is None else graphics_from_camera(mesh.normals, options.up)
    return {
        "vertices": (graphics_from_camera(mesh.vertices, options.up) * factor).astype(np.float32),
        "faces": mesh.faces,
        "vertex_normals": None if normals is None else normals.astype(np.float32),
        "vertex_colours": mesh.colours,
        "uv": mesh.uv,
    }


def write_tracked_npz(
    path: Path, track: TrackedSurface, numbers: tuple[int, ...], options: ExportOptions, factor: float
) -> None:
    """Write the registered surface: vertices (frames, n, 3), faces, uv, confidence, frames, frame_rate_hz."""
    wanted = set(numbers)
    rows = [row for row, number in enumerate(track.numbers) if number in wanted]
    sequence, template = track.sequence, track.sequence.template
    moving = (graphics_from_camera(sequence.vertices[row], options.up) * factor for row in rows)
    arrays: dict[str, Any] = {
        "vertices": StreamedArray(
            shape=(len(rows), len(template.vertices), 3), dtype=np.float32, rows=moving
        ),
        "faces": template.faces,
        "frames": np.array([track.numbers[row] for row in rows]),
        "frame_rate_hz": np.array(sequence.frame_rate_hz),
        "up": np.array(options.up.value),
    }
    arrays |= {name: v for name, v in (("uv", template.uv), ("colours", template.colours)) if v is not None}
    confidence = sequence.confidence
    if confidence is not None:
        arrays["confidence"] = StreamedArray(
            shape=(len(rows), len(template.vertices)), dtype=np.float32, rows=(confidence[r] for r in rows)
        )
    write_npz(path, arrays)
