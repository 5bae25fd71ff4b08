"""`track` on a gel follows the material, in simulation and on photographs; a touch tells how it moved."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

import vntoolkit as vt
from tests.drawn_gel import HEIGHT, WIDTH, U, V, picture
from tests.pipeline.test_gel import write_presses
from vntoolkit.__main__ import main
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.maps_and_meshes.exr import read_exr
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.io.rigs import write_rig
from vntoolkit.pipeline.calibrate_presses import calibrate_presses
from vntoolkit.pipeline.gel_motion import read_displacement_mm
from vntoolkit.tactile.dots import DotFilter
from vntoolkit.tactile.motion import Membrane

FRAMES = 5
REAL = os.environ.get("VNTOOLKIT_REAL_DATA")


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A gel whose material moves down by a pixel a frame, under a ball that stays; reconstructed."""
    folder, rng = tmp_path_factory.mktemp("moved"), np.random.default_rng(2)
    job = write_presses(folder, picture(rng, 0, 0, 0))
    write_rig(folder / "rig.json", calibrate_presses(job).rig)
    for k in range(FRAMES):
        write_png(folder / "touch" / f"{k}.png", picture(rng, 60, 90, 18, moved_px=k + 1))
    files = f"{folder}/touch --rig {folder}/rig.json --background {folder}/background.png"
    assert main(f"reconstruct {files} --to depth --out {folder}/out".split()) == 0
    return folder


def test_track_follows_the_material_and_goes_on_where_it_stopped(moved: Path, capsys) -> None:
    command = f"track {moved}/out --background {moved}/background.png --object".split()
    assert main(command) == 0
    sequence = read_mesh_sequence(moved / "out" / "track")
    vertices_mm, uncertainty = 1000 * np.array(sequence.vertices), np.array(sequence.uncertainty_px)
    assert len(vertices_mm) == FRAMES
    told = capsys.readouterr().out
    assert f"object.csv: pose in {FRAMES} of {FRAMES} frames" in told
    head, *rows = (moved / "out" / "track" / "object.csv").read_text().splitlines()
    assert head.startswith("frame,contact,lost,x_mm")
    # the ball stays, while the gel moves
    place = np.array([row.split(",")[3:6] for row in rows], float)
    assert np.abs(place).max() < 0.1
    step = np.diff(vertices_mm, axis=0)
    inner = (vertices_mm[0, :, 1] > -7) & (vertices_mm[0, :, 1] < 6) & (np.abs(vertices_mm[0, :, 0]) < 5)
    known = inner & np.isfinite(uncertainty).all(axis=0)
    assert known.sum() > 0.8 * inner.sum()
    # 0.1 mm is a pixel
    assert np.percentile(np.abs(step[:, known, 1] - 0.1), 95) < 0.05
    assert np.percentile(np.abs(step[:, known, 0]), 95) < 0.05
    track = moved / "out" / "track"
    for k in range(FRAMES):
        maps, _ = read_exr(track / "motion" / f"{k:06d}.exr")
        seen = np.isfinite(maps["error_mm"]) & (np.hypot(U - 60, V - 90) > 40)
        assert np.median(maps["dy_mm"][seen]) == pytest.approx(0.1 * (k + 1), abs=0.02)
        assert abs(np.median(maps["dx_mm"][seen])) < 0.02
        assert {"divergence", "curl_deg"} < set(maps)
        read = read_displacement_mm(track, k)
        assert np.array_equal(np.isfinite(read[..., 0]), np.isfinite(maps["error_mm"]))
    head, *rows = (track / "motion.csv").read_text().splitlines()
    assert head == "frame,shear_x_mm,shear_y_mm,twist_deg,seen_share"
    assert [float(row.split(",")[2]) for row in rows] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5], abs=0.03)
    (track / "checkerboard.mkv").unlink()
    kept = (moved / "out" / "track" / "vertices.npy").read_bytes()
    capsys.readouterr()
    assert main(command) == 0
    assert f"{FRAMES} of them from before" in capsys.readouterr().out
    assert (moved / "out" / "track" / "vertices.npy").read_bytes() == kept


def test_without_the_untouched_gel_the_shape_alone_is_tracked(moved: Path, tmp_path, caplog) -> None:
    assert main(f"track {moved}/out --out {tmp_path}/track".split()) == 0
    assert "give the untouched gel as --background" in caplog.text


def test_a_touch_tells_how_the_material_moved(moved: Path) -> None:
    gel = vt.Gel.read(moved / "rig.json", moved / "background.png")
    for k in range(FRAMES):
        touch = gel(read_image(moved / "touch" / f"{k}.png"))
        assert touch.motion.shear_mm == pytest.approx((0, 0.1 * (k + 1)), abs=0.03)
        assert abs(touch.motion.twist_deg) < 2
    assert touch.motion.displacement_mm.shape == (HEIGHT, WIDTH, 2)
    seen = touch.motion.seen & (np.hypot(U - 60, V - 90) > 40)
    assert np.median(touch.motion.displacement_mm[seen][:, 1]) == pytest.approx(0.5, abs=0.02)
    assert np.isinf(touch.motion.error_mm[~touch.motion.seen]).all()


@pytest.mark.slow
@pytest.mark.skipif(REAL is None, reason="VNTOOLKIT_REAL_DATA is not set")
def test_printed_dots_of_a_real_gel_are_followed() -> None:
    """dots.csv tells where a blob detector saw the dots; where it takes one for its neighbour, it errs."""
    folder = Path(str(REAL)) / "gelsight" / "dotted_ball"
    corners = np.array([(33, 58), (208, 61), (56, 250), (185, 244)], np.float32)
    flat_from_filmed = cv2.getPerspectiveTransform(
        corners, np.array([(0, 0), (240, 0), (0, 320), (240, 320)], np.float32)
    )

    def rectified(path: Path) -> np.ndarray:
        return cv2.warpPerspective(np.float32(read_image(path)) / 255, flat_from_filmed, (240, 320))

    def mapped(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
        return cv2.perspectiveTransform(np.float64(points)[:, None], matrix)[:, 0]

    def moved(at: np.ndarray) -> np.ndarray:
        return cv2.remap(
            membrane.displacement_at_rest(motion), np.float32(at)[:, None], None, cv2.INTER_LINEAR
        )[:, 0]

    rows = np.loadtxt(folder / "dots.csv", delimiter=",", skiprows=1)
    untouched = rectified(folder / "dotted_ball_background.jpg")
    membrane, motion = Membrane(untouched, DotFilter(untouched).dots), None
    errors, lost = [], []
    for number in range(13, 113):
        motion = membrane.follow(membrane.picture(rectified(folder / f"{number:06d}.jpg")), motion)
        own = rows[rows[:, 0] == number]
        if number == 13:
            known = own[:, 1].astype(int).tolist()
            places = rest = mapped(own[:, 2:], flat_from_filmed)
            for _ in range(5):
                rest = places - moved(rest)
            nearest = cKDTree(membrane.rest_px).query(rest)[1]
        told = mapped(rest + moved(rest), np.linalg.inv(flat_from_filmed))
        for dot, place in zip(own[:, 1].astype(int), own[:, 2:], strict=True):
            if dot in known:
                errors.append(np.linalg.norm(told[known.index(dot)] - place))
                lost.append(not motion.found[nearest[known.index(dot)]])
    found = np.array(errors)[~np.array(lost)]
    assert np.median(found) < 0.5
    assert np.percentile(found, 95) < 2.0
    assert np.mean(lost) < 0.05
