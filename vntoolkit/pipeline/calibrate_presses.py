"""Calibration of a tactile sensor from labelled ball presses, and rectified copies of its footage."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from vntoolkit.calibration.presses import (
    GelFit,
    Press,
    PressOptions,
    PressSamples,
    fit_gel_to_presses,
    samples_from_press,
)
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.io.atomic import sole_writer
from vntoolkit.io.files import read_text, source_file
from vntoolkit.io.footage.captures import Capture, CaptureOptions, open_capture
from vntoolkit.io.footage.frame_range import Gaps
from vntoolkit.io.footage.gel_dots import DotFilter
from vntoolkit.io.footage.images import write_png
from vntoolkit.io.footage.mosaics import SensorOptions
from vntoolkit.io.footage.resampling import rectify_frame
from vntoolkit.normals.gel import change_without_drift
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, encoded_from_linear

_SEED = 0
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class PressJob:
    """What a calibration on presses reads.

    source: images, one press each. background: image of the untouched gel. labels: folder of `NAME.txt`, one
    per image. transfer: curve of the footage, None for the one that it states, else linear. sensor: how
    samples of the sensor itself are read. rectification: takes the camera's view to the gel; None where the
    images are rectified. label_size: (width, height) of the frame that labels refer to; None for that of the
    images, rectified.
    """

    source: str
    background: Path
    labels: Path
    transfer: Transfer | None = None
    sensor: SensorOptions = field(default_factory=SensorOptions)
    rectification: Rectification | None = None
    label_size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if self.label_size is not None and min(self.label_size) < 1:
            got = " ".join(map(str, self.label_size))
            raise BadInput(f"label size: expected a width and height of 1 pixel or more, got {got}")

    def prepare(self, frame: LinearFrame) -> LinearFrame:
        """Rectify a frame where asked for."""
        return frame if self.rectification is None else rectify_frame(frame, self.rectification)


def calibrate_presses(
    job: PressJob, options: PressOptions, on_frame: Progress = lambda done, total: None
) -> tuple[Rig, GelFit]:
    """Fit a rig to presses; frames without a label are passed over."""
    rng = np.random.default_rng(_SEED)
    options_of_images = CaptureOptions(transfer=job.transfer, gaps=Gaps.SKIP, sensor=job.sensor)
    capture = open_capture(job.source, options_of_images)
    background = job.prepare(open_capture(job.background, options_of_images).frame(0))
    samples = list(_samples(job, options, capture, background, rng, on_frame))
    if not samples:
        raise BadCalibration(
            f"calibrate presses: no image of {job.source} has a label in {job.labels} (NAME.txt for NAME.jpg)"
        )
    level = np.median(background.rgb[~background.clipped].astype(np.float64), axis=0)
    height, width = background.shape
    fit = fit_gel_to_presses(samples, level, (width, height), options)
    gel = fit.gel
    if job.rectification is not None:
        filmed = (capture.info.width, capture.info.height)
        gel = replace(gel, rectification=job.rectification, filmed_px=filmed)
    camera = (
        job.rectification.camera
        if job.rectification is not None
        else Camera.orthographic(width=width, height=height, pixels_per_unit=1000.0 / options.pixel_mm)
    )
    rig = Rig(
        camera=camera,
        response=fit.response,
        transfer=capture.transfer,
        quality=fit.quality,
        sources=tuple(source_file(path) for path in (*capture.info.files, job.background)),
        gel=gel,
    )
    return rig, fit


def rectify_capture(
    capture: Capture,
    rectification: Rectification,
    folder: Path,
    on_frame: Progress = lambda done, total: None,
    *,
    overwrite: bool = False,
) -> int:
    """Write every frame of a capture, rectified, as a 16-bit PNG with the capture's transfer curve.

    Raises `BadInput` where the folder holds the footage, or other numbered images, which `overwrite` removes.
    """
    if folder.resolve() in {path.parent.resolve() for path in capture.info.files}:
        raise BadInput(f"{folder}: the footage lies there; choose another --out")
    with sole_writer(folder):
        earlier = sorted(path for path in folder.glob("*.png") if path.stem.isdigit() and len(path.stem) == 6)
        if earlier and not overwrite:
            raise BadInput(
                f"{folder}: holds images already, such as {earlier[0].name}; add --overwrite to replace "
                "them, or choose another --out"
            )
        for path in earlier:
            path.unlink()
        for number, frame in enumerate(capture.frames()):
            rectified = rectify_frame(frame, rectification)
            encoded = encoded_from_linear(rectified.rgb.astype(np.float64), capture.transfer)
            write_png(folder / f"{number:06d}.png", np.round(encoded * 65535).astype(np.uint16))
            on_frame(number + 1, len(capture))
    return len(capture)


def _samples(
    job: PressJob,
    options: PressOptions,
    capture: Capture,
    background: LinearFrame,
    rng: np.random.Generator,
    on_frame: Progress,
) -> Iterator[PressSamples]:
    dots = DotFilter(background.rgb)
    file_of = dict(zip(capture.info.numbers, capture.info.files, strict=False))
    for done, frame in enumerate(capture.frames(), start=1):
        path = label_path(job.labels, file_of.get(frame.number, capture.info.files[-1]))
        if path.exists():
            prepared = job.prepare(frame)
            if prepared.shape != background.shape:
                raise BadCalibration("calibrate presses: the background has another size than the presses")
            unknown = prepared.clipped | background.clipped
            change, filled = dots.filled(prepared.rgb - background.rgb, unknown)
            change = change_without_drift(change, ~filled)
            yield samples_from_press(change, ~filled, _press(path, job, prepared), options, rng)
        on_frame(done, len(capture.present))


def _press(path: Path, job: PressJob, frame: LinearFrame) -> Press:
    """Read a label and scale it to the frame; the radius counts along the width."""
    u, v, radius = read_press_label(path)
    height, width = frame.shape
    label_width, label_height = job.label_size or (width, height)
    return Press(
        u_px=u * width / label_width, v_px=v * height / label_height, radius_px=radius * width / label_width
    )


def read_press_label(path: Path | str) -> tuple[float, float, float]:
    """Read centre u, v and contact radius, pixels, of one press."""
    words = read_text(path).split()
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise BadInput(
            f"{path}: expected three numbers (u, v, contact radius), got '{words[0][:40]} …'"
        ) from error
    if len(values) != 3 or not np.isfinite(values).all() or values[2] <= 0:
        raise BadInput(f"{path}: expected three numbers (u, v, contact radius > 0), got {len(values)}")
    return values[0], values[1], values[2]


def label_path(folder: Path, image: Path) -> Path:
    """The label of an image: the file of its name with the suffix .txt."""
    return folder / f"{image.stem}.txt"
