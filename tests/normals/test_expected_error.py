"""Nine of ten normals lie within their expected error, whatever the error's cause."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.maps_and_meshes.maps import read_normal_map, write_normal_map
from vntoolkit.normals.expected_error import (
    errors_of_materials,
    with_added_error,
    with_expected_error,
)
from vntoolkit.normals.frame_evidence import fit_ellipsoid
from vntoolkit.normals.inversion import normals_from_frame, rows_of
from vntoolkit.normals.lost_detail import _OF_MANY_WAVES, detail_kernel, lost_over_left, side_of_squares
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

MATRIX = np.array([[0.5, 0.06, -0.45], [-0.22, 0.4, -0.5], [-0.2, -0.35, -0.42]])
RESPONSE = LightResponse(matrix=MATRIX, ambient=np.array([0.02, 0.01, 0.03]))


def waves(size=240):
    """Normals (size, size, 3) of a surface with slopes up to 0.7 in all directions."""
    v, u = np.mgrid[:size, :size] / 12.0
    p = 0.35 * np.sin(u + 0.3 * v) + 0.25 * np.cos(0.6 * u - v)
    q = 0.35 * 0.3 * np.sin(u + 0.3 * v) - 0.25 / 0.6 * np.cos(0.6 * u - v) + 0.2 * np.sin(0.9 * v)
    normals = np.stack([p, q, -np.ones_like(p)], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def seen(rgb, response=RESPONSE, truth=None, **more):
    """Return the map with its expected error, and the true errors in degrees."""
    frame = LinearFrame(rgb=np.minimum(rgb, 1.0), clipped=(rgb >= 1.0).any(axis=2))
    normal_map = with_expected_error(normals_from_frame(frame, response), frame, response, **more)
    cosine = np.einsum("vui,vui->vu", normal_map.normals_in_camera, waves() if truth is None else truth)
    return normal_map, np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def colours(normals=None):
    return (waves() if normals is None else normals) @ MATRIX.T + RESPONSE.ambient


@pytest.mark.parametrize("sigma", [0.01, 0.02, 0.04])
def test_noise_is_foretold_to_a_tenth(rng, sigma):
    normal_map, error = seen(colours() + rng.normal(0, sigma, (240, 240, 3)))
    within = (error <= normal_map.error_deg)[normal_map.mask].mean()
    assert 0.85 < within < 0.95
    assert np.median(normal_map.error_deg) == pytest.approx(1.82 * np.median(error), rel=0.25)


def test_an_error_of_m_is_seen_without_any_truth(rng):
    """Four wrong rigs: the bound is neither broken nor ten times too wide."""
    light = colours() + rng.normal(0, 0.003, (240, 240, 3))
    for _ in range(4):
        wrong = LightResponse(matrix=MATRIX * (1 + rng.normal(0, 0.1, (3, 3))), ambient=RESPONSE.ambient)
        normal_map, error = seen(light, wrong)
        right, _ = seen(light)
        assert np.median(normal_map.error_deg) > 3 * np.median(right.error_deg)
        assert (error <= normal_map.error_deg).mean() > 0.6
        assert np.median(normal_map.error_deg) < 8 * np.median(error)


def test_an_error_of_m_is_seen_on_a_subject_that_is_nearly_flat(rng):
    """Most of E's entries are not told there, nor do they turn these normals; two are, and do."""
    truth = waves() * [0.12, 0.12, 1.0]
    truth /= np.linalg.norm(truth, axis=-1, keepdims=True)
    light = colours(truth) + rng.normal(0, 0.004, (240, 240, 3))
    right, error = seen(light, truth=truth)
    assert np.median(right.error_deg) < 2.5 * np.median(error)
    within = []
    for _ in range(6):
        wrong = LightResponse(matrix=MATRIX * (1 + rng.normal(0, 0.04, (3, 3))), ambient=RESPONSE.ambient)
        normal_map, error = seen(light, wrong, truth)
        within.append((error <= normal_map.error_deg).mean())
    assert np.median(within) > 0.9, within


@pytest.mark.parametrize("distance", [5.0, 10.0])
def test_near_lamps_are_seen_without_any_truth(rng, distance):
    """Point lamps a few half pictures away, under a rig that is right at the centre: light from two sides."""
    towards = MATRIX / np.linalg.norm(MATRIX, axis=1, keepdims=True)
    v, u = (np.mgrid[:240, :240] - 119.5) / 120
    place = np.stack([u, v, np.zeros_like(u)], axis=-1)
    to_lamp = distance * towards - place[..., None, :]
    away = np.linalg.norm(to_lamp, axis=-1, keepdims=True)
    lamps = np.linalg.norm(MATRIX, axis=1)[:, None] * to_lamp / away * (distance / away) ** 2
    light = np.einsum("vuki,vui->vuk", lamps, waves()) + RESPONSE.ambient
    normal_map, error = seen(np.maximum(light, 0) + rng.normal(0, 0.003, light.shape))
    assert np.median(error) > 25 / distance
    assert (error <= normal_map.error_deg).mean() > 0.9
    assert np.median(normal_map.error_deg) < 2.5 * np.median(error)


def test_clipped_painted_and_shadowed_pixels_are_doubted(rng):
    light = colours() + rng.normal(0, 0.003, (240, 240, 3))
    painted = light.copy()
    painted[60:100, 60:100] *= [1.0, 0.7, 0.4]
    normal_map, error = seen(painted)
    assert (error <= normal_map.error_deg)[60:100, 60:100].mean() > 0.85
    assert np.median(normal_map.error_deg[60:100, 60:100]) > 5 * np.median(normal_map.error_deg)
    clipped, error = seen(1.8 * light)
    at = (1.8 * light).max(axis=2) > 1.1
    assert at.mean() > 0.02
    assert (error <= clipped.error_deg)[at].mean() > 0.85
    labels = np.full((240, 240), 7, np.uint8)
    labels[:, :40], labels[:, 40:80], labels[:, 80:120] = 3, 4, 0
    shadowed, _ = seen(light, labels=labels)
    lit, two, one, none = (np.median(shadowed.error_deg[:, k : k + 40]) for k in (120, 0, 40, 80))
    assert lit < 25 < min(two, one)
    assert max(two, one) < none * 1.2


def beside_the_plane_of_two():
    """Return the unit normal of the plane of lights 1 and 2, and the direction of light 0."""
    missing, *two = RESPONSE.light_directions
    across = np.cross(*two)
    return across / np.linalg.norm(across), missing


def of_the_albedo_deg(off):
    """Nine of ten turns of a normal at `off` from the plane of two lights by an albedo known to 3 %."""
    in_plane = 1 - off**2
    moved = in_plane + in_plane**2 / (off**2 + 0.06 * in_plane)
    return np.degrees(2.146 * 0.03 * np.sqrt(moved))


def test_of_two_lights_the_bound_is_the_distance_of_the_other_normal():
    """Where the normal faces the light that is missing: something throws a shadow."""
    normal_map, _ = seen(colours(), labels=np.full((240, 240), 6, np.uint8))
    across, missing = beside_the_plane_of_two()
    found = normal_map.normals_in_camera
    off, bound = found @ across, normal_map.error_deg
    other = found - 2 * off[..., None] * across
    faces = (found @ missing > 0.05) & (other[..., 2] < 0)
    apart = np.degrees(1.1 * 2 * np.abs(off))
    middle = faces & (apart > 10) & (apart < 60)
    assert middle.sum() > 1000
    expected = np.hypot(apart, of_the_albedo_deg(off))
    np.testing.assert_allclose(bound[middle], expected[middle], rtol=0.1)
    assert bound.max() < 72.0  # as of a normal that faces the camera without light: less weight tears depth


def test_of_two_lights_and_a_normal_behind_the_third_the_bound_is_how_far_it_departs_from_their_light(rng):
    """The normal explains the shadow: the other one cannot be meant."""
    across, missing = beside_the_plane_of_two()
    behind = -0.3 * missing + 0.9 * np.array([0, 0, -1.0])
    behind += (-0.2 - behind @ missing) * missing
    behind /= np.linalg.norm(behind)
    assert behind @ missing < -0.1
    assert behind[2] < -0.2
    light = colours()
    light[60:180, 60:180] = np.maximum(MATRIX @ behind, 0) + RESPONSE.ambient
    labels = np.full((240, 240), 7, np.uint8)
    labels[60:180, 60:180] = 6
    turn = np.radians(8.0)
    side = np.cross(behind, across)
    turned = np.cos(turn) * behind + np.sin(turn) * side / np.linalg.norm(side)
    frame = LinearFrame(rgb=light, clipped=np.zeros((240, 240), bool))
    for normal, least, most in ((behind, 0.0, 3.0), (turned, 7.0, 12.0)):
        plain = normals_from_frame(frame, RESPONSE)
        normals = np.array(plain.normals_in_camera)
        normals[60:180, 60:180] = normal
        given = NormalMap(normals_in_camera=normals, mask=np.ones((240, 240), bool), weight=plain.weight)
        bound = with_expected_error(given, frame, RESPONSE, labels).error_deg[80:160, 80:160]
        of_albedo = of_the_albedo_deg(behind @ across)
        assert least <= np.sqrt(np.median(bound) ** 2 - of_albedo**2) <= most
    other = with_expected_error(given, frame, RESPONSE, np.where(labels == 6, 4, 7).astype(np.uint8))
    assert (other.error_deg[80:160, 80:160] > 70).all()  # one light tells next to nothing


@pytest.mark.parametrize("label", [0, 4])
@pytest.mark.parametrize("tilt_deg", [0, 30, 60, 80])
def test_of_one_light_or_none_the_bound_holds_nine_tenths_of_the_normals_that_face_the_camera(
    label, tilt_deg
):
    y, x = np.mgrid[-1:1:201j, -1:1:201j]
    z = -np.sqrt(1 - np.minimum(x**2 + y**2, 1))
    sphere = np.stack([x, y, z], axis=-1)[x**2 + y**2 < 1]
    leaning = np.array([np.sin(np.radians(tilt_deg)), 0, -np.cos(np.radians(tilt_deg))])
    away = np.degrees(np.arccos(np.clip(sphere @ leaning, -1, 1)))
    frame = LinearFrame(rgb=colours()[:32, :32])
    given = NormalMap(normals_in_camera=np.broadcast_to(leaning, (32, 32, 3)), mask=np.ones((32, 32), bool))
    found = with_expected_error(given, frame, RESPONSE, np.full((32, 32), label, np.uint8))
    assert (np.abs(found.error_deg - np.percentile(away, 90)) < 2).all()
    assert found.error_deg.min() > 70
    doubted = with_added_error(found, np.full((32, 32), 20, np.float32))
    np.testing.assert_array_equal(doubted.error_deg, found.error_deg)  # nothing is not made worse


def test_the_residual_of_the_rig_is_part_of_it_and_the_weight_follows():
    light = colours()
    plain, _ = seen(light)
    doubted, _ = seen(light, residual_deg=10.0)
    assert np.median(plain.error_deg) < 2.5
    assert np.median(doubted.error_deg) == pytest.approx(11.0, rel=0.1)
    order = np.argsort(doubted.error_deg, axis=None)
    assert (np.diff(doubted.weight.ravel()[order]) <= 0).all()
    assert doubted.weight.min() > 0
    assert doubted.weight.max() < plain.weight.max() <= 1


def test_the_noise_in_the_residual_of_a_ball_counts_once(rng):
    """A ball's pixels are off by the noise that this footage has, too; a board's colours are means."""
    light = colours() + rng.normal(0, 0.01, (240, 240, 3))
    plain, error = seen(light)
    of_noise = float(np.median(error))
    assert of_noise > 0.5
    ball, _ = seen(light, residual_deg=of_noise, residual_of_pixels=True)
    board, _ = seen(light, residual_deg=of_noise)
    worse, _ = seen(light, residual_deg=4 * of_noise, residual_of_pixels=True)
    bounds = [float(np.median(found.error_deg)) for found in (plain, ball, board, worse)]
    assert bounds[1] < 1.05 * bounds[0]
    assert bounds[2] > 1.1 * bounds[0]
    assert bounds[3] > 2 * bounds[0]


def test_an_error_of_m_is_what_its_uncertainty_does_not_explain(rng):
    """A hundred independent lengths: E is small where M is right, and most of what is left is told."""
    z, azimuth = rng.uniform(0.4, 1.0, 200), rng.uniform(0, 2 * np.pi, 200)
    across = np.sqrt(1 - z**2)
    normals = np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), -z])
    place = rng.uniform(0, 96, (2, 200))
    told = {}
    for size in (0.0, 0.08):
        e = size * np.array([[1.0, 0.3, 0], [0.3, -0.6, 0], [0, 0, -0.4]])
        foretold = 1 + np.einsum("ni,ij,nj->n", normals, e, normals)
        squares = []
        for _ in range(20):
            length = foretold * np.exp(rng.normal(0, 0.02, 200))
            samples = np.vstack([normals.T * length, place])
            found, _ = fit_ellipsoid(samples, (96, 96), np.zeros((2, 3, 3, 3)))
            squares.append((found[1:7] ** 2 @ [1, 2, 2, 1, 2, 1], found[31]))
        whole, share = np.transpose(squares)
        told[size] = (whole * share).mean() / whole.mean()
    assert told[0.0] < 0.3
    assert told[0.08] > 0.9


def test_noise_that_the_normals_do_not_have_is_left_out(rng):
    """Means over 3×3 pixels have a third of the noise of the colours' own normals, and a bound to match."""
    light = colours() + rng.normal(0, 0.03, (240, 240, 3))
    frame = LinearFrame(rgb=light, clipped=np.zeros((240, 240), bool))
    own = normals_from_frame(frame, RESPONSE)
    smooth = normals_from_frame(replace(frame, rgb=cv2.blur(light, (3, 3))), RESPONSE)
    labels = np.full((240, 240), 7, np.uint8)
    bounds = []
    for found, most in ((own, 0.95), (smooth, 0.99)):
        bound = with_expected_error(found, frame, RESPONSE, labels).error_deg
        cosine = np.einsum("vui,vui->vu", found.normals_in_camera, waves())
        within = np.degrees(np.arccos(np.clip(cosine, -1, 1))) <= bound
        assert 0.85 < within.mean() < most
        bounds.append(np.median(bound))
    assert bounds[1] < 0.6 * bounds[0]


def test_vignetting_is_no_error_of_normals(rng):
    """Brightness that falls off towards the corners, as behind most lenses, turns no normal."""
    v, u = (np.mgrid[:240, :240] - 119.5) / 120
    light = colours() + rng.normal(0, 0.005, (240, 240, 3))
    plain, _ = seen(light)
    fallen, error = seen(
        RESPONSE.ambient + (light - RESPONSE.ambient) * (1 - 0.25 * (u**2 + v**2))[..., None]
    )
    assert np.median(fallen.error_deg) < 1.5 * np.median(plain.error_deg)
    assert (error <= fallen.error_deg).mean() > 0.85


def relief(rng, size=240, steepness=0.15):
    """Normals (size, size, 3) of waves 6 to 20 pixels long on top of `waves`, and the same without them."""
    v, u = np.mgrid[:size, :size].astype(float)
    smooth = waves(size)
    slopes = smooth[..., :2] / -smooth[..., 2:]
    fine = np.zeros_like(slopes)
    for _ in range(40):
        angle, k = rng.uniform(0, 2 * np.pi), 2 * np.pi / rng.uniform(6, 20)
        along = np.array([np.cos(angle), np.sin(angle)])
        fine += along * np.cos(k * (u * along[0] + v * along[1]) + rng.uniform(0, 2 * np.pi))[..., None]
    slopes = slopes + steepness / np.sqrt(20) * fine
    normals = np.dstack([slopes, -np.ones((size, size))])
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


@pytest.mark.parametrize("blur_px", [1.0, 1.5, 2.0])
def test_relief_that_blur_has_lost_is_foretold(rng, blur_px):
    truth = relief(rng)
    light = cv2.GaussianBlur(truth @ MATRIX.T + RESPONSE.ambient, (0, 0), blur_px)
    light = light + rng.normal(0, 0.003, light.shape)
    without, error = seen(light, truth=truth)
    found, _ = seen(light, truth=truth, blur_px=blur_px)
    inner = (slice(10, -10), slice(10, -10))
    assert (error <= without.error_deg)[inner].mean() < 0.75
    assert (error <= found.error_deg)[inner].mean() > 0.8
    assert np.median(found.error_deg[inner]) < 3 * np.median(error[inner])  # 1.8 where errors are alike


@pytest.mark.parametrize(("length_px", "blur_px"), [(5.0, 0.6), (6.0, 1.0), (8.0, 1.3), (14.0, 2.5)])
def test_what_blur_takes_from_one_wave_follows_from_two_more_blurs(rng, length_px, blur_px):
    """exp(b²k²/2) − 1 times what is left, whatever the wave; noise is told from it."""
    v, u = np.mgrid[:240, :240].astype(float)
    k, height = 2 * np.pi / length_px, 0.1
    slope = height * np.cos(k * (0.8 * u + 0.6 * v))
    normals = np.dstack([0.8 * slope, 0.6 * slope, -np.ones_like(slope)])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    light = cv2.GaussianBlur(colours(normals), (0, 0), blur_px) + rng.normal(0, 0.002, (240, 240, 3))
    side = side_of_squares(blur_px)
    inverse = np.linalg.inv(MATRIX).astype(np.float32)
    found, whole = np.zeros((3, 15, 15), np.float32), np.ones((240, 240), bool)
    detail_kernel(
        rows_of(light.astype(np.float32)), ~whole, whole, None, inverse, RESPONSE.ambient.astype(np.float32),
        np.float32(1), side, found,
    )  # fmt: skip
    left = found[0].sum() / found[1].sum()
    taken = np.sqrt(2 * lost_over_left(found, blur_px, side) * left / _OF_MANY_WAVES)
    true = height / np.sqrt(2) * (1 - np.exp(-0.5 * (blur_px * k) ** 2))
    assert taken == pytest.approx(true, rel=0.25)  # squares blur, too; a normal is no slope


def test_noise_that_is_alike_over_several_pixels_counts(rng):
    """As that of a codec: neighbours hardly differ by it."""
    noise = cv2.GaussianBlur(rng.normal(0, 0.08, (240, 240, 3)), (0, 0), 1.5)
    found, error = seen(colours() + noise)
    inner = (slice(20, -20), slice(20, -20))
    assert np.mean(error[inner] <= found.error_deg[inner]) > 0.8


def test_blur_takes_nothing_from_a_smooth_surface(rng):
    light = cv2.GaussianBlur(colours(), (0, 0), 2.0) + rng.normal(0, 0.005, (240, 240, 3))
    without, _ = seen(light)
    found, _ = seen(light, blur_px=2.0)
    assert np.median(found.error_deg) < 1.3 * np.median(without.error_deg)
    sharp, _ = seen(light, blur_px=0.2)
    np.testing.assert_array_equal(sharp.error_deg, without.error_deg)


def test_files_keep_it(tmp_path, rng):
    normal_map, _ = seen(colours() + rng.normal(0, 0.01, (240, 240, 3)))
    write_normal_map(tmp_path / "n.exr", normal_map)
    back = read_normal_map(tmp_path / "n.exr")
    np.testing.assert_allclose(back.error_deg, normal_map.error_deg, rtol=1e-3)


def test_a_frame_of_another_size_is_refused():
    frame = LinearFrame(rgb=np.ones((4, 5, 3), np.float32), clipped=np.zeros((4, 5), bool))
    empty = NormalMap(normals_in_camera=np.zeros((5, 4, 3)), mask=np.zeros((5, 4), bool))
    with pytest.raises(BadInput, match="frame of the normals: expected shape 5 × 4 × 3, got 4 × 5 × 3"):
        with_expected_error(empty, frame, RESPONSE)


def test_another_order_of_the_samples_gives_the_same_bits(rng: np.random.Generator) -> None:
    """As another order of sums does, between code that was compiled just now and code from the cache."""
    normals = waves(96)[::3, ::3].reshape(-1, 3)
    v, u = np.mgrid[:96:3, :96:3].reshape(2, -1)
    lengths = 0.9 * (1.0 + 0.1 * normals[:, 0]) * np.exp(rng.normal(0.0, 0.01, len(normals)))
    samples = np.vstack([normals.T * lengths, u, v])
    nearness = rng.normal(0.0, 0.3, (2, 3, 3, 3))
    found, _ = fit_ellipsoid(samples, (96, 96), nearness)
    other, _ = fit_ellipsoid(samples[:, rng.permutation(len(normals))], (96, 96), nearness)
    assert found[1:25].any()
    assert np.array_equal(found[:25], other[:25])


def test_errors_of_materials_and_of_paint_add_as_independent_errors() -> None:
    generator = np.random.default_rng(0)
    numbers, bounds = generator.integers(0, 3, (4, 5), dtype=np.uint8), np.array([0.0, 3.0, 6.0], np.float32)
    turned = generator.uniform(0, 9, numbers.shape).astype(np.float32)
    assert np.array_equal(errors_of_materials(numbers, bounds, None), bounds[numbers])
    errors = errors_of_materials(numbers, bounds, turned)
    assert np.allclose(errors, np.hypot(bounds[numbers], turned))
    normals = np.zeros((4, 5, 3), np.float32)
    normals[..., 2] = -1.0
    mask = numbers > 0
    told = np.where(mask, np.float32(8.0), np.float32(0.0))
    found = with_added_error(
        NormalMap(normals_in_camera=normals * mask[..., None], mask=mask, error_deg=told), errors
    )
    assert found.error_deg is not None
    assert found.weight is not None
    assert np.allclose(found.error_deg, np.where(mask, np.hypot(8.0, errors), 0.0))
    assert np.all(found.weight[~mask] == 0.0)
    assert np.all(np.diff(found.weight[mask][np.argsort(found.error_deg[mask])]) <= 0.0)
