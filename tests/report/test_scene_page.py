"""The offline page: it opens in a browser without a request or a complaint, and what it shows is there."""

import base64
import hashlib
import json
import re
import shutil
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.browser import visit
from tests.dome_result import DomeResult
from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh, face_normals
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.options.pages import ScenePageOptions
from vntoolkit.pipeline.opened_result import read_result
from vntoolkit.report.result_scene import thinned_template, write_scene

GROUND = np.array([32, 38, 47])


def covered(picture: np.ndarray) -> np.ndarray:
    """Where the surface is: neither ground nor the light's disc, which lies in the lower left corner."""
    differs = np.abs(picture.astype(int) - GROUND).max(axis=2) > 24
    differs[-150:, :150] = False
    return differs


@pytest.fixture(scope="module")
def page(dome_result: DomeResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scene") / "scene.html"
    write_scene(out, read_result(dome_result.folder), ScenePageOptions(vertices=300))
    return out


@pytest.mark.slow
def test_a_browser_shows_the_surface(page: Path) -> None:
    with visit(page, width=900, height=700) as seen:
        tab = seen.page

        def picture(wait_for: str = "") -> np.ndarray:
            if wait_for:
                tab.wait_for_selector(wait_for)
            tab.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            return seen.picture("#view")

        lit = picture("body[data-shown='0']")
        disc = covered(lit)
        v, u = np.nonzero(disc)
        # the dome is a disc of the view's height, in its middle
        assert abs(u.mean() - lit.shape[1] / 2) < 0.05 * lit.shape[1]
        assert disc.mean() > 0.15
        assert 0.9 < np.ptp(u) / np.ptp(v) < 1.2
        grey = lit.mean(axis=2)
        middle, reach = np.array([v.mean(), u.mean()]).astype(int), int(0.3 * np.ptp(v))
        upper_left, lower_right = grey[tuple(middle - reach)], grey[tuple(middle + reach)]
        assert upper_left > lower_right + 20  # lit from there, and bulging towards us

        box = tab.locator("#light").bounding_box()
        tab.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
        tab.mouse.down()
        tab.mouse.move(box["x"] + 0.85 * box["width"], box["y"] + 0.85 * box["height"], steps=3)
        tab.mouse.up()
        moved = picture().mean(axis=2)
        assert moved[tuple(middle + reach)] > moved[tuple(middle - reach)] + 20

        tab.select_option("#look", "2")
        normals = picture()[tuple(middle)].astype(int)
        assert normals[2] > normals[0] + 60  # blue: towards the viewer
        tab.select_option("#surface", "registered")
        tab.select_option("#look", "3")
        for _ in range(100):  # the registered surface comes when it is unpacked
            checks = picture()
            hue = checks[..., 0].astype(int) - checks[..., 2]
            if (hue[disc] > 40).mean() > 0.2:
                break
        assert (hue[disc] > 40).mean() > 0.2
        assert (hue[disc] < 40).mean() > 0.2
        tab.check("#wire")
        assert np.abs(picture().astype(int) - checks).max(axis=2)[disc].mean() > 5

        tab.locator("#time").focus()
        tab.keyboard.press("End")
        picture("body[data-shown='4']")
        assert tab.inner_text("#number") == "frame 5"
        tab.click("#play")
        tab.wait_for_selector("body[data-shown='2']")
        widths = tab.evaluate("[...document.querySelectorAll('aside canvas')].map(c => c.width)")
        assert widths == [64] * 4
        assert seen.requests == [page.as_uri()]
        assert seen.complaints == []


def data_of(page: Path) -> dict[str, Any]:
    return json.loads(re.search(r'id="setup">(.*?)</script>', page.read_text(), re.DOTALL)[1])


def opened(text: str) -> tuple[dict[str, Any], bytes]:
    """Header and blocks of a packet as it lies in the page."""
    packet = zlib.decompress(base64.b64decode(text))
    (length,) = struct.unpack_from("<I", packet)
    return json.loads(packet[4 : 4 + length]), packet[4 + length :]


def repacked(text: str, *, only: str) -> str:
    """The packet without any surface and with one picture only."""
    header, blocks = opened(text)
    small = json.dumps({"pictures": {only: header["pictures"][only]}}).encode()
    small += b" " * (-len(small) % 4)
    packet = struct.pack("<I", len(small)) + small + blocks
    return base64.b64encode(zlib.compress(packet)).decode()


def altered(page: Path, out: Path, data: dict[str, Any], **more: str) -> Path:
    """Write the page with other data, and with texts of it replaced."""
    text = re.sub(
        r'(?<=id="setup">).*?(?=</script>)', lambda _: json.dumps(data), page.read_text(), flags=re.S
    )
    before = _digest_of_script(text)
    for old, new in more.items():
        text = text.replace(old, new)
    out.write_text(text.replace(before, _digest_of_script(text)))
    return out


def _digest_of_script(text: str) -> str:
    """Return the SHA-256 by which the page's policy lets its script run."""
    script = text[text.rindex("<script>") + len("<script>") : text.rindex("</script>")]
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def test_the_saved_page_runs_its_own_script_alone_and_fetches_nothing(page: Path) -> None:
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page.read_text())[1]
    assert "default-src &#39;none&#39;" in policy
    assert f"script-src &#39;sha256-{_digest_of_script(page.read_text())}&#39;" in policy
    assert "unsafe" not in policy


@pytest.mark.slow
def test_a_foreign_script_in_a_saved_page_does_not_run(page: Path, tmp_path: Path) -> None:
    spoilt = page.read_text().replace("</header>", "<script>document.title = 'taken'</script></header>", 1)
    (tmp_path / "spoilt.html").write_text(spoilt)
    with visit(tmp_path / "spoilt.html") as seen:
        seen.page.wait_for_selector("body[data-shown='0']")
        assert seen.page.title() != "taken"
        assert any("Content Security Policy" in complaint for complaint in seen.complaints)


@pytest.mark.slow
def test_a_browser_copes_with_what_a_result_may_lack(page, dome_result, tmp_path):
    whole = data_of(page)
    with visit(altered(page, tmp_path / "no_webgl.html", whole, webgl2="nosuchthing")) as seen:
        seen.page.wait_for_selector("body[data-shown='0']")
        widths = seen.page.evaluate("[...document.querySelectorAll('aside canvas')].map(c => c.width)")
        assert widths == [64] * 4  # as the message promises
        seen.page.get_by_text("This browser shows no WebGL 2").wait_for()
        seen.page.locator("#time").focus()
        seen.page.keyboard.press("End")
        seen.page.wait_for_selector("body[data-shown='4']")
        assert seen.complaints == []

    folder = shutil.copytree(dome_result.folder, tmp_path / "single")
    shutil.rmtree(folder / "track")
    no_footage = read_result(folder, frames="0", footage=str(tmp_path / "nowhere.mkv"))
    write_scene(tmp_path / "single.html", no_footage)
    with visit(tmp_path / "single.html") as seen:
        seen.page.wait_for_selector("body[data-shown='0']")
        assert seen.page.evaluate("[...$('look').options].map(o => o.value)") == ["1", "2", "3"]
        assert seen.page.is_disabled("#play")
        assert seen.page.is_disabled("#time")
        assert seen.complaints == []

    gaps = {**whole, "frames": [repacked(whole["frames"][0], only="normals"), *whole["frames"][1:]]}
    with visit(altered(page, tmp_path / "gaps.html", gaps)) as seen:
        seen.page.wait_for_selector("body[data-shown='0']")
        assert not covered(seen.picture("#view"))[:-200].any()  # below lie the light and a hint
        seen.page.evaluate("show(1)")
        seen.page.wait_for_selector("body[data-shown='1']")
        assert covered(seen.picture("#view")).mean() > 0.05
        assert len(seen.page.query_selector_all("aside canvas")) == 4
        assert seen.complaints == []


@pytest.mark.slow
def test_playing_shows_frames_though_each_takes_longer_than_it_lasts(page: Path) -> None:
    with visit(page) as seen:
        seen.page.wait_for_selector("body[data-shown='0']")
        seen.page.evaluate(
            "void (frame = ((real) => async (index) => "
            "(await new Promise((done) => setTimeout(done, 200)), real(index)))(frame))"
        )
        seen.page.click("#play")
        for index in (1, 2, 3):
            seen.page.wait_for_selector(f"body[data-shown='{index}']", timeout=20_000)


def test_nothing_in_it_points_elsewhere(page: Path) -> None:
    text = page.read_text()
    assert re.findall(r"https?://", text) == []
    assert text.count("</script>") == 2
    assert "<b>dome" not in text


def test_five_frames_lie_in_it_the_skipped_one_not(page: Path) -> None:
    data = data_of(page)
    assert data["numbers"] == [0, 1, 2, 4, 5]
    assert data["template"] == 0
    assert len(data["frames"]) == 5
    assert data["surfaces"] == ["own", "registered"]
    for text in data["frames"]:
        header = opened(text)[0]
        assert {"own", "registered"} <= set(header)
        assert list(header["pictures"]) == ["captured", "normals", "depth", "shadows"]


def test_the_registered_mesh_arrives_as_it_was(page: Path, dome_result: DomeResult) -> None:
    data, sequence = data_of(page), read_mesh_sequence(dome_result.folder / "track")
    thin = thinned_template(sequence.template, 300)
    header, blocks = opened(data["frames"][2])
    entry, (shared, more) = header["registered"], opened(data["topology"])
    steps = np.frombuffer(blocks, np.uint16, 3 * len(thin.kept), entry["at"]).reshape(-1, 3)
    read = np.array(entry["low"]) + steps * np.array(entry["step"])
    truth = np.array(sequence.vertices[2])[thin.kept] * (1, -1, -1)
    np.testing.assert_allclose(read, truth, atol=0.51 * max(entry["step"]) + 1e-6)
    faces = shared["mesh"]["faces"]
    read_faces = np.frombuffer(more, np.uint32, faces["count"], faces["at"]).reshape(-1, 3)
    np.testing.assert_array_equal(read_faces, thin.mesh.faces)


def test_a_long_capture_is_thinned_evenly_and_keeps_its_pace(dome_result: DomeResult, tmp_path: Path) -> None:
    out = tmp_path / "scene.html"
    write_scene(out, read_result(dome_result.folder), ScenePageOptions(vertices=100, most_frames=3))
    data = data_of(out)
    assert data["numbers"] == [0, 2, 5]
    assert len(data["frames"]) == 3
    assert data["times_s"] == pytest.approx([0, 2 / 30, 5 / 30])


def test_frames_are_shown_at_the_times_they_were_filmed(dome_result: DomeResult, tmp_path: Path) -> None:
    result = read_result(dome_result.folder)
    filmed = result.manifest.input.model_copy(update={"times_s": [0.0, 0.1, 0.5, 0.6, 0.7, 2.0]})
    uneven = replace(result, manifest=result.manifest.model_copy(update={"input": filmed}))
    write_scene(tmp_path / "scene.html", uneven, ScenePageOptions(vertices=100, most_frames=3))
    assert data_of(tmp_path / "scene.html")["times_s"] == pytest.approx([0, 0.5, 2.0])


def test_thinning_keeps_true_vertices_and_their_sides(dome_result: DomeResult) -> None:
    template = read_mesh_sequence(dome_result.folder / "track").template
    thin = thinned_template(template, 200)
    assert 100 < len(thin.kept) < 250
    np.testing.assert_array_equal(thin.mesh.vertices, template.vertices[thin.kept])
    area = np.linalg.norm(face_normals(thin.mesh.vertices, thin.mesh.faces), axis=1).sum()
    whole = np.linalg.norm(face_normals(template.vertices, template.faces), axis=1).sum()
    assert 0.93 < area / whole < 1.02
    towards = face_normals(thin.mesh.vertices, thin.mesh.faces)[:, 2]
    assert (towards < 0).mean() > 0.98
    small = Mesh(vertices=template.vertices[:3], faces=np.array([[0, 1, 2]]))
    assert thinned_template(small, 200).mesh is small


def test_normals_alone_are_refused(dome_result: DomeResult, tmp_path: Path) -> None:
    folder = shutil.copytree(dome_result.folder, tmp_path / "result")
    for name in ("depth", "mesh", "track"):
        shutil.rmtree(folder / name)
    with pytest.raises(BadInput, match="has no depth; reconstruct with --to depth"):
        write_scene(tmp_path / "scene.html", read_result(folder))
    assert not (tmp_path / "scene.html").exists()
