"""An exception that nobody foresaw: one line, a status of its own, and the trace in a file."""

import re
import tempfile
from pathlib import Path

import pytest

from vntoolkit import __main__ as entry
from vntoolkit import cli


@pytest.fixture
def failing(monkeypatch, tmp_path):
    """Return a function that lets every command raise its argument."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def fail_with(error):
        def app(_):
            raise error

        monkeypatch.setattr(cli, "build_app", lambda _: app)

    return fail_with


def test_an_unforeseen_exception_is_one_line_and_its_trace_a_file(failing, capsys):
    failing(ZeroDivisionError("division\nby zero"))
    assert entry.main(["doctor"]) == entry.OWN_FAULT
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert r"not of your input (ZeroDivisionError: division\nby zero)" in said
    trace = Path(re.search(r"its trace is in (\S+):", said)[1]).read_text()
    assert trace.startswith("Traceback")
    assert "in app" in trace


def test_without_a_folder_for_the_trace_the_line_says_where_it_arose(failing, capsys, monkeypatch):
    failing(TypeError("no"))
    monkeypatch.setattr(tempfile, "tempdir", "/nowhere/at/all")
    assert entry.main(["doctor"]) == entry.OWN_FAULT
    assert re.search(r"it arose in app, line \d+ of \S+test_internal_error.py", capsys.readouterr().err)


def test_too_little_memory_is_the_users_to_mend(failing, capsys):
    failing(MemoryError("Unable to allocate 99.0 GiB"))
    assert entry.main(["doctor"]) == 1
    assert "out of memory (Unable to allocate 99.0 GiB): take fewer --jobs" in capsys.readouterr().err
