"""What is shown while a user waits."""

from __future__ import annotations

import io
import logging

import pytest
from rich.console import Console
from rich.progress import Progress

from vntoolkit import native
from vntoolkit.cli import output


def test_pace_is_that_of_this_run_and_blank_until_there_is_one() -> None:
    """Frames come in blocks of eight, at once; 50 of 100 are there from before."""
    now = [0.0]
    column = output._PaceColumn()
    with Progress(
        get_time=lambda: now[0], console=Console(file=io.StringIO()), auto_refresh=False
    ) as progress:
        number = progress.add_task("reconstruct", total=100, completed=50, before=50)
        task = progress.tasks[0]
        now[0] = 4.0
        assert column.render(task).plain == ""
        for _ in range(8):
            progress.advance(number)
        assert column.render(task).plain == "2.0/s 0:00:21"


def test_what_is_compiled_is_said_once_for_each_part(caplog: pytest.LogCaptureFixture) -> None:
    class Empty:
        def load_overload(self, *_asked: object) -> None: ...

    native._tell.cache_clear()
    with caplog.at_level(logging.INFO, "vntoolkit.native"):
        for module in ("vntoolkit.shadows.edges", "vntoolkit.shadows.levels", "vntoolkit.solvers", "numpy.a"):
            kernel = type("kernel", (), {"__module__": module})
            assert native._ForgivingCache(Empty(), kernel).load_overload() is None
    assert [record.getMessage() for record in caplog.records] == [
        "compiling the loops of shadows, once per installation ...",
        "compiling the loops of solvers, once per installation ...",
    ]
