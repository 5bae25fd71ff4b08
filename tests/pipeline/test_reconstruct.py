"""Footage to files: right values, the same bytes whatever the workers, and no loss when interrupted."""

import hashlib
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.each_step import EachStep
from tests.pipeline.conftest import DomeCapture
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.maps import read_depth_map, read_normal_map
from vntoolkit.io.maps_and_meshes.masks import write_mask
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.results.frame_log import FrameLog
from vntoolkit.io.results.manifest import ReconstructionFolder, read_manifest
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import OnError, Product, ReconstructOptions
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.rig import FitQuality
from vntoolkit.pipeline.frame_processor import Carried, FrameProcessor
from vntoolkit.pipeline.reconstruct import blocks_of, reconstruct
from vntoolkit.pipeline.request import Request
from vntoolkit.progress import heard_by


def job_of(capture: DomeCapture, out: Path, **options: object) -> Request:
    return Request(
        source=capture.source,
        rig=capture.rig,
        options=ReconstructOptions(**{"shadows": ShadowMethod.NONE, **options}),
        folder=ReconstructionFolder(root=out),
    )


def digest(folder: Path) -> dict[str, str]:
    """SHA-256 of every result file; the manifest and the log carry times."""
    files = sorted(path for path in folder.rglob("*") if path.suffix in (".exr", ".ply", ".png"))
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def whole_run(dome_capture: DomeCapture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    reconstruct(job_of(dome_capture, out))
    return out


@pytest.mark.parametrize("shadows", [ShadowMethod.NONE, ShadowMethod.ROBUST])
def test_a_frame_of_another_size_than_the_rigs_is_refused(dome_capture: DomeCapture, shadows) -> None:
    processor = FrameProcessor(dome_capture.rig, ReconstructOptions(shadows=shadows))
    frame = EncodedFrame(values=np.zeros((50, 64, 3), np.uint8), bits=8, number=0, name="a.png")
    for work in (processor.process, partial(processor.set_reference, Carried())):
        with pytest.raises(BadInput, match=r"a\.png: expected shape 48 × 64 × 3, got 50 × 64 × 3"):
            work(frame)


def test_normals_depth_and_mesh_are_those_of_the_dome(dome_capture: DomeCapture, whole_run: Path) -> None:
    number = 7
    normal_map = read_normal_map(whole_run / f"normals/{number:06d}.exr")
    mask = dome_capture.masks[number]
    assert np.array_equal(normal_map.mask, mask)
    angles = angles_deg(normal_map.normals_in_camera[mask], dome_capture.normals[number][mask])
    assert angles.max() < 0.1  # half floats are exact to 0.03 degrees, 16-bit samples to less
    depth_map = read_depth_map(whole_run / f"depth/{number:06d}.exr")
    truth = 40 * dome_capture.normals[number][..., 2][mask]  # a sphere's z is its radius times n_z
    error = depth_map.depth[mask] - truth
    assert np.abs(error - error.mean()).max() < 0.01 * np.ptp(truth)
    mesh = read_mesh(whole_run / f"mesh/{number:06d}.ply")
    assert len(mesh.vertices) == mask.sum()
    assert np.median(mesh.normals[:, 2]) < -0.8


def test_the_manifest_tells_what_was_done(dome_capture: DomeCapture, whole_run: Path) -> None:
    manifest = read_manifest(whole_run)
    assert manifest.outputs == ["normals", "depth", "mesh"]
    assert manifest.input.frame_count == len(dome_capture.normals) == len(manifest.input.files)
    assert manifest.known.relative_albedo == pytest.approx(1, abs=0.01)
    assert manifest.finished


@pytest.mark.parametrize("jobs", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_bytes_do_not_depend_on_the_workers(dome_capture, whole_run, tmp_path, jobs):
    reconstruct(job_of(dome_capture, tmp_path), jobs=jobs)
    assert digest(tmp_path) == digest(whole_run)


@pytest.mark.parametrize("stop_after", [0, 5, 17])
def test_an_interrupted_run_goes_on_and_ends_the_same(dome_capture, whole_run, tmp_path, stop_after):
    seen: list[int] = []

    def interrupt() -> None:
        seen.append(1)
        if len(seen) > stop_after:
            raise KeyboardInterrupt

    again = pytest.raises(KeyboardInterrupt, match="run the same command again")
    with again, heard_by(EachStep(interrupt)):
        reconstruct(job_of(dome_capture, tmp_path))
    summary = reconstruct(job_of(dome_capture, tmp_path))
    assert summary.resumed >= stop_after
    assert summary.resumed + summary.done == 20
    assert digest(tmp_path) == digest(whole_run)


def test_blocks_are_of_consecutive_frames() -> None:
    assert blocks_of(range(3, 40, 2)) == [range(3, 34, 2), range(35, 40, 2)]
    assert blocks_of(range(17)) == [range(16), range(16, 17)]
    assert blocks_of([0, 1, 2, 6, 8, 10]) == [range(3), range(6, 11, 2)]


def test_a_deleted_result_is_made_again(dome_capture: DomeCapture, whole_run: Path, tmp_path: Path) -> None:
    reconstruct(job_of(dome_capture, tmp_path))
    (tmp_path / "depth/000003.exr").unlink()
    assert reconstruct(job_of(dome_capture, tmp_path)).done == 1
    assert digest(tmp_path) == digest(whole_run)


def test_a_run_can_go_further_than_the_one_before(dome_capture: DomeCapture, tmp_path: Path) -> None:
    frames = FrameRange.from_text("2:12:3")
    reconstruct(job_of(dome_capture, tmp_path, to=Product.NORMALS), frames=frames)
    assert not (tmp_path / "depth").exists()
    reconstruct(job_of(dome_capture, tmp_path, to=Product.DEPTH), frames=frames)
    assert [path.stem for path in sorted((tmp_path / "depth").iterdir())] == [
        "000002", "000005", "000008", "000011",
    ]  # fmt: skip


def test_other_options_are_not_mixed_in(dome_capture: DomeCapture, tmp_path: Path) -> None:
    frames = FrameRange.from_text("0:2")
    reconstruct(job_of(dome_capture, tmp_path), frames=frames)
    changed = job_of(dome_capture, tmp_path)
    changed = replace(
        changed,
        options=replace(changed.options, meshing=replace(changed.options.meshing, stride=2)),
    )
    with pytest.raises(BadInput, match=r"meshing\.stride \(1 → 2\).*--overwrite"):
        reconstruct(changed, frames=frames)
    small = len(read_mesh(tmp_path / "mesh/000000.ply").vertices)
    reconstruct(changed, frames=frames, overwrite=True)
    assert len(read_mesh(tmp_path / "mesh/000000.ply").vertices) < 0.3 * small


@pytest.mark.parametrize("mistake", ["mask", "reference", "dark"])
def test_a_refused_command_leaves_the_old_result_and_makes_no_folder(dome_capture, tmp_path, mistake):
    frames, out = FrameRange.from_text("0"), tmp_path / "out"
    reconstruct(job_of(dome_capture, out), frames=frames)
    before = digest(out)
    write_mask(tmp_path / "small.png", np.ones((5, 5), bool))
    write_png(tmp_path / "dark.png", np.zeros((48, 64, 3), np.uint8))
    wrong = {
        "mask": replace(job_of(dome_capture, out), mask=tmp_path / "small.png"),
        "reference": job_of(dome_capture, out, reference_frame=99),
        "dark": replace(job_of(dome_capture, out), source=str(tmp_path / "dark.png")),
    }[mistake]
    with pytest.raises(BadInput, match=r"mask is 5×5|has only 20 frames|dark\.png"):
        reconstruct(wrong, frames=frames, overwrite=True)
    assert digest(out) == before
    elsewhere = replace(wrong, folder=ReconstructionFolder(root=tmp_path / "new"))
    with pytest.raises(BadInput):
        reconstruct(elsewhere, frames=frames)
    assert not (tmp_path / "new").exists()


def test_a_mask_is_obeyed(dome_capture: DomeCapture, tmp_path: Path) -> None:
    mask = np.zeros((48, 64), bool)
    mask[20:30, 25:40] = True
    write_mask(tmp_path / "mask.png", mask)
    job = replace(job_of(dome_capture, tmp_path / "out"), mask=tmp_path / "mask.png")
    reconstruct(job, frames=FrameRange.from_text("0"))
    assert np.array_equal(read_normal_map(tmp_path / "out/normals/000000.exr").mask, mask)


def footage_with_specks(capture: DomeCapture, tmp_path: Path) -> DomeCapture:
    """Return four frames of a capture; of the third only single pixels are left, which make no mesh."""
    folder = tmp_path / "footage"
    folder.mkdir()
    for number in range(4):
        picture = open_capture(Path(capture.source) / f"f{number}.png").encoded(0).values.copy()
        if number == 2:
            v, u = np.indices(picture.shape[:2])
            picture[(v % 3 > 0) | (u % 3 > 0)] = 0
        write_png(folder / f"f{number}.png", picture)
    return replace(capture, source=str(folder))


def test_a_failing_frame_stops_the_run_with_its_name(dome_capture: DomeCapture, tmp_path: Path) -> None:
    specks = footage_with_specks(dome_capture, tmp_path)
    with pytest.raises(BadMesh, match="no three neighbouring"):
        reconstruct(job_of(specks, tmp_path / "out"))


def test_or_it_is_skipped_and_named(dome_capture: DomeCapture, tmp_path: Path) -> None:
    out, specks = tmp_path / "out", footage_with_specks(dome_capture, tmp_path)
    summary = reconstruct(job_of(specks, out, on_error=OnError.SKIP))
    assert [record.number for record in summary.skipped] == [2]
    assert summary.done == 3
    assert not (out / "normals/000002.exr").exists()
    entries = FrameLog(out).entries()
    assert "no three neighbouring" in entries[2].failure
    assert [finding.frame for finding in read_manifest(out).findings] == [2]
    assert entries[3].valid_share == pytest.approx(dome_capture.masks[3].mean(), abs=1e-5)


def test_the_run_tells_the_expected_error_and_warns_where_it_is_large(dome_capture, tmp_path, caplog):
    summary = reconstruct(job_of(dome_capture, tmp_path / "good"), frames=FrameRange.from_text("0:3"))
    assert not caplog.records
    maps = [read_normal_map(tmp_path / f"good/normals/{n:06d}.exr") for n in range(3)]
    medians = [np.median(m.error_deg[::4, ::4][m.mask[::4, ::4]]) for m in maps]
    assert summary.error_deg == pytest.approx(max(medians), abs=0.05)  # EXR holds half floats
    assert read_manifest(tmp_path / "good").error_deg == summary.error_deg
    dull = FitQuality(method="sphere", residual_deg=40.0, condition_number=2.0, samples=100, cone_deg=60.0)
    rig = replace(dome_capture.rig, quality=dull)
    worse = replace(job_of(dome_capture, tmp_path / "bad"), rig=rig, allow=("residual",))
    summary = reconstruct(worse, frames=FrameRange.from_text("0:3"))
    assert summary.error_deg is not None
    assert summary.error_deg > 20
    assert [r.message for r in caplog.records if "the expected error of the normals" in r.message]
    kept = read_manifest(tmp_path / "bad").findings
    assert any("the expected error of the normals" in finding.text for finding in kept)


def test_a_distance_under_an_orthographic_camera_is_said_to_change_nothing(dome_capture, tmp_path) -> None:
    job = job_of(dome_capture, tmp_path, distance_m=5.0)
    reconstruct(job, frames=FrameRange.from_text("0:1"))
    (said,) = [f.text for f in read_manifest(tmp_path).findings if "--distance" in f.text]
    assert "changes nothing" in said
    assert "--focal-px" in said


def test_refusals(dome_capture: DomeCapture, tmp_path: Path) -> None:
    job = job_of(dome_capture, tmp_path)
    with pytest.raises(BadInput, match="jobs: expected 1 or more"):
        reconstruct(job, jobs=0)


def test_a_gel_is_neither_matched_nor_searched_for_shadows(dome_capture: DomeCapture, tmp_path: Path) -> None:
    quality = FitQuality(method="presses", residual_deg=7.0, condition_number=5.0, samples=100, cone_deg=40.0)
    job = job_of(dome_capture, tmp_path / "gel", to=Product.NORMALS)
    reconstruct(replace(job, rig=replace(job.rig, quality=quality)), frames=FrameRange.from_text("0"))
    manifest = read_manifest(tmp_path / "gel")
    assert manifest.options["shadows"] == "none"
    assert manifest.options["materials"] == "calibrated"
    assert not (tmp_path / "gel" / "shadows").exists()
