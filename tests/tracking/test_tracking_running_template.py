"""What frames have shown of the surface registers it where the template no longer does."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking import surface_fit
from vntoolkit.tracking.bands import Band
from vntoolkit.tracking.factors import Factor, factor
from vntoolkit.tracking.running_template import Comparison, RunningTemplate, running_template, what_exceeds
from vntoolkit.tracking.tracker import SurfaceTracker

WIDTH, HEIGHT = 160, 120
CAMERA = Camera.orthographic(width=WIDTH, height=HEIGHT)
GRID = CAMERA.pixel_grid()
WAVES = 24


def relief(seed: int, shift_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (h, w) of plane waves of 6 to 14 px, moved to the right."""
    rng = np.random.default_rng(seed)
    angle, phase = rng.uniform(0, 2 * np.pi, (2, WAVES))
    k = 2 * np.pi / rng.uniform(6, 14, WAVES)
    u, v = GRID[..., 0, None] - shift_px, GRID[..., 1, None]
    wave = np.cos(k * (u * np.cos(angle) + v * np.sin(angle)) + phase) * np.sqrt(2 / WAVES)
    return (wave * np.cos(angle)).sum(axis=-1), (wave * np.sin(angle)).sum(axis=-1)


def frame(number: int) -> tuple[NormalMap, DepthMap]:
    """A disc moves by 0.3 px a frame over a sheet at rest; its relief is another by frame 30."""
    rng = np.random.default_rng(number)
    moved = np.hypot(GRID[..., 0] - 80, GRID[..., 1] - 60) < 36
    angle = np.pi / 2 * number / 30
    slopes = []
    for still, first, second in zip(
        relief(0, 0.0), relief(1, 0.3 * number), relief(2, 0.3 * number), strict=True
    ):
        on_disc = np.cos(angle) * first + np.sin(angle) * second
        slopes.append(0.1 * np.where(moved, on_disc, still) + rng.normal(0, 0.01, still.shape))
    n = np.stack([*slopes, -np.ones_like(slopes[0])], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    mask = np.ones((HEIGHT, WIDTH), dtype=bool)
    return (
        NormalMap(normals_in_camera=n.astype(np.float32), mask=mask),
        DepthMap(depth=np.full((HEIGHT, WIDTH), 100.0), mask=mask),
    )


def on_disc(last: int = 30) -> tuple[float, float]:
    """Median error on the disc, and median of what is expected."""
    tracker = SurfaceTracker(*frame(0), CAMERA)
    for number in range(1, last + 1):
        tracked = tracker.step(*frame(number))
    pixels = tracker.template.positions_px
    inner = np.hypot(*(pixels - [80, 60]).T) < 20
    error = np.hypot(*(tracked.positions_px - pixels - [0.3 * last, 0.0]).T)
    return float(np.median(error[inner])), float(np.median(tracked.uncertainty_px[inner]))


@pytest.mark.slow
def test_relief_that_turns_into_another_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As under light that changes: the template tells nothing of it any more."""
    assert on_disc()[0] < 1.5
    monkeypatch.setattr(RunningTemplate, "with_frame", lambda self, told: self)
    assert on_disc()[0] > 3.0


@pytest.mark.slow
def test_what_is_remembered_is_doubted_where_the_template_does_not_match(monkeypatch):
    """That it follows another relief rightly, nothing but itself says."""
    doubted = on_disc()[1]
    monkeypatch.setattr(surface_fit, "_HALF_WAVE_PX", 0.0)
    assert on_disc()[1] < 0.5 * doubted


def compared(
    information: float, more: float, against: float, offset: tuple[float, float] = (0, 0)
) -> Comparison:
    one = np.array([[1.0, 0.0, 1.0]])
    band = Band(
        node=np.zeros((2, 2), np.int32),
        features=np.ones((2, 2, 2), np.float32),
        gradients=np.zeros((2, 2, 4), np.float32),
        weight=np.ones((2, 2), np.float32),
        beside=np.zeros((2, 2), bool),
    )
    still = np.zeros((1, 2))
    return Comparison(
        (band,),
        factor(information * one, np.array([offset])),
        factor(against * one, still),
        factor(more * one, still),
    )


def memory() -> RunningTemplate:
    return running_template(compared(1, 0, 0).bands, 1, 3)


def test_errors_of_what_is_remembered_grow_slowly_and_fall_where_the_template_tells() -> None:
    remembered = memory()
    variances = []
    for _ in range(200):
        remembered = remembered.with_frame(compared(2.0, 2.0, 2.0))
        variances.append(remembered.variance[0, 0, 0])
    assert np.all(np.diff(variances) > 0)
    assert variances[0] < 0.02  # half a px² of noise at a rate of a tenth
    for _ in range(100):
        remembered = remembered.with_frame(compared(20.0, 0.0, 2.0))
    assert remembered.variance[0, 0, 0] < 0.02


def test_what_was_not_measured_is_not_mixed_in() -> None:
    remembered = memory().with_frame(compared(0.0, 0.0, 0.0))
    np.testing.assert_array_equal(remembered.variance, 0.0)
    np.testing.assert_array_equal(remembered.features, memory().features)


def test_where_measurements_pull_is_kept_though_lengths_held_the_surface_back() -> None:
    """What is remembered was laid where the fit was; the surface is found beside it."""
    remembered = memory()
    for _ in range(100):
        remembered = remembered.with_frame(compared(2.0, 2.0, 2.0, (0.5, 0.0)))
    one = np.array([[1.0, 0.0, 1.0]])
    more = remembered.beyond(factor(0.0 * one, np.zeros((1, 2))), factor(2.0 * one, np.zeros((1, 2))))
    assert more.right_hand_side[0, 0] / more.information[0, 0] == pytest.approx(0.5, abs=0.01)


def test_departures_from_guesses_fade_and_are_kept_where_they_are_told_and_links_are_not_measured() -> None:
    departs = np.array([[2.0, 0.0], [0.0, 4.0], [1.0, 1.0]])
    told, none = np.array([1.0, 0.5, 0.0]), np.zeros(3)
    remembered = memory().with_residuals(departs, told, measured=none)
    assert 0.0 < remembered.residuals[0, 0] < departs[0, 0]
    assert remembered.residuals[1, 1] == pytest.approx(remembered.residuals[0, 0])
    np.testing.assert_array_equal(remembered.residuals[2], 0.0)
    measured = memory().with_residuals(departs, none + 1.0, measured=np.array([0.0, 0.0, 1.0]))
    assert measured.residuals[1, 1] > remembered.residuals[1, 1]
    np.testing.assert_array_equal(measured.residuals[2], 0.0)
    followed = remembered.with_residuals(remembered.residuals, known=none + 1.0, measured=none)
    ratio = followed.residuals[:2] / np.where(departs[:2] > 0, departs[:2], 1.0)
    assert ratio.max() < remembered.residuals[0, 0] / departs[0, 0]


def test_of_two_informations_the_greater_counts_in_every_direction(rng: np.random.Generator) -> None:
    first, second = np.array([[4.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 3.0]])
    still = np.zeros((1, 2))
    more = what_exceeds(factor(first, still), Factor(second, np.array([[0.7, 0.9]]), np.zeros(1)))
    np.testing.assert_allclose(more.information, [[0.0, 0.0, 2.0]], atol=1e-6)
    np.testing.assert_allclose(more.right_hand_side, [[0.0, 0.6]], atol=1e-6)  # to where the second found it
    assert not what_exceeds(factor(first, still), factor(0.5 * first, still)).information.any()
    roots = rng.normal(size=(2, 50, 2, 2))
    matrices = roots @ np.swapaxes(roots, 2, 3)
    (a, b), triples = matrices, matrices[..., [0, 0, 1], [0, 1, 1]]
    more = what_exceeds(*(factor(each, np.zeros((50, 2))) for each in triples))
    for k, known in enumerate(more.information):
        value, vector = eigh(b[k], a[k])
        across = a[k] @ vector
        exceeding = (across * np.maximum(value - 1.0, 0.0)) @ across.T
        np.testing.assert_allclose(known, exceeding[[0, 0, 1], [0, 1, 1]], atol=1e-4)
