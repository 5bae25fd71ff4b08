"""Calibration of a tactile sensor from ball presses, and rectified copies of its footage."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from vntoolkit.arrays import FloatArray, LinearImage, Mask, Vector3
from vntoolkit.calibration import presses
from vntoolkit.calibration.presses import find_contact_circle
from vntoolkit.diagnosis import press_checks
from vntoolkit.diagnosis.finding import Finding, judge
from vntoolkit.diagnosis.inspection import findings_from_calibration_footage
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.io.atomic import sole_writer
from vntoolkit.io.files import read_text, source_file
from vntoolkit.io.footage.captures import Capture, CaptureOptions, open_capture
from vntoolkit.io.footage.decoding import rectify_frame
from vntoolkit.io.footage.gel_dots import DotFilter
from vntoolkit.io.footage.images import write_png
from vntoolkit.normals.gel import change_without_drift
from vntoolkit.options.calibration import LabelOffset, PressOptions
from vntoolkit.options.footage import Gaps, SensorOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import (
    Transfer,
    TransferCurve,
    encoded_from_linear,
    linear_from_encoded,
)

_SEED = 0
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class PressJob:
    """What a calibration on presses reads.

    source: images, one press each. background: image of the untouched gel. labels: folder of `NAME.txt`, one
    per image, None to find the contact circles. transfer: curve of the footage, None for the one that it
    states, else linear. sensor: how samples of the sensor itself are read. rectification: takes the camera's
    view to the gel; None where the images are rectified. label_size: (width, height) of the frame that labels
    refer to; None for that of the images, rectified. allow: checks whose fatal findings on the footage do not
    stop the calibration.
    """

    source: str
    background: Path
    labels: Path | None = None
    transfer: Transfer | None = None
    sensor: SensorOptions = field(default_factory=SensorOptions)
    rectification: Rectification | None = None
    label_size: tuple[int, int] | None = None
    allow: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.label_size is not None and min(self.label_size) < 1:
            got = " ".join(map(str, self.label_size))
            raise BadInput(f"label size: expected a width and height of 1 pixel or more, got {got}")

    def prepare(self, frame: LinearFrame) -> LinearFrame:
        """Rectify a frame where asked for."""
        return frame if self.rectification is None else rectify_frame(frame, self.rectification)


@dataclass(frozen=True, kw_only=True, eq=False)
class PressCalibration:
    """A tactile sensor's rig and how it came about.

    used: presses fitted. passed_over: names of the images without a label, or without a dent that was found.
    findings: what labels and colours tell of mistakes, for `judge`.
    """

    rig: Rig
    fit: presses.GelFit
    used: int
    passed_over: tuple[str, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _ReadPress:
    """One image: its samples, None where it has no press; the circle found, None where there is none."""

    name: str
    samples: presses.PressSamples | None
    found: presses.Press | None


def calibrate_presses(
    job: PressJob, options: PressOptions, on_frame: Progress = lambda done, total: None
) -> PressCalibration:
    """Fit a rig to presses; images without a label, or without a dent where it is sought, are passed over."""
    rng = np.random.default_rng(_SEED)
    reader = PressReader(job)
    capture, background = reader.capture, reader.background
    judge(findings_from_calibration_footage(capture), job.allow)
    read = list(_read(reader, options, rng, on_frame))
    samples = [press.samples for press in read if press.samples is not None]
    if not samples and job.labels is not None:
        raise BadCalibration(
            f"calibrate presses: no image of {job.source} has a label in {job.labels} (NAME.txt for NAME.jpg)"
        )
    if not samples:
        raise BadCalibration(
            f"calibrate presses: no image of {job.source} shows the dent of one ball; is {job.background} "
            "the untouched gel of this sensor? --labels names the circles by hand"
        )
    level = np.median(background.rgb[~background.clipped].astype(np.float64), axis=0)
    height, width = background.shape
    if job.labels is None:  # what was found has no common offset
        options = replace(options, label_offset=LabelOffset.OWN)
    radii_mm = options.pixel_mm * np.array([part.press.radius_px for part in samples])
    findings = [
        *_findings_from_labels(job, read, (width, height)),
        *press_checks.check_contacts(radii_mm / options.ball_radius_mm),
    ]
    fit = presses.fit_gel_to_presses(samples, level, (width, height), options)
    if options.label_offset is LabelOffset.COMMON:
        findings += press_checks.check_offset(fit.label_offset_px, presses.largest_label_offset(samples))
    findings += _findings_from_transfer(samples, level, fit, options, capture.transfer)
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
    return PressCalibration(
        rig=rig,
        fit=fit,
        used=len(samples),
        passed_over=tuple(press.name for press in read if press.samples is None),
        findings=tuple(findings),
    )


def _findings_from_labels(job: PressJob, read: list[_ReadPress], size: tuple[int, int]) -> list[Finding]:
    both = [
        ((label.u_px, label.v_px, label.radius_px), (found.u_px, found.v_px, found.radius_px))
        for press in read
        if press.samples is not None and press.found is not None
        for label, found in [(press.samples.press, press.found)]
    ]
    if job.labels is None or not both:
        return []
    labels, found = np.moveaxis(np.array(both), 1, 0)
    return press_checks.check_labels(labels, found, size)


def _findings_from_transfer(
    samples: list[presses.PressSamples],
    level: Vector3,
    fit: presses.GelFit,
    options: PressOptions,
    used: Transfer,
) -> list[Finding]:
    """Fit one M with other transfer curves too, from the same samples."""

    def angle_under(curve: Transfer) -> float:
        def moved(rgb: FloatArray) -> FloatArray:
            return linear_from_encoded(np.clip(encoded_from_linear(rgb, used), 0.0, 1.0), curve)

        others = [
            replace(part, rgb=moved(part.rgb + part.untouched) - moved(part.untouched)) for part in samples
        ]
        return presses.angle_of_one_matrix(others, moved(level), fit.label_offset_px, options)

    angle = presses.angle_of_one_matrix(samples, level, fit.label_offset_px, options)
    curves = (TransferCurve.LINEAR, TransferCurve.SRGB)
    others = {curve.value: angle_under(Transfer(curve=curve)) for curve in curves if curve is not used.curve}
    return press_checks.check_press_transfer(used.curve.value, angle, others)


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


class PressReader:
    """Reads the presses of a job: the footage, the untouched gel, and the change of colour between them."""

    def __init__(self, job: PressJob) -> None:
        self.job = job
        options = CaptureOptions(transfer=job.transfer, gaps=Gaps.SKIP, sensor=job.sensor)
        self.capture = open_capture(job.source, options)
        self.untouched = open_capture(job.background, options).frame(0)  # as filmed
        self.background = job.prepare(self.untouched)
        self._dots = DotFilter(self.background.rgb)
        info = self.capture.info
        self._file_of = dict(zip(info.numbers, info.files, strict=False))

    def file(self, number: int) -> Path:
        """The file that a frame is in."""
        return self._file_of.get(number, self.capture.info.files[-1])

    def change(self, prepared: LinearFrame) -> tuple[LinearImage, Mask]:
        """The change of colour (h, w, 3) against the untouched gel, and the pixels that were filled."""
        background = self.background
        if prepared.shape != background.shape:
            raise BadCalibration("calibrate presses: the background has another size than the presses")
        unknown = prepared.clipped | background.clipped
        change, filled = self._dots.filled(prepared.rgb - background.rgb, unknown)
        return change_without_drift(change, ~filled), filled

    def press(self, label: Path) -> presses.Press:
        """Read a label and scale it to the frames; the radius counts along the width."""
        u, v, radius = read_press_label(label)
        height, width = self.background.shape
        label_width, label_height = self.job.label_size or (width, height)
        return presses.Press(
            u_px=u * width / label_width,
            v_px=v * height / label_height,
            radius_px=radius * width / label_width,
        )


def _read(
    reader: PressReader, options: PressOptions, rng: np.random.Generator, on_frame: Progress
) -> Iterator[_ReadPress]:
    job, capture = reader.job, reader.capture
    for done, frame in enumerate(capture.frames(), start=1):
        file = reader.file(frame.number)
        label = None if job.labels is None else label_path(job.labels, file)
        if label is not None and not label.exists():
            yield _ReadPress(name=file.name, samples=None, found=None)
        else:
            change, filled = reader.change(job.prepare(frame))
            circle = find_contact_circle(change)
            found = None if circle is None else circle.press
            press = found if label is None else reader.press(label)
            samples = None
            if press is not None:
                samples = presses.samples_from_press(
                    change, reader.background.rgb, ~filled, press, options, rng
                )
            yield _ReadPress(name=file.name, samples=samples, found=found)
        on_frame(done, len(capture.present))


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
