"""`vntoolkit integrate`: depth and meshes from anyone's normal maps."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

from vntoolkit.cli.output import ProgressBars, print_next, say
from vntoolkit.cli.verb import command, verb
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.results.manifest import ReconstructionFolder
from vntoolkit.options.base import File, Named, OptionalFile, Source, named
from vntoolkit.options.depth import IntegrationOptions, MeshOptions
from vntoolkit.options.export import NormalConvention, NormalConventionName
from vntoolkit.options.footage import PictureLimits
from vntoolkit.options.reconstruction import Product
from vntoolkit.options.shared import FrameOptions
from vntoolkit.pipeline.integrate_normals import IntegrateJob, integrate_normals
from vntoolkit.pipeline.opened_result import OpenedResult, open_result


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
    to: Named[Product, Literal["normals", "depth", "mesh"]] = named(Product.MESH)
    """How far to go: depth or mesh."""
    overwrite: bool = False
    """Replace the results that the folder holds."""


@verb(IntegrateArguments)
def integrate(asked: IntegrateArguments) -> OpenedResult:
    """Compute depth and meshes from normal maps of any origin.

    The folder is one as `vntoolkit reconstruct` writes: view, report and export read it.
    """
    job = IntegrateJob(
        source=str(asked.source),
        folder=ReconstructionFolder(root=Path(asked.out)),
        mask=asked.mask,
        camera=asked.camera,
        focal_px=asked.focal_px,
        convention=asked.convention,
        distance_m=asked.distance,
        to=asked.to,
        frames=FrameRange.from_text(asked.frames or "::"),
        integration=asked.part(IntegrationOptions),
        meshing=asked.part(MeshOptions),
    )
    with ProgressBars() as bars:
        begin = partial(bars.begin, "integrate")
        folder = integrate_normals(job, overwrite=asked.overwrite, on_start=begin, on_frame=bars.step)
    result = open_result(folder)
    count = len(result.frames)
    say(f"{folder}: depth of {count} normal map{'' if count == 1 else 's'}")
    print_next("view", folder)
    return result


integrate_command = command(integrate)
