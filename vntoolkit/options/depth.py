"""How normals become depth, and depth triangles."""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Literal, TypeAlias

from vntoolkit.options.base import Named, Options, named, positive, within


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


@dataclass(frozen=True, kw_only=True)
class IntegrationOptions(Options):
    """Options of `DepthIntegrator`."""

    integrator: Named[Integrator, IntegratorName] = named(Integrator.DISCONTINUITY)
    """How slopes become depth: discontinuity (least squares; depth jumps where the errors of the normals do
    not explain a residual), poisson (least squares), or cosine or fourier over a full rectangle."""


@dataclass(frozen=True, kw_only=True)
class MeshOptions(Options):
    """How depth becomes triangles."""

    largest_step: Annotated[float, positive("a positive number of pixels")] = 10.0
    """Largest step of depth within a triangle, in pixel widths at its distance. A triangle with a larger step
    spans a jump and is left out."""
    stride: Annotated[int, within(1)] = 1
    """Use every stride-th pixel in both directions."""
