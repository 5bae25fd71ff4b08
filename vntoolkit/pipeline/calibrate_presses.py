"""Calibration of a tactile sensor from ball presses, and rectified copies of its footage."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import FloatArray, LinearImage, Mask, Vector3
from vntoolkit.diagnosis import press_checks
from vntoolkit.diagnosis.finding import Finding, judge
from vntoolkit.diagnosis.inspection import findings_from_calibration_footage
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.io.files import read_text, source_file
from vntoolkit.io.footage.captures import Capture, CaptureOptions, open_capture
from vntoolkit.io.footage.decoding import Rectifier
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.sequence import CaptureKind, find_capture_files
from vntoolkit.io.results.folder import write_lock
from vntoolkit.options.base import File, OptionalFile, Source, named
from vntoolkit.options.calibration import LabelOffset, PressOptions
from vntoolkit.options.footage import Gaps, PictureLimits, SensorOptions
from vntoolkit.options.shared import AllowOptions, CornerOptions, CurveOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, TransferCurve, encoded_from_linear, linear_from_encoded
from vntoolkit.pipeline.corners import rectification_from_corners
from vntoolkit.tactile.circles import Press, aspect_of_contact, find_contact_circle
from vntoolkit.tactile.dots import DotFilter, shrunk
from vntoolkit.tactile.fit import GelFit, angle_of_one_matrix, fit_gel_to_presses, largest_label_offset
from vntoolkit.tactile.inversion import change_without_drift
from vntoolkit.tactile.presses import PressSamples, samples_from_press
from vntoolkit.tactile.session import untouched_terms

_SEED = 0
_MOST_COMPARED = 25  # presses whose median is looked at
_STRONG_PERCENTILE = 98.0  # of a change: the rim of a dent is a few percent of the picture


@dataclass(frozen=True, kw_only=True)
class PressJob(CornerOptions, CurveOptions, AllowOptions, SensorOptions, PressOptions, PictureLimits):
    """What a calibration on presses reads."""

    source: Source = field(kw_only=False)
    """A folder or pattern of images, one for each press."""
    background: File
    """Image of the untouched gel."""
    labels: OptionalFile = named(None)
    """A folder of text files, NAME.txt for NAME.jpg: u v contact_radius in pixels of the rectified image; an
    image without one is passed over. Or a text file of lines NAME.jpg u v contact_radius; the circles of
    other images are found. Default: all contact circles are found."""
    circle: tuple[tuple[str, float, float, float], ...] = ()
    """Name of an image, and u v contact_radius in pixels of the rectified image: the circle of a press that
    was passed over, or found beside its dent. May be given several times."""
    ball_radii: OptionalFile = named(None)
    """A text file of lines NAME radius, in millimetres, for balls of several sizes. NAME is an image, a
    folder of images, or a pattern such as small-*.png."""
    label_size: tuple[int, int] | None = None
    """Width and height of the image that the labels refer to; default: the rectified one."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.label_size is not None and min(self.label_size) < 1:
            got = " ".join(map(str, self.label_size))
            raise BadInput(f"label size: expected a width and height of 1 pixel or more, got {got}")

    @cached_property
    def rectification(self) -> Rectification | None:
        """What takes the camera's view to the gel; None where the images are rectified."""
        return rectification_from_corners(self, self.pixel_mm)

    @property
    def options(self) -> PressOptions:
        """The options of the fit, with a pixel's side as it is in the rectified image."""
        options, view = self.part(PressOptions), self.rectification
        return options if view is None else replace(options, pixel_mm=view.pixel_mm)

    def prepare(self, frame: LinearFrame) -> LinearFrame:
        """Rectify a frame where asked for."""
        return frame if self.rectification is None else Rectifier(self.rectification).frame(frame)


@dataclass(frozen=True, kw_only=True, eq=False)
class PressCalibration:
    """A tactile sensor's rig and how it came about.

    used: presses fitted. passed_over: names of the images without a label, or without a dent that was found.
    findings: what labels and colours tell of mistakes, for `judge`. ball_radii_mm: of the balls pressed.
    """

    rig: Rig
    fit: GelFit
    used: int
    passed_over: tuple[str, ...]
    findings: tuple[Finding, ...]
    ball_radii_mm: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _ReadPress:
    """One image: its samples, None where it has no press.

    labelled, found: the circle as labelled and as found, None where there is none. change: of colour, shrunk.
    aspect: height over width of the contact found.
    """

    name: str
    samples: PressSamples | None
    labelled: Press | None
    found: Press | None
    change: LinearImage | None
    aspect: float | None


def calibrate_presses(job: PressJob) -> PressCalibration:
    """Fit a rig to presses; images without a label, or without a dent where it is sought, are passed over."""
    rng, options = np.random.default_rng(_SEED), job.options
    reader = PressReader(job)
    capture, background = reader.capture, reader.background
    judge(findings_from_calibration_footage(capture), job.allow)
    read = list(_read(reader, options, rng))
    samples = [press.samples for press in read if press.samples is not None]
    if not samples and job.labels is not None:
        raise BadCalibration(
            f"calibrate presses: no image of {job.source} has a label in {job.labels} (NAME.txt for NAME.jpg)"
        )
    if not samples:
        raise BadCalibration(
            f"calibrate presses: no image of {job.source} shows the dent of one ball; is {job.background} "
            "the untouched gel of this sensor? --overlay draws the images, --circle gives a circle by hand"
        )
    level = np.median(background.rgb[~background.clipped].astype(np.float64), axis=0)
    height, width = background.shape
    if not reader.has_folder:  # what was found, or corrected one by one, has no common offset
        options = replace(options, label_offset=LabelOffset.OWN)
    shares = [options.side_mm * part.press.radius_px / part.ball_radius_mm for part in samples]
    findings = [
        *_findings_from_background(read),
        *press_checks.check_gel_fills_picture(level, _colour_at_contacts(samples)),
        *(_findings_from_labels(read, (width, height)) if reader.has_folder else ()),
        *press_checks.check_contacts(np.array(shares)),
        *press_checks.check_round(np.array([p.aspect for p in read if p.aspect is not None])),
    ]
    fit = fit_gel_to_presses(samples, level, (width, height), options)
    if options.label_offset is LabelOffset.COMMON:
        findings += press_checks.check_offset(fit.label_offset_px, largest_label_offset(samples))
    findings += _findings_from_transfer(samples, level, fit, options, capture.transfer)
    gel = replace(fit.gel, untouched=untouched_terms(background.rgb, ~background.clipped))
    if job.rectification is not None:
        filmed = (capture.info.width, capture.info.height)
        gel = replace(gel, rectification=job.rectification, filmed_px=filmed)
    camera = (
        job.rectification.camera
        if job.rectification is not None
        else Camera.orthographic(width=width, height=height, pixels_per_unit=1000.0 / options.side_mm)
    )
    rig = Rig(
        camera=camera,
        response=fit.response,
        transfer=capture.transfer,
        quality=fit.quality,
        sources=tuple(
            map(source_file, (*capture.info.files, *find_capture_files(Path(job.background)).files))
        ),
        gel=gel,
    )
    return PressCalibration(
        rig=rig,
        fit=fit,
        used=len(samples),
        passed_over=tuple(press.name for press in read if press.samples is None),
        findings=tuple(findings),
        ball_radii_mm=tuple(sorted({part.ball_radius_mm for part in samples})),
    )


def _findings_from_background(read: list[_ReadPress]) -> list[Finding]:
    """Look for a dent that the presses have in common, in their median."""
    changes = [press.change for press in read if press.change is not None]
    changes = changes[:: -(-len(changes) // _MOST_COMPARED)]
    common = np.asarray(np.median(changes, axis=0), dtype=np.float32)
    strength = _strength(common) / max(float(np.median([_strength(change) for change in changes])), 1e-9)
    circles = [circle for circle in map(find_contact_circle, changes) if circle is not None]
    found = np.array([(circle.u_px, circle.v_px, circle.radius_px) for circle in circles])
    common_dent = find_contact_circle(common)
    return press_checks.check_common_dent(common_dent, strength, found.reshape(-1, 3), len(changes))


def _strength(change: LinearImage) -> float:
    """Of a change of colour: its length where it is among the strongest."""
    return float(np.percentile(np.linalg.norm(change, axis=2), _STRONG_PERCENTILE))


def _colour_at_contacts(samples: list[PressSamples]) -> Vector3:
    """Median colour (3,) of the untouched gel inside the contacts."""
    inside = [np.linalg.norm(part.offsets_px(np.zeros(2)), axis=1) < part.press.radius_px for part in samples]
    untouched = [part.untouched[own] for part, own in zip(samples, inside, strict=True)]
    return np.median(np.concatenate(untouched), axis=0)


def _findings_from_labels(read: list[_ReadPress], size: tuple[int, int]) -> list[Finding]:
    both = [
        ((label.u_px, label.v_px, label.radius_px), (found.u_px, found.v_px, found.radius_px))
        for press in read
        for label, found in [(press.labelled, press.found)]
        if label is not None and found is not None
    ]
    if not both:
        return []
    labels, found = np.moveaxis(np.array(both), 1, 0)
    return press_checks.check_labels(labels, found, size)


def _findings_from_transfer(
    samples: list[PressSamples],
    level: Vector3,
    fit: GelFit,
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
        return angle_of_one_matrix(others, moved(level), fit.label_offset_px, options)

    angle = angle_of_one_matrix(samples, level, fit.label_offset_px, options)
    curves = (TransferCurve.LINEAR, TransferCurve.SRGB)
    others = {curve.value: angle_under(Transfer(curve=curve)) for curve in curves if curve is not used.curve}
    return press_checks.check_press_transfer(used.curve.value, angle, others)


def rectify_capture(
    capture: Capture, rectification: Rectification, folder: Path, *, overwrite: bool = False
) -> int:
    """Write every frame of a capture, rectified, as a 16-bit PNG with the capture's transfer curve.

    Raises `BadInput` where the folder holds the footage, or other numbered images, which `overwrite` removes.
    """
    if folder.resolve() in {path.parent.resolve() for path in capture.info.files}:
        raise BadInput(f"{folder}: the footage lies there; choose another --out")
    with write_lock(folder):
        earlier = sorted(path for path in folder.glob("*.png") if path.stem.isdigit() and len(path.stem) == 6)
        if earlier and not overwrite:
            raise BadInput(
                f"{folder}: holds images already, such as {earlier[0].name}; add --overwrite to replace "
                "them, or choose another --out"
            )
        for path in earlier:
            path.unlink()
        rectifier = Rectifier(rectification)
        for number, frame in enumerate(progress.counted(capture.frames(), "rectify", len(capture))):
            rectified = rectifier.frame(frame)
            encoded = encoded_from_linear(rectified.rgb.astype(np.float64), capture.transfer)
            write_png(folder / f"{number:06d}.png", np.round(encoded * 65535).astype(np.uint16))
    return len(capture)


class PressReader:
    """Reads the presses of a job: the footage, the untouched gel, and the change of colour between them.

    names: of the presses by number, of its file or, in a video, that number.
    """

    def __init__(self, job: PressJob) -> None:
        self.job = job
        options = CaptureOptions(transfer=job.curve, gaps=Gaps.SKIP, sensor=job.part(SensorOptions))
        self.capture = open_capture(str(job.source), options)
        self.background = job.prepare(open_capture(Path(job.background), options).frame(0))
        self._dots = DotFilter(self.background.rgb)
        info = self.capture.info
        if info.kind is CaptureKind.VIDEO:
            self.names = {number: str(number) for number in self.capture.present}
        else:
            self.names = {n: file.name for n, file in zip(info.numbers, info.files, strict=True)}
        self._by_hand = {name: _circle(values, f"--circle {name}") for name, *values in job.circle}
        self._labelled: dict[str, FloatArray] = {}
        self.has_folder = job.labels is not None and job.labels.is_dir()
        if job.labels is not None and not self.has_folder:
            self._labelled = _circles_of_file(job.labels)
        names = list(self.names.values())
        for name in (*self._by_hand, *self._labelled):
            if name not in names:
                raise BadInput(f"circle of {name}: expected an image of {job.source}, such as {names[0]}")

    @cached_property
    def ball_radii_mm(self) -> dict[str, float]:
        """Radius of the ball of each press that the table of balls lists, by name."""
        if self.job.ball_radii is None:
            return {}
        paths = dict(zip(self.capture.info.numbers, self.capture.info.files, strict=False))
        places = {name: paths.get(number, Path(name)) for number, name in self.names.items()}
        found: dict[str, float] = {}
        for pattern, radius_mm in _radii_of_file(self.job.ball_radii):
            of = {name for name, path in places.items() if path.match(pattern) or path.match(f"{pattern}/*")}
            where = f"{self.job.ball_radii}: {pattern}"
            if not of:
                raise BadInput(f"{where} is no image of {self.job.source}, such as {next(iter(places))}")
            if twice := sorted(of & set(found)):
                raise BadInput(f"{where} lists {twice[0]} again; expected each press once")
            found |= dict.fromkeys(of, radius_mm)
        return found

    def change(self, prepared: LinearFrame) -> tuple[LinearImage, Mask]:
        """The change of colour (h, w, 3) against the untouched gel, and the pixels that were filled."""
        background = self.background
        if prepared.shape != background.shape:
            raise BadCalibration("calibrate presses: the background has another size than the presses")
        unknown = prepared.clipped | background.clipped
        change, filled = self._dots.filled(prepared.rgb - background.rgb, unknown)
        return change_without_drift(change, ~filled), filled

    def labelled(self, name: str) -> Press | None:
        """The circle that a label, or --circle, gives a press."""
        if name in self._by_hand:
            return _press(self._by_hand[name])
        circle = self._labelled.get(name)
        if self.has_folder and self.job.labels is not None:
            label = self.job.labels / Path(name).with_suffix(".txt")
            circle = read_press_label(label) if label.exists() else None
        if circle is None:
            return None
        height, width = self.background.shape
        label_width, label_height = self.job.label_size or (width, height)
        return _press(circle * (width / label_width, height / label_height, width / label_width))

    def passes_over(self, name: str) -> bool:
        """True for a press without a label where a folder of labels is given."""
        return self.has_folder and self.labelled(name) is None


def _read(reader: PressReader, options: PressOptions, rng: np.random.Generator) -> Iterator[_ReadPress]:
    job, capture = reader.job, reader.capture
    for frame in progress.counted(capture.frames(), "read presses", len(capture.present)):
        name = reader.names[frame.number]
        samples = labelled = found = small = aspect = None
        if not reader.passes_over(name):
            change, filled = reader.change(job.prepare(frame))
            found, small = find_contact_circle(change), shrunk(change)
            if found is not None and job.rectification is None:  # corners take a size each way
                aspect = aspect_of_contact(change, found)
            labelled = reader.labelled(name)
            press = labelled or found
            if press is not None:
                own = replace(options, ball_radius_mm=reader.ball_radii_mm.get(name, options.ball_radius_mm))
                samples = samples_from_press(change, reader.background.rgb, ~filled, press, own, rng)
        yield _ReadPress(
            name=name, samples=samples, labelled=labelled, found=found, change=small, aspect=aspect
        )


def read_press_label(path: Path | str) -> FloatArray:
    """Read centre u, v and contact radius (3,), pixels, of one press."""
    return _circle(read_text(path).split(), str(path))


def _circles_of_file(path: Path) -> dict[str, FloatArray]:
    """Read circles by the name of their image, from lines `NAME u v radius`; empty lines do not count."""
    circles = {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.strip():
            name, *words = line.rsplit(maxsplit=3)
            circles[name.strip()] = _circle(words, f"{path} line {number}")
    return circles


def _radii_of_file(path: Path) -> list[tuple[str, float]]:
    """Read names and radii from lines `NAME radius_mm`; empty lines do not count."""
    found = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        name, _, word = line.strip().rpartition(" ")
        if not line.strip():
            continue
        try:
            radius = float(word)
        except ValueError:
            radius = 0.0
        if not (name and 0 < radius < np.inf):
            raise BadInput(
                f"{path} line {number}: expected NAME and a radius in mm, got '{line.strip():.40}'"
            )
        found.append((name.strip(), radius))
    return found


def _circle(words: Sequence[str | float], where: str) -> FloatArray:
    """Centre u, v and contact radius (3,), pixels."""
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise BadInput(
            f"{where}: expected three numbers (u, v, contact radius), got '{words[0]:.40} …'"
        ) from error
    if len(values) != 3 or not np.isfinite(values).all() or values[2] <= 0:
        raise BadInput(f"{where}: expected three numbers (u, v, contact radius > 0), got {len(values)}")
    return values


def _press(circle: FloatArray) -> Press:
    u, v, radius = circle.tolist()
    return Press(u_px=u, v_px=v, radius_px=radius)
