"""What the live page is sent: only what it asks for, the newest result in time, true to the maps."""

import http.client
import json
import struct
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from scipy import ndimage

from tests.pipeline.conftest import RIG, dome_light
from tests.report.test_viewer import free_port
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.live.capture import LiveFigures, LiveRecorder, TimedFrame
from vntoolkit.live.frames import LiveProcessor, LiveResult
from vntoolkit.live.page import LiveViewer, PacketSizes, camera_block
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.options.depth import MeshOptions
from vntoolkit.options.pages import ViewerOptions
from vntoolkit.report.dents import picture_of_dents
from vntoolkit.report.scene import depth_block, depth_box, normals_block, place_of
from vntoolkit.tactile.contact import Contact

FIGURES = LiveFigures(
    arrived=1, processed=1, dropped=0, failed=0, arrival_hz=0.0, rate_hz=0.0, latency_s=(0.0, 0.0)
)


def dome_frame(number: int = 0) -> EncodedFrame:
    values = np.round(dome_light() * 255).astype(np.uint8)
    return EncodedFrame(values=values, bits=8, number=number, name=f"frame {number}")


@pytest.fixture(scope="module")
def dome() -> tuple[LiveResult, Camera]:
    processor = LiveProcessor(RIG)
    return processor.process(dome_frame()), processor.depth_camera


@pytest.fixture
def viewer(dome: tuple[LiveResult, Camera], tmp_path: Path) -> Iterator[LiveViewer]:
    shown = LiveViewer(
        dome[1],
        ViewerOptions(port=free_port()),
        figures=lambda: FIGURES,
        recorder=LiveRecorder(tmp_path, 30.0),
    )
    yield shown
    shown.close()


def timed(number: int = 0, *, age_s: float = 0.0) -> TimedFrame:
    return TimedFrame(frame=dome_frame(number), arrived_s=time.perf_counter() - age_s)


def url_of(viewer: LiveViewer, path: str, query: str = "") -> str:
    """Where a path of the page is, its token added."""
    return viewer.address.replace("/?", f"/{path}?") + f"&{query}"


class Asked(threading.Thread):
    """A page that asks once, in a thread of its own."""

    def __init__(self, viewer: LiveViewer, serial: int = 0, ago_ms: int = 0) -> None:
        super().__init__()
        query = f"id=a&serial={serial}&ago_ms={ago_ms}&grid=20&normals=64&camera=30"
        self._address = url_of(viewer, "packet", query)
        self.content, self.seconds = b"", 0.0
        started = time.perf_counter()
        self.start()
        while not any(page.asked_s >= started for page in list(viewer._pages.values())):
            assert time.perf_counter() - started < 30, "the question never came"
            time.sleep(0.01)

    def run(self) -> None:
        started = time.perf_counter()
        self.content = urllib.request.urlopen(self._address, timeout=10).read()
        self.seconds = time.perf_counter() - started

    def header(self) -> dict[str, Any]:
        self.join()
        return opened(self.content)[0]


def opened(content: bytes) -> tuple[dict[str, Any], bytes]:
    (length,) = struct.unpack_from("<I", content)
    return json.loads(content[4 : 4 + length]), content[4 + length :]


def test_the_grid_carries_the_depth_and_says_where_there_is_none(dome: tuple[LiveResult, Camera]) -> None:
    result, camera = dome
    depth_map = result.depth_map
    assert depth_map is not None
    facts, steps = depth_block(depth_map, camera, 3)  # every third pixel: 16 × 22
    assert facts["shape"] == (16, 22)
    depth, mask = depth_map.depth[::3, ::3], depth_map.mask[::3, ::3]
    np.testing.assert_array_equal(steps == 65535, ~mask)
    read = facts["low"] + facts["step"] * steps[mask]
    np.testing.assert_allclose(read, depth[mask], atol=0.51 * facts["step"] + 1e-6)
    assert facts["step"] < 1e-3
    # the vertices that the page makes of it are the mesh's, whose rim alone lies between pixels
    inner = ndimage.binary_erosion(mask, np.ones((3, 3)))
    v, u = np.nonzero(inner)
    x, y = ((np.stack([u, v]).T - facts["centre"]) / facts["focal"]).T
    mesh = mesh_from_depth(depth_map, camera, options=MeshOptions(stride=3))
    assert inner.sum() > 50
    assert {tuple(p) for p in np.round([x, y, depth[inner]], 3).T} <= {
        tuple(p) for p in np.round(mesh.vertices, 3)
    }
    place = place_of([depth_box(depth_map, camera)])
    coarse = depth_map.depth[::4, ::4][depth_map.mask[::4, ::4]]
    assert place["size"][2] == pytest.approx(np.ptp(coarse), rel=1e-6)
    assert place["centre"][2] == pytest.approx(-(coarse.min() + coarse.max()) / 2, abs=1e-5)
    assert place["size"][0] == pytest.approx(np.ptp(np.nonzero(depth_map.mask[::4, ::4])[1]) * 4, abs=1e-4)
    speck = DepthMap(depth=np.full((48, 64), 2.0, np.float32), mask=np.arange(48 * 64).reshape(48, 64) == 65)
    assert place_of([depth_box(speck, camera)])["centre"][2] == -2.0


def test_pictures_carry_normals_and_mark_what_is_clipped(dome: tuple[LiveResult, Camera]) -> None:
    block = normals_block(dome[0].normal_map).astype(float)
    mask = dome[0].normal_map.mask
    np.testing.assert_array_equal(block[..., 3] == 255, mask)
    assert (block[~mask] == (128, 128, 128, 0)).all()  # turns no normal that it is blended with
    read = (block[..., :3] / 127.5 - 1) * (1, -1, -1)
    np.testing.assert_allclose(read[mask], dome[0].normal_map.normals_in_camera[mask], atol=1 / 127)
    values = np.full((6, 8, 3), 70, np.uint8)
    values[2, 3, 1] = 255
    for shift, kind in ((0, np.uint8), (2, np.uint16)):
        frame = EncodedFrame(
            values=(values.astype(np.uint16) << shift).astype(kind), bits=8 + shift, number=0, name="f"
        )
        picture = camera_block(TimedFrame(frame=frame, arrived_s=0.0), 8)
        assert tuple(picture[2, 3]) == (255, 0, 255, 255)
        assert (np.delete(picture.reshape(-1, 4), 19, axis=0) == (70, 70, 70, 255)).all()
    with pytest.raises(BadInput, match="sizes from 2 to"):
        PacketSizes(grid=100_000)


def test_a_touch_comes_with_its_depth_in_colours(dome: tuple[LiveResult, Camera]) -> None:
    shape = dome[0].normal_map.shape
    depth = DepthMap(depth=np.full(shape, -4e-4, np.float32), mask=np.ones(shape, bool))
    contact = Contact(mask=depth.mask, area_mm2=6.0, depth_mm=0.4)
    shown = LiveViewer(dome[1], ViewerOptions(port=free_port()), figures=lambda: FIGURES)
    try:
        asked = Asked(shown)
        shown.show(replace(dome[0], depth_map=depth, contact=contact), timed())
        asked.join()
        header, blocks = opened(asked.content)
    finally:
        shown.close()
    told = header["pictures"]["dents"]
    assert told["shape"] == list(shape)
    picture = np.frombuffer(blocks[told["at"] :][: 4 * depth.mask.size], np.uint8).reshape(*shape, 4)
    np.testing.assert_array_equal(picture[..., :3], picture_of_dents(depth, 0.5))
    assert (picture[..., 3] == 255).all()


def test_one_packet_per_question_and_always_the_newest(viewer, dome):
    assert viewer.watchers == 0
    viewer.show(dome[0], timed())  # nobody looks on
    page = Asked(viewer)
    assert viewer.watchers == 1
    viewer.show(dome[0], timed())
    first, rest = opened(page.content) if page.join() is None else ({}, b"")
    assert first["serial"] == 2  # not the old one that was there when it asked
    assert first["own"]["shape"] == [12, 16]
    assert {name: entry["shape"] for name, entry in first["pictures"].items()} == {
        "camera": [16, 22],
        "normals": [48, 64],
    }
    assert len(first["status"]["cards"]) == 4
    assert len(rest) == 2 * 12 * 16 + 4 * 48 * 64 + 4 * 16 * 22
    assert viewer.meter.count == 0  # sent, but not drawn yet
    for _ in range(3):
        viewer.show(dome[0], timed())  # passed over
    page = Asked(viewer, serial=2, ago_ms=150)
    assert viewer.meter.count == 1
    viewer.show(dome[0], timed())
    assert page.header()["serial"] == 6
    repeated = Asked(viewer, serial=2)  # not what was sent last
    viewer.show(dome[0], timed())
    repeated.join()
    assert viewer.meter.count == 1


def test_a_late_capture_comes_first(viewer: LiveViewer, dome: tuple[LiveResult, Camera]) -> None:
    page = Asked(viewer)
    viewer.show(dome[0], timed())
    assert page.header()["serial"] == 1
    page = Asked(viewer, serial=1)
    viewer.show(dome[0], timed(age_s=0.2))  # put off
    time.sleep(0.1)
    assert page.is_alive()
    viewer.show(dome[0], timed())
    assert page.header()["serial"] == 3
    page = Asked(viewer, serial=3)
    time.sleep(0.5)
    viewer.show(dome[0], timed(age_s=0.2))  # late again, but the page has waited long enough
    assert page.header()["serial"] == 4
    assert page.seconds < 1.0
    page = Asked(viewer, serial=4)
    page.join()
    assert page.content == b""  # no frame came


def status_of(address: str, **more: Any) -> int:
    try:
        return int(urllib.request.urlopen(urllib.request.Request(address, **more), timeout=10).status)
    except urllib.error.HTTPError as refused:
        return refused.code


def test_only_the_page_itself_may_record_and_nonsense_is_refused(viewer: LiveViewer) -> None:
    recorder = viewer._recorder
    assert recorder is not None
    record = url_of(viewer, "record")
    assert status_of(record.partition("?")[0], method="POST") == 403  # no token
    for elsewhere in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {"Host": "evil.example"}):
        assert status_of(record, method="POST", headers=elsewhere) == 403
    assert not recorder.is_recording
    own = viewer.address.partition("/?")[0]
    assert status_of(record, method="POST", headers={"Origin": own}) == 200
    assert recorder.is_recording
    recorder.stop()
    assert status_of(viewer.address) == 200
    assert status_of(url_of(viewer, "../../etc/passwd")) == 404
    for query in ("", "id=a&serial=x&ago_ms=0&grid=9&normals=9&camera=9",
                  "id=a&serial=0&ago_ms=0&grid=9&normals=9&camera=999999"):  # fmt: skip
        assert status_of(url_of(viewer, "packet", query)) == 400


def test_a_page_is_told_that_it_is_over(dome: tuple[LiveResult, Camera]) -> None:
    ended = LiveViewer(dome[1], ViewerOptions(port=free_port()), figures=lambda: FIGURES)
    kept = http.client.HTTPConnection(urlsplit(ended.address).netloc, timeout=10)
    kept.request("GET", ended.address.removeprefix(f"http://{urlsplit(ended.address).netloc}"))
    assert kept.getresponse().read().startswith(b"<!DOCTYPE html>")
    ended.close()
    kept.request("GET", url_of(ended, "packet", "id=a&serial=0&ago_ms=0&grid=9&normals=9&camera=9"))
    assert kept.getresponse().status == 503  # an empty answer would make it ask again at once


def test_a_port_in_use_is_passed_over(viewer: LiveViewer, dome: tuple[LiveResult, Camera]) -> None:
    port = urlsplit(viewer.address).port
    other = LiveViewer(dome[1], ViewerOptions(port=port), figures=lambda: FIGURES)
    try:
        assert urlsplit(other.address).port > port
        assert status_of(url_of(other, "record"), method="POST") == 404  # there is no recorder
    finally:
        other.close()
