"""The errors of the toolkit, by kind. The command line prints one line and exits with status 1.

A message states what was expected, what came, and what to do.
"""

from typing import ClassVar

LONGEST_MESSAGE = 900
"""Characters of a message; a longer one loses its middle, so that a hostile file cannot flood a terminal."""


def escaped(text: str) -> str:
    """Return text as one line; what is unprintable, and what a terminal obeys, is escaped as in `repr`."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def printable_line(text: str) -> str:
    """Return text as one line of limited length; unprintable characters are escaped as in `repr`."""
    line = escaped(text)
    if len(line) <= LONGEST_MESSAGE:
        return line
    kept = LONGEST_MESSAGE // 2 - len(" [...]")
    return f"{line[:kept]} [...] {line[-kept:]}"


class VntError(Exception):
    """Base of all errors that a user can cause and correct; the message is one printable line.

    page: where the guide says more, in the repository and on the site; empty where the message says all.
    """

    page: ClassVar[str] = ""

    def __init__(self, message: str) -> None:
        super().__init__(printable_line(message))


class BadInput(VntError):
    """A file, option or array is not what the operation needs."""


class BadCapture(BadInput):
    """A video, an image or a sequence cannot be used as a capture."""

    page = "docs/wrong.md#footage"


class NoSubject(BadCapture):
    """A frame shows no subject: all of it is black, clipped or outside the mask. No run stops for it."""


class BadRig(BadInput):
    """A rig file or a light response is unusable (unknown key, wrong size, singular M)."""

    page = "docs/wrong.md#rig"


class BadMesh(BadInput):
    """A mesh, point cloud or moving mesh is malformed."""

    page = "docs/wrong.md#mesh"


class BadMotion(BadInput):
    """A motion capture file is malformed."""

    page = "docs/wrong.md#motion"


class BadCalibration(VntError):
    """The footage does not suffice for a calibration; the message names the stage and what to film."""

    page = "docs/wrong.md#calibration"


class SolverFailed(VntError):
    """A solver did not reach its tolerance."""

    page = "docs/wrong.md#solver"


class CannotWrite(VntError):
    """An output cannot be written; no partial file remains."""

    page = "docs/wrong.md#output"


class MissingDependency(VntError):
    """A system or Python library is missing; the message contains the command that installs it."""

    page = "docs/wrong.md#libraries"
