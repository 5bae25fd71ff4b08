import numpy as np

from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.io.footage.decoding import Undistorter
from vntoolkit.photometry.frame import LinearFrame

PINHOLE = Camera.pinhole(width=120, height=90, focal_px=110.0)
BARREL = Camera(
    model=CameraModel.OPENCV,
    width=120,
    height=90,
    matrix=PINHOLE.matrix,
    distortion=np.array([-0.15, 0.02, 1e-3, 0]),
)


def smooth_scene(camera: Camera) -> LinearFrame:
    """What a camera sees of a plane at z = 1 painted with slow waves."""
    x, y, _ = np.moveaxis(camera.points_from_depth(np.ones((90, 120))), -1, 0)
    rgb = np.stack(
        [0.5 + 0.3 * np.sin(8 * x), 0.5 + 0.3 * np.cos(9 * y), 0.5 + 0.2 * np.sin(7 * (x + y))], -1
    )
    return LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros((90, 120), bool))


def test_an_undistorted_frame_is_what_the_pinhole_camera_sees() -> None:
    undistorter = Undistorter(BARREL)
    seen, wanted = undistorter.frame(smooth_scene(BARREL)), smooth_scene(PINHOLE)
    inside = undistorter.inside
    assert inside.mean() > 0.95
    # bilinear interpolation of waves of 80 px: error bounded by (2π/80)² · 0.3 / 8 per axis
    np.testing.assert_allclose(seen.rgb[inside], wanted.rgb[inside], atol=6e-4)


def test_masks_follow_and_lose_what_the_camera_did_not_see() -> None:
    undistorter = Undistorter(BARREL)
    moved = undistorter.mask(np.ones((90, 120), bool))
    assert np.array_equal(moved, undistorter.inside)


def test_a_camera_without_distortion_leaves_frames_alone() -> None:
    undistorter = Undistorter(PINHOLE)
    frame = smooth_scene(PINHOLE)
    assert undistorter.frame(frame) is frame
    assert not undistorter.changes_frames


def test_what_draws_on_a_clipped_pixel_is_clipped() -> None:
    """Bilinear interpolation mixes up to four pixels, each with a share of its own."""
    rgb, clipped = np.zeros((90, 120, 3), np.float32), np.zeros((90, 120), bool)
    rgb[40, 70], clipped[40, 70] = 1.0, True
    seen = Undistorter(BARREL).frame(LinearFrame(rgb=rgb, clipped=clipped))
    assert np.count_nonzero(seen.rgb[..., 0]) > 1
    assert np.array_equal(seen.clipped, seen.rgb[..., 0] > 0)


def test_beyond_the_picture_nothing_is_seen() -> None:
    """The lens bends the pinhole camera's corners out of the picture, by fractions of a pixel too."""
    cushion = Camera(
        model=CameraModel.OPENCV,
        width=120,
        height=90,
        matrix=PINHOLE.matrix,
        distortion=np.array([0.15, 0, 0, 0]),
    )
    undistorter = Undistorter(cushion)
    ones = LinearFrame(rgb=np.ones((90, 120, 3), np.float32), clipped=np.ones((90, 120), bool))
    seen = undistorter.frame(ones)
    assert 0.02 < 1 - undistorter.inside.mean() < 0.2
    assert not seen.rgb[~undistorter.inside].any()
    np.testing.assert_allclose(seen.rgb[undistorter.inside], 1.0)
