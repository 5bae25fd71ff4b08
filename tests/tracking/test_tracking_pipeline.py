"""`track` on a folder: resuming to the same bytes, any template frame, gaps, one line for bad input."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.each_step import EachStep
from tests.tracking.wrinkled_video import WrinkledVideo
from vntoolkit.errors import BadInput
from vntoolkit.io.maps_and_meshes.label_images import write_labels
from vntoolkit.io.maps_and_meshes.maps import write_depth_map, write_normal_map
from vntoolkit.io.results.manifest import InputEntry, Manifest, ReconstructionFolder, read_manifest
from vntoolkit.io.results.reconstruction import write_manifest
from vntoolkit.io.results.seams import read_seams, write_seams
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.io.rigs import entry_from_rig
from vntoolkit.options.tracking import TrackArguments, Tracker
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.checkerboard import write_checkerboard
from vntoolkit.pipeline.track import track
from vntoolkit.progress import heard_by

FRAMES = 8


@pytest.fixture(scope="module")
def video() -> WrinkledVideo:
    return WrinkledVideo(width=96, height=72, sway_px=2.0)


@pytest.fixture
def folder(video: WrinkledVideo, tmp_path: Path) -> Path:
    for k in range(FRAMES):
        normals, depth = video.maps(k)
        write_normal_map(tmp_path / f"normals/{k:06d}.exr", normals)
        write_depth_map(tmp_path / f"depth/{k:06d}.exr", depth)
    source = InputEntry(source="x", files=[], width=96, height=72, frame_count=FRAMES, frame_rate_hz=60.0)
    response = LightResponse(matrix=np.diag([0.5, 0.5, -0.5]), ambient=np.zeros(3))
    rig = entry_from_rig(Rig(camera=video.camera, response=response))
    write_manifest(tmp_path, Manifest(input=source, rig=rig))
    return tmp_path


def job(folder: Path, **more: object) -> TrackArguments:
    return TrackArguments(folder, **more)


@pytest.mark.parametrize("template", [0, 3, 7])
def test_any_frame_can_be_the_template(folder: Path, video: WrinkledVideo, template: int) -> None:
    summary = track(job(folder, template=template))
    sequence = read_mesh_sequence(folder / "track")
    assert (summary.frames, len(sequence)) == (FRAMES, FRAMES)
    start = video.camera.project(np.array(sequence.vertices[template]))
    material = video.material(start, template)
    inside = np.all((material > 16) & (material < [80, 56]), axis=1)
    for k in range(FRAMES):
        ended = video.camera.project(np.array(sequence.vertices[k]))
        assert np.median(np.linalg.norm(ended - video.warp(material, k), axis=1)[inside]) < 0.1


@pytest.mark.parametrize("killed", [False, True])
@pytest.mark.parametrize("stop_after", [2, 5])
def test_an_interrupted_run_ends_in_the_same_bytes(folder: Path, stop_after: int, killed: bool) -> None:
    """One that was killed has no memory of its last frames, and does them again."""

    def interrupt() -> None:
        left.pop()
        if not left:
            raise KeyboardInterrupt

    track(job(folder, template=3, out=folder / "whole"))
    left = [None] * stop_after
    with pytest.raises(KeyboardInterrupt), heard_by(EachStep(interrupt)):
        track(job(folder, template=3, out=folder / "parts"))
    memories = list((folder / "parts").rglob("remembered.npz"))
    assert memories
    for memory in memories if killed else ():
        memory.unlink()
    summary = track(job(folder, template=3, out=folder / "parts"))
    assert (summary.resumed > 0) is not (killed and stop_after == 2)
    for name in ("vertices.npy", "uncertainty_px.npy"):
        assert (folder / "parts" / name).read_bytes() == (folder / "whole" / name).read_bytes()
    assert not (folder / "parts" / "backwards").exists()


def test_a_missing_frame_is_held_and_tracking_goes_on(folder: Path, video: WrinkledVideo) -> None:
    (folder / "normals/000004.exr").unlink()
    summary = track(job(folder))
    sequence = read_mesh_sequence(folder / "track")
    assert summary.missing == (4,)
    np.testing.assert_array_equal(sequence.vertices[4], sequence.vertices[3])
    assert np.isinf(sequence.uncertainty_px[4]).all()
    assert np.median(sequence.uncertainty_px[7]) < 1.0


def test_without_the_footage_it_says_that_paint_is_not_tracked(folder, caplog):
    track(TrackArguments(folder, method=Tracker.FLOW))
    assert "paint" not in caplog.text  # a published method reads none
    track(job(folder, overwrite=True))
    assert "tracking uses relief and shape, not the colours of the surface: " in caplog.text
    assert "give --footage" in caplog.text


def test_a_single_frame_gives_a_sequence_of_one(folder: Path) -> None:
    for k in range(1, FRAMES):
        (folder / f"depth/{k:06d}.exr").unlink()
    assert track(job(folder)).frames == 1
    assert len(read_mesh_sequence(folder / "track")) == 1


def test_other_options_are_not_mixed_in(folder: Path) -> None:
    track(job(folder))
    other = TrackArguments(folder, method=Tracker.FLOW)
    with pytest.raises(BadInput, match=r"tracks made differently: options\.method .* add --overwrite"):
        track(other)
    assert track(dataclasses.replace(other, overwrite=True)).resumed == 0


@pytest.mark.parametrize("kind", ["normals", "depth", "shadows"])
def test_a_file_of_another_size_is_refused_by_name(folder: Path, kind: str) -> None:
    normal_map, depth_map = WrinkledVideo(width=48, height=36, sway_px=1.0).maps(4)
    path = ReconstructionFolder(root=folder).file(kind, 4)
    path.parent.mkdir(exist_ok=True)
    if kind == "normals":
        write_normal_map(path, normal_map)
    elif kind == "depth":
        write_depth_map(path, depth_map)
    else:
        write_labels(path, np.full(normal_map.shape, 7, dtype=np.uint8))
    with pytest.raises(BadInput, match=rf"{path.name}: 48×36 pixels, but the camera has 96×72"):
        track(job(folder))


def test_tracks_of_another_reconstruction_are_not_mixed_in(folder: Path) -> None:
    track(job(folder))
    manifest = read_manifest(folder)
    again = manifest.model_copy(update={"input": manifest.input.model_copy(update={"source": "../x"})})
    write_manifest(folder, again)  # the same footage, named from elsewhere
    assert track(job(folder)).resumed == FRAMES
    brighter = manifest.model_copy(update={"options": {"inversion.relative_albedo": 1.5}})
    write_manifest(folder, brighter)
    with pytest.raises(BadInput, match="tracks made differently: normals and depth; add --overwrite"):
        track(job(folder))
    assert track(job(folder, overwrite=True)).resumed == 0


def test_a_refused_command_leaves_the_old_tracks(folder: Path) -> None:
    track(job(folder))
    before = (folder / "track/vertices.npy").read_bytes()
    seams = folder / "seams.json"
    seams.write_text('{"seams": [[[0, 0]]]}')
    with pytest.raises(BadInput, match="seam 0: expected two points"):
        track(job(folder, seams=seams, overwrite=True))
    assert (folder / "track/vertices.npy").read_bytes() == before


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_moving_mesh_that_track_did_not_write_is_left_alone(folder: Path, overwrite: bool) -> None:
    track(job(folder))
    foreign = Path(shutil.copytree(folder / "track", folder / "truth"))
    (foreign / "track.json").unlink()  # as `simulate` writes it
    before = {path.name: path.read_bytes() for path in foreign.iterdir()}
    with pytest.raises(BadInput, match=r"holds vertices\.npy, which `vntoolkit track` did not write; choose"):
        track(job(folder, out=foreign, overwrite=overwrite))
    assert {path.name: path.read_bytes() for path in foreign.iterdir()} == before


def test_bad_input_is_one_line(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"--template 99: that frame is not in .* it holds 0 to 7"):
        track(job(folder, template=99))
    shutil.rmtree(folder / "depth")
    with pytest.raises(BadInput, match="no frame has both normals and depth"):
        track(job(folder))
    seams = tmp_path / "seams.json"
    seams.write_text(json.dumps({"seams": [[[1, 2]]]}))
    with pytest.raises(BadInput, match="seam 0: expected two points"):
        read_seams(seams)
    seams.write_text("{")
    with pytest.raises(BadInput, match="is not JSON"):
        read_seams(seams)
    seams.write_text(json.dumps({"seams": [[[1, 2], [3, 4.5]]]}))
    np.testing.assert_array_equal(read_seams(seams)[0], [[1, 2], [3, 4.5]])
    write_seams(seams, [np.array([[1.0, 2.0], [3.25, 4.5]])])
    np.testing.assert_array_equal(read_seams(seams)[0], [[1, 2], [3.25, 4.5]])


def test_the_checkerboard_is_drawn_on_every_frame(folder: Path) -> None:
    track(job(folder))
    write_checkerboard(folder)
    assert (folder / "track/checkerboard.mkv").stat().st_size > 1000
    assert (folder / "track/checkerboard.png").exists()
