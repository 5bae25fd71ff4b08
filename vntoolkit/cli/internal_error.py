"""What is said of an exception that nobody foresaw: one line, and the trace in a file that can be sent."""

from __future__ import annotations

import contextlib
import tempfile
import traceback
from pathlib import Path

from vntoolkit.errors import printable_line


def line_from_unforeseen(error: Exception) -> str:
    """Return the line to show; the traceback goes into a new file of the temporary folder, which it names.

    Where that folder cannot be written, the line names the function that failed instead.
    """
    if isinstance(error, MemoryError):
        return printable_line(
            f"out of memory ({error}): take fewer --jobs or --frames, or smaller footage; what is "
            "finished is on disk"
        )
    what = printable_line(f"{type(error).__name__}: {error}"[:300])
    last = traceback.extract_tb(error.__traceback__)[-1:]
    where = f"it arose in {last[0].name}, line {last[0].lineno} of {last[0].filename}" if last else ""
    with contextlib.suppress(OSError):
        where = f"its trace is in {_written(error)}"
    return f"a fault of vntoolkit's own, not of your input ({what}); {where}: please report it"


def _written(error: Exception) -> Path:
    with tempfile.NamedTemporaryFile(
        "w",
        prefix="vntoolkit-trace-",
        suffix=".txt",
        delete=False,
        encoding="utf-8",
        errors="backslashreplace",
    ) as file:
        file.writelines(traceback.format_exception(error))
    return Path(file.name)
