"""Paint tells where a surface is that has no relief, and only where it is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.tracking.test_tracking_information import CAMERA, GRID, HEIGHT, WIDTH, flat_depth, normals
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.pipeline.track import paint_of_materials
from vntoolkit.tracking.paint import Paint, paint_of_frame
from vntoolkit.tracking.tracker import SurfaceTracker

WHOLE = np.ones((HEIGHT, WIDTH), dtype=bool)
RESPONSE = LightResponse(
    matrix=np.array([[0.4, 0.1, -0.5], [-0.3, 0.3, -0.6], [0.0, -0.4, -0.4]]),
    ambient=np.array([0.02, 0.01, 0.03]),
)
DARKEST = 0.3


def smooth(frame: int) -> NormalMap:
    """A plain sheet, noisy, without any relief."""
    noise = np.random.default_rng(100 + frame).normal(0, 0.01, (2, HEIGHT, WIDTH))
    return normals(*noise)


def freckles(shift: np.ndarray) -> np.ndarray:
    """A smooth random paint (h, w) around 1, moved by a shift."""
    drawn = cv2.GaussianBlur(np.random.default_rng(5).normal(0, 1, (HEIGHT + 40, WIDTH + 40)), (0, 0), 3.0)
    drawn = 1.0 + 0.1 * drawn / drawn.std()
    at = np.float32(GRID + 20 - shift)
    return np.maximum(cv2.remap(np.float32(drawn), at[..., 0], at[..., 1], cv2.INTER_CUBIC), DARKEST)


def painted(frame: int, shift: np.ndarray, noise: float = 0.02) -> Paint:
    random = np.random.default_rng(frame).normal(0, noise, (HEIGHT, WIDTH))
    return np.float32(freckles(shift) + random)


def rolling(rng: np.random.Generator, slope: float) -> np.ndarray:
    """Normals (h, w, 3) of a surface that turns slowly, by slopes of that standard deviation."""
    drawn = (cv2.GaussianBlur(each, (0, 0), 12.0) for each in rng.normal(0, 1, (2, HEIGHT, WIDTH)))
    return normals(*(slope * each / each.std() for each in drawn)).normals_in_camera


def inverted(frame: LinearFrame, response: LightResponse) -> np.ndarray:
    """The normals (h, w, 3) that a frame shows by M."""
    scaled = (frame.rgb - response.ambient) @ response.inverse.T
    return np.float32(scaled / np.linalg.norm(scaled, axis=2, keepdims=True))


def test_it_is_the_reflectance_however_the_surface_is_turned(rng: np.random.Generator) -> None:
    turned = rolling(rng, 0.3)
    reflectance = rng.uniform(0.5, 1.2, (HEIGHT, WIDTH, 1))
    rgb = (reflectance * turned) @ RESPONSE.matrix.T + RESPONSE.ambient
    labels = np.full((HEIGHT, WIDTH), 7, dtype=np.uint8)
    labels[:, :10] = 5
    clipped = GRID[..., 0] > WIDTH - 10
    paint = paint_of_frame(LinearFrame(rgb=rgb, clipped=clipped), turned, RESPONSE, labels)
    known = (labels == 7) & ~clipped
    np.testing.assert_allclose(paint[known], reflectance[known, 0], rtol=0.05)
    assert not paint[~known].any()


def test_it_is_as_noisy_as_the_brightness_where_the_surface_turns_away(rng: np.random.Generator) -> None:
    """M⁻¹ makes more of the noise there."""
    tilted = np.array([0.0, 0.77, -0.64])
    noise = 0.01 * rng.standard_normal((HEIGHT, WIDTH, 3))
    light = RESPONSE.matrix @ tilted
    frame = LinearFrame(rgb=np.float32(light + RESPONSE.ambient + noise))
    inner = np.s_[10:-10, 10:-10]
    paint = paint_of_frame(frame, inverted(frame, RESPONSE), RESPONSE)
    assert paint[inner].std() < 1.1 * 0.01 / np.linalg.norm(light)


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_a_shadow_leaves_no_rim_beside_it(missing: int, rng: np.random.Generator) -> None:
    turned = rolling(rng, 0.1)
    beside = GRID[..., 0] - WIDTH // 2
    labels = np.where(beside < 0, 7 - (1 << missing), 7).astype(np.uint8)
    light = np.where((labels == 7)[..., None], 1.0, np.arange(3) != missing)
    frame = LinearFrame(rgb=np.float32(light * (turned @ RESPONSE.matrix.T) + RESPONSE.ambient))
    paint = paint_of_frame(frame, turned, RESPONSE, labels)
    np.testing.assert_allclose(paint[(beside >= 0) & (beside < 10)], 1.0, atol=0.005)


def test_paint_of_other_hues_is_their_reflectance_too(rng: np.random.Generator) -> None:
    colours = np.array([[0.7, 0.1, 0.02], [0.08, 0.6, 0.1], [0.02, 0.12, 0.65]])
    lights = np.array([[0.5, 0.0, -0.866], [-0.25, 0.433, -0.866], [-0.25, -0.433, -0.866]])
    response = LightResponse(matrix=colours.T @ lights, light_colours=colours)
    paints = np.array([[0.9, 0.4, 0.6], [0.3, 0.8, 0.5]])
    materials = np.uint8(GRID[..., 0] > WIDTH // 2)
    turned = rolling(rng, 0.2)
    frame = LinearFrame(rgb=((turned @ lights.T) * paints[materials] @ colours).astype(np.float32))
    paint = paint_of_materials(frame, turned, response, None, materials, paints)
    np.testing.assert_allclose(paint, np.prod(paints, axis=1)[materials] ** (1 / 3), rtol=0.05)
    alone = paint_of_materials(frame, inverted(frame, response), response, None, None, np.empty((0, 3)))
    assert alone[materials == 0].std() > 0.05  # the turns of the surface, where hues are not known


@pytest.mark.parametrize("has_paint", [True, False])
def test_a_sheet_without_relief_is_followed_by_its_paint_alone(has_paint: bool) -> None:
    velocity = np.array([0.9, -0.6])
    tracker = SurfaceTracker(
        smooth(0), flat_depth(WHOLE), CAMERA, paint=painted(0, 0 * velocity) if has_paint else None
    )
    for frame in range(1, 9):
        paint = painted(frame, frame * velocity) if has_paint else None
        tracked = tracker.step(smooth(frame), flat_depth(WHOLE), paint=paint)
    truth = tracker.template.positions_px + 8 * velocity
    inner = np.all((truth > 8) & (truth < [WIDTH - 8, HEIGHT - 8]), axis=1)
    error = np.linalg.norm(tracked.positions_px - truth, axis=1)[inner]
    told = tracked.uncertainty_px[inner]
    if has_paint:
        assert np.percentile(error, 95) < 0.5
        assert np.median(told) < 1.0
    else:
        assert np.median(told) > 4.0
    assert np.mean(error < told) > 0.85


def test_noise_of_paint_tells_nothing() -> None:
    blank = [np.float32(1 + np.random.default_rng(k).normal(0, 0.03, (HEIGHT, WIDTH))) for k in range(2)]
    tracker = SurfaceTracker(smooth(0), flat_depth(WHOLE), CAMERA, paint=blank[0])
    tracked = tracker.step(smooth(1), flat_depth(WHOLE), paint=blank[1])
    assert np.median(tracked.uncertainty_px) > 4.0


def test_a_place_that_suddenly_looks_otherwise_is_lost_though_all_around_it_is_not() -> None:
    def relief(seed: int) -> np.ndarray:
        drawn = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 1.5)
        return 3.0 * drawn

    place = (GRID[..., 0] >= 48) & (GRID[..., 0] < 80)
    told = []
    for heights in (relief(1), np.where(place, relief(2), relief(1))):
        tracker = SurfaceTracker(normals(*np.gradient(relief(1))[::-1]), flat_depth(WHOLE), CAMERA)
        tracked = tracker.step(normals(*np.gradient(heights)[::-1]), flat_depth(WHOLE))
        told.append(tracked.uncertainty_px.reshape(HEIGHT, WIDTH)[20:-20])
    assert told[0].max() < 1.0
    assert np.median(told[1][:, 56:72]) > 4.0
    assert np.median(told[1][:, :24]) < 1.0


@pytest.mark.parametrize("freckled", [True, False])
def test_relief_that_changes_is_no_doubt_where_paint_is_in_its_place(freckled: bool) -> None:
    """A camera's mosaic makes other slopes of the same strands of hair in every frame."""
    still = np.zeros(2)

    def moire(frame: int) -> NormalMap:
        height = cv2.GaussianBlur(np.random.default_rng(frame).normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 1.5)
        v, u = np.gradient(height)
        return normals(u, v)

    def paint(frame: int) -> Paint | None:
        return painted(frame, still) if freckled else None

    tracker = SurfaceTracker(moire(0), flat_depth(WHOLE), CAMERA, paint=paint(0))
    for frame in range(1, 4):
        tracked = tracker.step(moire(frame), flat_depth(WHOLE), paint=paint(frame))
    assert (np.median(tracked.uncertainty_px) < 1.0) == freckled


def test_a_frame_whose_paint_is_not_known_is_carried(rng: np.random.Generator) -> None:
    still = np.zeros(2)
    tracker = SurfaceTracker(smooth(0), flat_depth(WHOLE), CAMERA, paint=painted(0, still))
    known = tracker.step(smooth(1), flat_depth(WHOLE), paint=painted(1, still))
    unknown = tracker.step(smooth(2), flat_depth(WHOLE), paint=None)
    assert np.median(known.uncertainty_px) < 1.0
    assert np.median(unknown.uncertainty_px) > 4.0
