"""The report: self-contained, escaped, complete, the same for the same input; and it looks like something."""

import re
import runpy
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.browser import visit
from tests.dome_result import SKIPPED, DomeResult
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.io.results.manifest import FindingEntry, read_manifest
from vntoolkit.io.results.reconstruction import write_manifest
from vntoolkit.options.pages import ReportOptions
from vntoolkit.pipeline.opened_result import read_result
from vntoolkit.report.page import PageSection, PageTable, figure_from_file, figure_from_plot
from vntoolkit.report.pictures import new_figure, normals_from_depth, picture_of_depth
from vntoolkit.report.report import content_of_report, write_report
from vntoolkit.report.result_scene import write_scene

SCRIPT = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def page(dome_result: DomeResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("page") / "report.html"
    extra = PageSection(
        title="Compared with the truth",
        paragraphs=(SCRIPT,),
        tables=(PageTable(headings=("what", "ours"), rows=(("mean error", "1.2°"),), right=(1,)),),
    )
    assert write_report(dome_result.folder, out, ReportOptions(samples=2), extra=[extra]) == out
    return out


def test_every_part_is_there(page: Path) -> None:
    text = page.read_text()
    for part in ("Sample frames", "Compared with the truth", "0.40°", "61°", "no subject in sight",
                 "Registered surface", "mean error"):  # fmt: skip
        assert part in text
    assert f"frame {SKIPPED} shows no subject" in text
    assert f"frame {SKIPPED} (f{SKIPPED})" in text  # stills keep their names
    assert text.count("data:image/webp;base64,") == 1  # the sample frames, in rows
    assert text.count("data:image/jpeg;base64,") == 1  # the checkerboard


def test_names_are_escaped(page: Path) -> None:
    text = page.read_text()
    assert SCRIPT not in text
    assert "&lt;script&gt;" in text
    assert "<b>dome" not in text
    assert "&lt;b&gt;dome &amp; &#34;co&#34;" in text


def test_nothing_is_fetched(page: Path) -> None:
    text = page.read_text()
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None
    assert policy[1].startswith(
        "default-src 'none'; "
    )  # no script runs, whatever a name or a figure brings in
    assert "script-src" not in policy[1]
    assert re.findall(r'(?:src|href)="(?!data:|#)[^"]*"', text) == []
    assert set(re.findall(r"\w+://[^\"'\s)<]+", text)) <= {
        "http://www.w3.org/2000/svg",
        "http://www.w3.org/1999/xlink",
    }  # names of XML spaces, not addresses


def test_a_browser_shows_it_without_complaint(page: Path) -> None:
    with visit(page, width=1100) as seen:
        sizes = seen.page.evaluate("[...document.images].map(i => i.naturalWidth)")
        wide = seen.page.evaluate("document.documentElement.scrollWidth")
        curves = seen.picture("figure:has(svg) >> nth=1")
        assert len(sizes) == 2
        assert min(sizes) > 100
        assert wide <= 1100  # nothing sticks out to the side
        assert seen.requests == [page.as_uri()]
        assert seen.complaints == []
    assert len(np.unique(curves.reshape(-1, 3), axis=0)) > 20  # lines, labels, colours


def test_the_same_result_gives_the_same_bytes(dome_result, tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    first = write_report(dome_result.folder, tmp_path / "a.html").read_bytes()
    assert write_report(dome_result.folder, tmp_path / "b.html").read_bytes() == first


def test_ids_of_two_figures_do_not_meet() -> None:
    texts = []
    for heights in ([1, 2], [2, 1]):
        figure = new_figure()
        figure.subplots().bar([0, 1], heights)
        texts.append(figure_from_plot(figure, "bars").svg)
    first, second = (set(re.findall(r'\bid="([^"]+)"', text)) for text in texts)
    assert first
    assert not first & second
    for text, ids in zip(texts, (first, second), strict=True):
        assert set(re.findall(r"url\(#([^)]+)\)", text)) <= ids


def test_it_does_without_footage_and_tracks(dome_result, tmp_path, monkeypatch):
    folder = shutil.copytree(dome_result.folder, tmp_path / "moved")
    shutil.rmtree(folder / "track")
    shutil.rmtree(folder / "mesh")
    options = ReportOptions(footage=str(tmp_path / "nowhere.mkv"))
    text = write_report(folder, options=options).read_text()
    assert "the footage could not be looked at" in text
    assert "nowhere.mkv: no such" in text
    assert "Registered surface" not in text
    assert "captured" not in text
    monkeypatch.setattr(sys, "argv", ["readme_picture", "--demo", str(tmp_path), "--footage", "nowhere.mkv"])
    folder.rename(tmp_path / "reconstruction")
    with pytest.raises(BadInput, match=r"nowhere\.mkv: no such"):
        runpy.run_path(str(Path(__file__).parents[2] / "recipes" / "readme_picture.py"), run_name="__main__")


def test_it_repeats_what_the_run_found(dome_result: DomeResult, tmp_path: Path) -> None:
    folder = shutil.copytree(dome_result.folder, tmp_path / "warned")
    manifest = read_manifest(folder)
    clipped = FindingEntry(check="clipping", level="note", text="7.5% of the pixels are clipped")
    worse = FindingEntry(check="reconstruct", level="warning", text="the expected error is large", frame=2)
    known = manifest.known.model_copy(update={"findings": [clipped]})
    write_manifest(folder, manifest.model_copy(update={"known": known, "findings": [worse]}))
    page = write_report(folder).read_text()
    first = [page.index(finding.text) for finding in (worse, clipped)]
    assert first == sorted(first)
    assert first[1] < page.index("<h2>Sample frames")
    found = content_of_report(read_result(folder))["findings"]
    assert [finding["text"] for finding in found] == [worse.text, clipped.text]
    assert found[0]["frame"] == 2
    write_scene(tmp_path / "view.html", read_result(folder))
    shown = (tmp_path / "view.html").read_text()
    assert worse.text in shown
    assert clipped.text not in shown  # a note asks for nothing


def test_refusals(tmp_path: Path) -> None:
    (tmp_path / "a.bmp").write_bytes(b"BM")
    with pytest.raises(BadInput, match=r"a figure is one of \.png"):
        figure_from_file(tmp_path / "a.bmp", "no")


def test_normals_from_depth_are_those_of_the_sphere() -> None:
    camera = Camera.pinhole(width=81, height=81, focal_px=300)
    rays = camera.unproject(camera.pixel_grid(), np.ones((81, 81)))
    centre, radius = np.array([0, 0, 10.0]), 2.0
    along = (rays @ centre) / (rays**2).sum(-1)
    gap = (radius**2 - ((rays * along[..., None] - centre) ** 2).sum(-1)) / (rays**2).sum(-1)
    mask = gap > 0.01
    depth = np.where(mask, along - np.sqrt(np.maximum(gap, 0)), 0)
    depth_map = DepthMap(depth=depth, mask=mask)
    normals = normals_from_depth(depth_map, camera)
    truth = (rays * depth[..., None] - centre) / radius
    inner = (normals[..., 2] != 0) & (truth[..., 2] < -0.5)
    cosine = (normals * truth).sum(-1)[inner]
    assert inner.sum() > 1000
    assert np.rad2deg(np.arccos(cosine.clip(-1, 1))).max() < 1.0
    grey = picture_of_depth(depth_map, camera)[..., 0].astype(float)
    assert grey[20, 20] > grey[60, 60] + 60  # lit from the upper left, so it bulges towards us
