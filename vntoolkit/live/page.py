"""The live page: the camera's picture, normals, and the surface, turning in the light.

The page asks for the next packet when it has drawn the last, so one is under way at most; it is made in the
thread that answers, right after a result, when the capture rests until the next frame, and put off while the
capture is late. A capture without a page open spends nothing on it. Nothing is compressed: the page mostly
runs on the machine that films, where compressing costs both sides more than copying.
"""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vntoolkit.arrays import ByteArray
from vntoolkit.errors import BadInput, VntError
from vntoolkit.geometry.camera import Camera
from vntoolkit.live.capture import LatencyMeter, LiveFigures, LiveRecorder, TimedFrame
from vntoolkit.live.frames import LiveResult, exposure_warnings
from vntoolkit.options.pages import ViewerOptions
from vntoolkit.report import scene
from vntoolkit.report.dents import picture_of_dents, scale_end_mm
from vntoolkit.report.local_server import LocalServer
from vntoolkit.tactile.contact import Contact

_CAPTION_S = 0.4  # numbers that change faster cannot be read
_WARNED_S = 1.5  # a warning stays for so long, so that it can be read
_PUT_OFF_S = 0.5  # a late result is not sent on, but after so long one is
_ANSWER_S = 1.0  # an empty answer, where no frame comes
_GONE_S = 3.0  # a page that has not asked for so long is closed
_CLIPPED = (255, 0, 255, 255)
_MOST_PX = 4096


@dataclass(frozen=True, kw_only=True)
class PacketSizes:
    """Longest sides in pixels of what is sent: the grid of the surface, the normals, the camera's picture."""

    grid: int = 80
    normals: int = 320
    camera: int = 240

    def __post_init__(self) -> None:
        if not all(2 <= side <= _MOST_PX for side in (self.grid, self.normals, self.camera)):
            raise BadInput(f"live page: expected sizes from 2 to {_MOST_PX} pixels")


@dataclass
class _Page:
    """A browser that looks on. sent: serial number of its last packet, and when its frame arrived."""

    sent: tuple[int, float] = (0, 0.0)
    asked_s: float = 0.0
    captioned_s: float = 0.0
    meter: LatencyMeter = field(default_factory=LatencyMeter)


class LiveViewer:
    """Serves the newest result to pages that ask for one."""

    def __init__(
        self,
        camera: Camera,
        options: ViewerOptions | None = None,
        *,
        figures: Callable[[], LiveFigures],
        recorder: LiveRecorder | None = None,
        late_s: float = 0.05,
    ) -> None:
        """figures: how it goes. recorder: what the page's button and its key r start and stop.

        late_s: from a frame's arrival to its result; longer, and the next frame waits already.
        """
        self.meter = LatencyMeter()
        self._camera, self._figures, self._recorder = camera, figures, recorder
        self._newest: tuple[LiveResult | None, TimedFrame] | None = None
        self._serial, self._sent_s, self._late_s = 0, 0.0, late_s
        self._changed, self._closed = threading.Condition(), False
        self._pages: dict[str, _Page] = {}
        self._deepest_mm = 0.0  # so far: the scale of depth does not jump back
        self._place: dict[str, list[float]] | None = None
        self._warned: dict[str, float] = {}
        self._problem = ""
        self._server = LocalServer(
            options or ViewerOptions(),
            scene.scene_page("vntoolkit live", "live", {"records": recorder is not None}),
            {"/packet": self._asked},
            {} if recorder is None else {"/record": self._toggle},
        )
        self.address = self._server.address

    @property
    def watchers(self) -> int:
        """Number of pages that look on."""
        with self._changed:
            return sum(time.perf_counter() - page.asked_s < _GONE_S for page in self._pages.values())

    def show(self, result: LiveResult, timed: TimedFrame) -> None:
        """Hand over a result; returns at once."""
        self._hand_over(result, timed, result.warnings)

    def show_failure(self, problem: VntError, timed: TimedFrame) -> None:
        """Say that a frame gave no normals, and what to change; returns at once."""
        warnings = exposure_warnings(timed.frame) or (f"no normals in this frame: {problem}",)
        self._hand_over(None, timed, warnings)

    def close(self) -> None:
        """Stop serving."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._server.close()

    def _hand_over(self, result: LiveResult | None, timed: TimedFrame, warnings: tuple[str, ...]) -> None:
        now = time.perf_counter()
        with self._changed:
            self._newest = result, timed
            self._serial += 1
            self._warned |= dict.fromkeys(warnings, now)
            if now - timed.arrived_s < self._late_s or now - self._sent_s > _PUT_OFF_S:
                self._sent_s = now
                self._changed.notify_all()

    def _asked(self, query: Mapping[str, str]) -> bytes | None:
        sizes = PacketSizes(**{name: int(query[name]) for name in ("grid", "normals", "camera")})
        return self._answer(query["id"], int(query["serial"]), int(query["ago_ms"]) / 1000, sizes)

    def _answer(self, name: str, serial: int, ago_s: float, sizes: PacketSizes) -> bytes | None:
        """Return the next result in time as a packet, empty where none comes; None once all is over."""
        now = time.perf_counter()
        with self._changed:
            page = self._page(name, now)
            page.asked_s = now
            if serial and page.sent[0] == serial:
                for meter in (page.meter, self.meter):
                    meter.reached(page.sent[1], now - ago_s)
            page.sent = (0, 0.0)
            if not self._closed:
                self._changed.wait(_ANSWER_S)
            if self._closed or self._newest is None or self._serial == serial:
                return None if self._closed else b""
            (result, timed), serial = self._newest, self._serial
            page.sent = serial, timed.arrived_s
        return self._packet(page, serial, result, timed, sizes)

    def _page(self, name: str, now: float) -> _Page:
        for other in [key for key, page in self._pages.items() if now - page.asked_s > 60]:
            del self._pages[other]
        return self._pages.setdefault(name[:40], _Page())

    def _packet(
        self, page: _Page, serial: int, result: LiveResult | None, timed: TimedFrame, sizes: PacketSizes
    ) -> bytes:
        packet, pictures = scene.Packet(), {"camera": camera_block(timed, sizes.camera)}
        contact = None if result is None else result.contact
        header: dict[str, Any] = {"serial": serial, "status": self._status(page, contact)}
        if self._recorder is not None:
            header["record"] = "stop recording" if self._recorder.is_recording else "record"
        if result is not None:
            depth_map, normal_map = result.depth_map, result.normal_map
            pictures["normals"] = scene.normals_block(
                normal_map, scene.stride_to(normal_map.shape, sizes.normals)
            )
            if depth_map is not None and contact is not None:
                self._deepest_mm = max(self._deepest_mm, contact.depth_mm)
                dents = picture_of_dents(depth_map, scale_end_mm(self._deepest_mm))
                pictures["dents"] = np.dstack([dents, np.full(dents.shape[:2], 255, np.uint8)])
            if depth_map is not None and depth_map.mask.any():
                self._place = self._place or scene.place_of([scene.depth_box(depth_map, self._camera)])
                stride = scene.stride_to(depth_map.shape, sizes.grid)
                facts, steps = scene.depth_block(depth_map, self._camera, stride)
                header |= {"place": self._place, "own": {"at": packet.add(steps), **facts}}
        header["pictures"] = {name: packet.raw_picture(picture) for name, picture in pictures.items()}
        return packet.content(header)

    def _toggle(self, _query: Mapping[str, str]) -> bytes:
        assert self._recorder is not None
        try:
            self._recorder.toggle()
            self._problem = ""
        except VntError as error:  # nothing can be written there: say so, go on showing
            self._problem = str(error)
        with self._changed:
            for page in self._pages.values():
                page.captioned_s = 0.0
        return b""

    def _status(self, page: _Page, contact: Contact | None = None) -> dict[str, Any] | None:
        """Return what is to be said, a few times a second; a warning stays for a while."""
        now = time.perf_counter()
        if now - page.captioned_s < _CAPTION_S:
            return None
        page.captioned_s = now
        rate, (median, _) = page.meter.figures()
        with self._changed:
            warnings = [text for text, seen in self._warned.items() if now - seen < _WARNED_S]
        recorder, recording = self._recorder, ""
        if recorder is not None:
            if recorder.is_recording:
                recording = recorder.files[-1].name if recorder.files else "…"
            if recorder.lost:
                warnings.append(f"the recording lost {recorder.lost} frames: the disk is too slow")
            warnings += [problem for problem in (recorder.problem, self._problem) if problem]
        cards = status_cards(self._figures(), rate, median)
        if contact is not None:
            cards = (*contact_cards(contact), *cards)
        return {"cards": cards, "recording": recording, "warnings": warnings}


def status_cards(figures: LiveFigures, shown_hz: float, shown_s: float) -> tuple[tuple[str, str, str], ...]:
    """Return what the page says of the run: a value, what it is, what stands beside it.

    shown_hz: frames a second that the page draws. shown_s: from a frame's arrival until then, median.
    """
    median, high = (1000 * seconds for seconds in figures.latency_s)
    lost = f", {figures.failed:,} failed" if figures.failed else ""
    dropped = f"{100 * figures.dropped / max(1, figures.arrived):.1f} %"
    return (
        (f"{figures.rate_hz:.1f}", "frames a second", f"of {figures.arrival_hz:.1f} from the camera"),
        (f"{median:.0f} ms", "latency of a frame", f"95 %: {high:.0f} ms"),
        (f"{figures.dropped:,}", "frames dropped", f"of {figures.arrived:,}, {dropped}{lost}"),
        (f"{shown_hz:.1f}", "a second on this page", f"{1000 * shown_s:.0f} ms after arrival"),
    )


def contact_cards(contact: Contact) -> tuple[tuple[str, str, str], ...]:
    """Return what the page says of a touch on a tactile gel, as `status_cards` does."""
    parts = "nothing touches" if not contact.mask.any() else f"{contact.mask.mean():.1%} of the gel"
    return (
        (f"{contact.area_mm2:.1f} mm²", "in contact", parts),
        (f"{contact.depth_mm:.2f} mm", "deepest point", "below the gel at rest"),
    )


def camera_block(timed: TimedFrame, longest_px: int) -> ByteArray:
    """Return the camera's picture (h, w, 4), what is clipped painted over."""
    values = timed.frame.values
    stride = scene.stride_to(values.shape, longest_px)
    small = values[::stride, ::stride]
    if small.dtype == np.uint16:
        small = small >> (timed.frame.bits - 8)
    elif small.dtype != np.uint8:
        small = 255 * np.clip(small, 0, 1)
    block = np.full((*small.shape[:2], 4), 255, np.uint8)
    block[..., :3] = small
    red, green, blue = (block[..., channel] == 255 for channel in range(3))
    block[red | green | blue] = _CLIPPED
    return block
