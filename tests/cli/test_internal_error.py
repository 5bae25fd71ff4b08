"""Exceptions that nobody foresaw: one line, a status, the trace in a file; and no Ctrl-C is lost."""

import re
import signal
import subprocess
import sys
import tempfile
import time
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

        monkeypatch.setattr(cli, "run_verb", app)

    return fail_with


def test_an_unforeseen_exception_is_one_line_and_its_trace_a_file(failing, capsys):
    failing(ZeroDivisionError("division\nby zero"))
    assert entry.main(["doctor"]) == entry.OWN_FAULT
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert r"not a fault of your input (ZeroDivisionError: division\nby zero)" in said
    trace = Path(re.search(r"the traceback is in (\S+);", said)[1]).read_text()
    assert trace.startswith("Traceback")
    assert "in app" in trace


def test_without_a_folder_for_the_trace_the_line_says_where_it_arose(failing, capsys, monkeypatch):
    failing(TypeError("no"))
    monkeypatch.setattr(tempfile, "tempdir", "/nowhere/at/all")
    assert entry.main(["doctor"]) == entry.OWN_FAULT
    assert re.search(r"raised in app, line \d+ of \S+test_internal_error.py", capsys.readouterr().err)


def test_too_little_memory_is_the_users_to_mend(failing, capsys):
    failing(MemoryError("Unable to allocate 99.0 GiB"))
    assert entry.main(["doctor"]) == 1
    assert "out of memory (Unable to allocate 99.0 GiB): use fewer --jobs" in capsys.readouterr().err


def test_an_interrupt_that_strikes_in_a_callback_is_heard(monkeypatch, capsys):
    class Struck:
        def __del__(self):
            raise KeyboardInterrupt

    def app(_):
        Struck()
        for _ in range(500):
            time.sleep(0.01)
        return 0

    monkeypatch.setattr(cli, "run_verb", app)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    try:
        assert entry.main(["doctor"]) == entry.INTERRUPTED
    finally:
        signal.signal(signal.SIGINT, before)
    said = capsys.readouterr().err
    assert "interrupted: run the same command again to continue" in said
    assert "Traceback" not in said


def test_an_interrupt_that_strikes_within_compiled_code_is_one(failing, capsys):
    struck = SystemError("an unpickler returned a result with an exception set")
    struck.__cause__ = KeyboardInterrupt()
    around = SystemError("a kernel returned a result with an exception set")
    around.__cause__ = struck
    failing(around)
    assert entry.main(["doctor"]) == entry.INTERRUPTED
    assert "interrupted: run the same command again" in capsys.readouterr().err
    failing(SystemError("of another cause"))
    assert entry.main(["doctor"]) == entry.OWN_FAULT


def test_an_interrupt_that_strikes_when_all_is_done_leaves_no_traceback():
    script = """
import atexit, os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))
sys.argv = ["vntoolkit", "--version"]
from vntoolkit.__main__ import run
run()
"""
    done = subprocess.run([sys.executable, "-c", script], check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")
    assert done.stdout


def test_what_an_interrupt_leaves_half_built_leaves_no_traceback():
    script = """
import vntoolkit.cli
from vntoolkit.__main__ import main

class HalfBuilt:
    def __del__(self):
        self.pointer.close()

def struck(_):
    held = HalfBuilt()
    raise KeyboardInterrupt

vntoolkit.cli.run_verb = struck
raise SystemExit(main(["doctor"]))
"""
    done = subprocess.run([sys.executable, "-c", script], check=False, capture_output=True, text=True)
    assert done.returncode == entry.INTERRUPTED
    assert done.stderr == "\nvntoolkit: interrupted: run the same command again to continue\n"
