"""Frames without the subject are found, kept as empty and listed; nothing is learnt from them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.pipeline.conftest import RESPONSE, RIG, SIZE, DomeCapture, dome_normals, to_normals
from tests.pipeline.test_reconstruct import digest, job_of
from vntoolkit.__main__ import main
from vntoolkit.diagnosis.inspection import inspect_capture
from vntoolkit.errors import BadCapture
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.options.tracking import TrackArguments
from vntoolkit.photometry.response import rgb_from_normals
from vntoolkit.pipeline.reconstruct import reconstruct
from vntoolkit.pipeline.track import track

LEVELS = 3  # of 255, of noise in the dark


def _film(folder: Path, shown: list[float]) -> DomeCapture:
    """Write frames of a dome, a share of which is in the picture from below, before noise of few levels."""
    folder.mkdir()
    rng = np.random.default_rng(4)
    for number, share in enumerate(shown):
        normals, mask = dome_normals(31.5)
        mask &= np.arange(SIZE[0])[:, None] >= SIZE[0] * (1 - share)
        light = np.where(mask[..., None], 255 * rgb_from_normals(normals, RESPONSE).clip(0, 1), 0)
        noise = rng.integers(0, LEVELS, (*SIZE, 3))
        write_png(folder / f"f{number:02d}.png", np.rint(np.maximum(light, noise)).astype(np.uint8))
    return DomeCapture(str(folder), RIG, [], [])


@pytest.mark.parametrize("before", [3, 8])
def test_dark_frames_before_the_subject_are_listed_and_change_no_other(tmp_path: Path, before: int) -> None:
    late = _film(tmp_path / "late", [0.0] * before + [1.0] * 5)
    reconstruct(job_of(late, tmp_path / "out"))
    found = [f for f in read_manifest(tmp_path / "out").findings if f.check == "black"]
    assert [f.level for f in found] == ["warning"]
    assert f"frames 0 to {before - 1}" in found[0].text
    later = _film(tmp_path / "later", [1.0] * 5)
    for number in range(5):  # the same noise
        (Path(later.source) / f"f{number:02d}.png").write_bytes(
            (Path(late.source) / f"f{before + number:02d}.png").read_bytes()
        )
    reconstruct(job_of(later, tmp_path / "alone"))
    alone, with_dark = digest(tmp_path / "alone"), digest(tmp_path / "out")
    assert len(with_dark) == len(alone)
    for number in range(5):
        for kind in ("normals", "depth"):
            name = f"{kind}/{{:06d}}.exr"
            assert with_dark[name.format(before + number)] == alone[name.format(number)]


def test_dim_footage_of_many_bits_shows_its_subject(tmp_path: Path) -> None:
    capture = _film(tmp_path / "footage", [1.0] * 3)
    for path in sorted(Path(capture.source).iterdir()):
        light = open_capture(path).frame(0).rgb / 200
        write_png(path, np.rint(light * 65535).astype(np.uint16))
    assert reconstruct(job_of(capture, tmp_path / "out")).done == 3


def test_a_subject_that_leaves_stops_no_run(tmp_path: Path) -> None:
    capture = _film(tmp_path / "footage", [1.0, 1.0, 1.0, 0.0, 1.0, 0.0])
    summary = reconstruct(job_of(capture, tmp_path / "out"))
    assert (summary.done, [entry.number for entry in summary.skipped]) == (4, [3, 5])
    (found,) = [f for f in read_manifest(tmp_path / "out").findings if f.check == "black"]
    assert "frames 3, 5" in found.text


def test_footage_that_never_shows_a_subject_is_refused(tmp_path: Path) -> None:
    capture = _film(tmp_path / "footage", [0.0] * 5)
    with pytest.raises(BadCapture, match="no frame shows a subject"):
        reconstruct(job_of(capture, tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_doctor_names_the_frames_and_goes_on(tmp_path: Path) -> None:
    capture = _film(tmp_path / "footage", [0.0] * 9 + [1.0] * 11 + [0.0] * 4)
    report = inspect_capture(capture.source, rig=capture.rig)
    (found,) = [f for f in report.findings if f.check == "black"]
    assert found.level.value == "warning"
    assert "frames 0 to 8, 20 to 23" in found.problem


def test_the_template_is_the_frame_that_shows_most(tmp_path: Path) -> None:
    capture = _film(tmp_path / "footage", [0.0, 0.55, 0.8, 1.0, 0.9, 0.6])
    out = tmp_path / "out"
    reconstruct(job_of(capture, out))
    job = TrackArguments(out)
    summary = track(job)
    assert summary.template == 3
    assert track(replace(job, template=2, out=tmp_path / "own")).template == 2


def test_the_command_says_which_frames_are_empty_in_one_line(tmp_path, capsys, caplog) -> None:
    capture = _film(tmp_path / "footage", [0.0] * 3 + [1.0] * 3)
    assert main(to_normals(tmp_path, capture.source)) == 0
    shown = capsys.readouterr()
    assert "3 of 6 frames done" in shown.out
    assert [r.message for r in caplog.records if r.message.startswith("frames 0 to 2 show no subject")]
    assert "skipped frame" not in shown.out
