"""How normals become depth, and depth triangles."""

from dataclasses import dataclass
from enum import Enum
from typing import Literal, TypeAlias

from vntoolkit.checks import require_in_range
from vntoolkit.errors import BadInput
from vntoolkit.options.base import Named, Options, named


class Integrator(Enum):
    """How slopes become depth.

    DISCONTINUITY: as POISSON; depth may jump where the normals' errors do not explain its residuals.
    POISSON: least squares inside any mask, weighted by confidence.
    COSINE: least squares by the discrete cosine transform; full rectangle; the fastest.
    FOURIER: Frankot and Chellappa's projection on a mirrored image; full rectangle.
    """

    FOURIER = "fourier"
    COSINE = "cosine"
    POISSON = "poisson"
    DISCONTINUITY = "discontinuity"


IntegratorName: TypeAlias = Literal["fourier", "cosine", "poisson", "discontinuity"]


class Precision(Enum):
    """Floating point format of the spectral integrators: SINGLE is exact to about 1e-6 of the range."""

    SINGLE = "single"
    DOUBLE = "double"


@dataclass(frozen=True, kw_only=True)
class IntegrationOptions(Options):
    """Options of `DepthIntegrator`."""

    integrator: Named[Integrator, IntegratorName] = named(Integrator.DISCONTINUITY)
    """How slopes become depth: discontinuity (least squares; depth jumps where the errors of the normals do
    not explain a residual), poisson (least squares), or cosine or fourier over a full rectangle."""
    steepest_slope_deg: float = 89.0
    """Steepest slope: the largest angle in degrees between a normal and the direction to the camera. A normal
    beyond it is held at it, so that grazing normals do not tear the depth."""
    least_weight: float = 0.02
    """Pixels whose confidence (0 to 1) is lower are left out."""
    precision: Named[Precision, Literal["single", "double"]] = named(Precision.SINGLE)
    """Floating-point precision of cosine and fourier."""
    tolerance: float = 1e-5
    """Relative residual at which poisson stops."""
    most_iterations: int = 1000
    """Most iterations of poisson; reaching them is an error."""

    def _require_valid(self) -> None:
        require_in_range(self.steepest_slope_deg, 1.0, 89.9, "steepest slope in degrees")
        require_in_range(self.least_weight, 0.0, 1.0, "least weight")
        require_in_range(self.tolerance, 1e-12, 1e-2, "tolerance of the linear solver")
        require_in_range(self.most_iterations, 1, 100_000, "most iterations")


@dataclass(frozen=True, kw_only=True)
class MeshOptions(Options):
    """How depth becomes triangles."""

    largest_step: float = 10.0
    """Largest step of depth within a triangle, in pixel widths at its distance. A triangle with a larger step
    spans a jump and is left out."""
    stride: int = 1
    """Use every stride-th pixel in both directions."""

    def _require_valid(self) -> None:
        if not self.largest_step > 0:
            raise BadInput(f"largest step: expected a positive number of pixels, got {self.largest_step:g}")
        if self.stride < 1:
            raise BadInput(f"stride: expected 1 or more, got {self.stride}")
