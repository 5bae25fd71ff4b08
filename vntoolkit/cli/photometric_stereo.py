"""`vntoolkit photometric-stereo`: normals from photographs under one white lamp each."""

from pathlib import Path

import numpy as np

from vntoolkit.cli.output import print_next, say, unused
from vntoolkit.cli.verb import verb
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.results.folder import write_lock
from vntoolkit.options.normal_maps import PhotometricStereoArguments
from vntoolkit.pipeline.photometric_stereo import photometric_stereo as run


@verb(PhotometricStereoArguments)
def photometric_stereo(asked: PhotometricStereoArguments) -> NormalMap:
    """Compute normals from photographs under one lamp each; shadowed and glossy samples are left out.

    The folder is laid out as DiLiGenT's results, and `vntoolkit integrate` reads it.
    """
    with write_lock(Path(asked.out)):
        found = run(asked)
    say(f"{asked.out}: {int(found.mask.sum())} normals")
    if found.error_deg is not None:
        say(f"expected error: {np.median(found.error_deg[found.mask]):.1f} degrees, the median")
    print_next("integrate", str(asked.out), "--out", unused("result"))
    return found
