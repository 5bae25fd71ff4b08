"""The surface under shadows, against known height fields."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.normals.expected_error import with_expected_error
from vntoolkit.options.normals import RecoveryMethod
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.photometry.frame import LinearFrame, count_lit, labels_from_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows import surface
from vntoolkit.shadows.albedo import albedo_from_lit, fill_smoothly
from vntoolkit.shadows.contributions import contributions_from_rgb
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.shadows.recovery import recover_normals
from vntoolkit.shadows.roots import mirror_probability, roots_of_labels, spread_of_albedo
from vntoolkit.shadows.surface import SurfaceOptions, solve_surface
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene
from vntoolkit.solvers import (
    grid_hierarchy,
    multigrid_cycle,
    solve_grid,
)


def degrees(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((first * second).sum(-1), -1.0, 1.0)))


def errors(stage, labels: np.ndarray, method: RecoveryMethod = RecoveryMethod.SURFACE) -> np.ndarray:
    normal_map = recover_normals(stage.frame, labels, stage.response, method=method)
    return degrees(normal_map.normals_in_camera, stage.normals)


def test_the_lit_half_of_a_sphere_tells_the_side_and_so_the_error() -> None:
    """Where it does, the other root is left out of the error; where no lit pixel is near, it is not."""
    v, u = np.mgrid[-60:61, -60:61] / 120.0
    normals = np.stack([u, v, -np.sqrt(1 - u**2 - v**2)], axis=-1)
    lights = np.array([[-0.3, 0.3, -0.9], [0.5, 0.2, -0.85], [-0.3, -0.3, -0.9]])
    response = LightResponse(matrix=lights, light_colours=np.eye(3))

    def bounds(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rgb = normals @ lights.T * ((labels[..., None] >> np.arange(3)) & 1)
        frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(u.shape, bool))
        found = recover_normals(frame, labels, response)
        error_deg = with_expected_error(found, frame, response, labels).error_deg
        assert error_deg is not None
        assert found.mirror_probability is not None
        return found.mirror_probability, error_deg, degrees(found.normals_in_camera, normals)

    half = np.where(u > 0.15, 5, 7).astype(np.uint8)
    mirror, error_deg, wrong_deg = bounds(half)
    inside = u > 0.2
    assert (mirror[inside] < 0.1).all()
    assert np.mean(wrong_deg[inside] <= error_deg[inside]) > 0.9
    assert np.median(error_deg[inside]) < 15
    nothing_lit = bounds(np.full(u.shape, 5, np.uint8))
    assert (nothing_lit[0] == 0.5).all()
    assert np.median(nothing_lit[1][inside]) > 30


def test_half_a_sphere_follows_from_the_other_half() -> None:
    """It loses a light; without noise the true roots are those that continue the lit half."""
    v, u = np.mgrid[-30:31, -30:31] / 60.0
    normals = np.stack([u, v, -np.sqrt(1 - u**2 - v**2)], axis=-1)
    lights = np.array([[-0.3, 0.3, -0.9], [0.5, 0.2, -0.85], [-0.3, -0.3, -0.9]])  # plane at u < -0.2
    labels = np.where(u > 0.05, 5, 7).astype(np.uint8)
    rgb = normals @ lights.T * ((labels[..., None] >> np.arange(3)) & 1)
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(u.shape, bool))
    response = LightResponse(matrix=lights, light_colours=np.eye(3))
    found = recover_normals(frame, labels, response, method=RecoveryMethod.TWO_LIGHTS).normals_in_camera
    assert degrees(found, normals).max() < 0.5


def test_an_albedo_that_is_hardly_known_does_not_choose_the_normal(rng: np.random.Generator) -> None:
    """Half a sphere whose paint varies by 40 %: the ratio of two lamps and the depth tell more than roots."""
    v, u = np.mgrid[-60:61, -60:61] / 120.0
    normals = np.stack([u, v, -np.sqrt(1 - u**2 - v**2)], axis=-1)
    lights = np.array([[-0.3, 0.3, -0.9], [0.5, 0.2, -0.85], [-0.3, -0.3, -0.9]])
    labels = np.where(u > 0.15, 5, 7).astype(np.uint8)
    paint = np.kron(np.exp(rng.normal(0.0, 0.4, (31, 31))), np.ones((4, 4)))[:121, :121]
    rgb = 0.5 * paint[..., None] * normals @ lights.T * ((labels[..., None] >> np.arange(3)) & 1)
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(u.shape, bool))
    response = LightResponse(matrix=lights, light_colours=np.eye(3))

    def mean_error(method: RecoveryMethod) -> float:
        found = recover_normals(frame, labels, response, method=method).normals_in_camera
        return float(degrees(found, normals)[labels == 5].mean())

    assert mean_error(RecoveryMethod.SURFACE) < 0.5 * mean_error(RecoveryMethod.TWO_LIGHTS)


def test_where_both_roots_fit_as_well_nothing_is_said_to_block_the_light(rng: np.random.Generator) -> None:
    """A plane all in the shadow of one lamp: no lit neighbour tells on which side its normals lie."""
    lights = np.array([[-0.5, 0.1, -0.86], [0.35, 0.3, -0.89], [0.1, -0.45, -0.89]])
    averted = np.array([0.6, 0.2, -0.8]) / np.linalg.norm([0.6, 0.2, -0.8])
    rgb = np.tile(lights @ averted * [0.0, 1.0, 1.0], (40, 50, 1)) + rng.normal(0.0, 0.002, (40, 50, 3))
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros((40, 50), bool))
    response = LightResponse(matrix=lights, light_colours=np.eye(3))
    found = recover_normals(frame, np.full((40, 50), 6, np.uint8), response).normals_in_camera
    assert degrees(found, averted).max() < 3.0


def test_the_spread_of_the_albedo_is_the_paint_s(rng: np.random.Generator) -> None:
    lit, around = np.ones((80, 90), bool), np.ones((80, 90), np.float32)
    for deviation in (0.05, 0.2):
        paint = np.exp(rng.normal(0.0, deviation, lit.shape)).astype(np.float32)
        assert spread_of_albedo(paint, around, lit) == pytest.approx(2.0 * deviation, rel=0.05)
    assert spread_of_albedo(around, around, lit) == 0.01
    assert spread_of_albedo(around, around, ~lit) is None


@pytest.mark.parametrize("name", ["stage", "stage_with_crosstalk"])
def test_shadowed_normals_at_most_half_as_wrong_and_lit_ones_no_worse(name: str, request) -> None:
    stage = request.getfixturevalue(name)
    lights = count_lit(stage.labels)
    assert (lights == 2).mean() > 0.15
    plain = errors(stage, stage.labels, RecoveryMethod.INVERSION)
    for labels in (stage.labels, ShadowDetector(stage.response).labels(stage.frame)):
        found = errors(stage, labels)
        assert 2 * found[lights == 2].mean() < plain[lights == 2].mean()
        assert found[lights == 3].mean() < plain[lights == 3].mean() + 0.2
    roots = errors(stage, stage.labels, RecoveryMethod.TWO_LIGHTS)
    assert 2 * roots[lights == 2].mean() < plain[lights == 2].mean()


@pytest.mark.parametrize("label", range(8))
def test_any_single_label_passes_without_nan(stage, label: int) -> None:
    labels = np.full(stage.mask.shape, label, np.uint8)
    for method in RecoveryMethod:
        normal_map = recover_normals(stage.frame, labels, stage.response, method=method)
        normals = normal_map.normals_in_camera
        assert np.abs(np.linalg.norm(normals, axis=-1) - 1.0).max() < 1e-5
        assert (normals[..., 2] < 0).all()
        assert normal_map.weight is not None
        assert ((normal_map.weight >= 0) & (normal_map.weight <= 1)).all()


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_black_and_white_frames_pass_without_nan(stage, level: float) -> None:
    frame = LinearFrame(rgb=np.full((20, 31, 3), level, np.float32), clipped=np.full((20, 31), level == 1.0))
    for label in (0, 5, 7):
        result = recover_normals(frame, np.full((20, 31), label, np.uint8), stage.response)
        assert np.isfinite(result.normals_in_camera).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("camera", [None, Camera.pinhole(width=160, height=120, focal_px=300.0)])
def test_an_empty_mask_gives_an_empty_map(stage, camera: Camera | None) -> None:
    nothing = np.zeros(stage.mask.shape, bool)
    result = recover_normals(stage.frame, stage.labels, stage.response, nothing, camera=camera)
    assert not result.mask.any()
    assert not result.normals_in_camera.any()


def test_perspective_sphere_keeps_its_normals_and_distances(monkeypatch) -> None:
    """A sphere of radius 1 at distance 4 under three lights: normals and relative depth from all labels 7."""
    camera = Camera.pinhole(width=120, height=120, focal_px=180.0)
    rays = camera.unproject(camera.pixel_grid(), np.ones((120, 120)))
    a, b = (rays**2).sum(-1), rays @ np.array([0.0, 0.0, 4.0])
    inside = b**2 - a * 15.0
    mask = inside > 0.5
    depth = np.where(mask, (b - np.sqrt(np.maximum(inside, 0))) / a, 0.0)
    normals = np.where(mask[..., None], rays * depth[..., None] - [0, 0, 4.0], [0, 0, -1.0])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    lights = np.array([[0.2, 0.1, -0.97], [-0.3, 0.2, -0.93], [0.1, -0.3, -0.95]])
    monkeypatch.setattr(surface, "_TOLERANCE", 1e-7)
    solved = solve_surface(
        normals @ lights.T, np.full((120, 120), 7, np.uint8), lights, mask,
        first_normals=normals, camera=camera, options=SurfaceOptions(cycles=40),  # to the end
    )  # fmt: skip
    inner = cv2.erode(mask.astype(np.uint8), np.ones((5, 5))) > 0  # one-sided differences at the border
    assert degrees(solved.normals, normals)[inner].max() < 0.6
    ratio = np.exp(solved.depth[mask] / 180.0) / depth[mask]
    assert ratio.std() / ratio.mean() < 0.002


@pytest.mark.parametrize(("tilt_deg", "finds_shadows"), [(25.0, True), (45.0, False)])
def test_a_wall_far_behind_a_ball_keeps_its_normals_in_the_shadow(
    tilt_deg: float, finds_shadows: bool
) -> None:
    """A depth that must hold together from the ball to the wall turns the wall, by 10 degrees in the mean."""
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
    labels, start = labels_from_lit(lit), None
    two = count_lit(labels) == 2
    if finds_shadows:
        detector = ShadowDetector(response)
        labels, start = detector.labels(frame), detector.surface
    found = recover_normals(frame, labels, response, start=start).normals_in_camera
    assert degrees(found, normals)[two & ~on_ball].mean() < 1.5
    assert degrees(found, normals)[two & on_ball].mean() < 6.0


def test_grid_solver_solves_what_a_dense_solver_solves(rng: np.random.Generator) -> None:
    edges = random_edges(rng, 4, 9, 7)
    dense = dense_matrix(edges)
    right = rng.normal(size=(9, 7)).astype(np.float32)
    right -= right.mean()
    found = solve_grid(grid_hierarchy(edges), right, np.zeros_like(right), 1e-7, 100)
    # Constants, and they alone, are what `dense` sends to zero; kept at zero, they leave one solution.
    expected = np.linalg.solve(dense + np.full_like(dense, 1 / 63), right.ravel()).reshape(9, 7)
    assert np.abs((found - found.mean()) - (expected - expected.mean())).max() < 1e-4


def dense_matrix(edges: np.ndarray) -> np.ndarray:
    """The Laplacian of edges (kinds, h, w) to the east, south, south-east and south-west."""
    _, h, w = edges.shape
    ends = ((0, 0, 0, 1), (0, 0, 1, 0), (0, 0, 1, 1), (0, 1, 1, 0))
    dense = np.zeros((h * w, h * w))
    for kind, v, u in np.argwhere(edges != 0):
        dv1, du1, dv2, du2 = ends[kind]
        i, j = (v + dv1) * w + u + du1, (v + dv2) * w + u + du2
        dense[[i, j], [i, j]] += edges[kind, v, u]
        dense[[i, j], [j, i]] -= edges[kind, v, u]
    return dense


def random_edges(rng: np.random.Generator, kinds: int, h: int, w: int) -> np.ndarray:
    edges = rng.random((kinds, h, w)).astype(np.float32)
    edges[0, :, -1] = edges[1, -1] = edges[2:, :, -1] = edges[2:, -1] = 0
    return edges


@pytest.mark.parametrize("kinds", [2, 4])
def test_five_cycles_inside_a_mask_leave_less_than_a_thousandth(rng: np.random.Generator, kinds: int) -> None:
    """A disc, whose rows begin and end anywhere."""
    v, u = np.mgrid[:43, :38]
    mask = (u - 20) ** 2 + (v - 19) ** 2 < 17**2
    edges = 0.5 + 0.5 * random_edges(rng, kinds, 43, 38)
    for kind, (dv, du) in enumerate(((0, 1), (1, 0), (1, 1), (1, 1))[:kinds]):
        here, there = (mask, np.roll(mask, (-dv, -du), (0, 1)))
        if kind == 3:
            here, there = np.roll(mask, -1, 1), np.roll(mask, -1, 0)
        edges[kind] *= here & there
    right = np.where(mask, rng.normal(size=mask.shape), 0).astype(np.float32)
    right[mask] -= right[mask].mean()
    levels = grid_hierarchy(edges)
    found = solve_grid(levels, right, np.zeros_like(right), 0.0, 5)
    left = right.ravel() - dense_matrix(edges) @ found.ravel()
    assert np.linalg.norm(left) < 5e-4 * np.linalg.norm(right)
    assert not found[~mask].any()


@pytest.mark.parametrize("weak", [1e-4, 1e-3])
def test_blocks_on_a_weak_edge_do_not_spoil_the_correction(rng: np.random.Generator, weak: float) -> None:
    """Blocks of four lone pixels, one of them tied to a pixel that is cut off from its own block."""
    edges = random_edges(rng, 2, 40, 40)
    edges += 0.5 * (edges > 0)
    lone, tied = np.zeros((40, 40), bool), np.zeros((40, 40), bool)
    tied[2:38:6, 3:36:8] = True
    for dv, du in ((0, 0), (1, 0), (0, -1), (1, -1)):
        lone |= np.roll(tied, (dv, du), (0, 1))
    edges[0][lone | np.roll(lone, -1, 1) | np.roll(tied, 1, 1)] = edges[1][lone | np.roll(lone, -1, 0)] = 0
    edges[0][tied] = weak
    right = dense_matrix(edges) @ np.where(lone, 0, rng.normal(size=lone.shape)).ravel()
    asked = right.reshape(lone.shape).astype(np.float32)
    found = solve_grid(grid_hierarchy(edges), asked, np.zeros_like(asked), 0.0, 4)
    assert np.linalg.norm(right - dense_matrix(edges) @ found.ravel()) < 1e-3 * np.linalg.norm(right)


def test_a_cycle_is_symmetric(rng: np.random.Generator) -> None:
    edges = random_edges(rng, 4, 230, 181)
    levels = grid_hierarchy(edges)
    first, second = (rng.normal(size=(230, 181)).astype(np.float32) for _ in range(2))
    one, other = multigrid_cycle(levels, first), multigrid_cycle(levels, second)
    across, back = float(np.vdot(second, one)), float(np.vdot(first, other))
    size = float(np.linalg.norm(first) * np.linalg.norm(other))
    assert across == pytest.approx(back, abs=1e-5 * size)


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


def test_weights_fall_with_the_lights_that_are_missing(stage) -> None:
    labels = np.full(stage.mask.shape, 7, np.uint8)
    labels[20:40], labels[40:60], labels[60:80] = 6, 2, 0
    weight = recover_normals(
        stage.frame, labels, stage.response, stage.mask, method=RecoveryMethod.TWO_LIGHTS
    ).weight
    assert weight is not None
    assert (np.diff([weight[row, 80] for row in (10, 30, 50, 70)]) < 0).all()
    assert weight[10, 80] == 1.0


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
    shift = np.array([[1, 0, 4], [0, 1, 4], [0, 0, 1.0]])
    camera = Camera.pinhole(width=200, height=150, focal_px=300.0)
    near = camera.cropped(slice(0, 128), slice(0, 168))
    assert np.allclose(shift @ camera.cropped(slice(4, 124), slice(4, 164)).matrix, camera.matrix)
    assert (near.width, near.height) == (168, 128)
    detector = ShadowDetector(stage.response, camera=camera)
    labels = detector.labels(large, mask)
    found = recover_normals(large, labels, stage.response, mask, camera=camera)
    part = LinearFrame(rgb=rgb[:128, :168], clipped=large.clipped[:128, :168])
    alone = ShadowDetector(stage.response, camera=near)
    labels_alone = alone.labels(part, mask[:128, :168])
    expected = recover_normals(part, labels_alone, stage.response, mask[:128, :168], camera=near)
    assert (labels[~mask] == 7).all()
    assert np.array_equal(labels[:128, :168], labels_alone)
    normals = found.normals_in_camera
    assert np.allclose(normals[:128, :168], expected.normals_in_camera, atol=1e-5)
    assert not normals[~mask].any()


def test_a_step_in_depth_does_not_bend_the_surface_beside_it(monkeypatch) -> None:
    """Two tilted planes, one twenty pixels in front of the other, all lit and noisy."""
    height, width = 90, 120
    slopes = np.where(np.arange(width) < 60, 0.3, -0.2)[None, :, None] * np.ones((height, 1, 1))
    normals = np.concatenate([slopes, 0.1 * np.ones_like(slopes), -np.ones_like(slopes)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[20:70, 58:62] = [
        -0.7,
        0.0,
        -0.714,
    ]  # the front plane's rim turns away: its depth adds up to a step
    lights = np.array([[0.3, 0.1, -0.95], [-0.4, 0.2, -0.89], [0.1, -0.4, -0.91]])
    cosines = normals @ lights.T + np.random.default_rng(2).normal(0.0, 0.005, normals.shape)
    first = cosines @ np.linalg.inv(lights).T
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    labels, mask = np.full((height, width), 7, np.uint8), np.ones((height, width), bool)
    away = np.ones((height, width), bool)
    away[:, 54:66] = False

    def error(robust_scale: float) -> float:
        monkeypatch.setattr(surface, "_STEP_SCALE", robust_scale)
        solved = solve_surface(
            cosines, labels, lights, mask, first_normals=first, options=SurfaceOptions(noise=0.01)
        )
        return float(degrees(solved.normals, normals)[away].mean())

    plain = float(degrees(first, normals)[away].mean())
    assert error(10.0) < 0.5 * plain  # noise is averaged away, the step is not
    assert error(surface.NO_STEP) > plain  # without breaking, the step spreads over both planes


def test_a_shadow_cast_over_a_step_keeps_the_light_of_two_lamps() -> None:
    """A wall before a bent one, whose lamp reaches neither the step nor what lies beside it."""
    height, width, rim, end = 100, 140, 50, 110
    v, u = np.mgrid[:height, :width]
    across = np.where(u < rim, -0.3 + 0.002 * u, 0.45 - 0.004 * (u - rim))
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
    assert off[labels == 6].mean() < 5.0  # 4.0; a depth that bends at the rim, taken at its word, makes 6.2
    assert off[labels == 7].mean() < 1.0


def test_a_rim_of_two_shadows_by_turns_takes_the_root_of_the_lit_surface_beside_it() -> None:
    """A plane that all lights reach; at its rim every second pixel is called without one, the others without
    another, so that every lit pixel beside them has both as neighbours.
    """
    lights = np.array([[0.0, -0.5, -0.9], [0.45, 0.25, -0.9], [-0.45, 0.25, -0.9]])
    normal = np.array([0.25, 0.55, -0.8]) / np.linalg.norm([0.25, 0.55, -0.8])
    response = LightResponse(matrix=lights)
    rgb = np.broadcast_to((lights @ normal).astype(np.float32), (12, 16, 3)).copy()
    labels = np.full((12, 16), 7, np.uint8)
    labels[::2, -1], labels[1::2, -1] = 0b101, 0b011
    light = contributions_from_rgb(rgb, response, np.ones((12, 16), np.float32))
    roots = roots_of_labels(light, light.length, labels, np.ones((12, 16), bool), spread=0.01)
    assert degrees(roots.normals, normal).max() < 0.1


def test_the_end_of_a_cylinder_is_no_cast_shadow() -> None:
    """A lamp behind it leaves two roots; the wrong one continues the side that is seen above it."""
    scene = build_scene("cylinder", SceneOptions(width=480, height=360, seed=3))
    shot = render_frame(scene, 4)
    truth, response = shot.truth, true_response(scene, Nuisances())
    detector = ShadowDetector(response, camera=scene.camera)
    labels = detector.labels(shot.linear, truth.normals.mask)
    found = recover_normals(
        shot.linear, labels, response, truth.normals.mask, scene.camera, start=detector.surface
    )
    off = degrees(found.normals_in_camera, truth.normals.normals_in_camera)
    two = truth.normals.mask & (count_lit(truth.labels) == 2)
    assert two.sum() > 2000
    assert off[two].mean() < 8.0  # 3.6; 89 where a wide shadow is cast as lightly as a narrow one


def test_lit_pixels_vouch_for_a_root_as_far_as_it_is_unlikely_to_change() -> None:
    """A strip whose left end borders on light: half way along, a change of root costs nothing."""
    two, facing = np.ones((2, 3, 12), np.bool_)
    log_odds, east, south = np.zeros((3, *two.shape), np.float32)
    log_odds[:, 0] = [4.0, 3.0, 2.0]
    east[:], south[:], east[:, 5] = 5.0, 5.0, 0.0
    found = mirror_probability(log_odds, facing, two, east, south)
    np.testing.assert_allclose(found[:, :6], 1.0 / (1.0 + np.exp(3.0)), rtol=1e-5)
    np.testing.assert_allclose(found[:, 6:], 0.5)
    np.testing.assert_allclose(
        mirror_probability(log_odds, ~facing, two, east, south)[:, :6], 1 - found[:, :6]
    )
