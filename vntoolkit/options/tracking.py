"""How frames are registered to one mesh."""

from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from vntoolkit.options.base import File, Named, OptionalFile, Options, named, positive
from vntoolkit.options.footage import ReadingLimits
from vntoolkit.options.shared import MovedFootageOptions

LOST_PX = 4.0  # expected error of a vertex above which it is called lost


class Tracker(Enum):
    """A tracking method (`brostow2011` section V; ARAP: `sorkine2007`, by Open3D)."""

    DEFAULT = "default"  # the template itself is registered to every frame, with its lengths and outline
    NO_REGISTRATION = "no-registration"  # nothing moves
    FLOW = "flow"  # equations 5 and 6 alone
    TRANSLATION = "translation"  # neighbours are translated alike
    LAPLACIAN = "laplacian"  # equation 7 as published: Q is the template's
    LAPLACIAN_PREVIOUS = "laplacian-previous"  # Q is that of the frame before: only the step is smoothed
    LAPLACIAN_COTANGENT = "laplacian-cotangent"  # as that, with cotangent weights
    ARAP = "arap"  # as rigid as possible


TrackerName: TypeAlias = Literal[
    "default", "no-registration", "flow", "translation", "laplacian", "laplacian-previous",
    "laplacian-cotangent", "arap",
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TrackingOptions(Options):
    """How the template follows the video."""

    method: Named[Tracker, TrackerName] = named(Tracker.DEFAULT)
    """The tracking method: the default, or a published one for comparison."""


@dataclass(frozen=True, kw_only=True)
class TrackArguments(MovedFootageOptions, TrackingOptions, ReadingLimits):
    """What `track` takes."""

    folder: File = field(kw_only=False)
    """The folder that `vntoolkit reconstruct` wrote, with normals and depth."""
    seams: OptionalFile = named(None)
    """JSON file of polylines on the template image. The surface is cut along them, as at mouth and eyes."""
    template: int | None = None
    """Number of the template frame. Default: the one that shows most of the surface, lit and sharp; with
    --seams, and on a tactile gel, the first. It is tracked forwards and backwards."""
    out: OptionalFile = named(None)
    """The folder to write; default FOLDER/track."""
    lost_px: Annotated[float, positive()] = LOST_PX
    """A vertex is called lost where its expected error is above this, in pixels."""
    background: OptionalFile = named(None)
    """The background image that the reconstruction subtracted, for the colours of the texture."""
    object: bool = False
    """On a tactile gel: also write object.csv, the pose of what touches it, frame by frame."""
    overwrite: bool = False
    """Replace the tracks that the folder holds."""

    @property
    def target(self) -> Path:
        """The folder to write."""
        return self.out or Path(self.folder) / "track"
