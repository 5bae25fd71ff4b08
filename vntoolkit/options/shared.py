"""Options that several verbs share: footage and its frames, findings, the gel's corners, machines."""

from dataclasses import dataclass

from vntoolkit.options.base import OptionalFile, Options, named
from vntoolkit.photometry.transfer import Transfer


@dataclass(frozen=True, kw_only=True)
class FrameOptions(Options):
    """Which frames."""

    frames: str | None = "::"
    """Frames to use: a:b:c for every c-th frame from a to b - 1, or one number."""


@dataclass(frozen=True, kw_only=True)
class BackgroundOptions(Options):
    """What is subtracted."""

    background: OptionalFile = named(None)
    """Image, or first frame of footage, of the scene under ambient light only. It is subtracted from every
    frame."""


@dataclass(frozen=True, kw_only=True)
class CurveOptions(Options):
    """How stored values become light."""

    transfer: str | None = None
    """Transfer curve of the footage: linear, srgb, bt709, gamma:G, pq, hlg, slog3, vlog, clog3 or logc3.
    Default: the curve that the file states, else linear."""

    @property
    def curve(self) -> Transfer | None:
        """The curve that is given."""
        return None if self.transfer is None else Transfer.from_text(self.transfer)


@dataclass(frozen=True, kw_only=True)
class AllowOptions(Options):
    """Which findings do not stop a run."""

    allow: tuple[str, ...] = ()
    """Continue despite the fatal findings of these checks. A finding's line ends with the name of its
    check."""


@dataclass(frozen=True, kw_only=True)
class CornerOptions(Options):
    """Where the gel, or another rectangle, appears in the picture."""

    corners: tuple[float, float, float, float, float, float, float, float] | None = None
    """u v of the top left, top right, bottom left and bottom right corner of the gel (or of another
    rectangle) in the picture, of `live` in the crop. The picture is rectified to them. Default: those of the
    rig, if there is one; give them where the sensor or its camera has moved since."""
    size_mm: tuple[float, float] | None = None
    """Width and height of the rectangle between these corners in millimetres. Default: as --corners."""


@dataclass(frozen=True, kw_only=True)
class MovedFootageOptions(Options):
    """Where the footage of a result is."""

    footage: str = ""
    """Where the footage is now, if it was moved after the reconstruction."""


@dataclass(frozen=True, kw_only=True)
class JobOptions(Options):
    """Who does the work."""

    jobs: int = 1
    """Worker processes on this machine. The results do not depend on their number."""
