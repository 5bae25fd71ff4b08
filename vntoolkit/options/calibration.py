"""How a rig is fitted to a ball, a board, known lights or presses."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Literal, TypeAlias

from vntoolkit.errors import BadInput
from vntoolkit.options.base import Named, Options, named, positive, within
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


@dataclass(frozen=True, kw_only=True)
class BoardOptions(Options):
    """Options of the calibration on a board."""

    degree: Annotated[int, within(0, HIGHEST_DEGREE)] = 0
    """Degree of the polynomials by which M varies over the image, 0 to 3. 0 is one M for the whole image.
    Near lights need 2, and a board that was moved through the whole picture."""
    radial_terms: Annotated[int, within(0, 2)] = 1
    """Coefficients of radial distortion that are fitted where no camera is given, 0 to 2. More would follow
    noise where no corners are seen near the edge of the image."""
    fit: ResponseFitOptions = field(default_factory=ResponseFitOptions)
    """How M is fitted."""


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

    ball_radius_mm: Annotated[float, positive("a positive number of millimetres")]
    """Radius of the ball; of several, of those presses that --ball-radii does not list."""
    pixel_mm: Annotated[float | None, positive("a positive number of millimetres")] = None
    """Side of a pixel on the gel. Default: what --corners and --size-mm tell of the picture as filmed."""
    label_offset: Named[LabelOffset, Literal["common", "own", "none"]] = named(LabelOffset.COMMON)
    """Whether the circles move to their dents."""

    @property
    def side_mm(self) -> float:
        """Side of a pixel; raises `BadInput` where it is not known."""
        if self.pixel_mm is None:
            raise BadInput("presses: expected --pixel-mm, or --corners and --size-mm")
        return self.pixel_mm
