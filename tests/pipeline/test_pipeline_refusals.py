"""Jobs that cannot be done say in one line which folder, file or frame is to blame, and what to do."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recipes.real_objects import read_capture
from tests.dome_result import DomeResult
from tests.pipeline.conftest import RESPONSE, SIZE, DomeCapture
from tests.result_files import write_mesh_sequence
from vntoolkit.__main__ import main
from vntoolkit.errors import BadCalibration, BadCapture, BadInput, BadMotion
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.geometry.motion import Motion, Skeleton
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.results.manifest import ReconstructionFolder
from vntoolkit.io.rigs import write_rig
from vntoolkit.options.calibration import LightColours
from vntoolkit.options.reconstruction import ReconstructOptions
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline import simulate
from vntoolkit.pipeline.calibrate import CalibrationJob, calibrate_lights, mean_frame
from vntoolkit.pipeline.calibrate_presses import PressJob, calibrate_presses
from vntoolkit.pipeline.dress import dress
from vntoolkit.pipeline.evaluate import (
    CylinderTruth,
    compare_normal_files,
    evaluate_tracks,
    read_object,
    read_track_truth,
    surface_errors,
)
from vntoolkit.pipeline.opened_result import read_result
from vntoolkit.pipeline.reconstruct import reconstruct
from vntoolkit.pipeline.request import Request
from vntoolkit.pipeline.simulate import SimulationFolder, SimulationJob
from vntoolkit.pipeline.tracked_folder import read_track_record, recorded_camera
from vntoolkit.pipeline.truth_comparison import compare_with_truth

TRIANGLE = Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]], dtype=np.int32))


@pytest.fixture
def result(dome_result: DomeResult, tmp_path: Path) -> Path:
    """A copy of the result that a test may spoil."""
    return Path(shutil.copytree(dome_result.folder, tmp_path / "result"))


def test_records_of_tracks_that_are_spoilt(result: Path) -> None:
    record = read_track_record(result / "track")
    assert recorded_camera(record).width == SIZE[1]
    with pytest.raises(
        BadInput, match=r"names no whole camera .* run `vntoolkit track` again, with --overwrite"
    ):
        recorded_camera({"camera": {"model": "orthographic"}})
    for content in (
        [],
        {},
        {"frames": [0]},
        {"frames": ["0"], "template": 0},
        {"frames": [0], "template": ""},
    ):
        (result / "track" / "track.json").write_text(json.dumps(content))
        with pytest.raises(BadInput, match="expected an object with frames, a list of numbers, and template"):
            read_track_record(result / "track")
    (result / "track" / "track.json").unlink()
    with pytest.raises(BadInput, match=r"holds no track\.json; give a folder that `vntoolkit track`"):
        read_track_record(result / "track")


def _write_track_truth(folder: Path, frames: int) -> None:
    truth = folder / "truth"
    corners = np.array([[-1.0, -0.8, 2.0], [1.0, -0.8, 3.0], [-1.0, 0.8, 2.0]], dtype=np.float32)
    moving = MeshSequence(
        template=Mesh(vertices=corners, faces=TRIANGLE.faces), vertices=np.repeat(corners[None], frames, 0)
    )
    write_mesh_sequence(truth, moving)
    camera = Camera.pinhole(width=SIZE[1], height=SIZE[0], focal_px=60.0)
    write_rig(truth / "rig.json", Rig(camera=camera, response=RESPONSE))


def test_tracks_and_a_truth_that_do_not_match(result, tmp_path, capsys):
    _write_track_truth(tmp_path, 2)
    with pytest.raises(BadInput, match="its frames reach 5, the truth has 2"):
        evaluate_tracks(result / "track", tmp_path)
    _write_track_truth(tmp_path / "sound", 9)
    tables = tmp_path / "tables"
    command = ["evaluate", "tracks", str(result), "--truth", str(tmp_path / "sound"), "--out", str(tables)]
    assert main(command) == 0
    assert sorted(path.name for path in tables.iterdir()) == [f"{result.name}.tsv", "tracks.png"]
    assert f"next: vntoolkit report {result}" in capsys.readouterr().out
    record = json.loads((result / "track" / "track.json").read_text())
    (result / "track" / "track.json").write_text(json.dumps(record | {"template": 77}))
    _write_track_truth(tmp_path / "long", 9)
    with pytest.raises(BadInput, match="the template frame 77 is not tracked yet"):
        evaluate_tracks(result / "track", tmp_path / "long")
    np.save(tmp_path / "truth" / "vertices.npy", np.zeros((2, 3)))
    with pytest.raises(BadInput, match=r"expected \(frames, vertices, 3\) of the mesh template\.ply"):
        read_track_truth(tmp_path)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["A", "--every", "0"], "every: expected 1 or more, got 0"),
        (["A", "--out", "text.txt"], "a file stands where a folder is needed"),
    ],
)
def test_evaluate_tracks_refuses_what_it_cannot_do(arguments, line, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.txt").write_text("")
    assert main(["evaluate", "tracks", *arguments, "--truth", str(tmp_path)]) == 1
    assert line in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["live", "--rig", "R", "--camera", "0", "--realtime"], "--realtime is for --video"),
        (["live", "--rig", "R", "--video", "F", "--size-mm", "3", "4"], "expected both --corners"),
        (["live", "--rig", "R", "--video", "F", "--size-mm", "3", "4", "--pixel-mm", "1"], "both --corners"),
        (["reconstruct", "F", "--rig", "R", "--out", "o", "--scheduler", "nowhere"], "nowhere: no Dask"),
        (["session", "F", "--rig", "R", "--out", "o", "--method", "flow"], "--method needs --track"),
    ],
)  # fmt: skip
def test_flags_that_need_each_other(arguments, line, tmp_path, dome_capture, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_rig(tmp_path / "R", dome_capture.rig)
    assert main([dome_capture.source if a == "F" else a for a in arguments]) == 1
    assert line in capsys.readouterr().err


def test_known_lights_that_make_no_rig(tmp_path: Path) -> None:
    (tmp_path / "lights.txt").write_text("0 0 1\n0 0.5 1\n0.5 0 1\n")
    job = CalibrationJob(source="")
    for chosen, line in (
        ((0, 1, 1), "expected three different lights, got 0, 1, 1"),
        ((0, 1, 3), "holds 3 lights, numbered from 0; asked for 0, 1, 3"),
        ((0, 1, 2), "the image size is not known; give footage of the rig with --like"),
    ):
        with pytest.raises(BadInput, match=line):
            calibrate_lights(tmp_path / "lights.txt", None, chosen, LightColours.CHANNELS, job)
    with pytest.raises(BadCalibration, match="the footage holds no frame"):
        mean_frame(iter(()))


def test_presses_without_labels_or_of_another_size(tmp_path: Path, dome_capture: DomeCapture) -> None:
    (tmp_path / "labels").mkdir()
    write_png(tmp_path / "gel.png", np.full((24, 32, 3), 9, np.uint8))
    given = {"background": tmp_path / "gel.png", "labels": tmp_path / "labels"}
    job = PressJob(dome_capture.source, **given, ball_radius_mm=3.0, pixel_mm=0.1)
    with pytest.raises(
        BadCalibration, match=r"no image of .* has a label in .*labels \(NAME\.txt for NAME\.jpg\)"
    ):
        calibrate_presses(job)
    (tmp_path / "labels" / "f0.txt").write_text("30 20 9")
    with pytest.raises(BadCalibration, match="the background has another size than the presses"):
        calibrate_presses(job)
    with pytest.raises(BadInput, match="label size: expected a width and height of 1 pixel or more, got 0 0"):
        replace(job, label_size=(0, 0))


def test_rectified_images_are_not_mixed_with_others(tmp_path, dome_capture, capsys):
    footage, out = tmp_path / "footage", tmp_path / "out"
    write_png(footage / "000000.png", np.full((*SIZE, 3), 90, np.uint8))
    write_png(out / "000007.png", np.full((*SIZE, 3), 9, np.uint8))
    plane = "--corners 0 0 63 0 0 47 63 47 --size-mm 6 4 --pixel-mm 0.2"
    for target, line in ((out, "holds images already, such as 000007.png"), (footage, "footage lies there")):
        assert main(f"rectify {footage} --out {target} {plane}".split()) == 1
        assert line in capsys.readouterr().err
    assert main(f"rectify {footage} --out {out} {plane} --overwrite".split()) == 0
    assert [path.name for path in out.iterdir()] == ["000000.png"]


def test_a_first_frame_that_shows_nothing_is_named(tmp_path: Path, dome_capture: DomeCapture) -> None:
    write_png(tmp_path / "dark.png", np.zeros((*SIZE, 3), np.uint8))
    job = Request(
        source=str(tmp_path / "dark.png"),
        rig=dome_capture.rig,
        options=ReconstructOptions(),
        folder=ReconstructionFolder(root=tmp_path / "out"),
    )
    with pytest.raises(BadCapture, match=r"dark\.png"):
        reconstruct(job)


def test_simulations_of_what_cannot_be_filmed(tmp_path: Path) -> None:
    job = SimulationJob(scene="sphere", folder=SimulationFolder(root=tmp_path))
    (tmp_path / "capture.mkv").write_bytes(b"0")
    with pytest.raises(
        BadInput, match=r"holds capture\.mkv, which `vntoolkit simulate` did not write; choose"
    ):
        simulate.simulate(job)
    (tmp_path / "simulation.json").write_bytes(b"\xff\xfe")
    with pytest.raises(BadInput, match=r"simulation\.json: expected a JSON file; byte 0 is no text in UTF-8"):
        simulate.simulate(job)


def test_truth_that_is_not_there_or_of_another_scene(result: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="the simulated capture holds no truth for frame 0"):
        list(compare_with_truth(read_result(result), tmp_path))
    truth = CylinderTruth(folder=SimulationFolder(root=tmp_path))
    (tmp_path / "truth").mkdir()
    for name, text, line in (
        ("scene.json", "{", "but this is not JSON"),
        ("scene.json", "[]", "expected scene, and facts with the radius_m of a cylinder"),
        ("scene.json", '{"scene": "cylinder", "facts": {}}', "expected scene, and facts with the radius_m"),
        ("poses.json", "{}", "expected camera_from_object, a 4 × 4 matrix a frame"),
        ("poses.json", '{"camera_from_object": [1]}', "expected shape any × 4 × 4, got 1"),
    ):
        (tmp_path / "truth" / name).write_text(text)
        with pytest.raises(BadInput, match=line):
            _ = truth.radius_m if name == "scene.json" else truth.poses
    (tmp_path / "truth" / "poses.json").write_text(json.dumps({"camera_from_object": [np.eye(4).tolist()]}))
    with pytest.raises(BadInput, match="has 1 frames, the reconstruction frame 3"):
        truth.axis(3)


def test_objects_with_depth_that_are_spoilt(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="surfaces of at least 16 pixels, got 8"):
        next(surface_errors(8))
    with pytest.raises(BadInput, match="no pair of maps was given"):
        compare_normal_files([])
    white = np.full((4, 5), 255, np.uint8)
    write_png(tmp_path / "mask.png", white)
    write_png(tmp_path / "normal_map.png", np.dstack([white // 2, white // 2, white]))
    (tmp_path / "K.txt").write_text("1 0 0 0 1 0")
    with pytest.raises(BadInput, match="3 × 3 camera matrix, got 6 words"):
        read_object(tmp_path)
    (tmp_path / "K.txt").write_text("9 0 2\n0 9 2\n0 0 1")
    (tmp_path / "depth_gt.npz").write_bytes(b"PK\3\4")
    with pytest.raises(BadInput, match=r"depth_gt\.npz: is not a whole \.npz archive"):
        read_object(tmp_path)
    np.savez(tmp_path / "depth_gt.npz", depth_gt=np.ones((9, 9)))
    with pytest.raises(BadInput, match="is 9×9 but the mask is 5×4: they must have one size"):
        read_object(tmp_path)


def test_captures_with_a_reference_that_are_unknown_or_cut_off(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="capture 'cheese': expected one of"):
        read_capture(tmp_path, "cheese")


def test_garments_and_motions_that_cannot_be_joined() -> None:
    skeleton = Skeleton(names=("hips",), parents=np.array([-1]), offsets=np.zeros((1, 3)))
    still = Motion(
        skeleton=skeleton,
        rotations=np.array([[[0, 0, 0, 1.0]]]),
        root_positions=np.zeros((1, 3)),
        frame_rate_hz=30.0,
    )
    cloth = MeshSequence(template=TRIANGLE, vertices=np.zeros((0, 3, 3), np.float32))
    with pytest.raises(BadMotion, match="the skeleton has no height, so its scale cannot be guessed"):
        dress(cloth, still)
    tall = Motion(**{**still.__dict__, "metres_per_unit": 1.0})
    with pytest.raises(BadInput, match="the garment has no frame"):
        dress(cloth, tall)
