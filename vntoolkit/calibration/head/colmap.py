"""Poses, points and focal length adjusted to tracks by COLMAP.

COLMAP puts the centre of the top left pixel at (0.5, 0.5), this toolkit at (0, 0): all ways between them,
those of `mapping` and `sift` too, go through this file's functions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vntoolkit.arrays import BoolArray, FloatArray, IntArray, Points, Points2, read_only
from vntoolkit.calibration.head.tracks import Tracks
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.rigid import RigidTransform

_PIXEL_CENTRE = 0.5  # COLMAP's centre of the first pixel less ours
_CAMERA_ID = 1
_ITERATIONS, _TOLERANCE = 15, 1e-4  # of a round: more of both moves no pose by a hundredth of a degree
# Per round, pixels: the scale of the Cauchy loss, and the error beyond which an observation is then dropped.
_ROUNDS_PX = ((1.0, 4.0), (0.3, 1.0), (0.3, 1.0))
_LEAST_ANGLE_DEG = 1.5  # between a point's rays: below it the depth is noise
_LEAST_POINTS = 10  # that an image must show for its pose to count


@dataclass(frozen=True, kw_only=True, eq=False)
class SparseModel:
    """What the tracks of a rigid head give; the length unit is free.

    camera: with the focal length that was used or refined. camera_from_head: per frame used, None where the
    frame could not be placed. points_in_head: (n, 3). point: (n,) the track of each. error_px: mean
    reprojection error. observations: how many it rests on.
    """

    camera: Camera
    camera_from_head: tuple[RigidTransform | None, ...]
    points_in_head: Points
    point: IntArray
    error_px: float
    observations: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_in_head", read_only(np.asarray(self.points_in_head)))


def adjust_sparse_model(
    tracks: Tracks,
    camera: Camera,
    camera_from_head: Sequence[RigidTransform | None],
    points_in_head: Points,
    known: BoolArray,
    *,
    refine_focal: bool = False,
) -> SparseModel:
    """Adjust poses and points to all tracks at once, robustly (bundle adjustment: triggs2000).

    camera_from_head: initial pose per frame, None where there is none. points_in_head: (n, 3) initial point
    per track, valid where `known` (n,). refine_focal: the camera's focal length is refined, too.
    Tracks that follow shading, highlights, neck or shoulders disagree with the rest and are dropped.
    """
    reconstruction = _reconstruction(tracks, camera, camera_from_head, points_in_head, known)
    _adjust(reconstruction, refine_focal)
    return _sparse_model(reconstruction, tracks, camera)


def _reconstruction(
    tracks: Tracks,
    camera: Camera,
    poses: Sequence[RigidTransform | None],
    points: Points,
    known: BoolArray,
) -> Any:
    import pycolmap

    reconstruction = pycolmap.Reconstruction()
    reconstruction.add_camera_with_trivial_rig(camera_for_colmap(camera))
    place = np.zeros(len(tracks.point), dtype=np.int64)  # of an observation among those of its frame
    for k, pose in enumerate(poses):
        rows = np.flatnonzero(tracks.frame == k)
        place[rows] = np.arange(len(rows))
        if pose is None:
            continue
        pixels = colmap_from_pixels(tracks.positions_px[rows])
        image = pycolmap.Image(name=f"{k:06d}", keypoints=pixels, camera_id=_CAMERA_ID, image_id=k + 1)
        reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose.matrix[:3]))
    placed = np.array([pose is not None for pose in poses])
    starts = np.searchsorted(tracks.point, np.arange(tracks.point_count + 1))
    for point in np.flatnonzero(known):
        rows = np.arange(starts[point], starts[point + 1])
        rows = rows[placed[tracks.frame[rows]]]
        if len(rows) < 2:
            continue
        elements = [pycolmap.TrackElement(int(tracks.frame[r]) + 1, int(place[r])) for r in rows]
        track = pycolmap.Track(elements=elements)
        reconstruction.add_point3D_with_id(int(point) + 1, pycolmap.Point3D(xyz=points[point], track=track))
    return reconstruction


def _adjust(reconstruction: Any, refine_focal: bool) -> None:
    import pycolmap

    adjustment = pycolmap.BundleAdjustmentOptions()
    adjustment.refine_focal_length = refine_focal
    adjustment.refine_extra_params = False
    adjustment.refine_principal_point = False
    adjustment.print_summary = False
    adjustment.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    adjustment.ceres.solver_options.num_threads = 1  # the same footage gives the same poses
    adjustment.ceres.solver_options.max_num_iterations = _ITERATIONS * (4 if refine_focal else 1)
    adjustment.ceres.solver_options.function_tolerance = _TOLERANCE
    for loss_px, largest_px in _ROUNDS_PX:
        adjustment.ceres.loss_function_scale = loss_px
        config = pycolmap.BundleAdjustmentConfig()
        for image_id in reconstruction.reg_image_ids():
            config.add_image(image_id)
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        if not refine_focal:
            config.set_constant_cam_intrinsics(_CAMERA_ID)
        pycolmap.create_default_bundle_adjuster(adjustment, config, reconstruction).solve()
        manager = pycolmap.ObservationManager(reconstruction)
        manager.filter_all_points3D(largest_px, _LEAST_ANGLE_DEG)


def _sparse_model(reconstruction: Any, tracks: Tracks, camera: Camera) -> SparseModel:
    poses: list[RigidTransform | None] = [None] * tracks.frame_count
    for image_id in reconstruction.reg_image_ids():
        image = reconstruction.image(image_id)
        if image.num_points3D >= _LEAST_POINTS:
            poses[image_id - 1] = RigidTransform.from_matrix(image.cam_from_world().matrix())
    numbers = sorted(reconstruction.points3D)
    points = np.array([reconstruction.point3D(n).xyz for n in numbers]).reshape(-1, 3)
    return SparseModel(
        camera=camera_from_colmap(next(iter(reconstruction.cameras.values())), camera),
        camera_from_head=tuple(poses),
        points_in_head=points,
        point=np.array(numbers, dtype=np.int64) - 1,
        error_px=float(reconstruction.compute_mean_reprojection_error()),
        observations=int(reconstruction.compute_num_observations()),
    )


def colmap_from_pixels(positions_px: Points2) -> FloatArray:
    """Move pixel positions (…, 2) from centres at integers to centres at a half."""
    return np.asarray(positions_px, dtype=np.float64) + _PIXEL_CENTRE


def pixels_from_colmap(positions: FloatArray) -> Points2:
    """Move pixel positions (…, 2) from centres at a half to centres at integers."""
    return np.asarray(positions, dtype=np.float64) - _PIXEL_CENTRE


def camera_for_colmap(camera: Camera) -> Any:
    """Return the pycolmap camera whose pixel centres are at a half."""
    import pycolmap

    k = camera.matrix
    model, focal = camera.model.value, [k[0, 0], k[1, 1]]
    if camera.model is CameraModel.PINHOLE and k[0, 0] == k[1, 1]:
        # A turn about the vertical tells nothing of a second focal length.
        model, focal = "SIMPLE_PINHOLE", [k[0, 0]]
    parameters = [*focal, *colmap_from_pixels(k[:2, 2])]
    if camera.model is CameraModel.OPENCV:
        lens = camera.distortion
        if len(lens) > 4:
            model, lens = "FULL_OPENCV", np.pad(lens, (0, 8 - len(lens)))
        parameters += list(lens)
    return pycolmap.Camera(
        camera_id=_CAMERA_ID,
        model=model,
        width=camera.width,
        height=camera.height,
        params=parameters,
        has_prior_focal_length=True,
    )


def camera_from_colmap(refined: Any, camera: Camera) -> Camera:
    """Return ours from pycolmap's, which may have a refined focal length; model and size as in `camera`."""
    matrix = np.array(refined.calibration_matrix(), dtype=np.float64)
    matrix[:2, 2] = pixels_from_colmap(matrix[:2, 2])
    return Camera(
        model=camera.model,
        width=camera.width,
        height=camera.height,
        matrix=matrix,
        distortion=camera.distortion,
    )
