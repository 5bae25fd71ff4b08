"""The stages of the calibration on a head, each alone, on shapes that are known."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tests.calibration.turning_egg import (
    AXES,
    CAMERA,
    DISTANCE,
    MATRIX,
    relative_error,
    render_egg,
    turning_poses,
)
from vntoolkit.calibration.head.hull import (
    Box,
    SilhouetteView,
    fit_hull,
    mesh_of_grid,
    neighbours_of,
    turn_angles_deg,
)
from vntoolkit.calibration.head.light import fit_light
from vntoolkit.calibration.head.samples import HeadRays, HeadSamples, spread_over_orientations
from vntoolkit.calibration.head.sift import joined_matches
from vntoolkit.calibration.head.silhouettes import find_silhouette
from vntoolkit.calibration.head.tracks import TrackBuilder, local_contrast
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.options.calibration import ResponseModel
from vntoolkit.options.head import HeadSteps

POSES = turning_poses(13, 80.0)


def test_smooth_light_leaves_local_contrast_as_it_is():
    image = render_egg(POSES[6])
    slope = np.linspace(0.7, 1.3, CAMERA.width, dtype=np.float32)[None, :, None]
    inner = np.s_[90:150, 120:200]
    before, after = (local_contrast(each)[inner].astype(float) for each in (image, image * slope))
    assert before.std() > 16
    assert np.abs(after - before).mean() < 0.1 * before.std()


def test_a_shifted_pattern_is_followed_to_a_fraction_of_a_pixel():
    rng = np.random.default_rng(2)
    wave = rng.standard_normal((6, 4))
    v, u = np.mgrid[0:120, 0:160]

    def image(shift):
        waves = [np.sin(a * (u - shift) / 6 + b * (v - 0.5 * shift) / 6 + 3 * c) for a, b, c, _ in wave]
        return np.clip(127.5 + 32 * np.sum(waves, axis=0), 0, 255).astype(np.uint8)

    mask = np.ones((120, 160), np.bool_)
    builder = TrackBuilder(steps=HeadSteps(corners=60))
    for k in range(6):
        builder.add(image(0.7 * k), mask)
    tracks = builder.finish()
    start = np.searchsorted(tracks.point, np.arange(tracks.point_count))
    moved = tracks.positions_px - tracks.positions_px[start][tracks.point]
    expected = 0.7 * (tracks.frame - tracks.frame[start][tracks.point])[:, None] * [1.0, 0.5]
    assert tracks.point_count >= 50
    assert np.abs(moved - expected).mean() < 0.05


def test_silhouette_is_the_eggs_outline():
    found = find_silhouette(render_egg(POSES[6]))
    area = np.pi * AXES[0] * AXES[1] * (CAMERA.matrix[0, 0] / DISTANCE) ** 2
    # dark skin at the rim, where no light arrives, may be lost; blur may add half a pixel
    assert 0.97 * area < found.mask.sum() < 1.03 * area
    assert found.rival_share == 0.0
    assert found.cut_share == 0.0


@pytest.mark.parametrize("glow", [0.0, 0.004])
def test_silhouette_follows_the_edge_of_bright_skin_and_of_dark_hair(glow):
    """A disc, bright to the left and thirty times darker to the right, blurred by a lens, with noise."""
    v, u = np.mgrid[:240, :240] - 119.5
    light = np.where(u < 0, 0.6, 0.02) * (np.hypot(u, v) < 80)
    lens = gaussian_filter(light, 0.9) + 0.004 + glow * np.exp(-np.hypot(u, v) / 100)
    noise = np.random.default_rng(3).normal(0, 0.0015, (240, 240, 3))
    found = find_silhouette((lens[..., None] + noise).astype(np.float32))
    for half in (u < -3, u > 3):
        exact = (half & (np.hypot(u, v) < 80)).sum()
        assert abs(found.mask[half].sum() - exact) / (np.pi * 80) < 0.35  # px along its half of the contour


def egg_views(poses):
    shape = (CAMERA.height, CAMERA.width)
    return [
        SilhouetteView(
            camera=CAMERA, camera_from_head=pose, mask=render_egg(pose).max(axis=2).reshape(shape) > 0.0041
        )
        for pose in poses
    ]


def test_hull_holds_the_egg_and_hardly_more():
    views = egg_views(turning_poses(24, 172.0))
    box = Box(low=-1.3 * AXES, high=1.3 * AXES)
    hull = mesh_of_grid(fit_hull(views, box, HeadSteps(hull_cells=48)))
    radii = np.linalg.norm(hull.vertices / AXES, axis=1)
    pixel = DISTANCE / CAMERA.matrix[0, 0] / AXES.min()
    assert radii.min() > 1 - 1.5 * pixel
    assert np.median(radii) < 1 + 1.5 * pixel
    outward = (hull.normals * hull.vertices / AXES**2).sum(axis=1)
    assert (outward > 0).mean() > 0.99


def test_hull_refuses_silhouettes_that_contradict_each_other():
    views = egg_views(POSES[:2])
    empty = SilhouetteView(camera=CAMERA, camera_from_head=POSES[2], mask=np.zeros_like(views[0].mask))
    with pytest.raises(BadCalibration, match="hull: no point"):
        fit_hull([*views, empty], Box(low=-AXES, high=AXES), HeadSteps(hull_cells=24))


def test_neighbours_lie_to_both_sides_also_beyond_half_a_turn():
    mask = np.ones((CAMERA.height, CAMERA.width), np.bool_)
    views = [
        SilhouetteView(camera=CAMERA, camera_from_head=pose, mask=mask) for pose in turning_poses(36, 175.0)
    ]
    angles = turn_angles_deg([view.camera_from_head for view in views], 18)
    assert angles[19] * angles[17] < 0
    assert sorted(neighbours_of(views, 18, (10.0,))) == [17, 19]
    assert sorted(neighbours_of(views, 0, (10.0,))) == [1, 35]


def ball_samples(rng, wrong=0.0, ambient=0.0, outliers=0.0, noise_deg=3.0, albedo=1.0):
    """Samples of a ball in several poses: disturbed normals, a share of points of another albedo."""
    directions = rng.standard_normal((1500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    other = rng.random(1500) < wrong
    tint = np.where(other[:, None], [0.5, 0.25, 0.4], albedo)
    parts = []
    for number, pose in enumerate(POSES):
        true = pose.rotate(directions)
        lit = (true @ MATRIX.T > 0.05).all(axis=1) & (true[:, 2] < -0.35)
        rgb = (true @ MATRIX.T + ambient) * tint
        seen = true + np.deg2rad(noise_deg) * rng.standard_normal(true.shape)
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        stray = rng.random(1500) < outliers
        rgb = np.where(stray[:, None], rng.uniform(0, 0.8, rgb.shape), rgb)
        rows = np.flatnonzero(lit)
        parts.append((rows, np.full(len(rows), number), seen[rows], rgb[rows]))
    point, frame, normals, rgb = (np.concatenate(each) for each in zip(*parts, strict=True))
    samples = HeadSamples(
        point=point,
        frame=frame,
        normals_in_camera=normals,
        rgb=rgb,
        position_px=np.zeros((len(point), 2)),
        camera_from_head=tuple(POSES),
    )
    return samples, HeadRays(ball_mesh(directions))


def ball_mesh(directions):
    from scipy.spatial import ConvexHull

    faces = ConvexHull(directions).simplices
    a, b, c = (directions[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", a, np.cross(b, c)) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh(vertices=directions, faces=faces.astype(np.int32))


@pytest.mark.parametrize(("wrong", "outliers"), [(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)])
def test_light_is_found_through_noise_other_albedo_and_outliers(wrong, outliers):
    rng = np.random.default_rng(4)
    samples, rays = ball_samples(rng, wrong=wrong, outliers=outliers)
    found = fit_light(samples, rays, HeadSteps(light_draws=600), rng)
    assert relative_error(found.response.matrix) < 0.03
    assert found.quality.residual_deg > 1.0  # the normals are wrong by 3 degrees a component, and it says so


def test_ambient_light_is_found_on_skin_of_one_albedo():
    rng = np.random.default_rng(4)
    samples, rays = ball_samples(rng, ambient=0.15, noise_deg=1.0)
    found = fit_light(samples, rays, HeadSteps(light_draws=600), rng, ResponseModel.AMBIENT)
    assert relative_error(found.response.matrix) < 0.05
    np.testing.assert_allclose(found.response.ambient, 0.15, atol=0.02)


def test_light_refuses_colours_that_mean_nothing():
    rng = np.random.default_rng(4)
    samples, rays = ball_samples(rng, outliers=1.0)
    with pytest.raises(BadCalibration, match="light: "):
        fit_light(samples, rays, HeadSteps(light_draws=300, light_inlier=0.05), rng)


def test_points_are_spread_over_orientations_not_over_area():
    rng = np.random.default_rng(0)
    crowded = np.concatenate([np.tile([0.0, 0.0, -1.0], (5000, 1)), rng.standard_normal((500, 3))])
    crowded /= np.linalg.norm(crowded, axis=1, keepdims=True)
    chosen = spread_over_orientations(crowded, 300, rng)
    assert len(chosen) == 300
    assert (chosen >= 5000).mean() > 0.9


def test_rays_know_what_the_head_itself_covers():
    directions = np.random.default_rng(0).standard_normal((300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ball = ball_mesh(directions)
    rays = HeadRays(ball)
    outward = vertex_normals(ball.vertices, ball.faces)
    number = np.arange(300)
    assert rays.free(number, outward).all()
    assert not rays.free(number, -outward).any()


def test_features_are_joined_into_tracks_that_show_no_frame_twice():
    places = [np.array([[1.0, 1.0], [5.0, 5.0], [9.0, 9.0]]) + k for k in range(3)]  # features 0-2, 3-5, 6-8
    matches = np.array([[0, 3], [3, 6], [1, 4], [4, 7], [7, 2]])  # the last: one frame, two places
    tracks = joined_matches(matches, places)
    assert tracks.point_count == 2
    np.testing.assert_array_equal(tracks.frame, [0, 1, 2] * 2)
    np.testing.assert_allclose(tracks.positions_px[:, 0], [1, 2, 3, 5, 6, 7])
    assert joined_matches(np.array([[1, 4]]), places).point_count == 0  # two frames say nothing
