"""`vntoolkit photometric-stereo`: normals from photographs under one white lamp each."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vntoolkit.cli.given import curve_from_text
from vntoolkit.cli.output import print_next, progress_bar, say
from vntoolkit.cli.verb import command, verb
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.results.folder import write_lock
from vntoolkit.options.base import File, OptionalFile, named
from vntoolkit.options.footage import PictureLimits
from vntoolkit.options.shared import CurveOptions
from vntoolkit.pipeline.photometric_stereo import StereoJob
from vntoolkit.pipeline.photometric_stereo import photometric_stereo as run


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


@verb(PhotometricStereoArguments)
def photometric_stereo(asked: PhotometricStereoArguments) -> NormalMap:
    """Compute normals from photographs under one lamp each; shadowed and glossy samples are left out.

    The folder is laid out as DiLiGenT's results, and `vntoolkit integrate` reads it.
    """
    job = StereoJob(
        folder=Path(asked.folder),
        out=Path(asked.out),
        lights=asked.lights,
        mask=asked.mask,
        transfer=curve_from_text(asked.transfer),
    )
    with write_lock(job.out), progress_bar("photographs", 0) as advance:
        found = run(job, advance)
    say(f"{asked.out}: {int(found.mask.sum())} normals")
    if found.error_deg is not None:
        say(f"expected error: {np.median(found.error_deg[found.mask]):.1f} degrees, the median")
    print_next("integrate", str(asked.out), "--out", "result")
    return found


photometric_stereo_command = command(photometric_stereo)
