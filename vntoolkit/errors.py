"""What can go wrong, by kind. The command line turns each into one line and exit status 1.

A message says what was expected, what came, and what to do.
"""

from __future__ import annotations


class VntError(Exception):
    """Base of every error that a user can cause and mend."""


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
