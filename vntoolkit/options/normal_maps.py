"""What `integrate` takes of anyone's normal maps, and `photometric-stereo` of photographs."""

from dataclasses import dataclass, field
from typing import Literal

from vntoolkit.options.base import File, Named, OptionalFile, Source, named
from vntoolkit.options.depth import IntegrationOptions, MeshOptions
from vntoolkit.options.export import NormalConvention, NormalConventionName
from vntoolkit.options.footage import PictureLimits
from vntoolkit.options.reconstruction import Product
from vntoolkit.options.shared import CurveOptions, FrameOptions


@dataclass(frozen=True, kw_only=True)
class IntegrateArguments(FrameOptions, IntegrationOptions, MeshOptions, PictureLimits):
    """What `integrate` takes."""

    source: Source = field(kw_only=False)
    """A normal map (PNG, TIFF or JPEG of 8 or 16 bits or floats, EXR, NPZ, DiLiGenT's .mat), a folder of
    them, or a video."""
    out: File
    """The folder to write: normals, depth, mesh and reconstruction.json."""
    mask: OptionalFile = named(None)
    """White where the subject is. Default: mask.png beside a single map; else all but a black, white, grey or
    flat-blue background."""
    camera: OptionalFile = named(None)
    """A rig.json, or a text file with the nine numbers of K. Default: K.txt beside a single map, else
    orthographic."""
    focal_px: float | None = None
    """Focal length in pixels; use it instead of --camera."""
    convention: Named[NormalConvention | None, NormalConventionName | None] = named(None)
    """Axes of the maps: opengl (y up, z to the viewer), directx (y down, z to the viewer) or opencv (y down,
    z away). Default: what the file states, else what the first map itself tells."""
    distance: float | None = None
    """Distance in metres from a perspective camera to the subject. It fixes the scale."""
    prior: OptionalFile = named(None)
    """Depth that is known, of stereo or a sensor: an EXR with a channel Z, of the map's size. In metres, in
    pixels for an orthographic camera. NaN where it is not known."""
    prior_error: str | None = None
    """What nine of ten errors of the prior stay within: a number, in millimetres (in pixels for an
    orthographic camera), or an EXR in the prior's unit. Default: what the prior states."""
    to: Named[Product, Literal["normals", "depth", "mesh"]] = named(Product.MESH)
    """How far to go: depth or mesh."""
    overwrite: bool = False
    """Replace the results that the folder holds."""


@dataclass(frozen=True, kw_only=True)
class PhotometricStereoArguments(CurveOptions, PictureLimits):
    """What `photometric_stereo` takes."""

    folder: File = field(kw_only=False)
    """A folder of photographs from one place, each under one lamp, or an object of DiLiGenT."""
    out: File
    """The folder to write: normals.exr with expected errors, normal.png, Normal_est.mat, mask.png and
    albedo.png."""
    lights: OptionalFile = named(None)
    """A text file with one row for each photograph, in the order of their names: x y z towards the lamp (x
    right, y up, z towards the viewer), and perhaps red green blue. Default: light_directions.txt in the
    folder."""
    mask: OptionalFile = named(None)
    """White where the subject is. Default: mask.png in the folder."""
