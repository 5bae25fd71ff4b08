"""Read every file of a folder; print name, peak of memory so far in MB, and why it was refused."""

import resource
import sys
from pathlib import Path

import cv2
import OpenEXR
import tifffile

from vntoolkit.errors import VntError
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.maps_and_meshes.arrays import read_npz
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.motion.bvh import read_bvh
from vntoolkit.io.results.frame_log import FrameLog
from vntoolkit.io.rigs import read_rig

LOADED = (cv2, OpenEXR, tifffile)  # their own megabytes are no file's
READERS = {
    ".obj": read_mesh,
    ".ply": read_mesh,
    ".bvh": read_bvh,
    ".json": read_rig,
    ".npz": lambda path: read_npz(path, "depth"),
    ".log": lambda path: FrameLog(path.parent).entries(),
}


def peak_mb() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


before = peak_mb()
for path in sorted(Path(sys.argv[1]).iterdir()):
    try:
        READERS.get(path.suffix, read_image)(path)
    except VntError as error:
        sys.stdout.write(f"{path.name} {peak_mb() - before} {error}\n")
    else:
        sys.exit(f"{path} was let in")
