"""Shapes from photographs of a real dinosaur and a real David with their own cameras."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vntoolkit.calibration.head.hull import Box, HullOptions, SilhouetteView, fit_hull, mesh_of_grid
from vntoolkit.calibration.head.poses import PoseOptions, PoseStart, solve_head_motion
from vntoolkit.calibration.head.shape import FusionOptions, fuse_points
from vntoolkit.calibration.head.sift import SiftBuilder, require_features
from vntoolkit.calibration.head.stereo import StereoOptions, hull_depth, stereo_points
from vntoolkit.calibration.head.tracks import local_contrast
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.pipeline.calibrate import CalibrationJob
from vntoolkit.pipeline.calibrate_head import calibrate_head

STEREO = StereoOptions(
    neighbour_angles_deg=(20.0,), least_correlation=0.8, stereo_window_px=9, smoothing_px=1.0
)
FUSION = FusionOptions(fusion_depth=8, confirmations=2, hull_gap=0.006)


def largest_region(bright):
    _, labels, stats, _ = cv2.connectedComponentsWithStats(bright.astype(np.uint8))
    return labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])


def view_of(matrix, rotation, translation, mask):
    left, _, right = np.linalg.svd(rotation)
    camera = Camera(model=CameraModel.PINHOLE, width=640, height=480, matrix=matrix)
    pose = RigidTransform(rotation=left @ right, translation=translation)
    return SilhouetteView(camera=camera, camera_from_head=pose, mask=mask)


def read(path):
    return cv2.imread(str(path))[..., ::-1].astype(np.float32) / 255


def dinosaur(folder):
    views, images = [], []
    for line in (folder / "dinoSR_par.txt").read_text().splitlines()[1:]:
        name, *values = line.split()
        numbers = np.array(values, dtype=float)
        images.append(read(folder / name))
        # the ceramic throws dark shadows on itself: close them
        bright = cv2.morphologyEx(
            (images[-1].mean(axis=2) > 0.1).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7))
        )
        mask = largest_region(bright)
        views.append(view_of(numbers[:9].reshape(3, 3), numbers[9:18].reshape(3, 3), numbers[18:], mask))
    low, high = np.array([-0.061897, -0.018874, -0.057845]), np.array([0.010897, 0.068227, 0.015495])
    return views, images, Box(low=low - 0.005, high=high + 0.005)


def david(folder):
    matrix = np.array([[685, 0, 322.6], [0, 685.5, 232.2], [0, 0, 1.0]])
    views, images = [], []
    for number in range(18):
        projection = np.linalg.inv(matrix) @ np.loadtxt(folder / f"david_{number:02d}.pa").reshape(3, 4)
        projection /= np.cbrt(np.linalg.det(projection[:, :3]))
        images.append(read(folder / f"david_{number:02d}.jpg"))
        bright = images[-1].mean(axis=2) > 105 / 255
        bright[:70], bright[400:] = False, False  # lamps above and the turntable's foot below
        views.append(view_of(matrix, projection[:, :3], projection[:, 3], largest_region(bright)))
    middle, half = np.array([1.127, 0.037, -0.559]), 2.98  # where the silhouettes' centres meet
    return views, images, Box(low=middle - half, high=middle + half)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "load", "cells", "least"),
    [("dinoSparseRing", dinosaur, 128, 0.95), ("david", david, 160, 0.90)],
)
def test_the_fused_mesh_fills_the_silhouettes(real_data, name, load, cells, least):
    views, images, box = load(real_data / "turntable" / name)
    contrasts = [np.clip(127.5 + 32 * local_contrast(image), 0, 255).astype(np.uint8) for image in images]
    grid = fit_hull(views, box, HullOptions(hull_cells=cells))
    hull = mesh_of_grid(grid)
    maps = [stereo_points(views, contrasts, hull, k, STEREO) for k in range(len(views))]
    mesh = fuse_points(maps, hull, grid, FUSION)
    whole = slice(0, 480), slice(0, 640)
    overlaps = []
    for view in views:
        covered = hull_depth(view, mesh, *whole)[0] > 0
        overlaps.append((covered & view.mask).sum() / (covered | view.mask).sum())
    assert np.mean(overlaps) >= least


@pytest.mark.slow
@pytest.mark.parametrize("pattern", ["david/david_*.jpg", "dinoSparseRing/*.png"])
def test_twenty_degrees_from_view_to_view_are_too_many_to_follow(real_data, pattern):
    source = str(real_data / "turntable" / pattern)
    with pytest.raises(BadCalibration, match=r"film"):
        calibrate_head(CalibrationJob(source=source, focal_px=2000.0))


def poses_from_images(views, images):
    """Poses by matched features in the local contrast inside the silhouettes, the camera alone given."""
    builder = SiftBuilder(camera=views[0].camera)
    for view, image in zip(views, images, strict=True):
        builder.add(local_contrast(image), view.mask)
    tracks = builder.finish()
    require_features(tracks)
    rng = np.random.default_rng(0)
    return solve_head_motion(tracks, views[0].camera, PoseOptions(), rng, start=PoseStart.MAPPING)


@pytest.mark.slow
def test_poses_of_the_dinosaur_are_found_from_its_images_alone(real_data):
    views, images, _ = dinosaur(real_data / "turntable" / "dinoSparseRing")
    found = poses_from_images(views, images).camera_from_head
    relative = Rotation.from_matrix(
        [view.camera_from_head.rotation.T @ pose.rotation for view, pose in zip(views, found, strict=True)]
    )
    assert np.rad2deg((relative.mean().inv() * relative).magnitude()).max() < 2.0


@pytest.mark.slow
def test_a_small_smooth_david_has_too_few_features(real_data):
    views, images, _ = david(real_data / "turntable" / "david")
    with pytest.raises(
        BadCalibration, match=r"features: a frame shares only \d+ with the next, 60 are needed"
    ):
        poses_from_images(views, images)
