"""One frame of a result, as a recording holds it."""

from dataclasses import dataclass

from vntoolkit.arrays import ByteArray, Float32Array, Mask
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rigid import RigidTransform


@dataclass(frozen=True, kw_only=True)
class Stamp:
    """When a picture was filmed: nanoseconds by the recorder's clock and by the camera's, and its frame."""

    logged_ns: int
    filmed_ns: int
    frame_id: str


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedFrame:
    """What is known of a frame; None for what is not.

    time_s: from the first frame. stamp: of the picture in its recording. picture: (h, w, 3) sRGB.
    contact_mm2, contact_depth_mm: of `contact`. moved_px: (h, w, 2), motion of a gel's material, NaN where it
    is lost. mesh: in the axes and lengths of files. object_from_first:
    motion of what touches a gel since its contact began, in the axes and lengths of the mesh.
    """

    number: int
    time_s: float
    stamp: Stamp
    normals: NormalMap
    picture: ByteArray | None = None
    depth: DepthMap | None = None
    contact: Mask | None = None
    contact_mm2: float | None = None
    contact_depth_mm: float | None = None
    moved_px: Float32Array | None = None
    mesh: Mesh | None = None
    object_from_first: RigidTransform | None = None
