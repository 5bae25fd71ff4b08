"""The viewer in a real browser: the surface is there, moves with time, and hides from the network."""

import shutil
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from tests.browser import Visit, visit
from tests.dome_result import DomeResult
from vntoolkit.options.pages import ViewerOptions
from vntoolkit.pipeline.opened_result import read_result
from vntoolkit.report.result_scene import ResultViewer


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def viewer(dome_result: DomeResult) -> Iterator[ResultViewer]:
    shown = ResultViewer(read_result(dome_result.folder), ViewerOptions(port=free_port()))
    yield shown
    shown.close()


def picture_when(seen: Visit, wanted: object, seconds: float = 30.0) -> np.ndarray:
    """Take pictures of the middle of the scene until one is as wanted; return the last."""
    until = time.monotonic() + seconds
    while True:
        picture = seen.picture()[150:650, 100:700].astype(int)
        if wanted(picture) or time.monotonic() > until:
            return picture
        seen.page.wait_for_timeout(300)


def bright(picture: np.ndarray) -> float:
    return float((picture.max(axis=2) > 90).mean())


@pytest.mark.slow
def test_a_browser_shows_the_surface(viewer: ResultViewer) -> None:
    with visit(viewer.address, width=1200, height=800) as seen:
        picture = picture_when(seen, lambda p: bright(p) > 0.1)
        assert bright(picture) > 0.1
        colour = picture[picture.max(axis=2) > 90]
        assert np.abs(colour - colour.mean(axis=1, keepdims=True)).mean() < 25  # plaster, all but grey

        tab = seen.page
        tab.select_option("#look", "2")
        normals = picture_when(seen, lambda p: (p[..., 2] - p[..., 0] > 60).mean() > 0.02)
        assert (normals[..., 2] - normals[..., 0] > 60).mean() > 0.02

        tab.select_option("#surface", "registered")
        tab.select_option("#look", "3")
        checks = picture_when(seen, lambda p: (p[..., 0] - p[..., 2] > 60).mean() > 0.02)
        assert (checks[..., 0] - checks[..., 2] > 60).mean() > 0.02

        tab.select_option("#look", "4")  # the template's errors are 0: blue
        known = picture_when(seen, lambda p: (p[..., 2] - p[..., 0] > 60).mean() > 0.02)
        assert (known[..., 2] - known[..., 0] > 60).mean() > 0.02
        assert tab.inner_text("#look option:checked") == "expected error (red: 4 px and more)"

        tab.locator("#time").focus()
        tab.keyboard.press("End")
        tab.wait_for_selector("body[data-shown='4']")
        assert tab.inner_text("#number") == "frame 5"
        tab.locator("#canvas").click()
        tab.evaluate("document.activeElement.blur()")
        tab.keyboard.press("ArrowLeft")
        tab.wait_for_selector("body[data-shown='3']")
        tab.keyboard.press(" ")
        tab.wait_for_selector("body[data-shown='1']")  # it plays
        tab.keyboard.press(" ")
        sizes = tab.evaluate(
            "[...document.querySelectorAll('aside canvas')].map(c => [c.id, c.width, c.height])"
        )
        assert sizes == [[name, 64, 48] for name in ("captured", "normals", "depth", "shadows")]
        assert seen.strange_requests(viewer.address.partition("?")[0]) == []
        assert seen.complaints == []


@pytest.mark.slow
def test_frames_come_whole_and_what_cannot_be_read_is_said(dome_result: DomeResult, tmp_path: Path) -> None:
    folder = shutil.copytree(dome_result.folder, tmp_path / "result")
    shown = ResultViewer(read_result(folder), ViewerOptions(port=free_port()))
    try:
        with visit(shown.address, width=700, height=700) as seen:
            seen.page.wait_for_selector("body[data-shown='0']")
            grid = "frame(0).then((packet) => packet.own.shape)"
            assert seen.page.evaluate(grid) == [48, 64]  # every pixel
            seen.page.evaluate("change(3)")  # as a browser does that draws slowly
            assert seen.page.get_by_text("drawing reduced").is_visible()
            (folder / "depth" / "000001.exr").write_bytes(b"broken")
            seen.page.evaluate("show(1)")
            seen.page.get_by_text("000001.exr").wait_for()
            seen.page.evaluate("show(2)")
            seen.page.wait_for_selector("body[data-shown='2']")
            assert not seen.page.locator("#failed").is_visible()
            shown.close()
            seen.page.evaluate("show(4)")
            seen.page.get_by_text("has ended").wait_for()
    finally:
        shown.close()


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height"), [(360, 640), (500, 700), (740, 360)])
def test_it_fits_a_small_window(viewer: ResultViewer, width: int, height: int) -> None:
    with visit(viewer.address, width=width, height=height) as seen:
        seen.page.wait_for_selector("body[data-shown='0']")
        for control in ("#look", "#reset", "#light", "#play", "#time", "#captured"):
            box = seen.page.locator(control).bounding_box()
            assert 0 <= box["x"] < box["x"] + box["width"] <= width, control
            assert 0 <= box["y"] < height - 10, control
        box = seen.page.locator("#canvas").bounding_box()
        assert box["width"] >= 0.6 * min(width, height)
        assert box["height"] >= 0.35 * height
        assert seen.page.evaluate("document.documentElement.scrollWidth") <= width


def test_only_this_machine_sees_it(viewer: ResultViewer) -> None:
    assert viewer.address.startswith("http://127.0.0.1:")
    port = urlsplit(viewer.address).port
    with socket.create_connection(("127.0.0.1", port), timeout=5):
        pass
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
    for address in others - {"127.0.0.1"}:
        if not address.startswith("127."):
            with (
                pytest.raises(OSError, match=r"refused|timed|reach"),
                socket.create_connection((address, port), timeout=2),
            ):
                pass
