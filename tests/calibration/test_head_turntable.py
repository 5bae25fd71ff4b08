"""Shapes from photographs of a real dinosaur and a real David with their own cameras."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vntoolkit.calibration.head.hull import Box, SilhouetteView, fit_hull, mesh_of_grid, neighbours_of
from vntoolkit.calibration.head.poses import solve_head_motion
from vntoolkit.calibration.head.shape import fit_shape
from vntoolkit.calibration.head.sift import SiftBuilder, require_features
from vntoolkit.calibration.head.stereo import hull_depth
from vntoolkit.calibration.head.tracks import local_contrast
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.head import Features, HeadSteps
from vntoolkit.pipeline.calibrate import CalibrationJob
from vntoolkit.pipeline.calibrate_head import calibrate_head

WINDOW = (11, 11)


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


def photo_consistency(views, contrasts, mesh):
    """Mean correlation of windows with those of neighbours 20 degrees off, carried over by the mesh."""
    whole = slice(0, 480), slice(0, 640)
    depths = [hull_depth(view, mesh, *whole)[0] for view in views]
    scores = []
    for k, view in enumerate(views):
        on = depths[k] > 0
        own = contrasts[k].astype(np.float32)
        points = view.camera.unproject(view.camera.pixel_grid(), np.where(on, depths[k], 1.0))
        for j in neighbours_of(views, k, (20.0,)):
            moved = (views[j].camera_from_head @ view.camera_from_head.inverse()).apply(points)
            u, v = np.moveaxis(views[j].camera.project(moved).astype(np.float32), -1, 0)
            there = cv2.remap(depths[j].astype(np.float32), u, v, cv2.INTER_NEAREST, borderValue=0)
            other = cv2.remap(contrasts[j].astype(np.float32), u, v, cv2.INTER_LINEAR, borderValue=0)
            both = on & view.mask & (np.abs(there - moved[..., 2]) < 0.01 * mesh.diagonal)
            both = cv2.erode(both.astype(np.uint8), np.ones(WINDOW)) > 0
            means = [cv2.blur(each, WINDOW) for each in (own, other)]
            spreads = [
                np.sqrt(np.maximum(cv2.blur(each * each, WINDOW) - mean**2, 1.0))
                for each, mean in zip((own, other), means, strict=True)
            ]
            shared = cv2.blur(own * other, WINDOW) - means[0] * means[1]
            if both.sum() > 500:
                scores.append((shared / (spreads[0] * spreads[1]))[both].mean())
    return np.mean(scores)


@pytest.mark.slow
@pytest.mark.parametrize(  # consistency of the hull alone: 0.33 and 0.63
    ("name", "load", "cells", "least", "consistent"),
    [("dinoSparseRing", dinosaur, 128, 0.95, 0.62), ("david", david, 160, 0.86, 0.67)],
)
def test_default_stereo_fits_silhouettes_and_neighbouring_photographs(
    real_data, name, load, cells, least, consistent
):
    views, images, box = load(real_data / "turntable" / name)
    contrasts = [local_contrast(image) for image in images]
    grid = fit_hull(views, box, HeadSteps(hull_cells=cells))
    rough = fit_shape(views, contrasts, grid, HeadSteps())
    mesh = fit_shape(views, contrasts, grid, HeadSteps().closely(), about=rough)
    whole = slice(0, 480), slice(0, 640)
    overlaps = []
    for view in views:
        covered = hull_depth(view, mesh, *whole)[0] > 0
        overlaps.append((covered & view.mask).sum() / (covered | view.mask).sum())
    assert np.mean(overlaps) >= least
    assert photo_consistency(views, contrasts, mesh) > consistent
    assert photo_consistency(views, contrasts, mesh_of_grid(grid)) < consistent - 0.03


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
    return solve_head_motion(tracks, views[0].camera, HeadSteps(), rng, features=Features.SIFT)


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
