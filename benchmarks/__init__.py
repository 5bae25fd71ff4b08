"""Speed, memory and accuracy of every stage with default options: `python -m benchmarks` runs all."""

import sys
from types import TracebackType

import vntoolkit.__main__  # noqa: F401 - tames the thread pools, before numpy is loaded
from vntoolkit.errors import BadInput


def _in_one_line(kind: type[BaseException], problem: BaseException, trace: TracebackType | None) -> None:
    """Say what was wrong with the input, as the command line does. All else keeps its traceback."""
    if issubclass(kind, BadInput):
        print(f"benchmarks: {problem}", file=sys.stderr)
    else:
        sys.__excepthook__(kind, problem, trace)


sys.excepthook = _in_one_line
