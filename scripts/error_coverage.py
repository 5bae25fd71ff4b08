"""Print the fraction of the package's errors that the tests raise, and every `raise` that no test reaches.

    python scripts/error_coverage.py [pytest arguments]

A statement counts as reached where a `VntError` is made on its lines while the tests run in this process;
what worker processes and commands of their own raise is not seen, so the figure errs to the low side.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from pathlib import Path

import pytest

from vntoolkit import errors

PACKAGE = Path(errors.__file__).parent
_KINDS = {name for name in vars(errors) if isinstance(getattr(errors, name), type)}
_MADE_BY = {"error", "cannot_write"}  # a kind handed in, and the maker of write errors
Place = tuple[str, int, int]


def raises_of(path: Path) -> list[Place]:
    """Return (file, first line, last line) of each statement that raises a `VntError`."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            name = getattr(node.exc.func, "id", getattr(node.exc.func, "attr", ""))
            is_method = name.startswith("_") and isinstance(node.exc.func, ast.Attribute)
            if name in _KINDS | _MADE_BY or is_method:
                found.append((str(path), node.lineno, node.end_lineno or node.lineno))
    return found


class Recorder:
    """A pytest plugin that notes the lines from which `VntError`s are made, helpers' callers too."""

    def __init__(self) -> None:
        self.lines: set[tuple[str, int]] = set()
        original = errors.VntError.__init__

        def record(error: errors.VntError, *arguments: object) -> None:
            frame = sys._getframe(1)
            for _ in range(3):
                self.lines.add((frame.f_code.co_filename, frame.f_lineno))
                if frame.f_back is None:
                    break
                frame = frame.f_back
            original(error, *arguments)

        errors.VntError.__init__ = record  # type: ignore[method-assign]


def main() -> int:
    """Run the tests, then compare the lines that raised with those that can."""
    recorder = Recorder()
    status = pytest.main([*sys.argv[1:], "-q"], plugins=[recorder])
    places = [place for path in sorted(PACKAGE.rglob("*.py")) for place in raises_of(path)]
    reached = [p for p in places if any((p[0], line) in recorder.lines for line in range(p[1], p[2] + 1))]
    total, hit = (
        Counter(Path(p[0]).relative_to(PACKAGE).parts[0] for p in some) for some in (places, reached)
    )
    for room in sorted(total):
        print(f"{room:>14}  {hit[room]:4d} of {total[room]:4d}")
    for place in sorted(set(places) - set(reached)):
        print(f"not reached: {Path(place[0]).relative_to(PACKAGE)}:{place[1]}")
    print(f"{len(reached)} of {len(places)} raised errors are reached: {len(reached) / len(places):.0%}")
    return int(status)


if __name__ == "__main__":
    sys.exit(main())
