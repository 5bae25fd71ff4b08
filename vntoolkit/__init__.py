"""Surface normals, depth and moving meshes from video under three coloured lights.

The floors, from the ground up; imports go strictly down:

    0    arrays, errors, checks, native, libraries, shipped    foundations
    1    geometry, photometry              the objects that flow between the stages
    1.8  options                           option types and enums of all verbs
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

__version__ = "1.0.0"

TYPE_CHECKING = False  # nothing is imported here: a Ctrl-C before `main` leaves a traceback
if TYPE_CHECKING:
    # isort: off
    # The public names, in pipeline order: type checkers import them here, and `_modules` reads them.
    from vntoolkit.geometry.camera import Camera as Camera
    from vntoolkit.geometry.camera import CameraModel as CameraModel
    from vntoolkit.geometry.rigid import RigidTransform as RigidTransform
    from vntoolkit.io.footage.captures import open_capture as open_capture
    from vntoolkit.io.rigs import read_rig as read_rig
    from vntoolkit.photometry.frame import LinearFrame as LinearFrame
    from vntoolkit.photometry.transfer import Transfer as Transfer
    from vntoolkit.photometry.response import LightResponse as LightResponse
    from vntoolkit.photometry.rig import Rig as Rig
    from vntoolkit.calibration.fit import fit_response as fit_response
    from vntoolkit.shadows.detector import ShadowDetector as ShadowDetector
    from vntoolkit.normals.inversion import normals_from_frame as normals_from_frame
    from vntoolkit.normals.photometric_stereo import normals_from_lights as normals_from_lights
    from vntoolkit.shadows.recovery import recover_normals as recover_normals
    from vntoolkit.geometry.maps import NormalMap as NormalMap
    from vntoolkit.integration.integrate import DepthIntegrator as DepthIntegrator
    from vntoolkit.geometry.maps import DepthMap as DepthMap
    from vntoolkit.meshing.surface import mesh_from_depth as mesh_from_depth
    from vntoolkit.meshing.surface import point_cloud_from_depth as point_cloud_from_depth
    from vntoolkit.geometry.point_cloud import PointCloud as PointCloud
    from vntoolkit.geometry.mesh import Mesh as Mesh
    from vntoolkit.io.maps_and_meshes.meshes import read_mesh as read_mesh
    from vntoolkit.io.maps_and_meshes.meshes import write_mesh as write_mesh
    from vntoolkit.pipeline.opened_result import read_result as read_result
    from vntoolkit.evaluation.angular_error import evaluate_normals as evaluate_normals
    from vntoolkit.pipeline.gel import Gel as Gel
    from vntoolkit.pipeline.gel import Touch as Touch
    from vntoolkit.tactile.motion_maps import GelMotion as GelMotion
    from vntoolkit.tactile.pose import ObjectPose as ObjectPose
    from vntoolkit.tactile.pose import TrackedPose as TrackedPose
    from vntoolkit.tracking.tracker import SurfaceTracker as SurfaceTracker
    from vntoolkit.geometry.mesh import MeshSequence as MeshSequence

    # options, and the methods that they name
    from vntoolkit.io.footage.captures import CaptureOptions as CaptureOptions
    from vntoolkit.options.footage import SensorOptions as SensorOptions
    from vntoolkit.options.footage import MatteOptions as MatteOptions
    from vntoolkit.options.footage import Gaps as Gaps
    from vntoolkit.options.calibration import ResponseFitOptions as ResponseFitOptions
    from vntoolkit.options.calibration import ResponseModel as ResponseModel
    from vntoolkit.options.calibration import FitMethod as FitMethod
    from vntoolkit.options.normals import InversionOptions as InversionOptions
    from vntoolkit.options.normals import ShadowMethod as ShadowMethod
    from vntoolkit.options.normals import RecoveryMethod as RecoveryMethod
    from vntoolkit.options.depth import IntegrationOptions as IntegrationOptions
    from vntoolkit.options.depth import Integrator as Integrator
    from vntoolkit.options.depth import MeshOptions as MeshOptions
    from vntoolkit.options.reconstruction import ReconstructOptions as ReconstructOptions
    from vntoolkit.options.reconstruction import Product as Product
    from vntoolkit.options.reconstruction import MaterialSearch as MaterialSearch
    from vntoolkit.options.tracking import TrackingOptions as TrackingOptions
    from vntoolkit.options.tracking import Tracker as Tracker
    from vntoolkit.options.export import ExportFormat as ExportFormat
    from vntoolkit.options.export import NormalConvention as NormalConvention
    from vntoolkit.options.export import MeshUpAxis as MeshUpAxis

    # what a person can cause and correct
    from vntoolkit.errors import VntError as VntError
    from vntoolkit.errors import BadInput as BadInput

    # the verbs of the command line
    from vntoolkit.cli.demo import demo as demo
    from vntoolkit.cli.board import write_board as write_board
    from vntoolkit.cli.simulate import simulate as simulate
    from vntoolkit.cli.doctor import inspect_footage as inspect_footage
    from vntoolkit.cli.calibrate import calibrate_sphere as calibrate_sphere
    from vntoolkit.cli.calibrate import calibrate_board as calibrate_board
    from vntoolkit.cli.calibrate import calibrate_head as calibrate_head
    from vntoolkit.cli.calibrate import calibrate_lights as calibrate_lights
    from vntoolkit.cli.calibrate import calibrate_presses as calibrate_presses
    from vntoolkit.cli.calibrate import rectify as rectify
    from vntoolkit.cli.reconstruct import reconstruct as reconstruct
    from vntoolkit.cli.photometric_stereo import photometric_stereo as photometric_stereo
    from vntoolkit.cli.integrate import integrate as integrate
    from vntoolkit.cli.track import track as track
    from vntoolkit.cli.session import session as session
    from vntoolkit.cli.view import view as view
    from vntoolkit.cli.live import watch as watch
    from vntoolkit.cli.export import export as export
    from vntoolkit.cli.report import write_report as write_report
    from vntoolkit.cli.dress import dress as dress
    from vntoolkit.cli.evaluate import evaluate_normal_files as evaluate_normal_files
    from vntoolkit.cli.evaluate import evaluate_mesh as evaluate_mesh
    from vntoolkit.cli.evaluate import evaluate_cylinder as evaluate_cylinder
    from vntoolkit.cli.evaluate import evaluate_tracks as evaluate_tracks
    from vntoolkit.cli.evaluate import evaluate_integration as evaluate_integration
    from vntoolkit.cli.schema import json_schema as json_schema
    from vntoolkit.cli.schema import copy_data as copy_data
    from vntoolkit.cli.recipe import run_recipe as run_recipe
    # isort: on
else:  # else a type checker takes every name for a public one

    def _modules():
        """Return public name -> module that holds it, as stated above."""
        with open(__file__, encoding="utf-8") as source:  # noqa: PTH123 - pathlib takes time
            stated = [line.split() for line in source if line.startswith("    from vntoolkit.")]
        return {name: module for _, module, _, name, *_ in stated}

    _PUBLIC = _modules()
    __all__ = [*_PUBLIC, "__version__"]

    def __getattr__(name):
        import importlib

        if name not in _PUBLIC:
            raise AttributeError(f"module 'vntoolkit' has no attribute '{name}'")
        return getattr(importlib.import_module(_PUBLIC[name]), name)

    def __dir__():
        return sorted(__all__)
