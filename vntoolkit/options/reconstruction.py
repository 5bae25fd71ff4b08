"""How far a reconstruction goes, and what it assumes of the subject."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Literal

from vntoolkit.errors import BadInput
from vntoolkit.options.base import Named, Options, named, positive, within
from vntoolkit.options.depth import IntegrationOptions, MeshOptions
from vntoolkit.options.normals import InversionOptions, ShadowMethod, ShadowMethodName

MOST_MATERIALS = 12


class Product(Enum):
    """How far a reconstruction goes; each includes the ones before it."""

    NORMALS = "normals"
    DEPTH = "depth"
    MESH = "mesh"


class OnError(Enum):
    """What a frame that fails does to the run."""

    STOP = "stop"
    SKIP = "skip"  # the frame is left out, and named in the manifest and at the end


class MaterialSearch(Enum):
    """How many materials the subject has, where no number is given."""

    AUTO = "auto"  # as many as are found; the rig's alone where it does not hold its lamps' colours
    CALIBRATED = "calibrated"  # one: what the rig was calibrated on


@dataclass(frozen=True, kw_only=True)
class ReconstructOptions(Options):
    """Options of `reconstruct`, with those of its stages.

    With the rig of a tactile gel, materials and shadows are off.
    """

    to: Named[Product, Literal["normals", "depth", "mesh"]] = named(Product.MESH)
    """How far to go; each includes what comes before it."""
    distance_m: Annotated[float | None, positive("a positive number of metres")] = None
    """Distance in metres from a perspective camera to the subject, along the optical axis. It fixes the scale
    that normals alone leave free."""
    materials: Named[MaterialSearch | int, Literal["auto", "calibrated"] | int] = named(MaterialSearch.AUTO)
    """How many materials the subject has: a number, or auto to find as many as there are, or calibrated for
    the calibration material alone. Their reflectances are found in some of the frames. A rig without the
    colours of its lamps knows the calibration material alone."""
    shadows: Named[ShadowMethod, ShadowMethodName] = named(ShadowMethod.ROBUST)
    """Method that finds where the subject shadows itself: robust, published (the paper's detector) or none.
    The surface in shadow is then recovered, and visibility labels are written."""
    reference_frame: Annotated[int | None, within(0, words="a frame number")] = None
    """The constant that normals leave free in depth is tied to this frame. Noise and the blur of materials'
    seams are measured in it. Default: the first of all frames that were asked for."""
    smoothing: Annotated[float, within(0, 1, "a share of full scale from 0 to 1")] = 0.0
    """Average a pixel with the frames before and after where its colour differs by less than this share of
    full scale. 0 is off; about 3 times the noise is useful."""
    on_error: Named[OnError, Literal["stop", "skip"]] = named(OnError.STOP)
    """What a frame that fails does: stop the run, or skip the frame and name it at the end."""
    inversion: InversionOptions = field(default_factory=InversionOptions)
    integration: IntegrationOptions = field(default_factory=IntegrationOptions)
    meshing: MeshOptions = field(default_factory=MeshOptions)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.materials, MaterialSearch) and not 1 <= self.materials <= MOST_MATERIALS:
            raise BadInput(
                f"materials: expected auto, calibrated or a number from 1 to {MOST_MATERIALS}, got "
                f"{self.materials}"
            )
