"""Calibration on a bare head that turns: tracks, poses, hull, stereo and light give a rig."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import ByteArray, IntArray
from vntoolkit.calibration.head.hull import (
    DistanceGrid,
    SilhouetteView,
    box_about_points,
    fit_hull,
    mesh_of_grid,
    spread_over_turn,
)
from vntoolkit.calibration.head.light import HeadLight, fit_light
from vntoolkit.calibration.head.patches import detail_in_8_bits, find_again
from vntoolkit.calibration.head.poses import HeadMotion, adjust_head_motion, solve_head_motion
from vntoolkit.calibration.head.refinement import RefinedHead, refine_head
from vntoolkit.calibration.head.samples import HeadRays, HeadSamples, LightFrame, sample_head
from vntoolkit.calibration.head.shape import fit_shape
from vntoolkit.calibration.head.sift import SiftBuilder, require_features
from vntoolkit.calibration.head.silhouettes import Silhouette, find_silhouette, require_head
from vntoolkit.calibration.head.tracks import TrackBuilder, Tracks, local_contrast, require_tracks
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.footage.captures import Capture
from vntoolkit.io.footage.decoding import Undistorter
from vntoolkit.options.footage import Gaps
from vntoolkit.options.head import Features, HeadOptions, HeadShape, HeadSteps
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.calibrate import CalibrationJob, rig_of

_SEED = 0
_INITIAL_FOCAL = 3.0  # of the picture's longer side, where nobody knows: a portrait lens
_LEAST_FRAMES, _MOST_FRAMES = 12, 400
_HULL_VIEWS = 32
_NORMAL_FRAMES = 24  # over the turn: each part of the face is seen in ten of them


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadCalibration:
    """Result of a calibration.

    hull, fused, mesh: shapes in the head frame, of silhouettes, with stereo, and the one used.
    refined: how the shape was refined, None where it was not. light_numbers: frames of the samples.
    stage_seconds: wall time per stage.
    """

    footage: HeadFootage
    tracks: Tracks
    motion: HeadMotion
    hull: Mesh
    fused: Mesh
    mesh: Mesh
    refined: RefinedHead | None
    light_numbers: tuple[int, ...]
    samples: HeadSamples
    light: HeadLight
    stage_seconds: Mapping[str, float]


def calibrate_head(job: CalibrationJob, options: HeadOptions | None = None) -> tuple[Rig, HeadCalibration]:
    """Fit a rig to footage of a head that turns left and right with a fixed expression (brostow2011, IV).

    Raises `BadCalibration` that names the stage and what to film instead.
    """
    options = options or HeadOptions()
    rng = np.random.default_rng(_SEED)
    clock = _Clock()
    capture = job.open()
    job.judge(capture)
    given = job.camera_for(capture.info)
    size = (capture.info.width, capture.info.height)
    undistorter = Undistorter(
        given or Camera.pinhole(width=size[0], height=size[1], focal_px=_INITIAL_FOCAL * max(size))
    )
    with clock.stage("tracks"):
        footage, tracks = _follow(job, undistorter, options)
    with clock.stage("poses"):
        motion = solve_head_motion(
            tracks,
            undistorter.camera,
            options.steps,
            rng,
            refine_focal=given is None,
            features=options.features,
        )
    with clock.stage("hull"):
        carved = _carve(footage, motion, options.steps)
    shape = carved.mesh
    if options.head_shape is not HeadShape.HULL:
        carved, shape = _with_stereo(footage, carved, options, clock, refine_focal=given is None)
    turn = _Turn(capture=capture, undistorter=undistorter, footage=footage, motion=carved.motion)
    with clock.stage("light"):
        chosen = spread_over_turn(carved.views, options.steps.light_frames)
        samples = sample_head(shape, carved.motion.camera, turn.frames(chosen), options.steps, rng)
        light = fit_light(samples, HeadRays(shape), options.steps, rng, options.light_model)
    mesh, refined = shape, None
    if options.head_shape is HeadShape.REFINED:
        chosen = spread_over_turn(carved.views, _NORMAL_FRAMES)
        with clock.stage("refinement"):
            frames = partial(turn.frames, chosen)
            refined = refine_head(shape, carved.motion.camera, frames, light, options.steps, rng)
        mesh, samples, light = refined.mesh, refined.samples, refined.light
    camera = carved.motion.camera if given is None else given
    rig = rig_of(job, capture, camera, light.response, light.quality, "the skin of the head")
    return rig, HeadCalibration(
        footage=footage,
        tracks=tracks,
        motion=carved.motion,
        hull=carved.mesh,
        fused=shape,
        mesh=mesh,
        refined=refined,
        light_numbers=tuple(footage.numbers[k] for k in chosen),
        samples=samples,
        light=light,
        stage_seconds=clock.seconds,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Carved:
    """The head's motion, and its silhouettes' hull: views of all frames, grid and mesh."""

    motion: HeadMotion
    views: list[SilhouetteView]
    grid: DistanceGrid
    mesh: Mesh


def _carve(footage: HeadFootage, motion: HeadMotion, steps: HeadSteps) -> _Carved:
    views = [
        SilhouetteView(camera=motion.camera, camera_from_head=pose, mask=silhouette.mask)
        for pose, silhouette in zip(motion.camera_from_head, footage.silhouettes, strict=True)
    ]
    box = box_about_points(motion.points_in_head)
    grid = fit_hull([views[k] for k in spread_over_turn(views, _HULL_VIEWS)], box, steps)
    return _Carved(motion=motion, views=views, grid=grid, mesh=mesh_of_grid(grid))


def _with_stereo(
    footage: HeadFootage, carved: _Carved, options: HeadOptions, clock: _Clock, *, refine_focal: bool
) -> tuple[_Carved, Mesh]:
    """Fuse stereo into the hull twice: what the first pass finds corrects the poses for the second."""
    fuse = partial(fit_shape, contrasts=footage.contrasts)
    with clock.stage("stereo"):
        rough = fuse(carved.views, hull=carved.grid, steps=options.steps)
    with clock.stage("poses again"):
        again = find_again(carved.views, footage.details, rough, carved.motion.points_in_head)
        motion, moved = adjust_head_motion(carved.motion, *again, refine_focal=refine_focal)
        carved = _carve(footage, motion, options.steps)
        rough = rough.with_vertices(moved.apply(rough.vertices))
    with clock.stage("stereo again"):
        closely = options.steps.closely()
        shape = fuse(carved.views, hull=carved.grid, steps=closely, about=rough)
    return carved, shape


@dataclass(frozen=True, kw_only=True, eq=False)
class _Turn:
    """The frames of the turn, with the head's pose and silhouette in each."""

    capture: Capture
    undistorter: Undistorter
    footage: HeadFootage
    motion: HeadMotion

    def frames(self, numbers: IntArray) -> Iterator[LightFrame]:
        """Yield those frames, counted among the frames used."""
        wanted = {self.footage.numbers[k]: k for k in numbers.tolist()}
        # one pass: to seek in a video costs more than to decode what lies between
        for frame in self.capture.frames(min(wanted), max(wanted) + 1):
            if frame.number in wanted:
                k = wanted[frame.number]
                yield LightFrame(
                    frame=self.undistorter.frame(frame),
                    camera_from_head=self.motion.camera_from_head[k],
                    mask=self.footage.silhouettes[k].mask,
                )


def _follow(
    job: CalibrationJob, undistorter: Undistorter, options: HeadOptions
) -> tuple[HeadFootage, Tracks]:
    capture = job.open(gaps=Gaps.REFUSE)  # points are followed from frame to frame
    numbers = job.numbers(capture)
    if not _LEAST_FRAMES <= len(numbers) <= _MOST_FRAMES:
        more = len(numbers) > _MOST_FRAMES
        hint = f"give --frames ::{-(-len(numbers) // 120)}" if more else "film at most 4 degrees a frame"
        fault = BadInput if more else BadCalibration
        raise fault(
            f"tracks: expected {_LEAST_FRAMES} to {_MOST_FRAMES} frames of the turn, got {len(numbers)}; "
            f"{hint}"
        )
    read = capture.frames(numbers.start, numbers.stop, numbers.step)
    frames = map(undistorter.frame, progress.counted(read, "tracks", len(numbers)))
    return follow_frames(frames, undistorter.camera, options)


class _Clock:
    """Seconds that each stage takes."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        progress.begin(name)
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadFootage:
    """What is kept of the footage: per frame used its number, silhouette, and two images in 8 bits.

    contrasts: local contrast, (h, w). details: logarithm of the brightness less its mean around, (h, w).
    """

    numbers: tuple[int, ...]
    silhouettes: tuple[Silhouette, ...]
    contrasts: tuple[ByteArray, ...]
    details: tuple[ByteArray, ...]


def follow_frames(
    frames: Iterable[LinearFrame], camera: Camera, options: HeadOptions
) -> tuple[HeadFootage, Tracks]:
    """Find silhouettes and tracks in undistorted frames; raise `BadCalibration` where either is no use."""
    sift = options.features is Features.SIFT
    builder = SiftBuilder(camera=camera) if sift else TrackBuilder(steps=options.steps)
    numbers, silhouettes, contrasts, details = [], [], [], []
    for frame in frames:
        silhouette = find_silhouette(frame.rgb, options.threshold)
        contrasts.append(local_contrast(frame.rgb))
        builder.add(contrasts[-1], silhouette.bright)
        numbers.append(frame.number)
        silhouettes.append(silhouette)
        details.append(detail_in_8_bits(frame.rgb))
    require_head(silhouettes)
    tracks = builder.finish()
    (require_features if sift else require_tracks)(tracks)
    footage = HeadFootage(
        numbers=tuple(numbers),
        silhouettes=tuple(silhouettes),
        contrasts=tuple(contrasts),
        details=tuple(details),
    )
    return footage, tracks
