"""Contact circles on a page: what is dragged becomes a label; corners move; strangers are refused."""

import json
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.browser import visit
from tests.drawn_gel import HEIGHT, MARGIN, RADIUS_PX, WIDTH, picture
from vntoolkit.__main__ import main
from vntoolkit.errors import BadInput
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.io.footage.images import write_png
from vntoolkit.options.pages import ViewerOptions
from vntoolkit.pipeline.calibrate_presses import PressJob, read_press_label
from vntoolkit.pipeline.press_circles import PressCircles
from vntoolkit.report.circles_page import CirclesViewer

PLACES = {"press-2": (50.0, 60.0), "press-10": (80.0, 120.0)}
LEFT, RIGHT, BOTTOM = MARGIN, MARGIN + WIDTH, MARGIN + HEIGHT


@pytest.fixture
def presses(tmp_path: Path) -> Path:
    rng = np.random.default_rng(6)
    for name, (u, v) in PLACES.items():
        write_png(tmp_path / "presses" / f"{name}.png", picture(rng, u, v, 17))
    write_png(tmp_path / "presses" / "press-11.png", picture(rng, 0, 0, 0))
    write_png(tmp_path / "gel.png", picture(rng, 0, 0, 0))
    return tmp_path


def job(presses: Path) -> PressJob:
    corners = (LEFT, LEFT, RIGHT, LEFT, LEFT, BOTTOM, RIGHT, BOTTOM)
    return PressJob(
        source=str(presses / "presses"),
        background=presses / "gel.png",
        labels=presses / "labels",
        rectification=Rectification(
            corners_px=tuple(map(float, corners)), width_mm=WIDTH / 10, height_mm=HEIGHT / 10, pixel_mm=0.1
        ),
    )


def label(presses: Path, name: str) -> tuple[float, float, float]:
    return read_press_label(presses / "labels" / f"{name}.txt")


def test_circles_are_found_in_the_order_of_the_numbers_and_kept(presses: Path, capsys) -> None:
    command = ["circles", str(presses / "presses"), "--background", str(presses / "gel.png"), "--no-page"]
    corners = [LEFT, LEFT, RIGHT, LEFT, LEFT, BOTTOM, RIGHT, BOTTOM]
    command += ["--corners", *map(str, corners), "--size-mm", str(WIDTH / 10), str(HEIGHT / 10)]
    assert main([*command, "--out", str(presses / "labels")]) == 1
    assert "need --pixel-mm" in capsys.readouterr().err
    assert main([*command, "--out", str(presses / "labels"), "--pixel-mm", "0.1"]) == 0
    told = capsys.readouterr().out
    assert "2 circles, 0 corrected by hand" in told
    assert "1 images: press-11.png" in told
    assert f"--labels {presses / 'labels'} --corners {LEFT}" in told
    for name, (u, v) in PLACES.items():
        assert label(presses, name) == (
            pytest.approx(u, abs=1),
            pytest.approx(v, abs=1),
            pytest.approx(17, rel=0.15),
        )
    again = PressCircles(job(presses))
    assert [press.name for press in again.presses] == ["press-2.png", "press-10.png", "press-11.png"]
    assert [press.by for press in again.presses] == ["label"] * 3
    assert again.presses[2].circle is None


def test_corners_that_are_moved_take_the_corrected_circles_along(presses: Path) -> None:
    circles = PressCircles(job(presses))
    first = circles.presses[0].circle
    assert first is not None
    circles.put(0, first)
    assert circles.presses[0].by == "hand"
    moved = np.array(circles.rectification.corners_px) + np.tile([4.0, -6.0], 4)
    circles.move_corners(tuple(moved.tolist()))
    u, v, radius = label(presses, "press-2")
    assert (u, v, radius) == (
        pytest.approx(first.u_px - 4, abs=0.01),
        pytest.approx(first.v_px + 6, abs=0.01),
        pytest.approx(first.radius_px, abs=0.01),
    )
    found = label(presses, "press-10")
    assert found[:2] == (pytest.approx(76, abs=1), pytest.approx(126, abs=1))
    with pytest.raises(BadInput, match="outside the picture"):
        circles.put(0, type(first)(u_px=-3.0, v_px=5.0, radius_px=4.0))
    circles.put(1, None)
    assert not (presses / "labels" / "press-10.txt").exists()


@pytest.fixture
def page(presses: Path) -> Iterator[CirclesViewer]:
    shown = CirclesViewer(PressCircles(job(presses)), ViewerOptions(port=18733))
    yield shown
    shown.close()


def ask(page: CirclesViewer, path: str, method: str = "GET", **headers: str) -> bytes:
    base, _, query = page.address.partition("/?")
    name, _, more = path.partition("?")
    address = f"{base}{name}?{query}&{more}"
    with urllib.request.urlopen(urllib.request.Request(address, method=method, headers=headers)) as reply:
        return reply.read()


def test_the_server_writes_labels_for_its_own_page_only(page: CirclesViewer, presses: Path) -> None:
    told = json.loads(ask(page, "/presses"))
    assert [press["name"] for press in told["presses"]] == ["press-2.png", "press-10.png", "press-11.png"]
    ask(page, "/circle?press=2&u=30&v=40&r=12.5", "POST")
    assert label(presses, "press-11") == (30, 40, 12.5)
    ask(page, "/none?press=2", "POST")
    assert not (presses / "labels" / "press-11.txt").exists()
    for path, headers, status in (
        ("/circle?press=2&u=nan&v=40&r=12", {}, 400),
        ("/circle?press=77&u=30&v=40&r=12", {}, 400),
        ("/circle?press=2&u=30&v=40&r=12", {"Origin": "http://evil.example"}, 403),
        ("/circle?press=2&u=30&v=40&r=12", {"Host": "evil.example"}, 403),
    ):
        with pytest.raises(urllib.error.HTTPError) as refused:
            ask(page, path, "POST", **headers)
        assert refused.value.code == status
    assert not (presses / "labels" / "press-11.txt").exists()


def test_a_circle_is_dragged_in_a_browser(page: CirclesViewer, presses: Path) -> None:
    before = label(presses, "press-2")
    with visit(page.address, 900, 700) as seen:
        seen.page.wait_for_selector("#cards .card")  # drawn once; the cards take room from the canvas
        two_frames = "requestAnimationFrame(() => requestAnimationFrame(done))"
        seen.page.evaluate(f"() => new Promise((done) => {two_frames})")
        to_page = (
            "([u, v]) => { const box = canvas.getBoundingClientRect(), ratio = canvas.width / box.width,"
            " at = onScreen(u, v); return [box.left + at[0] / ratio, box.top + at[1] / ratio]; }"
        )
        drags = [((before[0], before[1]), (before[0] + 5, before[1] - 3))]
        drags.append(((before[0] + 5 + before[2], before[1] - 3), (before[0] + 5 + RADIUS_PX, before[1] - 3)))
        for start, end in drags:
            seen.page.mouse.move(*seen.page.evaluate(to_page, list(start)))
            seen.page.mouse.down()
            with seen.page.expect_response(lambda reply: "/circle" in reply.url):
                seen.page.mouse.move(*seen.page.evaluate(to_page, list(end)))
                seen.page.mouse.up()
        assert not seen.complaints
        assert not seen.strange_requests(page.address.partition("?")[0])
    u, v, radius = label(presses, "press-2")
    assert (u, v) == (pytest.approx(before[0] + 5, abs=0.5), pytest.approx(before[1] - 3, abs=0.5))
    assert radius == pytest.approx(RADIUS_PX, abs=0.7)
