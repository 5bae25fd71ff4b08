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

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # importing typing takes time, and a Ctrl-C before `main` leaves a traceback
if TYPE_CHECKING:  # what editors and type checkers know; a test holds it to the names below
    from vntoolkit.calibration.fit import fit_response as fit_response
    from vntoolkit.cli.board import write_board as write_board
    from vntoolkit.cli.calibrate import calibrate_board as calibrate_board
    from vntoolkit.cli.calibrate import calibrate_head as calibrate_head
    from vntoolkit.cli.calibrate import calibrate_lights as calibrate_lights
    from vntoolkit.cli.calibrate import calibrate_presses as calibrate_presses
    from vntoolkit.cli.calibrate import calibrate_sphere as calibrate_sphere
    from vntoolkit.cli.calibrate import rectify as rectify
    from vntoolkit.cli.demo import demo as demo
    from vntoolkit.cli.doctor import inspect_footage as inspect_footage
    from vntoolkit.cli.dress import dress as dress
    from vntoolkit.cli.evaluate import evaluate_cylinder as evaluate_cylinder
    from vntoolkit.cli.evaluate import evaluate_integration as evaluate_integration
    from vntoolkit.cli.evaluate import evaluate_mesh as evaluate_mesh
    from vntoolkit.cli.evaluate import evaluate_normal_files as evaluate_normal_files
    from vntoolkit.cli.evaluate import evaluate_tracks as evaluate_tracks
    from vntoolkit.cli.export import export as export
    from vntoolkit.cli.integrate import integrate as integrate
    from vntoolkit.cli.live import watch as watch
    from vntoolkit.cli.photometric_stereo import photometric_stereo as photometric_stereo
    from vntoolkit.cli.recipe import run_recipe as run_recipe
    from vntoolkit.cli.reconstruct import reconstruct as reconstruct
    from vntoolkit.cli.report import write_report as write_report
    from vntoolkit.cli.schema import copy_data as copy_data
    from vntoolkit.cli.schema import json_schema as json_schema
    from vntoolkit.cli.session import session as session
    from vntoolkit.cli.simulate import simulate as simulate
    from vntoolkit.cli.track import track as track
    from vntoolkit.cli.view import view as view
    from vntoolkit.errors import BadInput as BadInput
    from vntoolkit.errors import VntError as VntError
    from vntoolkit.evaluation.angular_error import evaluate_normals as evaluate_normals
    from vntoolkit.geometry.camera import Camera as Camera
    from vntoolkit.geometry.camera import CameraModel as CameraModel
    from vntoolkit.geometry.maps import DepthMap as DepthMap
    from vntoolkit.geometry.maps import NormalMap as NormalMap
    from vntoolkit.geometry.mesh import Mesh as Mesh
    from vntoolkit.geometry.mesh import MeshSequence as MeshSequence
    from vntoolkit.geometry.point_cloud import PointCloud as PointCloud
    from vntoolkit.geometry.rigid import RigidTransform as RigidTransform
    from vntoolkit.integration.integrate import DepthIntegrator as DepthIntegrator
    from vntoolkit.io.footage.captures import CaptureOptions as CaptureOptions
    from vntoolkit.io.footage.captures import open_capture as open_capture
    from vntoolkit.io.maps_and_meshes.meshes import read_mesh as read_mesh
    from vntoolkit.io.maps_and_meshes.meshes import write_mesh as write_mesh
    from vntoolkit.io.rigs import read_rig as read_rig
    from vntoolkit.meshing.surface import mesh_from_depth as mesh_from_depth
    from vntoolkit.meshing.surface import point_cloud_from_depth as point_cloud_from_depth
    from vntoolkit.normals.inversion import normals_from_frame as normals_from_frame
    from vntoolkit.normals.photometric_stereo import normals_from_lights as normals_from_lights
    from vntoolkit.options.calibration import FitMethod as FitMethod
    from vntoolkit.options.calibration import ResponseFitOptions as ResponseFitOptions
    from vntoolkit.options.calibration import ResponseModel as ResponseModel
    from vntoolkit.options.depth import IntegrationOptions as IntegrationOptions
    from vntoolkit.options.depth import Integrator as Integrator
    from vntoolkit.options.depth import MeshOptions as MeshOptions
    from vntoolkit.options.export import ExportFormat as ExportFormat
    from vntoolkit.options.export import MeshUpAxis as MeshUpAxis
    from vntoolkit.options.export import NormalConvention as NormalConvention
    from vntoolkit.options.footage import Gaps as Gaps
    from vntoolkit.options.footage import MatteOptions as MatteOptions
    from vntoolkit.options.footage import SensorOptions as SensorOptions
    from vntoolkit.options.normals import InversionOptions as InversionOptions
    from vntoolkit.options.normals import RecoveryMethod as RecoveryMethod
    from vntoolkit.options.normals import ShadowMethod as ShadowMethod
    from vntoolkit.options.reconstruction import DepthOffset as DepthOffset
    from vntoolkit.options.reconstruction import MaterialSearch as MaterialSearch
    from vntoolkit.options.reconstruction import Product as Product
    from vntoolkit.options.reconstruction import ReconstructOptions as ReconstructOptions
    from vntoolkit.options.tracking import Tracker as Tracker
    from vntoolkit.options.tracking import TrackingOptions as TrackingOptions
    from vntoolkit.photometry.frame import LinearFrame as LinearFrame
    from vntoolkit.photometry.response import LightResponse as LightResponse
    from vntoolkit.photometry.rig import Rig as Rig
    from vntoolkit.photometry.transfer import Transfer as Transfer
    from vntoolkit.pipeline.gel import Gel as Gel
    from vntoolkit.pipeline.gel import Touch as Touch
    from vntoolkit.pipeline.opened_result import read_result as read_result
    from vntoolkit.shadows.detector import ShadowDetector as ShadowDetector
    from vntoolkit.shadows.recovery import recover_normals as recover_normals
    from vntoolkit.tactile.motion_maps import GelMotion as GelMotion
    from vntoolkit.tactile.pose import ObjectPose as ObjectPose
    from vntoolkit.tactile.pose import TrackedPose as TrackedPose
    from vntoolkit.tracking.tracker import SurfaceTracker as SurfaceTracker

__version__ = "0.1.0"

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
    "read_result": "vntoolkit.pipeline.opened_result",
    "evaluate_normals": "vntoolkit.evaluation.angular_error",
    "Gel": "vntoolkit.pipeline.gel",
    "Touch": "vntoolkit.pipeline.gel",
    "GelMotion": "vntoolkit.tactile.motion_maps",
    "ObjectPose": "vntoolkit.tactile.pose",
    "TrackedPose": "vntoolkit.tactile.pose",
    "SurfaceTracker": "vntoolkit.tracking.tracker",
    "MeshSequence": "vntoolkit.geometry.mesh",
    # options, and the methods that they name
    "CaptureOptions": "vntoolkit.io.footage.captures",
    "SensorOptions": "vntoolkit.options.footage",
    "MatteOptions": "vntoolkit.options.footage",
    "Gaps": "vntoolkit.options.footage",
    "ResponseFitOptions": "vntoolkit.options.calibration",
    "ResponseModel": "vntoolkit.options.calibration",
    "FitMethod": "vntoolkit.options.calibration",
    "InversionOptions": "vntoolkit.options.normals",
    "ShadowMethod": "vntoolkit.options.normals",
    "RecoveryMethod": "vntoolkit.options.normals",
    "IntegrationOptions": "vntoolkit.options.depth",
    "Integrator": "vntoolkit.options.depth",
    "MeshOptions": "vntoolkit.options.depth",
    "ReconstructOptions": "vntoolkit.options.reconstruction",
    "Product": "vntoolkit.options.reconstruction",
    "MaterialSearch": "vntoolkit.options.reconstruction",
    "DepthOffset": "vntoolkit.options.reconstruction",
    "TrackingOptions": "vntoolkit.options.tracking",
    "Tracker": "vntoolkit.options.tracking",
    "ExportFormat": "vntoolkit.options.export",
    "NormalConvention": "vntoolkit.options.export",
    "MeshUpAxis": "vntoolkit.options.export",
    # what a person can cause and correct
    "VntError": "vntoolkit.errors",
    "BadInput": "vntoolkit.errors",
    # the verbs of the command line
    "demo": "vntoolkit.cli.demo",
    "write_board": "vntoolkit.cli.board",
    "simulate": "vntoolkit.cli.simulate",
    "inspect_footage": "vntoolkit.cli.doctor",
    "calibrate_sphere": "vntoolkit.cli.calibrate",
    "calibrate_board": "vntoolkit.cli.calibrate",
    "calibrate_head": "vntoolkit.cli.calibrate",
    "calibrate_lights": "vntoolkit.cli.calibrate",
    "calibrate_presses": "vntoolkit.cli.calibrate",
    "rectify": "vntoolkit.cli.calibrate",
    "reconstruct": "vntoolkit.cli.reconstruct",
    "photometric_stereo": "vntoolkit.cli.photometric_stereo",
    "integrate": "vntoolkit.cli.integrate",
    "track": "vntoolkit.cli.track",
    "session": "vntoolkit.cli.session",
    "view": "vntoolkit.cli.view",
    "watch": "vntoolkit.cli.live",
    "export": "vntoolkit.cli.export",
    "write_report": "vntoolkit.cli.report",
    "dress": "vntoolkit.cli.dress",
    "evaluate_normal_files": "vntoolkit.cli.evaluate",
    "evaluate_mesh": "vntoolkit.cli.evaluate",
    "evaluate_cylinder": "vntoolkit.cli.evaluate",
    "evaluate_tracks": "vntoolkit.cli.evaluate",
    "evaluate_integration": "vntoolkit.cli.evaluate",
    "json_schema": "vntoolkit.cli.schema",
    "copy_data": "vntoolkit.cli.schema",
    "run_recipe": "vntoolkit.cli.recipe",
}

if not TYPE_CHECKING:  # else a type checker takes every name for a public one
    __all__ = [*_PUBLIC, "__version__"]

    def __getattr__(name):
        if name not in _PUBLIC:
            raise AttributeError(f"module 'vntoolkit' has no attribute '{name}'")
        return getattr(importlib.import_module(_PUBLIC[name]), name)

    def __dir__():
        return sorted(__all__)
