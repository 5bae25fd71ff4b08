"""All of a result on one timeline, as a recording for the Rerun viewer."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import Float32Array
from vntoolkit.display import picture_of_normals
from vntoolkit.geometry.maps import LengthUnit
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.recordings.recorded import RecordedFrame
from vntoolkit.libraries import require_installed
from vntoolkit.options.export import MeshUpAxis

_AXES = {MeshUpAxis.Y: "RUB", MeshUpAxis.Z: "RFU"}  # what x, y and z of the files point to
_JPEG_QUALITY = 90
_ARROW_PX = 12  # between arrows
_IN_SPACE = ("surface", "object")
_PLOTS = ("contact_mm2", "contact_depth_mm")


def write_rrd(path: Path | str, frames: Iterable[RecordedFrame], up: MeshUpAxis = MeshUpAxis.Y) -> int:
    """Write frames, in order, atomically: timelines `time` (seconds) and `frame`. Returns their number.

    `picture` and `normals` (x right, y up, z towards the viewer, as colours) are images, `depth` a depth
    image, `error_deg` a grey one, `contact` a segmentation, `picture/motion` arrows of a gel's material;
    `surface` is the mesh and `object` the motion of what touches a gel; `contact_mm2` and `contact_depth_mm`
    are plotted. Invalid normals are white, invalid depths and errors NaN.
    """
    require_installed("rerun", "'vntoolkit[rerun]'", "Rerun's recordings are written by rerun-sdk")
    import rerun as rr

    recording = rr.RecordingStream("vntoolkit")
    recording.set_log_time_enabled(False)
    count, names, faces = 0, dict[str, None](), None
    with atomic_path(path) as temporary:
        recording.save(temporary)
        recording.log("/", getattr(rr.ViewCoordinates, _AXES[up]), static=True)
        for frame in frames:
            recording.set_time("frame", sequence=frame.number)
            recording.set_time("time", duration=frame.time_s)
            for name, content in _entities(rr, frame):
                recording.log(name, content)
                names[name] = None
            if frame.mesh is not None:
                is_known = faces is not None and np.array_equal(frame.mesh.faces, faces)
                recording.log("surface", _surface(rr, frame.mesh, is_known))
                names["surface"], faces = None, frame.mesh.faces
            count += 1
        recording.send_blueprint(_blueprint(list(names)))
        recording.flush()
        recording.disconnect()
    return count


def _entities(rr: Any, frame: RecordedFrame) -> Iterator[tuple[str, Any]]:
    """Name and content of what a frame logs."""
    mask, depth, pose = frame.normals.mask, frame.depth, frame.object_from_first
    if frame.picture is not None:
        yield "picture", rr.Image(frame.picture).compress(jpeg_quality=_JPEG_QUALITY)
    yield "normals", rr.Image(picture_of_normals(frame.normals.normals_in_camera, mask))
    if frame.normals.error_deg is not None:
        yield "error_deg", rr.Image(np.where(mask, frame.normals.error_deg, np.nan).astype(np.float32), "L")
    if depth is not None:
        known = np.where(depth.mask, depth.depth, np.nan).astype(np.float32)
        span = [float(np.nanmin(known)), float(np.nanmax(known))] if depth.mask.any() else None
        meter = 1.0 if depth.unit is LengthUnit.METRE else None
        yield "depth", rr.DepthImage(known, meter=meter, depth_range=span)
    if frame.contact is not None:
        yield "contact", rr.SegmentationImage(frame.contact.astype(np.uint8))
    if frame.moved_px is not None:
        yield "picture/motion", _arrows(rr, frame.moved_px)
    for name in _PLOTS:
        if (value := getattr(frame, name)) is not None:
            yield name, rr.Scalars(value)
    if pose is not None:
        yield "object", rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation)


def _arrows(rr: Any, moved_px: Float32Array) -> Any:
    """Motion (h, w, 2), in its true length, from where the material was."""
    half = _ARROW_PX // 2
    some = moved_px[half::_ARROW_PX, half::_ARROW_PX]
    v, u = np.nonzero(np.isfinite(some).all(axis=-1))
    ends = _ARROW_PX * np.column_stack([u, v]) + half
    return rr.Arrows2D(origins=ends - some[v, u], vectors=some[v, u])


def _surface(rr: Any, mesh: Mesh, is_known: bool) -> Any:
    """A mesh, or only where it has moved: a tracked one keeps its triangles."""
    if is_known:
        return rr.Mesh3D.from_fields(vertex_positions=mesh.vertices, vertex_normals=mesh.normals)
    colours = None if mesh.colours is None else (255 * mesh.colours + 0.5).astype(np.uint8)
    return rr.Mesh3D(
        vertex_positions=mesh.vertices,
        triangle_indices=mesh.faces,
        vertex_normals=mesh.normals,
        vertex_colors=colours,
    )


def _blueprint(names: list[str]) -> Any:
    """One view of space, one of each picture, one plot."""
    import rerun.blueprint as rrb

    space = [name for name in names if name in _IN_SPACE]
    plots = [name for name in names if name in _PLOTS]
    maps = [name for name in names if name not in (*space, *plots) and "/" not in name]
    flat = [rrb.Spatial2DView(origin=name, name=name) for name in maps]
    views: list[Any] = [rrb.Spatial3DView(origin="/", contents=space, name="surface")] if space else []
    views += [rrb.TimeSeriesView(origin="/", contents=plots, name="contact")] if plots else []
    return rrb.Blueprint(rrb.Horizontal(rrb.Grid(*flat), rrb.Vertical(*views)) if views else rrb.Grid(*flat))
