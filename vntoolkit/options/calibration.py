"""How a rig is fitted to a ball, a board, known lights or presses."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Literal, TypeAlias

import numpy as np

from vntoolkit.checks import require_in_range, require_positive
from vntoolkit.errors import BadInput
from vntoolkit.options.base import Named, Options, named
from vntoolkit.photometry.response import HIGHEST_DEGREE


class ResponseModel(Enum):
    """Unknowns of the fit."""

    LINEAR = "linear"  # 3×3: r = M n
    AMBIENT = "ambient"  # 3×4: r = M n + a


ResponseModelName: TypeAlias = Literal["linear", "ambient"]


class FitMethod(Enum):
    """How outliers are left out."""

    TRIMMED = "trimmed"  # least squares, repeated without shadow and outliers: few bad pairs
    MSAC = "msac"  # minimal samples with a truncated cost: many bad pairs


@dataclass(frozen=True, kw_only=True)
class ResponseFitOptions(Options):
    """Options of the fit of a light response."""

    model: Named[ResponseModel, ResponseModelName] = named(ResponseModel.LINEAR)
    """With or without ambient light."""
    method: Named[FitMethod, Literal["trimmed", "msac"]] = named(FitMethod.TRIMMED)
    """How outliers are left out."""
    shadow_share: float = 0.08
    """(trimmed) a pair counts as shadowed if a channel's estimated contribution is at most this fraction of
    its largest; 0 keeps shadowed pairs."""
    outlier_sigmas: float = 3.0
    """(trimmed) pairs whose colour residual exceeds this many robust standard deviations are outliers (gloss
    or cast shadow)."""
    inlier_share: float = 0.08
    """(MSAC) largest residual of an inlier, divided by the median length of the colours."""

    def _require_valid(self) -> None:
        if not 0 <= self.shadow_share < 1:
            raise BadInput(f"shadow share: expected 0 to 1, got {self.shadow_share:g}")
        if not (0 < self.outlier_sigmas < np.inf and 0 < self.inlier_share < np.inf):
            raise BadInput("outlier sigmas and inlier share: expected positive numbers")


@dataclass(frozen=True, kw_only=True)
class IntrinsicsOptions(Options):
    """Options of the camera fit."""

    radial_terms: int = 1
    """Number of coefficients of radial distortion, 0 to 2. More would follow noise where no corners are seen
    near the edge of the image."""
    tangential: int = 0
    """Number of tangential coefficients, 0 or 2."""

    def _require_valid(self) -> None:
        if self.radial_terms not in (0, 1, 2) or self.tangential not in (0, 2):
            raise BadInput("intrinsics: expected 0 to 2 radial and 0 or 2 tangential terms")


@dataclass(frozen=True, kw_only=True)
class BoardOptions(Options):
    """Options of the calibration on a board."""

    degree: int = 0
    """Degree of the polynomials by which M varies over the image, 0 to 3. 0 is one M for the whole image.
    Near lights need 2, and a board that was moved through the whole picture."""
    intrinsics: IntrinsicsOptions = field(default_factory=IntrinsicsOptions)
    """How the camera is fitted where none is given."""
    fit: ResponseFitOptions = field(default_factory=ResponseFitOptions)
    """How M is fitted."""

    def _require_valid(self) -> None:
        require_in_range(self.degree, 0, HIGHEST_DEGREE, "board: degree of the variation")


class LightColours(Enum):
    """Which colours the lights have."""

    GIVEN = "given"  # each row of intensities is the light's red, green and blue
    CHANNELS = "channels"  # light k alone is seen by channel k: three photographs stacked as one


LightColoursName: TypeAlias = Literal["given", "channels"]


class LabelOffset(Enum):
    """Whether the circles are used as they are, or moved so that ball and flat gel agree."""

    COMMON = "common"  # by one offset for all, then each by its own
    OWN = "own"  # each by its own, as for circles that were found in the pictures
    NONE = "none"


@dataclass(frozen=True, kw_only=True)
class PressOptions(Options):
    """Options of the calibration on presses."""

    ball_radius_mm: float
    """Radius of the ball; of several, of those presses that --ball-radii does not list."""
    pixel_mm: float | None = None
    """Side of a pixel on the gel. Default: what --corners and --size-mm tell of the picture as filmed."""
    contact_share: float = 0.8
    """Share of the labelled contact radius inside which the gel follows the ball."""
    samples: int = 400
    """Pixels drawn from a press's contact."""
    label_offset: Named[LabelOffset, Literal["common", "own", "none"]] = named(LabelOffset.COMMON)
    """Whether the circles move to their dents."""
    outlier_sigmas: float = 4.0
    """Pixels whose colour differs from M's by more than this many robust standard deviations (dots, creases)
    are left out of M's fit."""

    @property
    def side_mm(self) -> float:
        """Side of a pixel; raises `BadInput` where it is not known."""
        if self.pixel_mm is None:
            raise BadInput("presses: expected --pixel-mm, or --corners and --size-mm")
        return self.pixel_mm

    def _require_valid(self) -> None:
        if not (0 < self.ball_radius_mm < np.inf and (self.pixel_mm is None or 0 < self.pixel_mm < np.inf)):
            raise BadInput("presses: expected a positive ball radius and pixel size in mm")
        if not 0 < self.contact_share <= 1:
            raise BadInput(f"presses: expected a contact share from 0 to 1, got {self.contact_share:g}")
        if self.samples < 4:
            raise BadInput(f"presses: expected at least 4 samples a press, got {self.samples}")
        require_positive(self.outlier_sigmas, "presses: outlier sigmas")
