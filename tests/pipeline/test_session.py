"""The captures of a session: each as if alone, whatever runs beside it and whatever fails."""

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest

from tests.pipeline.conftest import write_dome_capture
from vntoolkit.__main__ import main
from vntoolkit.errors import BadInput
from vntoolkit.io.rigs import write_rig
from vntoolkit.pipeline.session import names_from_sources


@pytest.fixture
def films(tmp_path: Path) -> Path:
    """Two captures of six frames and three, a folder without an image between them, and their rig."""
    for name, count in (("take1", 6), ("take3", 3)):
        (tmp_path / name).mkdir()
        capture = write_dome_capture(tmp_path / name, count)
    (tmp_path / "take2").mkdir()
    write_rig(tmp_path / "rig.json", capture.rig)
    return tmp_path


def session(films: Path, out: Path, *more: str, takes: tuple[str, ...] = ("take1", "take2", "take3")) -> int:
    sources = " ".join(str(films / take) for take in takes)
    command = f"session {sources} --rig {films}/rig.json --out {out} --to depth --shadows none"
    return main([*command.split(), *more])


def digest(folder: Path) -> dict[str, str]:
    files = sorted([*folder.rglob("*.exr"), *folder.rglob("*.npy")])
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_every_capture_becomes_what_it_would_alone_and_a_bad_one_stops_none(films, tmp_path, capsys):
    out, alone = tmp_path / "out", tmp_path / "alone"
    assert session(films, out, "--track") == 1
    said = capsys.readouterr()
    lines = said.out.splitlines()
    assert [line.startswith(str(out / f"take{k}:")) for k, line in enumerate(lines, 1)] == [True] * 3
    assert "6 of 6 frames done" in lines[0]
    assert "vertices tracked" in lines[0]
    assert "failed: " in lines[1]
    assert "take2" in said.err
    assert "1 of 3 captures failed" in said.err
    how = f"--rig {films}/rig.json --to depth --shadows none"
    for take in ("take1", "take3"):
        assert main(f"reconstruct {films}/{take} {how} --out {alone}/{take}".split()) == 0
        assert main(["track", str(alone / take)]) == 0
        assert digest(out / take) == digest(alone / take)
        assert (out / take / "track" / "checkerboard.mkv").is_file()


def test_the_same_command_goes_on_and_overwrite_begins_again(films, tmp_path, capsys):
    out, takes = tmp_path / "out", ("take1", "take3")
    assert session(films, out, "--track", takes=takes) == 0
    before = digest(out)
    (out / "take3/depth/000001.exr").unlink()
    capsys.readouterr()
    assert session(films, out, "--track", takes=takes) == 0
    first, second, then = capsys.readouterr().out.splitlines()
    assert "0 of 6 frames done, 6 from before" in first
    assert "1 of 3 frames done, 2 from before" in second
    assert "vntoolkit " in then  # the next command
    assert digest(out) == before
    capsys.readouterr()
    assert session(films, out, "--track", "--overwrite", takes=takes) == 0
    assert "6 of 6 frames done;" in capsys.readouterr().out
    assert digest(out) == before


def test_names_are_those_of_files_and_folders(films):
    (films / "b.mkv").write_bytes(b"")
    sources = (f"{films}/take1/", str(films / "b.mkv"))
    assert names_from_sources(sources) == {"take1": sources[0], "b": sources[1]}


@pytest.mark.parametrize(
    ("sources", "line"),
    [
        (("take1", "take1/"), "both would be written into 'take1'; give one another name"),
        (("take1/f*.png",), "no such video or folder of images; a session takes these, not patterns"),
    ],
)
def test_captures_without_a_name_of_their_own_are_refused(films, sources, line):
    with pytest.raises(BadInput, match=line):
        names_from_sources(tuple(f"{films}/{source}" for source in sources))


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["take1", "--track", "--to", "normals"], "--track needs depth"),
        ([], "expected at least one video or folder of images, got none"),
    ],
)
def test_what_no_capture_could_mend_stops_before_the_first(films, capsys, monkeypatch, arguments, line):
    monkeypatch.chdir(films)
    assert main(["session", *arguments, "--rig", "rig.json", "--out", "out"]) == 1
    assert line in capsys.readouterr().err
    assert not Path("out").exists()


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_stops_before_the_first_capture(films, tmp_path, capsys):
    pytest.importorskip("distributed")
    assert session(films, tmp_path / "out", "--scheduler", "tcp://127.0.0.1:1") == 1
    assert "no Dask scheduler answers there" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_on_a_cluster_sequences_are_tracked_by_its_workers_to_the_same_bytes(films, tmp_path, capfd):
    pytest.importorskip("distributed")
    here, there = tmp_path / "here", tmp_path / "there"
    assert session(films, here, "--track") == 1
    capfd.readouterr()
    command = f"{sys.executable} -m vntoolkit session {films}/take1 {films}/take2 {films}/take3 --track"
    command += f" --rig {films}/rig.json --out {there} --to depth --shadows none --scheduler local --jobs 2"
    assert subprocess.run(command.split(), check=False).returncode
    assert capfd.readouterr().err == "vntoolkit: 1 of 3 captures failed: take2\n"  # and nothing of Dask's own
    assert digest(there) == digest(here)
    assert len(digest(there)) == 2 * (6 + 3) + 2 * 2
