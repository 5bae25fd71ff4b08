"""What a stranger types wrongly is answered by one line: what was expected, what came, what to do."""

import numpy as np
import pytest

from vntoolkit.__main__ import main
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.rigs import write_rig
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig

MATRIX = np.array([[0.35, -0.02, -0.5], [-0.17, 0.3, -0.48], [-0.15, -0.28, -0.52]])


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a frame, its rig, a rig of another size, a text, an empty folder and one of videos."""
    folder = tmp_path_factory.mktemp("stranger")
    for name, width in (("rig.json", 40), ("other.json", 50)):
        camera = Camera.orthographic(width=width, height=30)
        write_rig(folder / name, Rig(camera=camera, response=LightResponse(matrix=MATRIX)))
    write_png(folder / "frame.png", np.full((30, 40, 3), 90, dtype=np.uint8))
    write_png(folder / "large.png", np.full((60, 80, 3), 90, dtype=np.uint8))
    for name in ("text.txt", "fake.png", "fake.ply", "fake.json", "fake.mkv", "fake.usdc"):
        (folder / name).write_text("hello, world\n")
    (folder / "empty").mkdir()
    (folder / "films").mkdir()
    (folder / "films" / "a.mkv").write_bytes(b"0")
    return folder


def line_of(command, place, capsys, monkeypatch):
    monkeypatch.chdir(place)
    assert main(command.split()) == 1
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    return captured.err.strip()


@pytest.mark.parametrize(
    ("command", "line"),
    [
        (
            "reconstruct",
            "reconstruct: SOURCE is missing (a video, an image, a folder of images, or a pattern",
        ),
        ("reconstruct frame.png", "--rig is missing (the rig.json that `vntoolkit calibrate` wrote)"),
        ("reconstruct frame.png --rig rig.json", "--out is missing (the folder to write)"),
        ("reconstruct frame.png --rig rig.json --ot out", "unknown option --ot, perhaps for --out"),
        ("reconstruct frame.png -r rig.json -o out", "unknown option -r, perhaps for --rig"),
        (
            "reconstruct frame.png --rig rig.json --out o -j 2",
            "unknown option -j: options have no short form",
        ),
        ("-v", "unknown option -v: options have no short form"),
        ("reconstruct frame.png --rig rig.json --out", "--out: expected 1 value, got none"),
        ("reconstruct frame.png rig.json --rig rig.json --out o", "one file or folder too many: 'rig.json'"),
        ("reconstruct frame.png --rig rig.json --out o --integratr poisson", "mean --integrator?"),
        ("reconstruct frame.png --rig rig.json --out o --integrator poison", 'mean "poisson"?'),
        ("reconstruct frame.png --rig rig.json --out o --jobs two", 'expected a whole number, got "two"'),
        (
            "reconstruct frame.png --rig rig.json --out o --materials blue",
            'expected auto, calibrated or a whole number, got "blue"',
        ),
        ("reconstruct frame.png --rig rig.json --out o --stride 2.9", 'expected a whole number, got "2.9"'),
        ("reconstruct frame.png --rig rig.json --out o --materials 2.5", 'a whole number, got "2.5"'),
        ("calibrate lights t.txt --out r.json --lights 0 1.2 2", 'expected a whole number, got "1.2"'),
        ("board --out b.pdf --columns 11.0", 'expected a whole number, got "11.0"'),
        ("reconstruct frame.png --rig rig.json --out o --distance far", 'expected a number, got "far"'),
        ("calibrate lights text.txt --out r.json --lights 1 2", "--lights: expected 3 values, got 2"),
        (
            "export empty",
            "--to is missing (one of ply, obj, stl, usd, glb, points, npz, diligent, png, heights,",
        ),
        ("reconstrct frame.png", 'Did you mean "reconstruct"?'),
        ("calibrate bord frame.png", 'Did you mean "board"?'),
    ],
)
def test_a_misspelt_command_is_answered_by_what_to_type(command, line, place, capsys, monkeypatch):
    said = line_of(command, place, capsys, monkeypatch)
    assert line in said
    assert said.endswith("--help` explains it")


@pytest.mark.parametrize(
    ("command", "line"),
    [
        ("simulate sphare --out o", "unknown scene 'sphare': expected one of board"),
        ("recipe run figur07", "recipe 'figur07': expected all, or one of figure02"),
        ("simulate sphere --out o --size 64", "size: expected WIDTHxHEIGHT such as 1280x720, got '64'"),
        ("simulate sphere --out o --size 99999x99999", "expected at most 200 megapixels, got 99999x99999"),
        ("evaluate tracks empty --truth empty", "empty: holds no truth; give the folder that `vntoolkit sim"),
        ("board --out b.txt", "b.txt: the board is drawn as .pdf, not '.txt'"),
        ("reconstruct frame.png --rig rig.json --out o --frames x", "frames: expected a:b:c as in 0:100:2"),
        ("reconstruct frame.png --rig rig.json --out o --frames 5:9", "the capture has only 1 frame"),
        ("reconstruct frame.png --rig rig.json --out o --transfer rec709", "expected linear, srgb, bt709"),
        ("reconstruct frame.png --rig rig.json --out o --distance -3", "expected a positive number"),
        ("track empty --refine-albedo", "--refine-albedo: was removed, since it left normals as they were"),
        # a file of another kind, or none
        ("reconstruct nothere.mkv --rig rig.json --out o", "nothere.mkv: no such file"),
        ("reconstruct empty --rig rig.json --out o", "or a pattern such as frame_%04d.png"),
        ("reconstruct films --rig rig.json --out o", "name the video, films/a.mkv"),
        ("reconstruct fake.mkv --rig rig.json --out o", "fake.mkv: cannot be opened as a video"),
        ("reconstruct fake.png --rig rig.json --out o", "is not a PNG, TIFF, JPEG, BMP, WebP or EXR image"),
        ("reconstruct f_*.png --rig rig.json --out o", "no file matches this pattern; is the folder right?"),
        ("reconstruct f_%d.png --rig rig.json --out o", "no file matches this pattern; is the folder right?"),
        ("reconstruct rig.json --rig frame.png --out o", "a rig.json of `vntoolkit calibrate`; byte"),
        ("reconstruct frame.png --rig fake.json --out o", "`vntoolkit calibrate`, but this is not JSON"),
        ("reconstruct frame.png --rig empty --out o", "empty: is a folder, expected a file"),
        ("reconstruct frame.png --rig rig.json --out text.txt", "a file stands where a folder is needed"),
        ("calibrate lights text.txt --out r.json", "expected x y z, and perhaps red green blue, per light"),
        ("calibrate lights frame.png --out r.json", "per light; byte 0 is no text in UTF-8"),
        ("evaluate mesh fake.usdc", "a mesh is read from .ply or .obj, not '.usdc'; export it as .ply"),
        ("evaluate mesh fake.ply", "fake.ply: is not a PLY file"),
        ("evaluate mesh empty", "empty: is a folder, expected a file"),
        ("dress empty --motion text.txt --out a.usdc", "no registered mesh: run `vntoolkit track empty`"),
        ("dress text.txt --motion empty --out a.usdc", "expected a folder written by `vntoolkit track`"),
        # a folder that no command wrote
        ("track empty", "holds no reconstruction.json; give a folder that `vntoolkit reconstruct` wrote"),
        ("export text.txt --to ply", "text.txt: is no folder; give a folder that `vntoolkit reconstruct`"),
        ("view nothere", "nothere: is no folder; give a folder that `vntoolkit reconstruct` wrote"),
        # an output that cannot be, told before the work
        ("calibrate sphere frame.png --out text.txt/rig.json", "a file stands where a folder is needed"),
        ("calibrate board frame.png --out rig", "rig: expected a name that ends in .json"),
        ("calibrate lights text.txt --out empty", "empty: expected a name that ends in .json"),
        ("calibrate presses empty --out rig.png --background frame.png --labels empty --ball-radius-mm 3 "
         "--pixel-mm 0.1", "rig.png: expected a name that ends in .json"),
        ("calibrate head frame.png --out r.json --mesh m.stl", "m.stl: expected a name that ends in .ply or"),
        ("calibrate head frame.png --out r.json --figure f.jpg", "f.jpg: expected a name that ends in .png"),
        ("calibrate head frame.png --out r.json --report r.pdf", "r.pdf: expected a name that ends in .html"),
        ("evaluate mesh fake.ply --out text.txt", "a file stands where a folder is needed"),
        ("evaluate normals fake.png fake.png --out text.txt", "a file stands where a folder is needed"),
        ("evaluate tracks empty --truth empty --out text.txt", "a file stands where a folder is needed"),
        ("dress nothere --motion text.txt --out a.fbx", "a.fbx: expected .usdc, .usd, .glb, or a pattern"),
        ("dress nothere --motion text.txt --out a.ply", "a.ply: expected one place for the frame number"),
        ("view empty --html v.txt", "v.txt: expected a name that ends in .html"),
        ("report empty --out text.txt/r.html", "a file stands where a folder is needed"),
        # another size
        ("reconstruct frame.png --rig other.json --out o", "is 40×30 but the rig's camera is 50×30"),
        ("reconstruct frame.png --rig rig.json --out o --mask large.png", "mask is 80×60, the capture 40×30"),
        ("reconstruct frame.png --rig rig.json --out o --background large.png", "background is 80×60, the"),
        ("evaluate normals frame.png large.png", "they must have one size"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_answered_by_what_was_expected(command, line, place, capsys, monkeypatch):
    assert line in line_of(command, place, capsys, monkeypatch)


def test_a_camera_that_is_not_there_is_one_line(place, capfd, monkeypatch):
    """OpenCV has a word to say about it, too, on the process's own descriptor."""
    monkeypatch.chdir(place)
    assert main(["live", "--rig", "rig.json", "--camera", "77"]) == 1
    said = capfd.readouterr().err
    assert "camera 77: cannot be opened; is it plugged in, free, and yours to read?" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("number", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(
    "command",
    [
        "reconstruct frame.png --rig rig.json --out o --distance=",
        "calibrate sphere frame.png --out r.json --focal-px=",
        "calibrate board frame.png --out r.json --square-mm=",
        "track empty --lost-px=",
        "view empty --max-megapixels=",
    ],
)
def test_no_flag_takes_what_is_no_number(command, number, place, capsys, monkeypatch):
    said = line_of(command + number, place, capsys, monkeypatch)
    assert f'Invalid value "{number}" for {command.split()[-1][:-1]}. Expected a finite number.' in said
