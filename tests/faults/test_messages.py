"""Every error's message is one printable line of bounded length, whatever a file or a flag put into it."""

import ast
import logging
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import vntoolkit
from vntoolkit import cli
from vntoolkit.__main__ import main
from vntoolkit.cli.messages import OneLineFormatter
from vntoolkit.cli.output import print_next, print_table, say
from vntoolkit.errors import LONGEST_MESSAGE, BadCapture, BadInput, CannotWrite, VntError
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.maps_and_meshes.usd import write_usd_sequence

HOSTILE = "x\n\x1b[31mRED"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a\nb\tc", r"a\nb\tc"),
        ("erase \x1b[2J", r"erase \x1b[2J"),
        ("line\u2028break", r"line\u2028break"),
        ("name \udcff.png", r"name \udcff.png"),
        ("größe, 5 °", "größe, 5 °"),
    ],
)
def test_what_cannot_be_printed_becomes_its_escape(text, line):
    assert str(VntError(text)) == line


def test_a_long_message_keeps_both_ends():
    message = str(BadCapture("start " + "x" * 100_000 + " end"))
    assert len(message) <= LONGEST_MESSAGE
    assert message.startswith("start x")
    assert message.endswith("x end")


def test_an_error_survives_the_way_from_another_process():
    again = pickle.loads(pickle.dumps(BadCapture("a\nb")))
    assert type(again) is BadCapture
    assert str(again) == r"a\nb"


def test_names_are_escaped_wherever_a_verb_prints_them(capsys):
    say(f"{HOSTILE}: 2 frames")
    print_next("view", HOSTILE)
    print_table(HOSTILE, ("name", "value"), [(HOSTILE, "1")])
    said = capsys.readouterr().out
    assert "\x1b" not in said
    assert said.count(r"x\n\x1b[31mRED") == 4
    assert len(said.splitlines()) == 5


def test_no_verb_prints_past_that():
    """`say` and the tables are the only ways; JSON is escaped by itself, shipped names are our own."""
    allowed = {"output.py": 1, "report.py": 1, "schema.py": 1, "recipe.py": 1}
    for path in sorted(Path(cli.__file__).parent.glob("*.py")):
        calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        printed = [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "print"]
        assert len(printed) <= allowed.get(path.name, 0), f"{path.name}: use say"


def test_warnings_and_usage_errors_are_escaped(capsys):
    record = logging.LogRecord("vntoolkit", logging.WARNING, "", 1, "%s: odd", (HOSTILE,), None)
    assert OneLineFormatter("vntoolkit: %(message)s").format(record) == r"vntoolkit: x\n\x1b[31mRED: odd"
    assert main(["board", "--out", "b.pdf", HOSTILE]) == 1
    assert "\x1b" not in capsys.readouterr().err


def test_warnings_of_libraries_do_not_reach_the_terminal(tmp_path):
    """numpy warns of a header that Python 2 wrote, two lines with a line of its own source."""
    np.save(tmp_path / "a.npy", np.zeros((1, 3, 3), np.float32))
    content = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(content.replace(b"(1, 3, 3)", b"(1L, 3, 3)").replace(b"  \n", b" \n"))
    code = "import vntoolkit.__main__ as m, numpy, sys; m._set_up_logging(); numpy.load(sys.argv[1])"
    command = [sys.executable, "-c", code, str(tmp_path / "a.npy")]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (0, "")


def test_a_constructor_is_called_by_its_class():
    camera = vntoolkit.Camera.orthographic(width=8, height=8)
    with pytest.raises(BadInput, match=r"^DepthIntegrator: options: expected"):
        vntoolkit.DepthIntegrator(camera, 3)


def test_what_usd_says_comes_without_its_source_files(tmp_path):
    mesh = Mesh(vertices=np.eye(3, dtype=np.float32), faces=np.array([[0, 1, 2]], np.int32))
    with pytest.raises(CannotWrite) as refused:
        write_usd_sequence(tmp_path / "a:SDF_FORMAT_ARGS:b=c.usd", mesh, [mesh.vertices], frame_rate_hz=30)
    assert "choose another name" in str(refused.value)
    assert ".cpp" not in str(refused.value)
