"""The normals under shadows, against known height fields."""

from __future__ import annotations

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.photometry.frame import LinearFrame, count_lit, labels_from_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.albedo import albedo_from_lit, fill_smoothly
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.shadows.recovery import recover_normals
from vntoolkit.shadows.roots import spread_of_albedo


def degrees(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((first * second).sum(-1), -1.0, 1.0)))


def errors(stage, labels: np.ndarray) -> np.ndarray:
    return degrees(recover_normals(stage.frame, labels, stage.response).normals_in_camera, stage.normals)


def test_half_a_sphere_follows_from_the_other_half() -> None:
    """It loses a light; without noise the true roots are those that continue the lit half."""
    v, u = np.mgrid[-30:31, -30:31] / 60.0
    normals = np.stack([u, v, -np.sqrt(1 - u**2 - v**2)], axis=-1)
    lights = np.array([[-0.3, 0.3, -0.9], [0.5, 0.2, -0.85], [-0.3, -0.3, -0.9]])  # plane at u < -0.2
    labels = np.where(u > 0.05, 5, 7).astype(np.uint8)
    rgb = normals @ lights.T * ((labels[..., None] >> np.arange(3)) & 1)
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(u.shape, bool))
    response = LightResponse(matrix=lights, light_colours=np.eye(3))
    found = recover_normals(frame, labels, response).normals_in_camera
    assert degrees(found, normals).max() < 0.5  # an albedo known to 1 % lets the smoothing bend that much


@pytest.mark.parametrize("name", ["stage", "stage_with_crosstalk"])
def test_shadowed_normals_at_most_half_as_wrong_and_lit_ones_as_inverted(name: str, request) -> None:
    stage = request.getfixturevalue(name)
    lights = count_lit(stage.labels)
    assert (lights == 2).mean() > 0.15
    inverted = normals_from_frame(stage.frame, stage.response).normals_in_camera
    plain = degrees(inverted, stage.normals)
    for labels in (stage.labels, ShadowDetector(stage.response).labels(stage.frame)):
        found = recover_normals(stage.frame, labels, stage.response).normals_in_camera
        assert 2 * degrees(found, stage.normals)[lights == 2].mean() < plain[lights == 2].mean()
        assert degrees(found, inverted)[labels == 7].max() < 0.05  # in single precision


@pytest.mark.parametrize("label", range(8))
def test_any_single_label_passes_without_nan(stage, label: int) -> None:
    labels = np.full(stage.mask.shape, label, np.uint8)
    normal_map = recover_normals(stage.frame, labels, stage.response)
    normals = normal_map.normals_in_camera
    assert np.abs(np.linalg.norm(normals, axis=-1) - 1.0).max() < 1e-5
    assert (normals[..., 2] < 0).all()
    assert normal_map.weight is not None
    assert ((normal_map.weight >= 0) & (normal_map.weight <= 1)).all()


@pytest.mark.parametrize("level", [0.0, 1.0, float("nan")])
def test_black_white_and_broken_frames_pass_without_nan(stage, level: float) -> None:
    frame = LinearFrame(rgb=np.full((20, 31, 3), level, np.float32), clipped=np.full((20, 31), level == 1.0))
    for label in (0, 5, 7):
        result = recover_normals(frame, np.full((20, 31), label, np.uint8), stage.response)
        assert np.isfinite(result.normals_in_camera).all()


@pytest.mark.filterwarnings("error")
def test_an_empty_mask_gives_an_empty_map(stage) -> None:
    nothing = np.zeros(stage.mask.shape, bool)
    result = recover_normals(stage.frame, stage.labels, stage.response, nothing)
    assert not result.mask.any()
    assert not result.normals_in_camera.any()


@pytest.mark.parametrize(("tilt_deg", "finds_shadows"), [(25.0, True), (45.0, False)])
def test_a_wall_far_behind_a_ball_keeps_its_normals_in_the_shadow(
    tilt_deg: float, finds_shadows: bool
) -> None:
    """The shadow on the wall takes the roots that face the lamp, the ball's own those that do not."""
    v, u = np.mgrid[-60:101, -70:71] / 50.0
    square = 1.0 - u**2 - v**2
    on_ball = square > 0.02
    height = np.where(on_ball, np.sqrt(np.maximum(square, 0.0)), -1.0)
    points = np.stack([u, v, -height], axis=-1)
    normals = np.where(on_ball[..., None], points, [0.0, 0.0, -1.0])
    around, tilt = np.radians([-90.0, 30.0, 150.0]), np.radians(tilt_deg)
    lamps = np.column_stack(
        [np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.full(3, -np.cos(tilt))]
    )
    along = points @ lamps.T
    reach = along**2 - (np.sum(points**2, axis=-1) - 1.0)[..., None]  # of the ray to the lamp into the ball
    blocked = ~on_ball[..., None] & (reach > 0.0) & (np.sqrt(np.maximum(reach, 0.0)) > along)
    lit = (normals @ lamps.T > 0.0) & ~blocked
    rgb = np.where(lit, 0.8 * (normals @ lamps.T), 0.0) + np.random.default_rng(0).normal(
        0.0, 0.003, lit.shape
    )
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(on_ball.shape, bool))
    response = LightResponse(matrix=0.8 * lamps, light_colours=np.eye(3))
    labels = labels_from_lit(lit)
    two = count_lit(labels) == 2
    if finds_shadows:
        labels = ShadowDetector(response).labels(frame)
    found = recover_normals(frame, labels, response).normals_in_camera
    assert degrees(found, normals)[two & ~on_ball].mean() < 1.5
    assert degrees(found, normals)[two & on_ball].mean() < 6.0


def test_fill_keeps_what_is_known_and_stays_between() -> None:
    values = np.tile(np.linspace(0.0, 1.0, 64, dtype=np.float32), (48, 1))
    trust = np.ones((48, 64))
    trust[10:30, 20:40] = 0.0
    filled = fill_smoothly(np.where(trust > 0, values, 9.0), trust)
    assert np.abs(filled - values)[trust > 0].max() < 1e-3
    assert np.abs(filled - values)[trust == 0].max() < 0.15
    assert not fill_smoothly(values, np.zeros((48, 64))).any()


def test_albedo_ignores_outliers_and_shadow() -> None:
    length = np.full((64, 64), 0.7)
    length[20:40, 20:40] = 0.2  # in shadow the length means nothing
    length[5, 5] = 3.0  # a highlight
    lit = np.ones((64, 64), bool)
    lit[20:40, 20:40] = False
    albedo = albedo_from_lit(length, lit)
    assert np.abs(albedo[20:40, 20:40] - 0.7).max() < 0.02
    assert albedo[5, 5] < 1.0
    assert (albedo_from_lit(length, np.zeros((64, 64), bool)) == 1.0).all()


def test_the_spread_of_the_albedo_is_the_paint_s(rng: np.random.Generator) -> None:
    lit, around = np.ones((80, 90), bool), np.ones((80, 90), np.float32)
    for deviation in (0.05, 0.2):
        paint = np.exp(rng.normal(0.0, deviation, lit.shape)).astype(np.float32)
        assert spread_of_albedo(paint, around, lit) == pytest.approx(2.0 * deviation, rel=0.05)
    assert spread_of_albedo(around, around, lit) == 0.01
    assert spread_of_albedo(around, around, ~lit) == 0.15


def test_weights_fall_with_the_lights_that_are_missing(stage) -> None:
    labels = np.array(stage.labels)
    labels[:4, 0] = 7, 6, 2, 0
    weight = recover_normals(stage.frame, labels, stage.response).weight
    assert weight is not None
    assert weight[0, 0] == 1.0
    assert (np.diff(weight[:4, 0]) < 0).all()


def test_refusals(stage) -> None:
    with pytest.raises(BadInput, match="bytes from 0 to 7"):
        recover_normals(stage.frame, np.full(stage.mask.shape, 9, np.uint8), stage.response)
    with pytest.raises(BadInput, match="mask: expected booleans, got uint8"):
        recover_normals(stage.frame, stage.labels, stage.response, np.full((120, 160), 255, np.uint8))
    with pytest.raises(BadInput, match="visibility labels: expected shape"):
        recover_normals(stage.frame, np.zeros((3, 3), np.uint8), stage.response)


def test_the_place_of_a_figure_in_its_frame_changes_nothing(stage) -> None:
    """The same figure alone, and in the corner of a larger dark frame."""
    mask = np.zeros((150, 200), bool)
    mask[4:124, 4:164] = True
    rgb = np.zeros((150, 200, 3), np.float32)
    rgb[4:124, 4:164] = stage.frame.rgb
    large = LinearFrame(rgb=rgb, clipped=np.zeros(mask.shape, bool))
    detector = ShadowDetector(stage.response)
    labels = detector.labels(large, mask)
    normals = recover_normals(large, labels, stage.response, mask).normals_in_camera
    part = LinearFrame(rgb=rgb[:128, :168], clipped=large.clipped[:128, :168])
    labels_alone = detector.labels(part, mask[:128, :168])
    expected = recover_normals(part, labels_alone, stage.response, mask[:128, :168])
    assert (labels[~mask] == 7).all()
    assert np.array_equal(labels[:128, :168], labels_alone)
    assert np.allclose(normals[:128, :168], expected.normals_in_camera, atol=1e-5)
    assert not normals[~mask].any()


def test_a_shadow_cast_over_a_step_keeps_the_light_of_two_lamps() -> None:
    """A wall before a bent one, whose lamp reaches neither the step nor what lies beside it."""
    height, width, rim, end = 100, 140, 50, 110
    v, u = np.mgrid[:height, :width]
    across = np.where(u < rim, -0.3 + 0.002 * u, -0.25 + 0.004 * (u - rim))
    slopes = np.stack([across, 0.2 - 0.004 * v], axis=-1)
    normals = np.concatenate([slopes, -np.ones((height, width, 1))], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    lights = np.array([[-0.5, 0.1, -0.86], [0.35, 0.3, -0.89], [0.1, -0.45, -0.89]])
    labels = np.where((u >= rim) & (u < end), 6, 7).astype(np.uint8)
    arrives = (labels[..., None] >> np.arange(3)) & 1
    rgb = normals @ lights.T * arrives + np.random.default_rng(4).normal(0.0, 0.004, normals.shape)
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros((height, width), bool))
    response = LightResponse(matrix=lights, light_colours=np.eye(3))
    found = recover_normals(frame, labels, response)
    off = degrees(found.normals_in_camera, normals)
    assert off[labels == 6].mean() < 2.0
    assert off[labels == 7].mean() < 1.0


def test_where_both_roots_fit_as_well_nothing_is_said_to_block_the_light(rng: np.random.Generator) -> None:
    """A plane all in the shadow of one lamp: no lit neighbour tells on which side its normals lie."""
    lights = np.array([[-0.5, 0.1, -0.86], [0.35, 0.3, -0.89], [0.1, -0.45, -0.89]])
    averted = np.array([0.6, 0.2, -0.8]) / np.linalg.norm([0.6, 0.2, -0.8])
    rgb = np.tile(lights @ averted * [0.0, 1.0, 1.0], (40, 50, 1)) + rng.normal(0.0, 0.002, (40, 50, 3))
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros((40, 50), bool))
    response = LightResponse(matrix=lights, light_colours=np.eye(3))
    found = recover_normals(frame, np.full((40, 50), 6, np.uint8), response).normals_in_camera
    assert degrees(found, averted).max() < 3.0
