"""The viewer in a real browser: the surface is there, moves with time, and hides from the network."""

import socket
import time
from collections.abc import Iterator

import numpy as np
import pytest

from tests.browser import Visit, visit
from tests.dome_result import DomeResult
from vntoolkit.errors import BadInput
from vntoolkit.pipeline.opened_result import open_result
from vntoolkit.report.scene_page import Look, Surface
from vntoolkit.report.viewer import ResultViewer, ViewerOptions


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def viewer(dome_result: DomeResult) -> Iterator[ResultViewer]:
    shown = ResultViewer(open_result(dome_result.folder), ViewerOptions(port=free_port()))
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

        viewer._look.value = Look.NORMALS.value
        normals = picture_when(seen, lambda p: (p[..., 2] - p[..., 0] > 60).mean() > 0.02)
        assert (normals[..., 2] - normals[..., 0] > 60).mean() > 0.02

        viewer._surface.value = Surface.REGISTERED.value
        viewer._look.value = Look.CHECKERBOARD.value
        checks = picture_when(seen, lambda p: (p[..., 0] - p[..., 2] > 60).mean() > 0.02)
        assert (checks[..., 0] - checks[..., 2] > 60).mean() > 0.02

        viewer._slider.value = 4
        seen.page.get_by_text("5 of 5").wait_for()
        images = seen.page.evaluate("[...document.images].filter(i => i.naturalWidth == 64).length")
        assert images == 4  # captured, normals, depth, shadows
        here = (viewer.address, viewer.address.replace("http", "ws"), "blob:" + viewer.address)
        assert seen.strange_requests(*here) == []
        assert seen.complaints == []


def test_only_this_machine_sees_it(viewer: ResultViewer) -> None:
    assert viewer.address.startswith("http://127.0.0.1:")
    port = int(viewer.address.rsplit(":", 1)[1])
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


def test_refusals() -> None:
    with pytest.raises(BadInput, match="port: expected 1 to 65535"):
        ViewerOptions(port=0)
