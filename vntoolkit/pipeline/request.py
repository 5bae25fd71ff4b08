"""What a reconstruction was asked for. The manifest stores it; two runs of one folder agree in it."""

import os
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from vntoolkit.io.files import reading_limits
from vntoolkit.io.footage.captures import Capture, CaptureOptions, open_capture
from vntoolkit.io.footage.mattes import Mattes, open_mattes
from vntoolkit.io.results.folder import option_values
from vntoolkit.io.results.manifest import Known, ReconstructionFolder
from vntoolkit.options.footage import Gaps, MatteOptions, ReadingLimits, SensorOptions
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import MaterialSearch, Product, ReconstructOptions
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer


@dataclass(frozen=True, kw_only=True, eq=False)
class Footage:
    """A capture, and where its subject is."""

    capture: Capture
    mattes: Mattes

    def usable(self, numbers: Iterable[int]) -> list[int]:
        """Return those of the frames whose file and matte are there, in order."""
        wanted = set(numbers)
        there = [number for number in self.capture.present if number in wanted]
        without = set(self.mattes.missing(there))
        return [number for number in there if number not in without]


@dataclass(frozen=True, kw_only=True, eq=False)
class Request:
    """Footage, rig, options and folder of a reconstruction.

    source, gaps, frame_rate_hz: as for `open_capture`. rig: its transfer is the footage's. calibrated: the
    curve that the rig was calibrated with, None for the same. allow: checks whose fatal findings do not stop
    the run. mask: image, or video, folder or pattern of mattes, or None. matting: how these become masks.
    background: file or None. sensor: how samples of the sensor itself are read. limits: on what any process
    reads.
    """

    source: str
    rig: Rig
    options: ReconstructOptions
    folder: ReconstructionFolder
    mask: Path | None = None
    matting: MatteOptions = field(default_factory=MatteOptions)
    background: Path | None = None
    gaps: Gaps = Gaps.REFUSE
    frame_rate_hz: float | None = None
    calibrated: Transfer | None = None
    allow: tuple[str, ...] = ()
    sensor: SensorOptions = field(default_factory=SensorOptions)
    limits: ReadingLimits = field(default_factory=reading_limits)

    @property
    def is_of_gel(self) -> bool:
        """Whether the rig was fitted to presses. A gel has one material and no shadows."""
        fitted = self.rig.quality is not None and self.rig.quality.method == "presses"
        return self.rig.gel is not None or fitted

    @property
    def effective_options(self) -> ReconstructOptions:
        """The options, as far as the rig leaves them open."""
        if not self.is_of_gel:
            return self.options
        return replace(self.options, materials=MaterialSearch.CALIBRATED, shadows=ShadowMethod.NONE)

    def options_with(self, known: Known) -> ReconstructOptions:
        """Return the effective options with what was found."""
        options = self.effective_options
        if known.relative_albedo is None or known.materials:  # these are relit as the rig's own
            return options
        return replace(options, inversion=replace(options.inversion, relative_albedo=known.relative_albedo))

    def folders_with(self, known: Known) -> list[str]:
        """Return the folders that hold a file of every finished frame."""
        options = self.effective_options
        has_depth = options.to is not Product.NORMALS
        written = {
            "normals": True,
            "depth": has_depth,
            "mesh": options.to is Product.MESH,
            "shadows": options.shadows is not ShadowMethod.NONE,
            "contact": has_depth and self.rig.gel is not None,
            "materials": bool(known.materials),
        }
        return [kind for kind, is_written in written.items() if is_written]

    def open_footage(self, threads: int = 2) -> "Footage":
        """Open capture and mattes, with the rig's transfer curve. threads: for decoding."""
        options = CaptureOptions(
            transfer=self.rig.transfer,
            response=self.rig.response,
            background=None if self.matting.key is not None else self.background,
            max_megapixels=self.limits.max_megapixels,
            gaps=self.gaps,
            frame_rate_hz=self.frame_rate_hz,
            sensor=self.sensor,
            threads=threads,
        )
        capture = open_capture(self.source, options)
        mattes = open_mattes(capture, self.mask, self.matting, self.background)
        return Footage(capture=capture, mattes=mattes)

    def shaping_options(self) -> dict[str, Any]:
        """Return the options that results depend on, by name, as the manifest stores them.

        Those of sensor and mattes are named only where they are not left at their defaults.
        """
        values = option_values(self.effective_options, without=("to", "on_error"))
        # by value: options from the command line are of classes of their own
        for given, default, prefix in (
            (self.sensor, SensorOptions(), "sensor."),
            (self.matting, MatteOptions(), "matte."),
        ):
            own = option_values(given, prefix)
            values.update(own if own != option_values(default, prefix) else {})
        return values

    def from_anywhere(self) -> "Request":
        """Return the request with absolute paths: other machines run in another folder, but see the same."""

        def absolute(path: Path | None) -> Path | None:
            return None if path is None else Path(path).absolute()

        return replace(
            self,
            source=os.path.abspath(self.source),  # noqa: PTH100 - may be a pattern; Path would keep the dots
            folder=ReconstructionFolder(root=self.folder.root.absolute()),
            mask=absolute(self.mask),
            background=absolute(self.background),
        )


def seeks_materials(rig: Rig, options: ReconstructOptions) -> bool:
    """True where the footage is asked for its materials, and the rig can tell them."""
    if options.materials is MaterialSearch.AUTO:
        return rig.response.light_colours is not None and rig.gel is None
    return options.materials is not MaterialSearch.CALIBRATED
