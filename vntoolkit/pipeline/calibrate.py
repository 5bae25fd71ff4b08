"""Calibration on a ball, a board or known lights: from footage to rig."""

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import Mask
from vntoolkit.calibration.board import BoardCalibration, fit_response_to_board
from vntoolkit.calibration.board_detection import BoardDetector, BoardSighting
from vntoolkit.calibration.lights import (
    FrameColour,
    SwitchedLamps,
    colour_of_frame,
    find_switched_lamps,
    fit_light_colours,
    response_from_lights,
    with_light_colours,
)
from vntoolkit.calibration.sphere import (
    SphereCalibration,
    fit_response_to_sphere,
    fit_response_to_switched_sphere,
)
from vntoolkit.diagnosis.finding import judge
from vntoolkit.diagnosis.inspection import findings_from_calibration_footage
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.files import source_file
from vntoolkit.io.footage.captures import Capture, CaptureInfo, CaptureOptions, open_capture
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.footage.mattes import open_mattes
from vntoolkit.io.light_files import read_lights
from vntoolkit.io.rigs import read_rig
from vntoolkit.options.base import OptionalFile, Source, as_path, named
from vntoolkit.options.calibration import BoardOptions, LightColours, ResponseFitOptions
from vntoolkit.options.footage import Gaps, MatteOptions, PictureLimits, SensorOptions
from vntoolkit.options.shared import AllowOptions, BackgroundOptions, CurveOptions, FrameOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality, Rig

logger = logging.getLogger(__name__)
_SEED = 0  # calibrating the same footage twice gives the same rig


@dataclass(frozen=True, kw_only=True)
class CalibrationJob(
    FrameOptions, BackgroundOptions, CurveOptions, SensorOptions, AllowOptions, PictureLimits
):
    """What the calibrations ask of their footage."""

    source: Source = field(kw_only=False)
    """A video, a folder of images, or a pattern."""
    camera: OptionalFile = named(None)
    """A rig.json whose camera is taken. Default: orthographic (sphere, lights), fitted to the same footage
    (board), or of a focal length that is estimated from the turn, which is rough (head)."""
    focal_px: float | None = None
    """Focal length in pixels. Gives a pinhole camera; use it instead of --camera."""
    single_light: tuple[Source, ...] | None = None
    """Three photographs, each under one light alone: red, green, blue. Or one video, folder or pattern in
    which each light is on alone for a while. They split M into its lights."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.camera is not None and self.focal_px is not None:
            raise BadInput("calibrate: expected --camera or --focal-px, got both")
        if len(self.single_light or ()) not in (0, 1, 3):
            raise BadInput(
                "--single-light: expected three photographs (red, green, blue), or one video, folder or "
                f"pattern in which each lamp is on alone for a while, got {len(self.single_light or ())} "
                "sources"
            )

    @property
    def subtracted(self) -> Path | None:
        """Image of the light that is subtracted from every frame."""
        return as_path(self.background)

    def open(self, source: Source | None = None, gaps: Gaps = Gaps.SKIP) -> Capture:
        """Open the footage, or another source, with the job's transfer curve and background.

        gaps: photographs of a ball or board need no order, and bad ones are often thrown away.
        """
        options = CaptureOptions(
            transfer=self.curve, background=self.subtracted, gaps=gaps, sensor=self.part(SensorOptions)
        )
        return open_capture(str(source or self.source), options)

    def numbers(self, capture: Capture) -> range:
        """Return which of its frames count."""
        return FrameRange.from_text(self.frames or "::").numbers(capture.info.frame_count)

    def judge(self, capture: Capture, mask: Mask | None = None) -> None:
        """Raise `FatalFinding` for footage that no rig can come of. mask: (h, w) of the object."""
        judge(findings_from_calibration_footage(capture, mask, self.numbers(capture)), self.allow)

    def camera_for(self, info: CaptureInfo) -> Camera | None:
        """The camera that the user gave, checked against the footage, or None."""
        if self.camera is not None:
            rig = read_rig(self.camera)
            rig.require_size(info.width, info.height, str(self.source))
            return rig.camera
        if self.focal_px is None:
            return None
        return Camera.pinhole(width=info.width, height=info.height, focal_px=self.focal_px)


@dataclass(frozen=True, kw_only=True)
class SphereJob(CalibrationJob, MatteOptions, ResponseFitOptions):
    """What the calibration on a ball asks."""

    source: Source = field(kw_only=False)
    """A video, an image, a folder of images, or a pattern. Several frames are averaged."""
    mask: OptionalFile = named(None)
    """White where the ball is: an image, or a video, a folder or a pattern with a matte for each frame.
    Default: the outline is detected."""

    @property
    def subtracted(self) -> Path | None:
        """Image of the light that is subtracted: a clean plate is not."""
        return None if self.key is not None else super().subtracted


def calibrate_sphere(job: SphereJob) -> tuple[Rig, SphereCalibration]:
    """Fit a rig to footage of a ball at rest; the frames are averaged.

    Where each lamp is on alone in some frames, M is that of the three together, and their colours, their
    distances and the light of the room are known.
    """
    capture = job.open()
    info, numbers, options = capture.info, job.numbers(capture), job.part(ResponseFitOptions)
    mattes = open_mattes(capture, job.mask, job.part(MatteOptions), as_path(job.background))
    mask = mattes.still
    if mattes.changes:  # the ball is at rest: where every frame has it
        for shown in capture.encoded_frames(numbers.start, numbers.stop, numbers.step):
            matte = mattes.of(shown)
            mask = matte if mask is None or matte is None else mask & matte
    job.judge(capture, mask)
    camera = job.camera_for(info) or Camera.orthographic(width=info.width, height=info.height)
    colours: list[FrameColour] = []
    frame = mean_frame(noted(capture.frames(numbers.start, numbers.stop, numbers.step), mask, colours))
    switched = find_switched_lamps(colours)
    rng = np.random.default_rng(_SEED)
    if switched is None:
        result = fit_response_to_sphere(frame, camera, mask, options, rng)
    else:
        alone = _alone(capture, switched)
        dark = mean_frame(map(capture.frame, switched.dark)) if switched.dark else None
        result = fit_response_to_switched_sphere(alone, camera, mask, options, rng, dark)
    response = result.fit.response
    response = _with_single_lights(job, response, mask)
    return rig_of(job, capture, camera, response, result.fit.quality, "the ball", mattes.files), result


def noted(
    frames: Iterable[LinearFrame], mask: Mask | None, colours: list[FrameColour]
) -> Iterator[LinearFrame]:
    """Yield frames as they come; add the colours of each to a list."""
    for frame in frames:
        colours.append(colour_of_frame(frame, mask))
        yield frame


def _alone(capture: Capture, switched: SwitchedLamps) -> list[LinearFrame]:
    """The mean frame under each lamp."""
    logger.info(
        "each lamp is on alone in %d (red), %d (green), %d (blue) frames, none in %d",
        *map(len, switched.alone),
        len(switched.dark),
    )
    return [mean_frame(map(capture.frame, numbers)) for numbers in switched.alone]


def calibrate_board(
    job: CalibrationJob, layout: BoardLayout, options: BoardOptions
) -> tuple[Rig, BoardCalibration]:
    """Fit a rig to footage of a board that is tilted in all directions, in constant memory."""
    capture = job.open()
    job.judge(capture)
    info, numbers = capture.info, job.numbers(capture)
    detector = BoardDetector(layout)
    sightings: list[BoardSighting] = []
    frames = capture.frames(numbers.start, numbers.stop, numbers.step)
    for frame in progress.counted(frames, "find the board", len(numbers)):
        sighting = detector.sight(frame)
        if sighting is not None:
            sightings.append(sighting)
    result = fit_response_to_board(
        sightings,
        layout,
        (info.width, info.height),
        job.camera_for(info),
        options,
        np.random.default_rng(_SEED),
    )
    response = result.fit.response
    if result.light_colours is not None and not job.single_light:
        response = with_light_colours(response, result.light_colours)
    response = _with_single_lights(job, response, None)
    return rig_of(
        job, capture, result.camera, response, result.fit.quality, "the sample in the board"
    ), result


def calibrate_lights(
    lights_path: Path,
    like: str | None,
    chosen: Sequence[int],
    colours: LightColours,
    job: CalibrationJob,
) -> Rig:
    """Make a rig from known lights.

    like: footage or image that gives the size, else the folder's own image. chosen: which three
    lights of the list are the red, green and blue one.
    """
    lights = read_lights(lights_path)
    if len(chosen) != 3 or len(set(chosen)) != 3:
        raise BadInput(
            f"calibrate lights: expected three different lights, got {', '.join(map(str, chosen))}"
        )
    if not all(0 <= k < len(lights.directions) for k in chosen):
        raise BadInput(
            f"calibrate lights: {lights_path} holds {len(lights.directions)} lights, numbered from 0; "
            f"asked for {', '.join(map(str, chosen))}"
        )
    intensities = None if lights.intensities is None else lights.intensities[list(chosen)]
    response, quality = response_from_lights(lights.directions[list(chosen)], intensities, colours)
    if like is None and not lights.images:
        raise BadInput("calibrate lights: the image size is not known; give footage of the rig with --like")
    capture = job.open(like or lights.images[chosen[0]])
    info = capture.info
    camera = job.camera_for(info) or Camera.orthographic(width=info.width, height=info.height)
    return Rig(
        camera=camera,
        response=response,
        transfer=capture.transfer,
        quality=quality,
        sources=tuple(source_file(path) for path in lights.files),
        material="a white surface",
    )


def mean_frame(frames: Iterable[LinearFrame]) -> LinearFrame:
    """Average frames of a scene at rest; a pixel clipped in any of them is clipped."""
    total, clipped, count = None, None, 0
    for frame in frames:
        count += 1
        if total is None or clipped is None:
            total, clipped = frame.rgb.astype(np.float64), frame.clipped.copy()
        else:
            total += frame.rgb
            clipped |= frame.clipped
    if total is None or clipped is None:
        raise BadCalibration("calibrate: the footage holds no frame")
    return LinearFrame(rgb=(total / count).astype(np.float32), clipped=clipped)


def _with_single_lights(job: CalibrationJob, response: LightResponse, mask: Mask | None) -> LightResponse:
    if not job.single_light:
        return response
    if len(job.single_light) == 3:
        frames = [next(job.open(path).frames()) for path in job.single_light]
        return with_light_colours(response, fit_light_colours(frames, mask))
    capture = job.open(job.single_light[0])
    colours = [colour_of_frame(frame, mask) for frame in capture.frames()]
    switched = find_switched_lamps(colours)
    if switched is None:
        raise BadCalibration(
            f"{job.single_light[0]}: no frame is lit by one lamp alone; show each lamp alone for a moment"
        )
    return with_light_colours(response, fit_light_colours(_alone(capture, switched), mask))


def rig_of(
    job: CalibrationJob,
    capture: Capture,
    camera: Camera,
    response: LightResponse,
    quality: FitQuality,
    material: str,
    mattes: tuple[Path, ...] = (),
) -> Rig:
    """Return the rig of a calibration on footage, with every file that it read."""
    lamps = [path for source in job.single_light or () for path in job.open(source).info.files]
    extra = [path for path in (*mattes, as_path(job.background), *lamps) if path is not None]
    return Rig(
        camera=camera,
        response=response,
        transfer=capture.transfer,
        quality=quality,
        sources=tuple(source_file(path) for path in (*capture.info.files, *extra)),
        material=material,
    )
