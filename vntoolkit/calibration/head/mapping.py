"""Initial poses and points from tracks by COLMAP's incremental mapping (schoenberger2016)."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from vntoolkit.arrays import Int64Array
from vntoolkit.calibration.head import colmap
from vntoolkit.calibration.head.factorisation import InitialPoses
from vntoolkit.calibration.head.tracks import Tracks
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rigid import RigidTransform

_ALL_PAIRS, _APART = 40, 20  # of so many frames all pairs count, of more those at most so far apart
_START_ANGLE_DEG, _START_INLIERS = 8.0, 40  # of the first pair
_ERROR_PX, _PLACING_ERROR_PX = 2.0, 4.0
_LEAST_SHARED_TRACKS = 15  # tracks of a pair of frames
_LEAST_INLIERS = 8  # points that place a frame


def map_tracks(tracks: Tracks, camera: Camera, *, refine_focal: bool) -> InitialPoses:
    """Return camera_from_head per frame (None where not placed), points (n, 3) and which are known (n,).

    Raises `BadCalibration` where nothing rigid comes out.
    """
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value  # what fails is raised below
    rows = [np.flatnonzero(tracks.frame == k) for k in range(tracks.frame_count)]
    with tempfile.TemporaryDirectory(prefix="vntoolkit-") as folder:
        path = Path(folder) / "tracks.db"
        _write_database(path, tracks, rows, camera)
        models = pycolmap.incremental_mapping(path, folder, folder, _pipeline(refine_focal))
    if not models:
        raise BadCalibration(
            "poses: no two frames of the features fit a rigid turning head; film at most 20 degrees from "
            "frame to frame, sharply, with a fixed expression"
        )
    model = max(models.values(), key=lambda each: int(each.num_reg_images()))
    poses: list[RigidTransform | None] = [None] * tracks.frame_count
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        poses[int(image.name)] = RigidTransform.from_matrix(image.cam_from_world().matrix())
    points, known = np.zeros((tracks.point_count, 3)), np.zeros(tracks.point_count, np.bool_)
    for each in model.points3D.values():
        element = each.track.elements[0]
        own = rows[int(model.image(element.image_id).name)][element.point2D_idx]
        points[tracks.point[own]], known[tracks.point[own]] = each.xyz, True
    return poses, points, known


def _pipeline(refine_focal: bool) -> Any:
    import pycolmap

    pipeline = pycolmap.IncrementalPipelineOptions()
    pipeline.multiple_models = False
    pipeline.extract_colors = False
    pipeline.random_seed = 0
    pipeline.num_threads = 1  # the same footage gives the same poses
    pipeline.min_model_size = 3
    pipeline.min_num_matches = _LEAST_SHARED_TRACKS
    pipeline.ba_refine_focal_length = refine_focal
    pipeline.ba_refine_extra_params = False
    pipeline.mapper.init_min_num_inliers = _START_INLIERS
    pipeline.mapper.init_min_tri_angle = _START_ANGLE_DEG
    pipeline.mapper.init_max_error = _ERROR_PX
    pipeline.mapper.abs_pose_max_error = _PLACING_ERROR_PX
    pipeline.mapper.abs_pose_min_num_inliers = _LEAST_INLIERS
    pipeline.mapper.abs_pose_min_inlier_ratio = 0.1
    pipeline.mapper.abs_pose_refine_focal_length = False
    pipeline.mapper.abs_pose_refine_extra_params = False
    pipeline.mapper.filter_max_reproj_error = _ERROR_PX
    return pipeline


def _write_database(path: Path, tracks: Tracks, rows: list[Int64Array], camera: Camera) -> None:
    import pycolmap

    with pycolmap.Database.open(path) as database:
        camera_id = database.write_camera(colmap.camera_for_colmap(camera))
        sensor = pycolmap.sensor_t(type=pycolmap.SensorType.CAMERA, id=camera_id)
        rig = pycolmap.Rig()
        rig.add_ref_sensor(sensor)
        rig_id = database.write_rig(rig)
        images = []
        for k, own in enumerate(rows):
            images.append(database.write_image(pycolmap.Image(name=f"{k:06d}", camera_id=camera_id)))
            frame = pycolmap.Frame()
            frame.rig_id = rig_id
            frame.add_data_id(pycolmap.data_t(sensor_id=sensor, id=images[-1]))
            database.write_frame(frame)
            database.write_keypoints(
                images[-1], colmap.colmap_from_pixels(tracks.positions_px[own]).astype("f4")
            )
        for i, j in _pairs_of(tracks):
            _, a, b = np.intersect1d(tracks.point[rows[i]], tracks.point[rows[j]], return_indices=True)
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            geometry.inlier_matches = np.column_stack([a, b]).astype(np.uint32)
            database.write_two_view_geometry(images[i], images[j], geometry)


def _pairs_of(tracks: Tracks) -> list[tuple[int, int]]:
    """Return the pairs of frames that share enough tracks."""
    seen = sparse.csr_array(
        (np.ones(len(tracks.point), np.int32), (tracks.frame, tracks.point)),
        shape=(tracks.frame_count, tracks.point_count),
    )
    shared = (seen @ seen.T).toarray()
    furthest = tracks.frame_count if tracks.frame_count <= _ALL_PAIRS else _APART
    first, second = np.nonzero(np.triu(shared >= _LEAST_SHARED_TRACKS, 1))
    return [(int(i), int(j)) for i, j in zip(first, second, strict=True) if j - i <= furthest]
