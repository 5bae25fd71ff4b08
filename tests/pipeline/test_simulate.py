"""`simulate` on disk: what the folder holds, resuming, the same bytes whoever renders, refusals."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.each_step import EachStep
from tests.result_files import read_flow
from vntoolkit.__main__ import main
from vntoolkit.errors import BadInput, BadMesh, BadMotion
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.maps_and_meshes.label_images import read_labels
from vntoolkit.io.maps_and_meshes.maps import read_depth_map, read_normal_map
from vntoolkit.io.maps_and_meshes.masks import read_mask
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.io.rigs import read_rig
from vntoolkit.options.simulation import Lighting, Nuisances, RenderOptions, SceneOptions
from vntoolkit.pipeline.simulate import SimulationFolder, SimulationJob, simulate
from vntoolkit.progress import heard_by
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

SIZE = SceneOptions(width=96, height=72)


def job_in(root: Path, **changes) -> SimulationJob:
    job = SimulationJob(
        scene="board",
        folder=SimulationFolder(root=root),
        options=SIZE,
        rendering=RenderOptions(samples=1),
        frames=FrameRange.from_text("10:40:10"),
    )
    return replace(job, **changes)


def bytes_in(root: Path) -> dict[str, str]:
    files = sorted(path for path in root.rglob("*") if path.is_file())
    return {str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    root = tmp_path_factory.mktemp("board")
    assert simulate(job_in(root)) == 3
    return root


def test_the_folder_holds_capture_and_truth(capture):
    scene = build_scene("board", SIZE)
    expected = render_frame(scene, 20, options=RenderOptions(samples=1))
    rig = read_rig(capture / "truth/rig.json")
    film = open_capture(capture / "capture.mkv", CaptureOptions(transfer=rig.transfer))
    assert (film.info.frame_count, film.info.frame_rate_hz) == (3, 6.0)
    rig.require_size(film.info.width, film.info.height, "capture")
    assert np.array_equal(film.frame(1).rgb, expected.linear.rgb)
    truth, name = capture / "truth", "000001"
    normals = read_normal_map(truth / f"normals/{name}.exr")
    assert np.array_equal(normals.mask, expected.truth.normals.mask)
    assert np.abs(normals.normals_in_camera - expected.truth.normals.normals_in_camera).max() < 1e-3
    depth = read_depth_map(truth / f"depth/{name}.exr")
    assert np.abs(depth.depth - expected.truth.depth.depth).max() < 1e-5
    assert depth.unit is expected.truth.depth.unit
    assert np.array_equal(read_mask(truth / f"mask/{name}.png"), depth.mask)
    assert np.array_equal(read_labels(truth / f"visibility/{name}.png"), expected.truth.labels)
    sequence = read_mesh_sequence(truth)
    assert np.allclose(sequence.vertices[1], scene.vertices(20), atol=1e-6)
    poses = json.loads((truth / "poses.json").read_text())["camera_from_object"]
    assert np.allclose(poses[1], scene.camera_from_object(20).matrix)
    assert len(json.loads((truth / "lights.json").read_text())["lights"]) == 3
    assert (capture / "contact_sheet.png").stat().st_size > 1000
    assert not (capture / ".frames").exists()


def test_flow_leads_to_the_next_filmed_frame(capture):
    """Ten scene frames lie between two of the film; the flow spans them all."""
    scene = build_scene("board", SIZE)
    flow = read_flow(capture / "truth/flow/000000.exr")
    mask = read_mask(capture / "truth/mask/000000.png")
    assert np.array_equal(np.isfinite(flow).all(axis=2), mask)
    points = scene.camera.points_from_depth(read_depth_map(capture / "truth/depth/000000.exr").depth)
    moved = scene.camera_from_object(20) @ scene.camera_from_object(10).inverse()
    expected = scene.camera.project(moved.apply(points[mask])) - scene.camera.pixel_grid()[mask]
    assert np.linalg.norm(expected, axis=1).max() > 3
    assert np.abs(flow[mask] - expected).max() < 0.05
    assert not (capture / "truth/flow/000002.exr").exists()


def test_an_interrupted_run_goes_on_to_the_same_bytes(capture, tmp_path):
    class Stop(Exception):
        pass

    def stop_after_the_first() -> None:
        raise Stop

    with pytest.raises(Stop), heard_by(EachStep(stop_after_the_first)):
        simulate(job_in(tmp_path))
    assert not (tmp_path / "capture.mkv").exists()
    assert simulate(job_in(tmp_path)) == 2
    assert bytes_in(tmp_path) == bytes_in(capture)
    assert simulate(job_in(tmp_path)) == 0


@pytest.mark.slow
def test_two_processes_write_the_same_bytes_as_one(capture, tmp_path):
    simulate(job_in(tmp_path), jobs=2)
    assert bytes_in(tmp_path) == bytes_in(capture)


def test_another_capture_in_the_folder_is_kept_unless_told(tmp_path):
    frames = FrameRange.from_text("0")
    simulate(job_in(tmp_path, frames=frames))
    other = job_in(tmp_path, frames=frames, nuisances=Nuisances(bits=12, transfer="srgb"))
    with pytest.raises(BadInput, match="holds a capture made differently: "):
        simulate(other)
    (tmp_path / "truth/mine.txt").write_text("")
    simulate(other, overwrite=True)
    film = open_capture(
        tmp_path / "capture.mkv", CaptureOptions(transfer=read_rig(tmp_path / "truth/rig.json").transfer)
    )
    assert film.info.bits == 16
    assert len(np.unique(film.frame(0).rgb)) < 4096


def test_a_white_light_alone_gives_lights_but_no_rig(tmp_path):
    options = replace(SIZE, lighting=Lighting.WHITE_2)
    simulate(job_in(tmp_path, options=options, frames=FrameRange.from_text("0")))
    assert not (tmp_path / "truth/rig.json").exists()
    (light,) = json.loads((tmp_path / "truth/lights.json").read_text())["lights"]
    assert light["label_bit"] == 1
    assert set(np.unique(read_labels(tmp_path / "truth/visibility/000000.png"))) <= {0, 2}


def test_a_motion_file_moves_the_mesh_or_is_refused(tmp_path):
    still = build_scene("sphere", SIZE).vertices(0)
    np.save(tmp_path / "m.npy", np.stack([still, still + np.array([0.01, 0, 0])]).astype(np.float32))
    job = job_in(tmp_path / "out", scene="sphere", motion=tmp_path / "m.npy", frames=FrameRange())
    assert simulate(job) == 2
    flow = read_flow(tmp_path / "out/truth/flow/000000.exr")
    depth = read_depth_map(tmp_path / "out/truth/depth/000000.exr")
    expected = 0.01 * job.built.camera.matrix[0, 0] / depth.depth[depth.mask]
    assert flow[depth.mask] == pytest.approx(np.stack([expected, 0 * expected], axis=1), abs=1e-3)
    assert not (tmp_path / "out/truth/poses.json").exists()
    np.save(tmp_path / "m.npy", np.stack([still, still]).astype(np.float32))
    with pytest.raises(BadInput, match="holds a capture made differently: "):  # of the same name
        simulate(job_in(tmp_path / "out", scene="sphere", motion=tmp_path / "m.npy", frames=FrameRange()))
    np.save(tmp_path / "m.npy", np.zeros((2, 7, 3), np.float32))
    with pytest.raises(BadMesh, match="another topology"):
        simulate(replace(job, folder=SimulationFolder(root=tmp_path / "b")))
    np.save(tmp_path / "m.npy", np.zeros((2, 7), np.float32))
    with pytest.raises(BadMotion, match=r"expected floating point vertices \(frames, n, 3\)"):
        simulate(replace(job, folder=SimulationFolder(root=tmp_path / "b")))


def test_command_line_renders_and_refuses_in_one_line(tmp_path, capsys):
    line = ["simulate", "sphere", "--frames", "0:2", "--size", "64x48", "--samples", "1", "--no-noise"]
    assert main([*line, "--out", str(tmp_path / "a")]) == 0
    assert "2 frames of sphere" in capsys.readouterr().out
    assert main([*line, "--jobs", "0", "--out", str(tmp_path / "b")]) == 1
    error = capsys.readouterr().err
    assert "jobs: expected at least 1 process, got 0" in error
    assert error.count("\n") == 1
