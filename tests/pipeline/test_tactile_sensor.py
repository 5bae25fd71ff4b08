"""A tactile sensor from the command line: circles found, corners kept, a flat gel, a contact that is told."""

from pathlib import Path

import numpy as np
import pytest

from tests.drawn_gel import DOTS, HEIGHT, MARGIN, MATRIX, RADIUS_PX, WIDTH, U, V, picture, sine_of_slope
from vntoolkit.__main__ import main
from vntoolkit.diagnosis.press_checks import (
    check_contacts,
    check_labels,
    check_offset,
    check_press_transfer,
)
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.maps_and_meshes.maps import read_depth_map, read_normal_map
from vntoolkit.io.rigs import read_rig
from vntoolkit.pipeline.calibrate_presses import PressJob, PressReader
from vntoolkit.tactile.circles import Press
from vntoolkit.tactile.contact import rested
from vntoolkit.tactile.dots import DotFilter


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve presses, the untouched gel, the same with a drift, and the rig that they give."""
    folder, rng = tmp_path_factory.mktemp("sensor"), np.random.default_rng(4)
    for k in range(12):
        place = rng.uniform(35, WIDTH - 35), rng.uniform(35, HEIGHT - 35)
        write_png(folder / "presses" / f"press-{k}.png", picture(rng, *place, rng.uniform(15, 19), 0.01))
        (folder / "labels").mkdir(exist_ok=True)
        # labels of a picture a fifth larger
        text = f"{1.2 * place[0]:.1f} {1.2 * place[1]:.1f} {1.2 * 17}"
        (folder / "labels" / f"press-{k}.txt").write_text(text)
    write_png(folder / "background.png", picture(rng, 0, 0, 0))
    write_png(folder / "touched.png", picture(rng, 60, 90, 18, 0.02))
    write_png(folder / "sharp.png", picture(rng, 60, 90, 18, 0.02, rest_px=0.1))
    assert calibrate(folder, folder / "rig.json") == 0
    return folder


LEFT, RIGHT, BOTTOM = MARGIN, MARGIN + WIDTH, MARGIN + HEIGHT
CORNERS = f"--corners {LEFT} {LEFT} {RIGHT} {LEFT} {LEFT} {BOTTOM} {RIGHT} {BOTTOM}"
PLANE = f"{CORNERS} --size-mm {WIDTH / 10} {HEIGHT / 10}"  # which tells that a pixel is 0.1 mm


def calibrate(sensor: Path, rig: Path, *more: str, ball_mm: str = "2.4", presses: str = "") -> int:
    source = presses or f"{sensor}/presses"
    files = f"{source} --background {sensor}/background.png --out {rig} --ball-radius-mm {ball_mm}"
    return main([*f"calibrate presses {files} {PLANE}".split(), *more])


def reconstruct(sensor: Path, frame: str, rig: Path, out: Path) -> int:
    files = f"{sensor}/{frame} --rig {rig} --background {sensor}/background.png"
    return main(f"reconstruct {files} --to depth --out {out}".split())


def test_a_sensor_from_presses_without_labels_to_depth_and_contact(sensor, tmp_path, capsys):
    rig = tmp_path / "rig.json"
    assert calibrate(sensor, rig) == 0
    told = capsys.readouterr().out
    assert "contact circles   12, found" in told
    assert "4.8 mm across" in told
    assert "negative in a dent" in told
    assert read_rig(rig).footage_size == (WIDTH + 2 * MARGIN, HEIGHT + 2 * MARGIN)
    rectify = f"rectify {sensor}/touched.png --out {tmp_path}/flat"
    assert main(f"{rectify} --rig {rig}".split()) == 0
    assert "next: vntoolkit calibrate presses" in capsys.readouterr().out
    own = read_image(tmp_path / "flat" / "000000.png")
    assert own.shape == (HEIGHT, WIDTH, 3)
    assert main(f"{rectify} --overwrite {PLANE}".split()) == 0
    np.testing.assert_array_equal(read_image(tmp_path / "flat" / "000000.png"), own)
    assert main(f"{rectify} --overwrite".split()) == 1
    assert "or the --rig of a tactile gel" in capsys.readouterr().err
    out = tmp_path / "out"
    assert reconstruct(sensor, "touched.png", rig, out) == 0
    normal_map = read_normal_map(out / "normals" / "000000.exr")
    normals, error_deg = normal_map.normals_in_camera, normal_map.error_deg
    inside = np.hypot(U - 60, V - 90) < 15
    truth = np.stack([U - 60, V - 90], axis=-1) / RADIUS_PX
    assert np.median(np.linalg.norm(normals[..., :2] - truth, axis=2)[inside]) < 0.04
    facing = np.concatenate([truth, -np.sqrt(np.maximum(1 - (truth**2).sum(-1), 0))[..., None]], axis=-1)
    flat = np.hypot(U - 60, V - 90) > 40
    for part, wanted in ((inside, facing[inside]), (flat, np.array([0.0, 0.0, -1.0]))):
        off_deg = np.degrees(np.arccos((normals[part] * wanted).sum(-1).clip(-1, 1)))
        assert 0.7 < (off_deg <= error_deg[part]).mean() < 0.99
    depth_map = read_depth_map(out / "depth" / "000000.exr")
    depth_mm = 1000 * depth_map.depth
    assert 0.5 < np.median(depth_map.error_percent) < 15
    assert abs(np.median(depth_mm[flat])) < 0.03
    sine = sine_of_slope(np.arange(0, 60, 0.1), 18)
    height_mm = np.cumsum((sine / np.sqrt(1 - sine**2))[::-1])[::-1] * 0.01
    assert depth_mm[90, 60] == pytest.approx(-height_mm[0], rel=0.08)
    frame, area_mm2, deepest_mm = (out / "contact.csv").read_text().splitlines()[1].split(",")
    assert frame == "0"
    rim_mm = 0.01 * np.count_nonzero(height_mm > height_mm[0] / 3)
    assert float(area_mm2) == pytest.approx(np.pi * rim_mm**2, rel=0.15)
    assert float(deepest_mm) == pytest.approx(-depth_mm.min(), abs=1e-3)
    contact = read_image(out / "contact" / "000000.png")
    assert contact[90, 60].min() == 255
    assert contact[20, 20].max() == 0


def test_without_corners_the_side_of_a_pixel_is_asked_for(sensor: Path, tmp_path: Path, capsys) -> None:
    files = f"{sensor}/presses --background {sensor}/background.png --out {tmp_path}/rig.json"
    assert main(f"calibrate presses {files} --ball-radius-mm 2.4".split()) == 1
    assert "expected --pixel-mm, or --corners and --size-mm" in capsys.readouterr().err


def test_the_dark_flank_of_a_sharp_rim_is_no_dot(sensor: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert reconstruct(sensor, "sharp.png", sensor / "rig.json", out) == 0
    depth_mm = 1000 * read_depth_map(out / "depth" / "000000.exr").depth
    # The cap's height is known; so is the area within which it is a third deep.
    assert depth_mm[90, 60] == pytest.approx(-(2.4 - np.sqrt(2.4**2 - 1.8**2)), abs=0.1)
    area_mm2 = float((out / "contact.csv").read_text().splitlines()[1].split(",")[1])
    assert area_mm2 == pytest.approx(np.pi * 1.5**2, rel=0.15)


def test_an_untouched_gel_is_flat_and_a_missing_background_is_said(sensor, tmp_path, capsys):
    rig, flat = sensor / "rig.json", tmp_path / "flat"
    assert main(f"reconstruct {sensor}/background.png --rig {rig} --to depth --out {flat}".split()) == 1
    said = capsys.readouterr().err
    assert "expected a photograph of the untouched gel, got none; give it with --background" in said
    assert reconstruct(sensor, "background.png", rig, flat) == 0
    assert np.ptp(read_depth_map(tmp_path / "flat" / "depth" / "000000.exr").depth) == 0
    assert (tmp_path / "flat" / "contact.csv").read_text().splitlines()[1] == "0,0.000,0.0000"


def test_labels_of_a_picture_of_another_size_are_refused(sensor, tmp_path, capsys):
    labels = ["--labels", str(sensor / "labels")]
    assert calibrate(sensor, tmp_path / "rig.json", *labels) == 1
    error = capsys.readouterr().err
    assert "[labels]" in error
    assert not (tmp_path / "rig.json").exists()
    size = ["--label-size", str(round(1.2 * WIDTH)), str(round(1.2 * HEIGHT))]
    assert calibrate(sensor, tmp_path / "rig.json", *labels, *size) == 0
    assert "as labelled in" in capsys.readouterr().out


def test_circles_are_drawn_over_a_grid_and_corrected_by_hand(sensor, tmp_path, capsys):
    rig, overlay, labels = tmp_path / "rig.json", tmp_path / "circles.png", tmp_path / "circles.txt"
    u, v, _ = (float(word) / 1.2 for word in (sensor / "labels" / "press-3.txt").read_text().split())
    circle = ["--circle", "press-3.png", str(u), str(v), "17", "--circle", "press-5.png"]
    assert calibrate(sensor, rig, *circle, "20", "30", "17", "--overlay", str(overlay)) == 0
    assert "contact circles   12, found" in capsys.readouterr().out
    assert read_image(overlay).shape[2] >= 3
    reader = PressReader(
        PressJob(
            source=str(sensor / "presses"), background=sensor / "background.png",
            circle=(("press-3.png", u, v, 17.0),), ball_radius_mm=2.4,
        )
    )  # fmt: skip
    assert reader.labelled("press-3.png") == Press(u_px=u, v_px=v, radius_px=17)
    assert reader.labelled("press-4.png") is None
    labels.write_text(f"press-3.png {u} {v} 17\n\n")
    assert calibrate(sensor, rig, "--labels", str(labels)) == 0
    for text, line in (
        ("press-3.png 1 2", f"{labels} line 1: expected three numbers"),
        ("press-99.png 1 2 3", "circle of press-99.png: expected an image of"),
    ):
        labels.write_text(text)
        assert calibrate(sensor, rig, "--labels", str(labels)) == 1
        assert line in capsys.readouterr().err
    assert main(["circles", "presses"]) == 1
    assert "--overlay circles.png" in capsys.readouterr().err


def test_a_diameter_given_as_the_radius_and_clipped_presses_are_said(sensor, tmp_path, capsys, caplog):
    assert calibrate(sensor, tmp_path / "rig.json", ball_mm="4.8") == 0
    assert "diameter given as --ball-radius-mm? [cone]" in caplog.text
    (tmp_path / "bright").mkdir()
    for path in sorted((sensor / "presses").iterdir())[:3]:
        values = read_image(path).astype(int)
        write_png(tmp_path / "bright" / path.name, np.minimum(3 * values, 255).astype(np.uint8))
    assert calibrate(sensor, tmp_path / "b.json", presses=f"{tmp_path}/bright") == 1
    assert "[clipping]" in capsys.readouterr().err


def test_what_labels_and_colours_tell_of_mistakes(rng: np.random.Generator) -> None:
    found = np.column_stack([rng.uniform(20, 200, 30), rng.uniform(20, 300, 30), np.full(30, 20.0)])
    jitter = rng.normal(0, 2, (30, 3))
    assert not check_labels(found + jitter, found, (240, 320))
    assert not check_labels(found + jitter + [-4, 2, 0], found, (240, 320))
    (scaled,) = check_labels((found + jitter) * [1, 1.1, 1], found, (240, 320))
    width, height = map(int, scaled.remedy.split()[-2:])
    assert (width, height) == (pytest.approx(240, abs=8), pytest.approx(352, abs=8))
    (beside,) = check_labels(found + jitter + [14, 3, 0], found, (240, 320))
    assert beside.check == "labels"
    assert not check_offset(np.array([3.0, 2.0]), 10.0)
    assert check_offset(np.array([6.0, 8.0]), 10.0)
    assert not check_press_transfer("linear", 8.9, {"srgb": 10.8})
    assert not check_contacts(np.array([0.5, 0.7, 0.6]))
    (narrow,) = check_contacts(np.array([0.25, 0.35, 0.3]))
    assert "diameter given" in narrow.remedy
    (curve,) = check_press_transfer("srgb", 10.8, {"linear": 8.9})
    assert "--transfer linear" in curve.remedy


def test_dots_are_filled_from_what_is_around_them(rng: np.random.Generator) -> None:
    untouched = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    untouched[DOTS] = 0.1
    moved = np.roll(untouched, 2, axis=1)
    smooth = np.stack([0.1 * np.sin(U / 25), 0.1 * np.cos(V / 30), 0 * U], axis=-1).astype(np.float32)
    change, filled = DotFilter(untouched).filled(moved + smooth - untouched, np.zeros(DOTS.shape, bool))
    assert filled[DOTS].all()
    assert filled.mean() < 0.25
    assert np.abs(change - smooth).max() < 0.03
    sine = sine_of_slope(np.hypot(U - 60, V - 90), 18, 0.1)
    outward = np.stack([U - 60, V - 90], axis=-1) / np.maximum(np.hypot(U - 60, V - 90), 1e-9)[..., None]
    dent = np.concatenate([sine[..., None] * outward, -np.sqrt(1 - sine**2)[..., None]], axis=-1) @ MATRIX.T
    dent[DOTS] *= 0.2
    at_rest = np.where(DOTS[..., None], 0.2, 1.0) * -MATRIX[:, 2]
    steep = DotFilter(at_rest.astype(np.float32))
    _, filled = steep.filled((dent - at_rest).astype(np.float32), np.zeros(DOTS.shape, bool))
    assert (filled == steep.dots).all()  # no pixel of the flank
    plain = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    assert not DotFilter(plain).filled(smooth, np.zeros(DOTS.shape, bool))[1].any()


def test_a_dot_that_has_moved_onto_a_dark_flank_is_told_from_it() -> None:
    untouched = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    untouched[DOTS] = 0.1
    flank = (np.abs(U - V) < 4) & (V > 40) & (V < 120)  # a groove, dark in all channels, wider than a dot
    moved = np.roll(DOTS, (3, 4), axis=(0, 1))
    frame = np.where(flank[..., None], np.float32(0.37), np.float32(0.5)) * np.ones(3, np.float32)
    frame[moved] = 0.1
    filter_ = DotFilter(untouched)
    _, filled = filter_.filled(frame - untouched, np.zeros(DOTS.shape, bool))
    assert (flank & moved & ~filter_.dots).any()
    assert filled[moved].mean() > 0.98
    assert filled[flank & ~moved & ~filter_.dots].mean() < 0.6


def test_holes_are_filled_between_what_is_known_in_row_and_column() -> None:
    v, u = np.indices((20, 30))
    ramp = np.stack([0.01 * u, 0.02 * v, 0.01 * u + 0.02 * v], axis=-1).astype(np.float32)
    dots, nothing = DotFilter(np.ones((20, 30, 3), np.float32)), np.zeros((20, 30), bool)
    inside = np.zeros((20, 30), bool)
    inside[5:9, 4:12] = inside[12, :] = True  # a hole inside, a row without anything known
    filled, holes = dots.filled(np.where(inside[..., None], 9, ramp).astype(np.float32), inside)
    np.testing.assert_allclose(filled, ramp, atol=1e-6)
    np.testing.assert_array_equal(holes, inside)
    border = np.zeros((20, 30), bool)
    border[:, :3] = border[17:, :] = True  # ends: the one known pixel of the row, or of the column, is taken
    filled, _ = dots.filled(np.where(border[..., None], 9, ramp).astype(np.float32), border)
    np.testing.assert_allclose(filled[3, :3], np.broadcast_to(ramp[3, 3], (3, 3)), atol=1e-6)
    np.testing.assert_allclose(filled[17:, 10], np.broadcast_to(ramp[16, 10], (3, 3)), atol=1e-6)
    assert filled.max() < 1
    assert dots.filled(ramp, nothing)[0] is ramp


def test_the_gel_at_rest_is_the_plane_of_depth_0() -> None:
    dent_m = -1e-3 * np.exp(-(np.hypot(U - 60, V - 90) ** 2) / 200)
    tilted = DepthMap(depth=dent_m + 2e-6 * U - 1e-6 * V + 5e-3, mask=np.ones(U.shape, bool))
    assert np.abs(rested(tilted).depth - dent_m).max() < 2e-5
    steep = 2e-5 * U  # too little of it is near one plane to tell a tilt: the shape is kept
    shift = rested(DepthMap(depth=steep, mask=np.ones(U.shape, bool))).depth - steep
    assert np.ptp(shift) < 1e-9
