"""Registration of all frames of a reconstruction to one moving mesh."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import (
    Array,
    FloatArray,
    Mask,
    MaterialLabels,
    Normals,
    Points,
    Points2,
    VisibilityLabels,
)
from vntoolkit.diagnosis.finding import Finding, judge
from vntoolkit.errors import BadInput, BadMesh, VntError
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import MeshSequence
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.io.maps_and_meshes.arrays import read_npz
from vntoolkit.io.results.folder import begin_run, option_values, read_lock, require_same_request, write_lock
from vntoolkit.io.results.frame_log import FrameEntry
from vntoolkit.io.results.seams import read_seams
from vntoolkit.io.results.sequences import MeshSequenceWriter, read_mesh_sequence
from vntoolkit.io.rigs import entry_from_camera
from vntoolkit.options.tracking import TrackArguments, Tracker, TrackingOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.pipeline.opened_result import OpenedResult, read_result
from vntoolkit.pipeline.tracked_folder import MEMORY_NAME, TRACKS, TRACKS_VERSION, remove_backwards
from vntoolkit.tracking.paint import Paint, paint_of_frame
from vntoolkit.tracking.running_template import RunningTemplate
from vntoolkit.tracking.tracker import SurfaceTracker, tracked_frame

if TYPE_CHECKING:
    from vntoolkit.pipeline.membrane_tracker import MembraneTracker
    from vntoolkit.tactile.motion import Membrane, MembraneMotion

    AnyTracker = SurfaceTracker | MembraneTracker
    Running = RunningTemplate | MembraneMotion

_LOGGER = logging.getLogger(__name__)
_MEMORY_EVERY = 16  # frames that a run killed on the way does again, at most

PaintReader = Callable[[int, NormalMap], Array]  # (h, w): of a membrane bytes, else `Paint`


@dataclass(frozen=True, kw_only=True)
class TrackSummary:
    """template: number of its frame. frames: in the result; resumed: of those, on disk already.

    missing: numbers of those held still. visible: of every other frame, the share of the vertices whose
    expected error is at most `lost_px`; empty for a published method, which tells no error.
    """

    folder: Path
    template: int
    vertices: int
    frames: int
    resumed: int
    missing: tuple[int, ...]
    visible: tuple[float, ...]


def track(asked: TrackArguments) -> TrackSummary:
    """Track the template through all frames into `asked.target`; go on where an earlier run stopped.

    The template is tracked backwards to the first frame, then forwards to the last. A frame without files
    holds the vertices where they were, with an infinite expected error; tracking goes on with the next frame
    that is there. A single frame gives a sequence of one. Raises `BadInput` for a template frame that is
    not there and for a target that holds something else, before anything there is touched; `CannotWrite`
    while another run is at work in one of the folders.
    """
    folder = Path(asked.folder)
    source = read_result(folder, footage=asked.footage, background=asked.background)
    seams = () if asked.seams is None else read_seams(asked.seams)
    if asked.object and source.rig.gel is None:
        raise BadInput("--object: expected the reconstruction of a tactile gel")
    numbers = source.frames_to_track
    there = [n for n in numbers if has_maps(source, n)]
    template = asked.template
    if template is None:  # seams were drawn on a frame that is known before
        template = there[0] if seams or source.rig.gel else best_frame(source, there)
    if template not in there:
        raise BadInput(
            f"--template {template}: that frame is not in {folder}; it holds {numbers[0]} to {numbers[-1]}"
        )
    membrane = None
    if source.rig.gel is not None and asked.method is Tracker.DEFAULT:
        membrane = _membrane_of(source)
    paint_of = _paint_reader(asked, source, there[0], membrane)
    record = _record(asked, seams, source, template) | {"paint": paint_of is not None}
    with read_lock(folder), write_lock(asked.target) as target:
        require_same_request(target, TRACKS, record, overwrite=asked.overwrite)
        tracker = _tracker_of(asked, seams, source, template, paint_of, membrane)
        begin_run(target, TRACKS, record, overwrite=asked.overwrite)
        resumed = _run(tracker, source, template, target, paint_of)
        if membrane is not None:
            from vntoolkit.pipeline.gel_motion import write_gel_motion

            write_gel_motion(source, membrane, target)
    missing = tuple(n for n in numbers if n not in there)
    visible, error_px = _visible_shares(asked, [numbers.index(n) for n in there])
    judge(findings_from_tracks(visible, error_px, there if visible else ()))
    if missing:
        _LOGGER.warning(
            "%d frames are missing and were held still, the first is %d", len(missing), missing[0]
        )
    return TrackSummary(
        folder=target,
        template=template,
        vertices=len(tracker.template.pixels),
        frames=len(numbers),
        resumed=resumed,
        missing=missing,
        visible=visible,
    )


def _membrane_of(source: OpenedResult) -> Membrane | None:
    """The membrane of a gel, whose material is followed; None, which is said, where the footage is gone."""
    try:
        background = source.capture.background
        if background is None:
            raise BadInput("give the untouched gel as --background")
        from vntoolkit.pipeline.pressed_gel import membrane_of

        membrane = membrane_of(source.rig, background)
        if not membrane.is_followable:
            raise BadInput("the picture of the gel is too small")
        return membrane
    except VntError as problem:
        _LOGGER.warning("the gel's material is not tracked, its shape alone is: %s", problem)
        return None


def _tracker_of(
    asked: TrackArguments,
    seams: Sequence[Points2],
    source: OpenedResult,
    template: int,
    paint_of: PaintReader | None,
    membrane: Membrane | None,
) -> AnyTracker:
    maps = maps_of(source, template)
    paint = None if paint_of is None else paint_of(template, maps[0])
    if membrane is not None and paint is not None:
        from vntoolkit.pipeline.membrane_tracker import MembraneTracker

        return MembraneTracker(*maps, source.camera, membrane, paint, seams)
    labels = source.labels(template)
    return SurfaceTracker(*maps, source.camera, asked.part(TrackingOptions), seams, labels, paint)


def has_maps(result: OpenedResult, number: int) -> bool:
    """Whether a frame has both normals and depth."""
    return result.folder.has(number, "normals", "depth")


def maps_of(result: OpenedResult, number: int) -> tuple[NormalMap, DepthMap]:
    """Read a frame that `has_maps`."""
    depth_map = result.depth(number)
    if depth_map is None:
        raise BadInput(f"frame {number}: its depth has vanished from {result.folder.root}")
    return result.normals(number), depth_map


def _paint_reader(
    asked: TrackArguments, result: OpenedResult, first: int, membrane: Membrane | None
) -> PaintReader | None:
    """Return what reads the paint of a frame from the footage; None where that is not at hand.

    membrane: of a gel, whose paint is its printed dots, or its texture.
    """
    if membrane is not None:
        from vntoolkit.pipeline.gel_motion import paint_of_gel

        return lambda number, _: paint_of_gel(result, membrane, number)
    if asked.method is not Tracker.DEFAULT or result.rig.gel is not None:  # a gel has one reflectance
        return None
    try:
        if result.lacks_background:
            raise BadInput("the reconstruction subtracted a background; give it as --background")
        result.linear(first)
    except VntError as problem:
        _LOGGER.warning("tracking uses relief and shape, not the colours of the surface: %s", problem)
        return None
    reflectances = np.array([entry.reflectance for entry in result.manifest.known.materials]).reshape(-1, 3)

    def paint_of(number: int, normal_map: NormalMap) -> Paint:
        return paint_of_materials(
            result.linear(number),
            normal_map.normals_in_camera,
            result.rig.response,
            result.labels(number),
            result.materials(number),
            reflectances,
        )

    return paint_of


def paint_of_materials(
    linear: LinearFrame,
    normals: Normals,
    response: LightResponse,
    labels: VisibilityLabels | None,
    materials: MaterialLabels | None,
    reflectances: Points,
) -> Paint:
    """Return (h, w), `paint_of_frame` of a subject of several materials, each by its own reflectance.

    materials: (h, w), numbers of the reflectances (m, 3), whose geometric mean over the lamps counts; None
    for the rig's material alone, whose M would take the hue of another for a turn of the surface.
    """
    if materials is None or not len(reflectances):
        return paint_of_frame(linear, normals, response, labels)
    from vntoolkit.materials.relighting import relit

    brightness = np.exp(np.log(reflectances).mean(axis=1)).astype(np.float32)
    alike = relit(linear, response.central, materials, reflectances)
    return brightness[materials] * paint_of_frame(alike, normals, response, labels)


def _visible_shares(
    asked: TrackArguments, rows: Sequence[int]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Of these rows, the share of the vertices that are reported visible, and the median expected error."""
    uncertainty = read_mesh_sequence(asked.target).uncertainty_px
    if uncertainty is None:
        return (), ()
    shares = tuple(float((uncertainty[row] <= asked.lost_px).mean()) for row in rows)
    return shares, tuple(float(np.median(uncertainty[row])) for row in rows)


def _run(
    tracker: AnyTracker,
    source: OpenedResult,
    template: int,
    target: Path,
    paint_of: PaintReader | None,
) -> int:
    numbers, filmed = source.frames_to_track, source.manifest.input
    rate, times_s = filmed.rate_of(numbers), filmed.times_of(numbers)
    at = numbers.index(template)
    back, ahead = numbers[:at][::-1], numbers[at + 1 :]
    mesh, first = tracker.mesh, tracker.state
    with MeshSequenceWriter(target, mesh, frame_rate_hz=rate, times_s=times_s, resume=True) as writer:
        _truncate_to_memory(writer, tracker, at + 1)
        resumed = writer.frame_count
        if resumed <= at:  # the part before the template is not yet in place
            writer.truncate(0)
            with MeshSequenceWriter(target / "backwards", mesh, frame_rate_hz=rate, resume=True) as backwards:
                _truncate_to_memory(backwards, tracker, 0)
                resumed = backwards.frame_count
                progress.begin("track", len(numbers), resumed)
                _follow(tracker, source, (template, *back), backwards, paint_of, lead=0)
            _copy_reversed(target / "backwards", writer, tracker)
            writer.append(first.vertices_in_camera, first.uncertainty_px)
            progress.step()
        else:
            progress.begin("track", len(numbers), resumed)
        tracker.resume(first, first, source.normals(template))
        _follow(tracker, source, (template, *ahead), writer, paint_of, lead=at + 1)
    remove_backwards(target)
    return resumed


def _follow(
    tracker: AnyTracker,
    source: OpenedResult,
    numbers: tuple[int, ...],
    writer: MeshSequenceWriter,
    paint_of: PaintReader | None,
    lead: int,
) -> None:
    """Track numbers[1:] from numbers[0]; the writer holds `lead` frames that are not of this run."""
    done = writer.frame_count - lead
    if done > 0:
        _go_on(tracker, source, numbers[: done + 1], writer.folder, writer.frame_count - 1 - done)
    kept = None
    try:
        for number in numbers[done + 1 :]:
            if has_maps(source, number):
                normal_map, depth_map = maps_of(source, number)
                paint = None if paint_of is None else paint_of(number, normal_map)
                tracked = tracker.step(normal_map, depth_map, source.labels(number), paint)
                writer.append(tracked.vertices_in_camera, tracked.uncertainty_px)
            else:
                held, uncertainty = tracker.state.vertices_in_camera, tracker.state.uncertainty_px
                writer.append(
                    held, None if uncertainty is None else np.full(len(held), np.inf, dtype=np.float32)
                )
            if tracker.running is not None:
                kept = writer.frame_count, tracker.running
                if writer.frame_count % _MEMORY_EVERY == 0:
                    write_running_template(writer.folder, *kept)
            progress.step()
    finally:
        if kept is not None:
            write_running_template(writer.folder, *kept)


def _truncate_to_memory(writer: MeshSequenceWriter, tracker: AnyTracker, lead: int) -> None:
    """Drop the frames after the one whose memory is on disk; lead: how many stay in any case."""
    if tracker.running is not None and writer.frame_count > lead:
        count, _ = read_running_template(writer.folder, tracker.running)
        writer.truncate(max(count if count <= writer.frame_count else 0, lead))


def _go_on(tracker: AnyTracker, source: OpenedResult, done: tuple[int, ...], folder: Path, row: int) -> None:
    """Restore the tracker after the last frame on disk. row: of the template among them, or −1."""
    present = [i for i, number in enumerate(done) if i == 0 or has_maps(source, number)]
    if len(present) < 2:
        return
    sequence = _tracked_before(folder, tracker)
    states = [tracker.state]  # of the template
    for i in present[1:][-2:]:
        uncertainty = None if sequence.uncertainty_px is None else np.array(sequence.uncertainty_px[row + i])
        states.append(tracked_frame(np.array(sequence.vertices[row + i]), uncertainty, source.camera))
    kept = tracker.running
    running: Any = None if kept is None else read_running_template(folder, kept)[1]
    tracker.resume(states[-2], states[-1], source.normals(done[present[-1]]), running)


def _copy_reversed(folder: Path, writer: MeshSequenceWriter, tracker: AnyTracker) -> None:
    if read_mesh_sequence(folder).vertices.size == 0:  # the template is the first frame
        return
    sequence = _tracked_before(folder, tracker)
    for row in range(len(sequence) - 1, -1, -1):
        uncertainty = None if sequence.uncertainty_px is None else np.array(sequence.uncertainty_px[row])
        writer.append(np.array(sequence.vertices[row]), uncertainty)


def _tracked_before(folder: Path, tracker: AnyTracker) -> MeshSequence:
    """Return what an earlier run tracked, with its expected errors, which nothing but a person removes."""
    sequence = read_mesh_sequence(folder)
    if sequence.uncertainty_px is None and tracker.state.uncertainty_px is not None:
        raise BadMesh(f"{folder}: uncertainty_px.npy is missing; add --overwrite to track anew")
    return sequence


def _record(
    asked: TrackArguments, seams: Sequence[Points2], source: OpenedResult, template: int
) -> dict[str, Any]:
    return {
        "version": TRACKS_VERSION,
        "result_sha256": source.digest,
        "template": template,
        "options": option_values(asked.part(TrackingOptions)),
        "lost_px": asked.lost_px,
        "seams": [np.asarray(seam).tolist() for seam in seams],
        "frame_rate_hz": source.manifest.input.playing_rate_hz,
        "camera": entry_from_camera(source.rig.camera).model_dump(mode="json"),
        "frames": list(source.frames_to_track),
    }


def write_running_template(folder: Path, frame_count: int, running: Running) -> None:
    """Write the running template after so many frames of the moving mesh in the folder."""
    with atomic_path(folder / MEMORY_NAME) as path, path.open("wb") as stream:
        np.savez(stream, frame_count=frame_count, **vars(running))


def read_running_template(folder: Path, like: Running) -> tuple[int, Running]:
    """Return what `write_running_template` wrote, and after how many frames.

    like: of the same template. Where the folder holds none that is whole and of this template: 0, and that.
    """
    path = folder / MEMORY_NAME
    if not path.exists():
        return 0, like
    try:
        found = {name: read_npz(path, name) for name in vars(like)}
        frame_count = int(read_npz(path, "frame_count"))
        whole = all(
            found[name].shape == array.shape and np.isfinite(found[name]).all()
            for name, array in vars(like).items()
        )
    except (BadInput, TypeError):
        return 0, like
    return (frame_count, type(like)(**found)) if whole else (0, like)


# The frame that a template is best made from: most of the surface, lit well, sharp.

_COMPARED = 12  # frames that are read: those that show most, evenly spread
_FINE_PX, _COARSE_PX = 1, 4  # over which normals change


def best_frame(result: OpenedResult, numbers: Sequence[int]) -> int:
    """Return the frame of these that shows most that is lit and sharp; of equals, the first.

    Frames are equal that differ by no more than most do from the next.
    """
    lit = np.array([_lit_share(result.entries.get(number)) for number in numbers])
    places = sampled(np.flatnonzero(lit >= np.median(lit)).tolist(), _COMPARED)
    worth = np.array([lit[k] * sharpness_of(result.normals(numbers[k])) for k in places])
    alike = float(np.median(np.abs(np.diff(worth)))) if len(worth) > 1 else 0.0
    return numbers[places[int(np.argmax(worth >= worth.max() - alike))]]


def _lit_share(entry: FrameEntry | None) -> float:
    """Return the share of the pixels that have a normal, which all lamps reach and no light clips."""
    if entry is None:  # a log that is gone
        return 1.0
    return entry.valid_share * (1.0 - entry.shadowed_share) * (1.0 - entry.clipped_share)


def sharpness_of(normal_map: NormalMap) -> float:
    """Return how much of the change of normals over pixels is left over single ones; 0 to about 1.

    Changes at two places are multiplied, so that noise, which they do not share, cancels.
    """
    coarse = _change(normal_map.normals_in_camera, normal_map.mask, _COARSE_PX)
    fine = _change(normal_map.normals_in_camera, normal_map.mask, _FINE_PX)
    return float(np.clip(fine / coarse, 0.0, 1.0)) if coarse > 0 else 1.0


def _change(normals: FloatArray, mask: Mask, step: int) -> float:
    """Return the mean product of changes a pixel over `step` pixels, at neighbouring places."""
    total = count = 0.0
    for axis in (0, 1):
        places = [np.roll(normals, -k * step, axis) for k in range(4)]
        seen = np.logical_and.reduce([np.roll(mask, -k * step, axis) for k in range(4)])
        seen[tuple(slice(-3 * step, None) if a == axis else slice(None) for a in (0, 1))] = False
        products = ((places[1] - places[0]) * (places[3] - places[2])).sum(axis=2)
        total, count = total + float(products[seen].sum()), count + float(seen.sum())
    return total / max(count, 1.0) / step**2


# Where tracking lost the surface.

_JUMP = 10.0  # times the expected error of the frame before; a surface that fades is lost more slowly
_LEAST_ERROR_PX = 0.2
_LEAST_VISIBLE = 0.5  # of a tracked surface's vertices; of a head that turns away more stay in view


def findings_from_tracks(
    visible: Sequence[float], error_px: Sequence[float], numbers: Sequence[int]
) -> list[Finding]:
    """Find where tracking lost the surface.

    visible: share of the vertices that are reported visible, for every frame in the order of time. error_px:
    the median of their expected errors. numbers: of these frames.
    """
    shares = np.asarray(visible, dtype=np.float64)
    if not len(shares) or shares.min() >= _LEAST_VISIBLE:
        return []
    worst, low = int(np.argmin(shares)), int(np.count_nonzero(shares < _LEAST_VISIBLE))
    errors = np.asarray(error_px, dtype=np.float64)
    seen = shares >= _LEAST_VISIBLE
    rise = np.abs(np.diff(np.log(np.maximum(errors, _LEAST_ERROR_PX)))) * (seen[1:] != seen[:-1])
    rise[np.minimum(errors[:-1], errors[1:]) == 0] = 0.0  # beside the template
    lost = {"low": low, "count": len(shares), "worst": numbers[worst], "share": shares[worst]}
    if not rise.max(initial=0.0) > np.log(_JUMP):
        return [Finding.of("lost", **lost)]
    where = int(np.argmax(rise))
    return [Finding.of("jump", **lost, first=numbers[where], second=numbers[where + 1])]
