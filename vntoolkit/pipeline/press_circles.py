"""Contact circles of presses, to be looked at and corrected: found once, kept as label files."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import LinearImage
from vntoolkit.calibration.presses import Press, find_contact_circle
from vntoolkit.errors import BadInput
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.io.atomic import write_text
from vntoolkit.io.footage.sequence import CaptureKind
from vntoolkit.pipeline.calibrate_presses import PressJob, PressReader, label_path

_SMALLEST_RADIUS_PX = 1.0


@dataclass(frozen=True, kw_only=True)
class LabelledPress:
    """One picture of a press. circle: None where it shows none. by: "found", "label" or "hand"."""

    name: str
    number: int
    circle: Press | None
    by: str


class PressCircles:
    """The circles of a folder of presses; every change is written at once, as NAME.txt for NAME.jpg.

    presses: in the natural order of their names.
    """

    def __init__(
        self, job: PressJob, on_frame: Callable[[int, int], None] = lambda done, total: None
    ) -> None:
        """Find the circles and write them to `job.labels`; labels that it holds are taken as they are.

        Raises `BadInput` where the presses are no images with names of their own.
        """
        if job.labels is None:
            raise BadInput("circles: expected a folder for the labels")
        self._labels, self._lock = job.labels, threading.Lock()
        self._reader = PressReader(job)
        if self._reader.capture.info.kind is CaptureKind.VIDEO:
            raise BadInput(
                f"{job.source}: expected a folder of images, since labels have their names; got a video"
            )
        held = self._labels.is_dir() and any(self._labels.glob("*.txt"))
        self.presses: list[LabelledPress] = []
        numbers = self._reader.capture.present
        for done, number in enumerate(numbers, start=1):
            self.presses.append(self._labelled(number) if held else self._found(number))
            on_frame(done, len(numbers))

    @property
    def rectification(self) -> Rectification | None:
        """From the camera's view to the gel; None where the images are of the gel."""
        return self._reader.job.rectification

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the pictures that the circles are of."""
        height, width = self._reader.background.shape
        return width, height

    def picture(self, place: int) -> LinearImage:
        """A press (h, w, 3), rectified, linear."""
        frame = self._reader.capture.frame(self.presses[place].number)
        return self._reader.job.prepare(frame).rgb

    def change(self, place: int) -> LinearImage:
        """A press less the untouched gel, (h, w, 3), drift and dots removed: what the circle is found in."""
        frame = self._reader.capture.frame(self.presses[place].number)
        return self._reader.change(self._reader.job.prepare(frame))[0]

    @property
    def untouched(self) -> LinearImage:
        """The untouched gel (h, w, 3) as filmed, where its corners are seen."""
        return self._reader.untouched.rgb

    def put(self, place: int, circle: Press | None) -> None:
        """Set the circle of a press, None for none, and write or remove its label."""
        if circle is not None:
            values = (circle.u_px, circle.v_px, circle.radius_px)
            width, height = self.size
            if not (np.isfinite(values).all() and circle.radius_px >= _SMALLEST_RADIUS_PX):
                raise BadInput(f"circle: expected u, v and a radius of 1 pixel or more, got {values}")
            if not (0 <= circle.u_px < width and 0 <= circle.v_px < height):
                raise BadInput(f"circle: ({circle.u_px:.1f}, {circle.v_px:.1f}) lies outside the picture")
        with self._lock:
            self.presses[place] = replace(self.presses[place], circle=circle, by="hand")
            self._write(self.presses[place])

    def move_corners(self, corners_px: tuple[float, ...]) -> None:
        """Rectify to other corners; circles found are found again, the others keep their place on the gel."""
        before = self.rectification
        if before is None:
            raise BadInput("corners: give --corners, --size-mm and --pixel-mm; they can then be moved")
        after = replace(before, corners_px=corners_px)
        moved = after.homography @ np.linalg.inv(before.homography)
        with self._lock:
            self._reader = PressReader(replace(self._reader.job, rectification=after))
            for place, press in enumerate(self.presses):
                if press.by == "found":
                    self.presses[place] = self._found(press.number)
                elif press.circle is not None:
                    point = moved @ (press.circle.u_px, press.circle.v_px, 1.0)
                    u, v = (point[:2] / point[2]).tolist()
                    self.presses[place] = replace(press, circle=replace(press.circle, u_px=u, v_px=v))
                    self._write(self.presses[place])

    def _labelled(self, number: int) -> LabelledPress:
        file = self._reader.file(number)
        label = label_path(self._labels, file)
        circle = self._reader.press(label) if label.exists() else None
        return LabelledPress(name=file.name, number=number, circle=circle, by="label")

    def _found(self, number: int) -> LabelledPress:
        change, _ = self._reader.change(self._reader.job.prepare(self._reader.capture.frame(number)))
        circle = find_contact_circle(change)
        name = self._reader.file(number).name
        press = LabelledPress(
            name=name, number=number, circle=None if circle is None else circle.press, by="found"
        )
        self._write(press)
        return press

    def _write(self, press: LabelledPress) -> None:
        path = label_path(self._labels, self._reader.file(press.number))
        if press.circle is None:
            path.unlink(missing_ok=True)
            return
        circle = press.circle
        write_text(path, f"{circle.u_px:.2f} {circle.v_px:.2f} {circle.radius_px:.2f}\n")
