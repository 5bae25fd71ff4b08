"""Surface normals, depth and moving meshes from video under three coloured lights.

The floors, from the ground up; imports go strictly down:

    0    arrays, errors, checks, native    foundations
    1    geometry, photometry              the objects that flow between the stages
    2    io, calibration, materials, simulation, normals, shadows,
         integration, meshing, tactile, tracking, skinning, evaluation      stages; none imports another
    2.5  diagnosis                         whether footage, rig and result can be trusted
    3    pipeline                          stages joined, one file a job
    3.5  report                            figures, HTML pages, the viewer
    3.7  live                              the live view of a camera
    4    cli                               the command line

Stages exchange these objects:

    LinearFrame -> NormalMap -> DepthMap -> Mesh -> MeshSequence

Public names are imported on first use, so that `import vntoolkit` is fast.
"""

from __future__ import annotations

import importlib
import os

TYPE_CHECKING = False  # importing typing takes time, and a Ctrl-C before `main` leaves a traceback
if TYPE_CHECKING:
    from typing import Any

__version__ = "0.1.0"

# Thread pools that spin while they wait take the cores from the pool that works: a frame then takes 17 to
# 22 ms instead of 7. numba would try TBB first and warn of an old one. What the user has set stays; a library
# that is imported before this package keeps its own ways.
for _name, _value in {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "PASSIVE",
    "GOMP_SPINCOUNT": "0",
    "KMP_BLOCKTIME": "0",
    "NUMBA_THREADING_LAYER_PRIORITY": "omp tbb workqueue",
}.items():
    os.environ.setdefault(_name, _value)

# In pipeline order: public name -> module that holds it.
_PUBLIC = {
    "Camera": "vntoolkit.geometry.camera",
    "CameraModel": "vntoolkit.geometry.camera",
    "RigidTransform": "vntoolkit.geometry.rigid",
    "open_capture": "vntoolkit.io.footage.captures",
    "read_rig": "vntoolkit.io.rigs",
    "LinearFrame": "vntoolkit.photometry.frame",
    "Transfer": "vntoolkit.photometry.transfer",
    "LightResponse": "vntoolkit.photometry.response",
    "Rig": "vntoolkit.photometry.rig",
    "fit_response": "vntoolkit.calibration.fit",
    "ShadowDetector": "vntoolkit.shadows.detector",
    "normals_from_frame": "vntoolkit.normals.inversion",
    "normals_from_lights": "vntoolkit.normals.photometric_stereo",
    "recover_normals": "vntoolkit.shadows.recovery",
    "NormalMap": "vntoolkit.geometry.maps",
    "DepthIntegrator": "vntoolkit.integration.integrate",
    "DepthMap": "vntoolkit.geometry.maps",
    "mesh_from_depth": "vntoolkit.meshing.surface",
    "point_cloud_from_depth": "vntoolkit.meshing.surface",
    "PointCloud": "vntoolkit.geometry.point_cloud",
    "Mesh": "vntoolkit.geometry.mesh",
    "read_mesh": "vntoolkit.io.maps_and_meshes.meshes",
    "write_mesh": "vntoolkit.io.maps_and_meshes.meshes",
    "Gel": "vntoolkit.pipeline.gel",
    "Touch": "vntoolkit.pipeline.gel",
    "SurfaceTracker": "vntoolkit.tracking.tracker",
    "MeshSequence": "vntoolkit.geometry.mesh",
    # the verbs of the command line
    "simulate": "vntoolkit.cli.functions",
    "calibrate_sphere": "vntoolkit.cli.functions",
    "calibrate_board": "vntoolkit.cli.functions",
    "calibrate_head": "vntoolkit.cli.functions",
    "calibrate_lights": "vntoolkit.cli.functions",
    "calibrate_presses": "vntoolkit.cli.functions",
    "reconstruct": "vntoolkit.cli.functions",
    "track": "vntoolkit.cli.functions",
    "dress": "vntoolkit.cli.functions",
    "export": "vntoolkit.cli.functions",
}

__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'vntoolkit' has no attribute '{name}'")
    return getattr(importlib.import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
