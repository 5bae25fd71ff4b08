"""What can go wrong, by kind. The command line turns each into one line and exit status 1.

A message says what was expected, what came, and what to do.
"""

from __future__ import annotations

LONGEST_MESSAGE = 900
"""Characters of a message; a longer one loses its middle, so that a hostile file cannot flood a terminal."""


def printable_line(text: str) -> str:
    """Return text as one line of bounded length: what cannot be printed becomes its escape, as in `repr`."""
    line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    if len(line) <= LONGEST_MESSAGE:
        return line
    kept = LONGEST_MESSAGE // 2 - len(" [...]")
    return f"{line[:kept]} [...] {line[-kept:]}"


class VntError(Exception):
    """Base of every error that a user can cause and mend; its message is one printable line."""

    def __init__(self, message: str) -> None:
        super().__init__(printable_line(message))


class BadInput(VntError):
    """A file, option or array is not what the operation needs."""


class BadCapture(BadInput):
    """A video, image or sequence cannot serve as a capture."""


class BadRig(BadInput):
    """A rig file or a light response is unusable (unknown key, wrong size, singular M)."""


class BadMesh(BadInput):
    """A mesh, point cloud or moving mesh is malformed."""


class BadMotion(BadInput):
    """A motion capture file is malformed."""


class BadCalibration(VntError):
    """The footage does not carry a calibration; the message names the stage and what to film."""


class SolverFailed(VntError):
    """A solver did not reach its tolerance."""


class CannotWrite(VntError):
    """An output cannot be written; nothing half-written is left."""


class MissingDependency(VntError):
    """A system or Python library is absent; the message is the line that installs it."""
