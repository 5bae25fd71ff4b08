"""A gel as one object: depth in millimetres from a raw frame, and what contradicts the rig is said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vntoolkit as vt
from tests.drawn_gel import HEIGHT, MARGIN, WIDTH, picture
from vntoolkit.diagnosis.finding import FatalFinding
from vntoolkit.diagnosis.press_checks import check_gel_fills_picture
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.rigs import read_rig, write_rig
from vntoolkit.pipeline.calibrate_presses import PressJob, PressReader, calibrate_presses
from vntoolkit.pipeline.gel import Gel


def write_presses(folder: Path, background: np.ndarray) -> PressJob:
    rng = np.random.default_rng(11)
    for k in range(12):
        place = rng.uniform(35, WIDTH - 35), rng.uniform(35, HEIGHT - 35)
        write_png(folder / "presses" / f"press-{k}.png", picture(rng, *place, rng.uniform(15, 19), 0.01))
    write_png(folder / "background.png", background)
    left, right, bottom = MARGIN, MARGIN + WIDTH, MARGIN + HEIGHT
    corners = tuple(map(float, (left, left, right, left, left, bottom, right, bottom)))
    return PressJob(
        folder / "presses", background=folder / "background.png", corners=corners,
        size_mm=(WIDTH / 10, HEIGHT / 10), pixel_mm=0.1, ball_radius_mm=2.4,
    )  # fmt: skip


@pytest.fixture(scope="module")
def untouched() -> np.ndarray:
    return picture(np.random.default_rng(1), 0, 0, 0)


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory: pytest.TempPathFactory, untouched: np.ndarray) -> Path:
    folder = tmp_path_factory.mktemp("gel")
    result = calibrate_presses(write_presses(folder, untouched))
    assert not result.findings
    write_rig(folder / "rig.json", result.rig)
    return folder / "rig.json"


def test_a_raw_frame_becomes_depth_in_millimetres_and_contact(rig_file: Path, untouched, rng) -> None:
    gel = vt.Gel.read(rig_file, rig_file.parent / "background.png")
    touch = gel(picture(rng, 60, 90, 18, 0.02, rest_px=0.1))
    assert touch.depth_mm.shape == touch.contact.shape == touch.error_deg.shape == (HEIGHT, WIDTH)
    u, v = touch.deepest_px
    assert np.hypot(u - 60, v - 90) < 4
    cap_mm = 2.4 - np.sqrt(2.4**2 - 1.8**2)
    assert touch.deepest_mm == pytest.approx(cap_mm, abs=0.15)
    assert touch.depth_mm[v, u] == pytest.approx(-touch.deepest_mm, abs=1e-6)
    assert touch.area_mm2 == pytest.approx(touch.contact.sum() * gel.pixel_mm**2)
    assert touch.contact[90, 60]
    assert np.median(touch.error_mm) < 0.3
    rest = gel(untouched)
    assert rest.deepest_px is None
    assert rest.area_mm2 == rest.deepest_mm == 0


def test_a_table_tells_the_balls_of_presses(tmp_path: Path, untouched: np.ndarray) -> None:
    """By image, by pattern or by folder; the ball that is not listed has the radius of the option."""
    job, table = write_presses(tmp_path, untouched), tmp_path / "balls.txt"
    table.write_text("press-0.png 2.41\n\npress-1?.png 2.39\n")
    job = replace(job, ball_radii=table)
    listed = {"press-0.png": 2.41, "press-10.png": 2.39, "press-11.png": 2.39}
    assert PressReader(job).ball_radii_mm == listed
    assert calibrate_presses(job).ball_radii_mm == (2.39, 2.4, 2.41)
    table.write_text("presses 2.41")
    assert set(PressReader(job).ball_radii_mm.values()) == {2.41}
    for text, line in (
        ("press-99.png 2", "press-99.png is no image of .*, such as press-0.png"),
        ("press-0.png 2\npress-?.png 3", "lists press-0.png again; expected each press once"),
        ("press-0.png two", "line 1: expected NAME and a radius in mm, got 'press-0.png two'"),
        ("2.4", "line 1: expected NAME and a radius"),
        ("press-0.png -1", "line 1: expected NAME and a radius"),
    ):
        table.write_text(text)
        with pytest.raises(BadInput, match=line):
            PressReader(job).ball_radii_mm  # noqa: B018 - refused when it is asked for


def test_what_contradicts_the_rig_is_said(rig_file, untouched, rng, caplog):
    rig = read_rig(rig_file)
    touched, press = picture(rng, 60, 90, 18), picture(rng, 100, 40, 18)
    for frame, line in (
        (touched[:-1], r"expected a frame of shape \(220, 180, 3\), got \(219"),
        (touched.astype(np.float64), "uint8, uint16 or float32, got float64"),
    ):
        with pytest.raises(BadInput, match=line):
            Gel(rig, untouched)(frame)
    with pytest.raises(FatalFinding, match="footage fits its background with exchanged channels"):
        Gel(rig, untouched)(touched[..., ::-1])
    with pytest.raises(FatalFinding, match="background fits the gel of the calibration with exchanged"):
        Gel(rig, untouched[..., ::-1])
    with pytest.raises(FatalFinding, match=r"background holds a dent, at u \d+ v \d+: it is no picture"):
        Gel(rig, press)(touched)
    Gel(rig, press, allow=("background",))(touched)
    assert "[background]" in caplog.text
    caplog.clear()
    Gel(rig, (untouched * np.array([1.0, 0.7, 1.0])).astype(np.uint8))
    assert "light of the background is not that of the calibration" in caplog.text
    with pytest.raises(BadInput, match="rig of a tactile gel"):
        Gel(replace(rig, gel=None), untouched)
    with pytest.raises(BadCapture, match="clipped at 100%"):
        Gel(rig, untouched)(np.full_like(untouched, 255))


def test_presses_against_a_background_that_is_a_press_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    result = calibrate_presses(write_presses(tmp_path, picture(rng, 100, 50, 17)))
    (finding,) = [each for each in result.findings if each.check == "background"]
    assert "holds a dent, at u" in finding.problem


def test_a_dark_frame_around_the_gel_asks_for_corners() -> None:
    assert not check_gel_fills_picture(np.array([0.4, 0.5, 0.4]), np.array([0.5, 0.5, 0.5]))
    (finding,) = check_gel_fills_picture(np.array([0.1, 0.5, 0.4]), np.array([0.5, 0.5, 0.5]))
    assert "--corners" in finding.remedy
