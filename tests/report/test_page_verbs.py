"""The verbs report, view --html and export, from the command line to the file."""

import shlex

import pytest

from vntoolkit.__main__ import main


def test_report_names_its_page(dome_result, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert main(["report", str(dome_result.folder), "--out", str(page), "--samples", "1"]) == 0
    after = f"next: vntoolkit export {dome_result.folder} --to usd"
    assert capsys.readouterr().out.splitlines() == [str(page), after]
    assert page.read_text().startswith("<!DOCTYPE html>")


def test_view_writes_the_page_that_it_is_asked_for(dome_result, tmp_path, capsys):
    page = tmp_path / "scene.html"
    flags = ["--html", str(page), "--frames", "1:3", "--vertices", "100"]
    assert main(["view", str(dome_result.folder), *flags]) == 0
    told = capsys.readouterr().out
    assert "2 frames" in told
    assert f"next: vntoolkit report {dome_result.folder}" in told
    assert page.stat().st_size < 200_000


def test_export_says_where_it_went(dome_result, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda program: program)
    out = tmp_path / "a.usdc"
    flags = ["--to", "usd", "--units", "mm", "--scale", "0.01", "--up", "z", "--frames", "0:2"]
    assert main(["export", str(dome_result.folder), "--out", str(out), *flags]) == 0
    line, after = capsys.readouterr().out.splitlines()
    assert line == f"{out}: 2 frames of the tracked mesh"
    program, flag, script = shlex.split(after.removeprefix("next: "))
    assert (program, flag) == ("blender", "--python-expr")
    assert f"usd_import(filepath='{out}')" in script
    assert out.read_bytes()[:8] == b"PXR-USDC"
    monkeypatch.setattr("shutil.which", lambda program: None)
    assert main(["export", str(dome_result.folder), "--out", str(out), *flags, "--overwrite"]) == 0
    assert f"next: open {out} in Blender (File, Import)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["export", "FOLDER", "--to", "fbx"], 'Invalid value "fbx" for --to'),
        (["export", "FOLDER", "--to", "ply", "--units", "cm"], "in pixels; give --scale METRES"),
        (["export", "FOLDER", "--to", "ply", "--frames", "90:"], "frames 90::1: the capture has only 6"),
        (["report", "NOWHERE"], "holds no reconstruction.json"),
        (["view", "FOLDER", "--port", "0"], "port: expected 1 to 65535"),
    ],
)
def test_mistakes_are_one_line(dome_result, tmp_path, capsys, words, complaint):
    places = {"FOLDER": str(dome_result.folder), "NOWHERE": str(tmp_path)}
    arguments = [places.get(word, word) for word in words]
    if words[0] == "export":
        arguments += ["--out", str(tmp_path / "out")]
    assert main(arguments) == 1
    said = capsys.readouterr().err
    assert complaint in said
    assert said.count("\n") == 1
