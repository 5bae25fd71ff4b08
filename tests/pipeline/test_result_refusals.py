"""Results that cannot be opened, exported or shown say in one line why, and what to do."""

import json
import shutil
from pathlib import Path

import pytest

from tests.dome_result import DomeResult
from tests.pipeline.conftest import DomeCapture
from vntoolkit.__main__ import main
from vntoolkit.errors import BadCapture, BadInput, CannotWrite
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import LengthUnit
from vntoolkit.io.results.sequences import MeshSequenceWriter, read_mesh_sequence
from vntoolkit.live.page import LiveViewer
from vntoolkit.options.export import ExportArguments, ExportedSurface, ExportFormat, ExportOptions
from vntoolkit.options.pages import ViewerOptions
from vntoolkit.pipeline.export import export, file_lengths
from vntoolkit.pipeline.opened_result import read_result
from vntoolkit.report.result_scene import ResultViewer


@pytest.fixture
def result(dome_result: DomeResult, tmp_path: Path) -> Path:
    """A copy of the result that a test may spoil."""
    return Path(shutil.copytree(dome_result.folder, tmp_path / "result"))


def exported(folder: Path, to: ExportFormat, **options: object) -> None:
    export(ExportArguments(folder, to=to, **options))


def test_a_result_without_the_frames_asked_for(result: Path) -> None:
    with pytest.raises(BadInput, match="holds none of the frames 3:4:1; it holds 5, from 0 to 5"):
        read_result(result, frames="3")


def test_tracks_of_an_earlier_reconstruction_are_left_out(result, caplog):
    assert read_result(result).track is not None
    manifest = json.loads((result / "reconstruction.json").read_text())
    manifest["rig"]["response"]["matrix"][0][0] += 0.01  # made again, with --overwrite and another rig
    (result / "reconstruction.json").write_text(json.dumps(manifest))
    opened = read_result(result)
    assert opened.track is None
    assert f"run `vntoolkit track {result} --overwrite`" in caplog.text
    with pytest.raises(BadInput, match="holds no tracked surface; run `vntoolkit track` first"):
        exported(result, ExportFormat.PLY, mesh=ExportedSurface.TRACKED)


def test_every_verb_says_that_recorded_frames_are_gone(result, tmp_path, caplog):
    (result / "normals/000001.exr").unlink()
    (result / "normals/000002.exr").unlink()
    (result / "depth/000005.exr").unlink()
    verbs = (
        f"track {result} --out {tmp_path}/t",
        f"export {result} --to png",
        f"view {result} --html {tmp_path}/v.html --frames 0:5",
        f"report {result}",
        f"evaluate cylinder {result} --out {tmp_path}/e",
    )
    for verb in verbs:
        caplog.clear()
        main(verb.split())
        said = caplog.text
        assert said.count("frames 1 to 2 are recorded as done, but files in normals are gone") == 1, verb
        assert said.count("frame 5 is recorded as done, but files in depth are gone") == (verb[:4] != "view")
        assert "run `vntoolkit reconstruct` again: it makes what is missing" in said
    (result / "frames.log").unlink()
    main(verbs[1].split())
    assert "incomplete: frames.log is gone" in caplog.text


def test_tracks_that_end_early_are_said_to_be_incomplete(result, caplog):
    with MeshSequenceWriter(
        result / "track", read_mesh_sequence(result / "track").template, resume=True
    ) as writer:
        writer.truncate(4)
    for arguments in (["export", str(result), "--to", "glb"], ["report", str(result)]):
        caplog.clear()
        assert main(arguments) == 0
        assert caplog.text.count("track: incomplete, holds 4 of 6 frames; run") == 1


def test_a_result_whose_footage_is_another(result: Path, dome_capture: DomeCapture) -> None:
    opened = read_result(result, footage=dome_capture.source)
    with pytest.raises(
        BadInput, match=r"20 frames of 64×48, but .* from 6 of 64×48; name the footage it came"
    ):
        _ = opened.capture
    moved = read_result(result, footage=str(result / "nowhere.mkv"))
    with pytest.raises(
        BadCapture, match=r"nowhere\.mkv: no such file; if the footage has moved, give --footage"
    ):
        _ = moved.capture


def test_a_result_with_a_background_needs_it_for_diligent(result: Path) -> None:
    manifest = json.loads((result / "reconstruction.json").read_text())
    manifest["extra_files"] = {"background": {"file": "b.png", "sha256": "0" * 64}}
    (result / "reconstruction.json").write_text(json.dumps(manifest))
    with pytest.raises(BadInput, match="made with a background; give it as --background"):
        exported(result, ExportFormat.DILIGENT)


def test_exported_lengths_that_contradict_the_result() -> None:
    with pytest.raises(BadInput, match="has lengths in metres already; leave out --scale"):
        file_lengths(ExportOptions(to=ExportFormat.PLY, scale=1.0), LengthUnit.METRE)


def test_a_viewer_at_an_address_that_is_not_ours(result: Path) -> None:
    options = ViewerOptions(host="203.0.113.1")  # of a network that exists in documents only
    camera = Camera.orthographic(width=64, height=48)
    for made in (
        lambda: ResultViewer(read_result(result), options),
        lambda: LiveViewer(camera, options, figures=lambda: None),
    ):
        with pytest.raises(CannotWrite, match=r"cannot serve on 203\.0\.113\.1:\d+"):
            made()


def test_a_result_of_normals_alone_has_nothing_to_view(result: Path) -> None:
    for name in ("mesh", "depth", "track"):
        shutil.rmtree(result / name)
    with pytest.raises(BadInput, match="holds no depth to show; run `vntoolkit reconstruct --to depth`"):
        ResultViewer(read_result(result), ViewerOptions(port=18231))
