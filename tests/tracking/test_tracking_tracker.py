"""The tracker: identities, rigid motion, the wrinkled video with exact tracks, occluders, bad input."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tracking.wrinkled_video import WrinkledVideo
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.options.tracking import Tracker, TrackingOptions
from vntoolkit.tracking import tracker as tracker_module
from vntoolkit.tracking.tracker import SurfaceTracker


def follow(video: WrinkledVideo, options: TrackingOptions, frames: int, mask_of=lambda k: None):
    tracker = SurfaceTracker(*video.maps(0, mask_of(0)), video.camera, options)
    for k in range(1, frames + 1):
        tracked = tracker.step(*video.maps(k, mask_of(k)))
    return tracker, tracked


def test_a_still_scene_leaves_the_template() -> None:
    video = WrinkledVideo(sway_px=0.0, bend=0.0)
    tracker, tracked = follow(video, TrackingOptions(), 4)
    assert np.abs(tracked.positions_px - tracker.template.positions_px).max() < 1e-3
    assert np.abs(tracked.vertices_in_camera - tracker.template.vertices_in_camera).max() < 1e-3
    assert tracked.uncertainty_px.max() < 1.0  # the outermost rows and columns too


@pytest.mark.parametrize("tracker", [Tracker.DEFAULT, Tracker.FLOW, Tracker.TRANSLATION])
def test_a_rigid_motion_is_recovered(tracker: Tracker) -> None:
    video = WrinkledVideo(sway_px=0.0, bend=0.0, drift_px=(0.7, -0.4))
    follower, tracked = follow(video, TrackingOptions(method=tracker), 5)
    error = video.error(tracked, follower.template, 5)
    assert np.median(error) < 0.05


def test_cotangent_weights_are_those_of_the_grid_on_a_flat_one() -> None:
    """Its triangles have two sides of one pixel: the diagonal's angles are right, its weight is 0."""
    video = WrinkledVideo(width=96, height=72, bend=0.0, drift_px=(0.7, -0.4))
    by_kind = [
        follow(video, TrackingOptions(method=name), 3)[1].positions_px
        for name in (Tracker.LAPLACIAN_COTANGENT, Tracker.LAPLACIAN_PREVIOUS)
    ]
    assert np.abs(by_kind[0] - by_kind[1]).max() < 0.02


@pytest.mark.slow
def test_registration_to_the_template_stops_the_drift_of_flow() -> None:
    video = WrinkledVideo(noise=0.05)
    errors = {}
    for name in (Tracker.FLOW, Tracker.TRANSLATION, Tracker.LAPLACIAN_PREVIOUS, Tracker.DEFAULT):
        tracker, tracked = follow(video, TrackingOptions(method=name), 100)
        errors[name] = float(np.median(video.error(tracked, tracker.template, 100)))
    best_published = min(error for name, error in errors.items() if name is not Tracker.DEFAULT)
    assert errors[Tracker.DEFAULT] < 0.5 * best_published
    assert errors[Tracker.DEFAULT] < 0.15


def test_no_registration_stays_where_it_was() -> None:
    video = WrinkledVideo(drift_px=(0.5, 0.0))
    tracker, tracked = follow(video, TrackingOptions(method=Tracker.NO_REGISTRATION), 6)
    assert np.abs(tracked.positions_px - tracker.template.positions_px).max() < 1e-4
    depth = video.maps(6)[1].depth
    u, v = tracker.template.pixels.T
    np.testing.assert_allclose(tracked.vertices_in_camera[:, 2], depth[v, u], atol=1e-3)


def occluded(normal_map: NormalMap, k: int) -> NormalMap:
    """A smooth ball of relief of its own crosses the picture, 4 px a frame."""
    h, w = normal_map.shape
    v, u = np.mgrid[:h, :w]
    x, y = u - (4.0 * k - 20), v - h / 2
    inside = x**2 + y**2 < 22**2
    ripple = 0.5 * np.sin(x / 2.5) * np.cos(y / 3.0)
    ball = np.stack([x / 40 + ripple, y / 40 - ripple, -np.ones_like(x)], axis=-1)
    ball /= np.linalg.norm(ball, axis=-1, keepdims=True)
    normals = np.where(inside[..., None], ball, normal_map.normals_in_camera)
    return NormalMap(normals_in_camera=normals.astype(np.float32), mask=normal_map.mask)


@pytest.mark.slow
@pytest.mark.parametrize("method", [Tracker.DEFAULT, Tracker.FLOW])
def test_what_an_occluder_hides_is_held_and_found_again(method: Tracker) -> None:
    video = WrinkledVideo(sway_px=2.0)
    tracker = SurfaceTracker(*video.maps(0), video.camera, TrackingOptions(method=method))
    for k in range(1, 61):
        normals, depth = video.maps(k)
        tracked = tracker.step(occluded(normals, k), depth)
        if k == 30 and method is Tracker.DEFAULT:  # what is hidden is less certain than what is seen
            assert np.percentile(tracked.uncertainty_px, 99) > 3 * np.median(tracked.uncertainty_px)
    ended = float(np.percentile(video.error(tracked, tracker.template, 60), 95))
    assert ended > 4.0 if method is Tracker.FLOW else ended < 0.5


@pytest.mark.slow
def test_what_is_hidden_stays_off_the_surface_before_it() -> None:
    video = WrinkledVideo(sway_px=2.0)
    tracker = SurfaceTracker(*video.maps(0), video.camera)
    for k in range(1, 21):
        normals, depth = video.maps(k)
        normals = occluded(normals, k)
        ball = np.any(normals.normals_in_camera != video.maps(k)[0].normals_in_camera, axis=-1)
        before = DepthMap(depth=np.where(ball, 100.0, depth.depth), mask=depth.mask)
        tracked = tracker.step(normals, before)
    hidden = ball[tuple(np.rint(tracked.positions_px).astype(int).T[::-1].clip(0, [[143], [191]]))]
    assert hidden.sum() > 1000
    true = video.height_at(tracker.template.positions_px, 20)
    assert np.percentile(np.abs(tracked.vertices_in_camera[:, 2] - true)[hidden], 90) < 10.0  # of 100


@pytest.mark.slow
def test_vertices_that_leave_the_mask_are_held_and_found_again() -> None:
    video = WrinkledVideo(sway_px=2.0)

    def mask_of(k: int):
        mask = np.ones((video.height, video.width), dtype=bool)
        if 5 <= k < 15:
            mask[:, :50] = False
        return mask

    tracker, _ = follow(video, TrackingOptions(), 10, mask_of)
    gone = tracker.template.pixels[:, 0] < 40
    far = tracker.template.pixels[:, 0] < 10
    assert tracker.state.uncertainty_px[far].min() > 2 * np.median(tracker.state.uncertainty_px[~gone])
    for k in range(11, 31):
        tracked = tracker.step(*video.maps(k, mask_of(k)))
    assert np.median(tracked.uncertainty_px[gone]) < 1.0
    assert np.percentile(video.error(tracked, tracker.template, 30), 95) < 0.5


def test_a_full_data_share_meets_the_target_exactly(monkeypatch) -> None:
    monkeypatch.setattr(tracker_module, "PAPERS_DATA_SHARE", 1.0)
    monkeypatch.setattr(tracker_module, "PAPERS_BETA", 1e6)
    video = WrinkledVideo()
    alone = follow(video, TrackingOptions(method=Tracker.FLOW), 3)[1]
    for method in (Tracker.TRANSLATION, Tracker.LAPLACIAN):
        same = follow(video, TrackingOptions(method=method), 3)[1]
        np.testing.assert_allclose(same.vertices_in_camera, alone.vertices_in_camera, atol=1e-3)


def test_arap_follows_its_handles() -> None:
    video = WrinkledVideo(width=64, height=48, sway_px=1.0)
    tracker, tracked = follow(video, TrackingOptions(method=Tracker.ARAP), 2)
    assert np.median(video.error(tracked, tracker.template, 2)) < 0.3


def test_arap_holds_a_piece_between_its_handles() -> None:
    """An island that no handle of the lattice meets."""
    video = WrinkledVideo(width=64, height=48, sway_px=0.0, bend=0.0, drift_px=(0.5, 0.0))
    mask = np.zeros((48, 64), dtype=bool)
    mask[8:40, 4:40] = mask[9:13, 49:54] = True
    tracker = SurfaceTracker(*video.maps(0, mask), video.camera, TrackingOptions(method=Tracker.ARAP))
    for k in (1, 2):
        tracked = tracker.step(*video.maps(k))
    moved = tracked.positions_px - tracker.template.positions_px
    assert np.abs(moved[tracker.template.pixels[:, 0] > 45] - [1.0, 0.0]).max() < 1.0


@pytest.mark.parametrize("size", [(2, 2), (8, 8), (3, 40)])
def test_a_template_of_a_few_pixels_is_followed(size: tuple[int, int]) -> None:
    video = WrinkledVideo(width=64, height=48)

    def cut(frame: int) -> tuple[NormalMap, DepthMap]:
        whole, depth = video.maps(frame)
        mask = np.zeros_like(whole.mask)
        mask[8 : 8 + size[0], 8 : 8 + size[1]] = True
        normals = NormalMap(normals_in_camera=whole.normals_in_camera, mask=whole.mask & mask)
        return normals, DepthMap(depth=depth.depth, mask=depth.mask & mask)

    tracked = SurfaceTracker(*cut(0), video.camera).step(*cut(1))
    assert np.isfinite(tracked.positions_px).all()
    assert tracked.uncertainty_px is not None
    assert np.isfinite(tracked.uncertainty_px).all()


@pytest.mark.parametrize("jump_px", [(40.0, 0.0), (-25.0, 30.0)])
def test_a_jump_is_followed_however_far(jump_px: tuple[float, float]) -> None:
    video = WrinkledVideo(drift_px=jump_px)
    tracker = SurfaceTracker(*video.maps(0), video.camera)
    for frame in (1, 2):
        state = tracker.step(*video.maps(frame))
        true = video.warp(tracker.template.positions_px, frame)
        seen = np.all((true > 8) & (true < [video.width - 9, video.height - 9]), axis=1)
        error = np.linalg.norm(state.positions_px - true, axis=1)[seen]
        assert np.percentile(error, 95) < 1.0


@pytest.mark.slow
def test_what_nothing_tells_of_does_not_run_away_and_is_said_to_be_lost() -> None:
    video = WrinkledVideo(bend=20.0, noise=0.01)  # a wave that travels over a smooth sheet without borders
    video.amplitude[:] = 0.0
    tracker = SurfaceTracker(*video.maps(0), video.camera)
    for frame in range(1, 25):
        state = tracker.step(*video.maps(frame))
    error = np.linalg.norm(state.positions_px - video.warp(tracker.template.positions_px, 24), axis=1)
    assert np.median(error) < 25
    assert np.mean(error <= state.uncertainty_px) > 0.8


def test_a_smooth_figure_that_jumps_is_followed_by_its_outline() -> None:
    video = WrinkledVideo(sway_px=0.0, bend=3.0, drift_px=(30.0, 12.0), noise=0.002)
    video.amplitude[:] = 0.0
    u, v = np.meshgrid(np.arange(video.width), np.arange(video.height))

    def figure(k: int) -> np.ndarray:
        return np.hypot((u - 60 - 30 * k) / 45, (v - 60 - 12 * k) / 35) < 1

    tracker = SurfaceTracker(*video.maps(0, figure(0)), video.camera)
    for frame in (1, 2):
        state = tracker.step(*video.maps(frame, figure(frame)))
        error = np.linalg.norm(state.positions_px - video.warp(tracker.template.positions_px, frame), axis=1)
        assert np.median(error) < 2.0
