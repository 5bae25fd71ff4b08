"""The live page in a real browser: it shows, turns, warns and records while frames come."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.browser import visit
from tests.pipeline.conftest import RESPONSE
from tests.report.test_viewer import bright, free_port, picture_when
from vntoolkit.errors import VntError
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.live.capture import LiveFigures, LiveRecorder, LiveRun, TimedFrame
from vntoolkit.live.frames import LiveProcessor, LiveResult
from vntoolkit.live.page import LiveViewer, status_cards
from vntoolkit.options.pages import ViewerOptions
from vntoolkit.photometry.response import rgb_from_normals
from vntoolkit.photometry.rig import Rig

WIDTH, HEIGHT = 160, 120


def dome(brightness: float) -> np.ndarray:
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    x, y = (u - WIDTH / 2) / 70, (v - HEIGHT / 2) / 70
    mask = x**2 + y**2 < 0.6
    normals = np.stack([x, y, -np.sqrt(np.maximum(1 - x**2 - y**2, 0.1))], -1)
    rgb = np.where(mask[..., None], rgb_from_normals(normals, RESPONSE), 0)
    return np.round((brightness * rgb).clip(0, 1) * 255).astype(np.uint8)


def wait_until(page: Any, expression: str) -> None:
    """Wait until an expression holds; `wait_for_function` would need what the page's policy forbids."""
    until = time.monotonic() + 90
    while not page.evaluate(expression):
        assert time.monotonic() < until, expression
        page.wait_for_timeout(100)


class Lamp:
    """A source of ten frames a second whose brightness a test turns up and down, until it is stopped."""

    name, width, height, frame_rate_hz, skipped = "lamp", WIDTH, HEIGHT, 10.0, 0

    def __init__(self) -> None:
        self.picture = dome(1.0)
        self.stopped = threading.Event()

    def frames(self) -> Iterator[TimedFrame]:
        number = 0
        while not self.stopped.wait(0.1):
            frame = EncodedFrame(values=self.picture, bits=8, number=number, name=f"frame {number}")
            yield TimedFrame(frame=frame, arrived_s=time.perf_counter())
            number += 1


@pytest.mark.slow
def test_a_browser_watches_while_frames_come(tmp_path: Path) -> None:
    lamp, recorder = Lamp(), LiveRecorder(tmp_path, 10.0)
    rig = Rig(camera=Camera.orthographic(width=WIDTH, height=HEIGHT), response=RESPONSE)
    processor = LiveProcessor(rig)

    def on_result(result: LiveResult, timed: TimedFrame) -> None:
        shown.show(result, timed)

    def on_failure(problem: VntError, timed: TimedFrame) -> None:
        shown.show_failure(problem, timed)

    run = LiveRun(lamp, processor, on_result, recorder.take, on_failure=on_failure)
    shown = LiveViewer(
        processor.depth_camera, ViewerOptions(port=free_port()), figures=run.figures, recorder=recorder
    )
    thread = threading.Thread(target=run.run)
    thread.start()
    try:
        with visit(shown.address, width=1200, height=800) as seen:
            seen.page.set_default_timeout(90_000)  # a browser that draws without a graphics card is slow
            first = picture_when(seen, lambda p: bright(p) > 0.1)
            assert bright(first) > 0.1  # the surface
            turned = picture_when(seen, lambda p: np.abs(p - first).max(axis=2).mean() > 4)
            assert np.abs(turned - first).max(axis=2).mean() > 4
            seen.page.get_by_text("frames a second").wait_for()
            sizes = seen.page.evaluate("['camera', 'normals'].map((n) => [$(n).width, $(n).height])")
            assert sizes == [[WIDTH, HEIGHT]] * 2
            colours = seen.picture("#normals").astype(int)
            assert (colours[..., 2] - colours[..., 0] > 60).mean() > 0.1  # a normal map, not a blank

            status = "{ cards: [], warnings: ['<b>x</b>'], recording: '' }"
            told = seen.page.evaluate(f"(tell({{ status: {status} }}), $('notices').textContent)")
            assert told == "▲ <b>x</b>"  # texts stay texts
            assert seen.page.get_by_text("clipped:").count() == 0
            lamp.picture = dome(3.0)
            seen.page.get_by_text("clipped:").wait_for()
            lamp.picture = dome(0.0)  # gives no normals at all
            seen.page.get_by_text("dark: expose more").wait_for()
            lamp.picture = dome(1.0)
            seen.page.get_by_text("dark: expose more").wait_for(state="detached")

            seen.page.get_by_role("button", name="record", exact=True).click()
            seen.page.get_by_text("● recording live-").wait_for()
            until = run.figures().arrived + 12
            while run.figures().arrived < until and thread.is_alive():
                seen.page.wait_for_timeout(200)
            seen.page.keyboard.press("r")  # the key does what the button does
            seen.page.get_by_text("● recording").wait_for(state="detached")
            assert seen.strange_requests(shown.address.partition("?")[0]) == []
            assert seen.complaints == []
    finally:
        lamp.stopped.set()
        thread.join()
        recorder.stop()
        shown.close()
    assert run.figures().processed > 20
    (recorded,) = recorder.files
    frames = [frame.values for frame in open_capture(recorded).encoded_frames()]
    assert len(frames) > 5
    np.testing.assert_array_equal(frames[0], dome(1.0))


@pytest.mark.slow
def test_a_slow_browser_draws_less_says_so_and_a_hidden_one_draws_nothing() -> None:
    lamp = Lamp()
    processor = LiveProcessor(Rig(camera=Camera.orthographic(width=WIDTH, height=HEIGHT), response=RESPONSE))

    def on_result(result: LiveResult, timed: TimedFrame) -> None:
        shown.show(result, timed)

    run = LiveRun(lamp, processor, on_result)
    shown = LiveViewer(processor.depth_camera, ViewerOptions(port=free_port()), figures=run.figures)
    thread = threading.Thread(target=run.run)
    thread.start()
    try:
        with visit(shown.address, width=1200, height=800) as seen:
            page = seen.page
            page.set_default_timeout(90_000)
            page.get_by_text("drawing reduced: this browser draws slowly").wait_for()  # no graphics card here
            drawn, box = page.evaluate("[canvas.width, canvas.clientWidth]")
            assert 0.3 * box < drawn < 0.7 * box
            assert page.evaluate("period()") >= 100  # ten a second at most

            page.evaluate("judge = ((real) => (window.real = real, () => {}))(judge)")
            page.evaluate("finest = 0; settled.fill(0); change(REDUCED)")
            fast = "for (let k = 0; k < 40; k++) real(1)"
            page.evaluate(fast)  # as a graphics card would
            assert page.evaluate("[level, period()]") == [0, pytest.approx(1000 / 30)]
            assert not page.get_by_text("drawing reduced").is_visible()
            wait_until(page, "canvas.width === 2 * canvas.clientWidth")
            page.evaluate("for (let k = 0; k < 40; k++) real(50)")
            assert page.evaluate("[level, period()]") == [3, 250]
            page.evaluate(fast)  # what was too slow is not tried again at once
            assert page.evaluate("level") == 3
            assert page.get_by_text("drawing reduced").is_visible()

            page.evaluate("Object.defineProperty(document, 'hidden', { value: true, configurable: true })")
            page.wait_for_timeout(1500)
            hidden = shown.meter.count
            arrived = run.figures().arrived
            page.wait_for_timeout(1500)
            assert run.figures().arrived > arrived
            assert shown.meter.count == hidden
            page.evaluate("delete document.hidden; document.dispatchEvent(new Event('visibilitychange'))")
            wait_until(page, f"document.body.dataset.shown > {run.figures().arrived}")
            assert seen.complaints == []
    finally:
        lamp.stopped.set()
        thread.join()
        shown.close()


def test_the_status_says_it_all() -> None:
    figures = LiveFigures(
        arrived=1200,
        processed=1188,
        dropped=12,
        failed=3,
        arrival_hz=30.1,
        rate_hz=29.7,
        latency_s=(0.0123, 0.0456),
    )
    assert status_cards(figures, 28.0, 0.02) == (
        ("29.7", "frames a second", "of 30.1 from the camera"),
        ("12 ms", "latency of a frame", "95 %: 46 ms"),
        ("12", "frames dropped", "of 1,200, 1.0 %, 3 failed"),
        ("28.0", "a second on this page", "20 ms after arrival"),
    )
