"""Options of tracking."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from vntoolkit.checks import require_in_range
from vntoolkit.errors import BadInput

_MOST_LEVELS = 8  # a picture of 8192 pixels is then 32 wide


class Regulariser(Enum):
    """How the motion of neighbouring vertices is regularised."""

    NONE = "none"  # flow alone: equations 5 and 6
    TRANSLATION = "translation"
    LAPLACIAN = "laplacian"  # equation 7
    ARAP = "arap"  # as rigid as possible, by Open3D


class LaplacianKind(Enum):
    """Edge weights of L in equation 7."""

    UNIFORM = "uniform"
    COTANGENT = "cotangent"


class RestShape(Enum):
    """Where the Laplacian coordinates Q of equation 7 come from."""

    TEMPLATE = "template"  # they do not turn with the surface
    PREVIOUS = "previous"  # they do, by what was tracked so far: only the step is smoothed


class DriftCorrection(Enum):
    """How drift is corrected: the error that accumulates over frames."""

    NONE = "none"
    TEMPLATE = "template"  # register the template itself to the current frame


class Confidence(Enum):
    """How vertices are treated where the frame does not match the template."""

    NONE = "none"
    TEMPLATE = "template"  # they weigh less in the data term
    CARRIED = "carried"  # they are carried along by those around them, from the template (`Extrapolation`)


class Tears(Enum):
    """Where the template is cut in addition to the given seams."""

    NONE = "none"
    NORMALS = "normals"  # where its normals show one surface before another (`tear_pixels`)


class FlowMethod(Enum):
    """Optical flow between consecutive normal maps."""

    NONE = "none"  # nothing moves: no registration
    DIS = "dis"  # dense inverse search
    LATTICE = "lattice"  # Lucas and Kanade on a lattice, from the motion before and, where it fits ill, DIS's


@dataclass(frozen=True, kw_only=True)
class FlowOptions:
    """Optical flow between consecutive normal maps.

    method: how motion between two frames is found: none, dis (dense inverse search), or lattice, which
    follows points by Lucas–Kanade and starts from dis where the motion before does not fit. lattice_px:
    spacing of the points that Lucas–Kanade follows, pixels. window_px: side of the window around such a
    point, pixels, odd. levels: pyramid levels above full resolution.
    """

    method: FlowMethod = FlowMethod.LATTICE
    lattice_px: int = 8
    window_px: int = 21
    levels: int = 0

    def __post_init__(self) -> None:
        require_in_range(self.lattice_px, 1, 1000, "flow lattice in pixels")
        require_in_range(self.window_px, 5, 101, "flow window in pixels")
        if self.window_px % 2 == 0:
            raise BadInput(f"flow window in pixels: expected an odd number, got {self.window_px}")
        require_in_range(self.levels, 0, _MOST_LEVELS, "pyramid levels of the flow")


@dataclass(frozen=True, kw_only=True)
class DriftOptions:
    """Registration of the template to the current frame.

    correction: what takes back the error that adds up from frame to frame: none, or template, which registers
    the template itself to every frame. every: frames from one correction to the next. cell_px: side of a
    lattice cell on the template, pixels. levels: pyramid levels above full resolution that a correction
    starts from. iterations: Gauss–Newton steps at full resolution. stiffness: how strongly neighbouring cells
    share their correction, as a share of the mean information of a cell. noise_slope: standard deviation of a
    slope that passes for noise at least, when judging the match; where most of a frame matches worse, as
    under aliasing, that passes.
    """

    correction: DriftCorrection = DriftCorrection.TEMPLATE
    every: int = 1
    cell_px: int = 8
    levels: int = 0
    iterations: int = 3
    stiffness: float = 0.5
    noise_slope: float = 0.05

    def __post_init__(self) -> None:
        require_in_range(self.every, 1, 1e6, "frames from one drift correction to the next")
        require_in_range(self.cell_px, 4, 64, "lattice cell in pixels")
        require_in_range(self.levels, 0, _MOST_LEVELS, "pyramid levels of the drift correction")
        require_in_range(self.iterations, 1, 1000, "iterations of the drift correction")
        require_in_range(self.stiffness, 0.0, 1e6, "stiffness of the drift correction")
        require_in_range(self.noise_slope, 1e-6, 10.0, "noise of a slope")


@dataclass(frozen=True, kw_only=True)
class TrackingOptions:
    """How the template follows the video.

    regulariser, laplacian, rest, confidence: see the enums. smoothing_length: in edges; Laplacian coordinates
    keep waves longer than about five times this (β = 1.5 / length², `beta_from_smoothing_length`).
    data_share: α of the translation regulariser, the share of the data term, 0 to 1. handle_spacing_px:
    distance of the vertices that ARAP is told where to go, pixels. tears: see Tears. flow, drift: their
    options.
    """

    regulariser: Regulariser = Regulariser.LAPLACIAN
    laplacian: LaplacianKind = LaplacianKind.UNIFORM
    rest: RestShape = RestShape.PREVIOUS
    confidence: Confidence = Confidence.CARRIED
    smoothing_length: float = 16.0
    data_share: float = 0.9
    handle_spacing_px: int = 8
    tears: Tears = Tears.NONE
    flow: FlowOptions = FlowOptions()
    drift: DriftOptions = DriftOptions()

    def __post_init__(self) -> None:
        require_in_range(self.data_share, 1e-3, 1.0, "data share α")
        require_in_range(self.smoothing_length, 0.0, 1e3, "smoothing length in edges")
        require_in_range(self.handle_spacing_px, 1, 1000, "handle spacing in pixels")
        used, name = self.confidence is not Confidence.NONE, self.confidence.value
        if used and self.drift.correction is DriftCorrection.NONE:
            raise BadInput(f"confidence `{name}` needs drift correction `template`, which it is measured by")
        if used and self.regulariser is not Regulariser.LAPLACIAN:
            raise BadInput(
                f"confidence `{name}` needs regulariser `laplacian`, not `{self.regulariser.value}`"
            )
