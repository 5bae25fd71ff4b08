"""What stays at the camera's pixels is told from relief, and does not hold the mesh."""

from collections.abc import Sequence

import cv2
import numpy as np

from tests.tracking.test_tracking_information import CAMERA, GRID, HEIGHT, WIDTH, flat_depth, normals
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking.paint import fixed_pattern
from vntoolkit.tracking.slopes import slopes_from_normals
from vntoolkit.tracking.tracker import SurfaceTracker

NOISE = 0.01  # of a slope, as fixed as in every frame


def moved_px(frame: int) -> float:
    """How far the sheet has moved."""
    return 0.02 * frame**2


def sheet(frame: int, relief: float, pattern: float, rng: np.random.Generator) -> tuple[NormalMap, DepthMap]:
    """A sheet that moves to the right, faster and faster, with relief fixed to it."""
    low = np.array([16.0 + moved_px(frame), 12.0])
    mask = np.all((low <= GRID) & (low + np.array([87, 71]) >= GRID), axis=-1)
    fixed = np.random.default_rng(7).normal(0, pattern, (2, HEIGHT, WIDTH))
    p = relief * np.cos((GRID[..., 0] - moved_px(frame)) * (2 * np.pi / 9))
    q = relief * np.cos(GRID[..., 1] * (2 * np.pi / 11))
    noise = rng.normal(0, NOISE, (2, HEIGHT, WIDTH)) + fixed
    return normals(p + noise[0], q + noise[1], mask), flat_depth(mask)


def pattern_of(
    relief: float, pattern: float, frames: Sequence[int], rng: np.random.Generator
) -> list[np.ndarray]:
    seen = (sheet(frame, relief, pattern, rng)[0] for frame in frames)
    return list(fixed_pattern(slopes_from_normals(each, CAMERA) for each in seen))


def test_its_power_is_that_of_the_gradients_it_makes(rng: np.random.Generator) -> None:
    inside = np.s_[40:56, 50:80]
    frames = range(0, 24, 3)
    (own,) = (power[inside].mean() for power in pattern_of(0.0, NOISE, frames, rng)[:1])
    slopes = slopes_from_normals(sheet(0, 0.0, NOISE, np.random.default_rng(1))[0], CAMERA)
    along = np.square(np.diff(slopes[inside][..., :2], axis=1)).sum(axis=-1).mean()  # of pattern and noise
    assert 0.05 * along < own < 0.6 * along
    twice = pattern_of(0.0, 2 * NOISE, frames, rng)[0][inside].mean()
    np.testing.assert_allclose(twice / own, 4.0, rtol=0.15)
    for relief, at in ((0.0, frames), (0.1, frames), (0.1, [0] * 8)):  # relief that moves, and at rest
        none = pattern_of(relief, 0.0, at, rng)[0][inside].mean()
        assert none < 0.05 * own


def test_paint_at_rest_is_none(rng: np.random.Generator) -> None:
    """Freckles turn normals, with curl, at the same pixels while a face is at rest."""
    whole = np.ones((HEIGHT, WIDTH), dtype=bool)
    inside = np.s_[20:76, 20:108]
    paint = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 2.0)
    paint *= 0.1 / paint.std()
    fixed = rng.normal(0, NOISE, (2, HEIGHT, WIDTH))

    def power(paint: np.ndarray, fixed: np.ndarray) -> float:
        noise = rng.normal(0, NOISE, (8, 2, HEIGHT, WIDTH))
        seen = [normals(paint + each[0] + fixed[0], each[1] + fixed[1], whole) for each in noise]
        return float(fixed_pattern(slopes_from_normals(each, CAMERA) for each in seen)[0][inside].mean())

    assert power(paint, 0 * fixed) < 0.1 * power(0 * paint, fixed)
    curl = slopes_from_normals(normals(paint, 0 * paint, whole), CAMERA)[inside][..., 0]
    assert np.square(np.diff(curl, axis=0)).mean() > 2 * power(0 * paint, fixed)  # strong as it is


def test_what_hardly_counts_does_not_hide_it(rng: np.random.Generator) -> None:
    """Beside a rim, where paint is wrong and weighs next to nothing, gains of pixels are no paint either."""
    inside = np.s_[20:76, 40:90]
    gain = rng.normal(0, NOISE, (HEIGHT, WIDTH))
    wrong = 3.0 * cv2.GaussianBlur(rng.normal(0, 1, gain.shape), (0, 0), 2.0) * (GRID[..., 0] > 100)
    weight = np.where(GRID[..., 0] > 100, 0.02, 1.0)

    def power(wrong: np.ndarray) -> float:
        paint = [1.0 + gain + wrong + noise for noise in rng.normal(0, NOISE, (8, *gain.shape))]
        seen = (np.float32(np.dstack([weight * each, weight])) for each in paint)
        return float(fixed_pattern(seen)[0][inside].mean())

    np.testing.assert_allclose(power(wrong), power(0.0 * wrong), rtol=0.2)


def test_too_few_frames_tell_nothing(rng: np.random.Generator) -> None:
    assert pattern_of(0.0, NOISE, range(3), rng) == []


def test_a_smooth_sheet_without_borders_is_lost_and_not_held_by_it(rng: np.random.Generator) -> None:
    pattern = pattern_of(0.0, 2 * NOISE, range(0, 24, 3), rng)
    whole = np.ones((HEIGHT, WIDTH), dtype=bool)

    def filling(frame: int) -> NormalMap:
        seen = np.random.default_rng(7).normal(0, 2 * NOISE, (2, HEIGHT, WIDTH))
        return normals(*(seen + np.random.default_rng(frame).normal(0, NOISE, seen.shape)), whole)

    told = []
    for known in ((), pattern):
        tracker = SurfaceTracker(filling(100), flat_depth(whole), CAMERA, pattern=known)
        told.append(np.median(tracker.step(filling(101), flat_depth(whole)).uncertainty_px))
    assert min(told) > 4.0  # two frames tell it by their common curl, too


def test_relief_is_followed_across_it(rng: np.random.Generator) -> None:
    pattern = pattern_of(0.1, NOISE, range(0, 24, 3), rng)
    tracker = SurfaceTracker(*sheet(0, 0.1, NOISE, rng), CAMERA, pattern=pattern)
    for frame in range(1, 13):
        tracked = tracker.step(*sheet(frame, 0.1, NOISE, rng))
        moved = tracked.positions_px - tracker.template.positions_px
        error = np.hypot(*(moved - [moved_px(frame), 0.0]).T)
        assert np.median(error) < 0.1
    assert np.median(tracked.uncertainty_px) < 0.5
