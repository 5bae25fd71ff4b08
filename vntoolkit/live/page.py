"""The live page: the camera's picture, normals, and the surface, turning in the light.

The page asks for the next packet when it has drawn the last, so one is under way at most; it is made in the
thread that answers, right after a result, when the capture rests until the next frame, and put off while the
capture is late. A capture without a page open spends nothing on it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from vntoolkit.errors import VntError
from vntoolkit.geometry.camera import Camera
from vntoolkit.live.capture import LatencyMeter, LiveFigures
from vntoolkit.live.frames import LiveResult, exposure_warnings
from vntoolkit.live.packet import (
    PacketSizes,
    Place,
    camera_block,
    depth_block,
    normals_block,
    packet,
)
from vntoolkit.live.recorder import LiveRecorder
from vntoolkit.live.server import LiveServer
from vntoolkit.live.sources import TimedFrame
from vntoolkit.report.viewer import ViewerOptions

_CAPTION_S = 0.4  # numbers that change faster cannot be read
_WARNED_S = 1.5  # a warning stays for so long, so that it can be read
_PUT_OFF_S = 0.5  # a late result is not sent on, but after so long one is
_ANSWER_S = 1.0  # an empty answer, where no frame comes
_GONE_S = 3.0  # a page that has not asked for so long is closed
_WARNING = "background:#4a3300;border-left:4px solid #e69f00;color:#ffe0a3"
_RECORDING = "background:#4d1f06;border-left:4px solid #d55e00;color:#ffd2ba"
_BOX = "margin:.35rem .75rem;padding:.4rem .6rem;border-radius:4px;font-size:.86rem"
_NUMBER = "font-size:1.25rem;font-weight:650;line-height:1.2;font-variant-numeric:tabular-nums"


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
        options = options or ViewerOptions()
        self.meter = LatencyMeter()
        self._camera, self._figures, self._recorder = camera, figures, recorder
        self._newest: tuple[LiveResult | None, TimedFrame] | None = None
        self._serial, self._sent_s, self._late_s = 0, 0.0, late_s
        self._changed, self._closed = threading.Condition(), False
        self._pages: dict[str, _Page] = {}
        self._place: Place | None = None
        self._warned: dict[str, float] = {}
        self._problem = ""
        self._host = options.host
        self._server = LiveServer(
            options.host, options.port, self._answer, None if recorder is None else self._toggle
        )

    @property
    def address(self) -> str:
        """The address to open in a browser."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self._server.port}"

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
        told = exposure_warnings(timed.frame) or (f"no normals in this frame: {problem}",)
        self._hand_over(None, timed, told)

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

    def _answer(self, name: str, serial: int, ago_s: float, sizes: PacketSizes) -> bytes | None:
        """Wait for the next result that comes in time, and return it as a packet; empty where none comes.

        None once all is over.
        """
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
        header: dict[str, Any] = {"serial": serial, "status": self._status(page)}
        blocks: list[Any] = []
        if self._recorder is not None:
            header["record"] = "stop recording" if self._recorder.is_recording else "record"
        if result is not None and result.depth_map is not None and result.depth_map.mask.any():
            self._place = self._place or Place.of(result.depth_map, self._camera)
            header["place"] = {"centre": self._place.centre, "size": self._place.size}
            header["depth"], steps = depth_block(result.depth_map, self._camera, sizes.grid)
            blocks.append(steps)
        if result is not None:
            blocks.append(normals_block(result.normal_map, sizes.normals))
            header["normals"] = blocks[-1].shape[:2]
        blocks.append(camera_block(timed, sizes.camera))
        header["camera"] = blocks[-1].shape[:2]
        return packet(header, blocks)

    def _toggle(self) -> None:
        assert self._recorder is not None
        try:
            self._recorder.toggle()
            self._problem = ""
        except VntError as error:  # nothing can be written there: say so, go on showing
            self._problem = str(error)
        with self._changed:
            for page in self._pages.values():
                page.captioned_s = 0.0

    def _status(self, page: _Page) -> str | None:
        """Return what is to be said as HTML, a few times a second; a warning stays for a while."""
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
        return LiveStatus(
            figures=self._figures(), shown_hz=rate, shown_s=median, warnings=warnings, recording=recording
        ).html()


@dataclass(frozen=True, kw_only=True)
class LiveStatus:
    """What is to be said. figures: of frames worked on. shown_hz: frames a second that go to the page.

    shown_s: seconds from a frame's arrival until it goes to the page, median. warnings: one line each.
    recording: name of the file being written, empty where none is.
    """

    figures: LiveFigures
    shown_hz: float
    shown_s: float
    warnings: Sequence[str] = ()
    recording: str = ""

    def html(self) -> str:
        """Return it as HTML with its own styles; all texts escaped."""
        figures = self.figures
        median, high = (1000 * seconds for seconds in figures.latency_s)
        lost = f", {figures.failed:,} failed" if figures.failed else ""
        dropped = f"{100 * figures.dropped / max(1, figures.arrived):.1f} %"
        cards = (
            (f"{figures.rate_hz:.1f}", "frames a second", f"{figures.processed:,} so far"),
            (f"{median:.0f} ms", "latency of a frame", f"95 %: {high:.0f} ms"),
            (f"{figures.dropped:,}", "frames dropped", f"of {figures.arrived:,}, {dropped}{lost}"),
            (f"{self.shown_hz:.1f}", "a second on this page", f"{1000 * self.shown_s:.0f} ms after arrival"),
        )
        boxes = [_box(_RECORDING, f"● recording {self.recording}")] if self.recording else []
        boxes += [_box(_WARNING, f"▲ {warning}") for warning in self.warnings]
        grid = "display:grid;grid-template-columns:repeat(2,1fr);gap:.4rem .8rem;padding:.2rem .75rem .4rem"
        return f'<div style="{grid}">{"".join(_card(*card) for card in cards)}</div>{"".join(boxes)}'


# What the live page says of itself: rate, latency, dropped frames, recording, and what to change.


def _card(value: str, what: str, beside: str) -> str:
    small = "font-size:.72rem;line-height:1.3"
    return (
        f'<div><div style="{small};opacity:.75">{escape(what)}</div>'
        f'<div style="{_NUMBER}">{escape(value)}</div>'
        f'<div style="{small};opacity:.75">{escape(beside)}</div></div>'
    )


def _box(style: str, text: str) -> str:
    return f'<div role="status" style="{_BOX};{style}">{escape(text)}</div>'
