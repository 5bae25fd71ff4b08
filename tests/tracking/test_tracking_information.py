"""Every measurement tells as much as it can and no more; what nothing tells is carried, and said to be."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.tracking.wrinkled_video import WrinkledVideo
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking.edge_prior import EdgePrior, share_right
from vntoolkit.tracking.factors import full_of, total
from vntoolkit.tracking.lattice import LocalJacobians, TemplateLattice, lattice_on_template
from vntoolkit.tracking.outline import Outline, outline_of_silhouette, signed_distance
from vntoolkit.tracking.registration import Registration, TemplateRegistration
from vntoolkit.tracking.slopes import Relief, jump_pixels, label_edges, relief_slopes, slopes_from_normals
from vntoolkit.tracking.template import template_from_maps
from vntoolkit.tracking.tracker import SurfaceTracker

WIDTH, HEIGHT = 128, 96
CAMERA = Camera.orthographic(width=WIDTH, height=HEIGHT)
GRID = CAMERA.pixel_grid()


def normals(p: np.ndarray, q: np.ndarray, mask: np.ndarray | None = None) -> NormalMap:
    """A map of slopes p, q."""
    n = np.stack([p, q, -np.ones_like(p)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    whole = np.ones(p.shape, dtype=bool) if mask is None else mask
    return NormalMap(normals_in_camera=n.astype(np.float32), mask=whole)


def flat_depth(mask: np.ndarray) -> DepthMap:
    return DepthMap(depth=np.full(mask.shape, 100.0), mask=mask)


def relief_of(normal_map: NormalMap) -> Relief:
    return relief_slopes(slopes_from_normals(normal_map, CAMERA), normal_map)


def measured(first: NormalMap, second: NormalMap, shift=(0.0, 0.0)) -> Registration:
    template = template_from_maps(first, flat_depth(first.mask), CAMERA)
    lattice = lattice_on_template(template, 8)
    registration = TemplateRegistration(template, lattice, relief_of(first))
    positions = template.positions_px + np.asarray(shift)
    jacobians = LocalJacobians(lattice, template.positions_px).of(positions)
    return registration.measure(positions, jacobians, relief_of(second))


def test_noise_tells_nothing(rng: np.random.Generator) -> None:
    frames = [normals(*rng.normal(0, 0.02, (2, HEIGHT, WIDTH))) for _ in range(2)]
    told = measured(*frames)
    assert np.mean(total(told.factors).information[:, [0, 2]].sum(axis=1) > 0) < 0.1
    assert np.median(told.expected) < 0.4  # nor is a match of it expected


def test_noise_that_is_alike_over_pixels_tells_nothing(rng: np.random.Generator) -> None:
    """As that of a codec, or of chroma of fewer pixels than luma: far more of it agrees by chance."""
    frames = []
    for _ in range(2):
        p, q = (
            cv2.GaussianBlur(rng.normal(0, 0.1, (2 * HEIGHT, 2 * WIDTH)), (0, 0), 2.0)[:HEIGHT, :WIDTH]
            for _ in range(2)
        )
        frames.append(normals(p, q))
    told = measured(*frames)
    assert np.mean(told.factors[0].information[:, [0, 2]].sum(axis=1) > 0) < 0.1
    assert np.mean(told.expected > 0.2) < 0.1


def test_what_two_frames_have_in_common_with_curl_is_no_relief(rng: np.random.Generator) -> None:
    """As what a mosaic makes of strands finer than its pixels: it moves otherwise than they do."""
    shared = rng.normal(0, 0.05, (2, HEIGHT, WIDTH))
    frames = [normals(*(shared + rng.normal(0, 0.02, shared.shape))) for _ in range(2)]
    told = measured(*frames).factors[0].information
    assert np.mean(told.sum(axis=1) > 0) < 0.2
    height = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 1.5)
    relief = np.stack([np.gradient(height, axis=1), np.gradient(height, axis=0)])
    relief *= 0.05 / relief.std()
    frames = [normals(*(relief + rng.normal(0, 0.02, shared.shape))) for _ in range(2)]
    told = measured(*frames).factors[0].information
    assert np.mean(told.sum(axis=1) > 0) > 0.9


def test_noise_is_not_expected_to_match_where_it_is_stronger_either(rng: np.random.Generator) -> None:
    strength = np.where(GRID[..., 0] < 64, 0.01, 0.06)
    frames = [normals(*(strength * rng.normal(0, 1, (2, HEIGHT, WIDTH)))) for _ in range(2)]
    assert np.percentile(measured(*frames).expected, 90) < 0.5
    relief = WrinkledVideo(width=WIDTH, height=HEIGHT).maps(0)[0]
    assert np.median(measured(relief, relief).expected) > 0.9


def test_a_fold_tells_across_and_not_along(rng: np.random.Generator) -> None:
    ridges = 0.2 * np.sin(GRID[..., 0] / 2.0)
    noise = rng.normal(0, 0.01, (4, HEIGHT, WIDTH))
    told = total(measured(normals(ridges + noise[0], noise[1]), normals(ridges + noise[2], noise[3])).factors)
    inner = told.information[:, 0] > 0
    assert inner.mean() > 0.8
    assert np.median(told.information[inner, 2]) < 1e-2 * np.median(told.information[inner, 0])


@pytest.mark.parametrize("shift", [(0.4, -0.3), (0.0, 0.5)])
def test_relief_tells_a_shift(shift: tuple[float, float], rng: np.random.Generator) -> None:
    video = WrinkledVideo(width=WIDTH, height=HEIGHT)
    frame = video.maps(0)[0]
    told = total(measured(frame, frame, shift).factors)
    matrices = full_of(told.information)
    known = np.linalg.det(matrices) > 1e-3
    step = np.linalg.solve(matrices[known], told.right_hand_side[known, :, None])[:, :, 0]
    np.testing.assert_allclose(np.median(step, axis=0), -np.asarray(shift), atol=0.1)


def test_a_window_whose_parts_move_apart_tells_less_than_one_that_moves_as_one() -> None:
    frame = WrinkledVideo(width=WIDTH, height=HEIGHT).maps(0)[0]
    apart = np.where((GRID // 8).sum(axis=-1) % 2, 0.4, -0.4).reshape(-1, 1)
    one = measured(frame, frame, (0.4, 0.4)).factors[0].information
    parts = measured(frame, frame, apart).factors[0].information
    assert np.median(parts[:, 0] + parts[:, 2]) < 0.3 * np.median(one[:, 0] + one[:, 2])


def test_a_window_tells_of_where_its_relief_lies(rng: np.random.Generator) -> None:
    frame = WrinkledVideo(width=WIDTH, height=HEIGHT).maps(0)[0]
    plain = normals(*rng.normal(0, 0.002, (2, HEIGHT, WIDTH)))
    half = np.where((GRID[..., 0] < 64)[..., None], frame.normals_in_camera, plain.normals_in_camera)
    told = (
        measured(*[NormalMap(normals_in_camera=half, mask=frame.mask)] * 2).factors[0].information.sum(axis=1)
    )
    column = np.repeat(np.arange(WIDTH // 8)[None], HEIGHT // 8, axis=0).ravel()
    assert np.median(told[column == 9]) < 0.1 * np.median(
        told[column == 6]
    )  # both see relief in their window


def test_an_error_that_all_normals_share_takes_nothing_off_their_weight() -> None:
    flat = normals(*np.zeros((2, HEIGHT, WIDTH)))
    left = GRID[..., 0] < 20

    def weights(shared_deg: float, left_deg: float) -> np.ndarray:
        square = shared_deg**2 + np.where(left, left_deg, 0.0) ** 2
        weight = (1.0 / (1.0 + square / 12.0**2)).astype(np.float32)
        with_weight = NormalMap(normals_in_camera=flat.normals_in_camera, mask=flat.mask, weight=weight)
        return slopes_from_normals(with_weight, CAMERA)[..., 2]

    np.testing.assert_allclose(weights(50.0, 0.0), 1.0, atol=1e-5)
    np.testing.assert_allclose(weights(40.0, 34.0), weights(2.0, 34.0), atol=1e-3)
    assert weights(2.0, 34.0)[:, :10].max() < 0.15


def test_the_border_of_an_open_sheet_is_followed_and_a_contour_that_turns_away_is_not() -> None:
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[20:76, 24:104] = True
    moved = np.roll(mask, 3, axis=1)
    angle = np.arcsin(np.clip((GRID[..., 0] - 63.5) / 40.0, -0.999, 0.999))
    for surface, followed in (((0 * angle, 0 * angle), True), ((np.tan(angle), 0 * angle), False)):
        first, second = normals(*surface, mask), normals(*surface, moved)
        slopes = slopes_from_normals(first, CAMERA)
        template = template_from_maps(first, flat_depth(mask), CAMERA)
        lattice = lattice_on_template(template, 8)
        outline = Outline(template, lattice, outline_of_silhouette(mask, slopes))
        figure = outline_of_silhouette(second.mask, slopes_from_normals(second, CAMERA))
        unturned = np.broadcast_to(np.eye(2), (lattice.count, 2, 2))
        information, pull, _ = outline.measure(template.positions_px, unturned, figure)
        right = (lattice.cells[:, 0] == lattice.cells[:, 0].max()) & (information[:, 0] > 1.0)
        if followed:
            assert right.sum() >= 5
            np.testing.assert_allclose(
                pull[right, 0] / information[right, 0], 3.0, atol=0.6
            )  # corners are round
        else:
            assert not right.any()


@pytest.mark.parametrize("radius_px", [24.0, 40.0])
def test_where_a_smooth_limb_is_turned_is_not_known(radius_px: float, rng: np.random.Generator) -> None:
    """It looks the same however it turns: its contours, and what its slopes do beside them, tell nothing."""
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    across = (GRID[..., 0] - 63.5) / radius_px
    mask[12:84] = np.abs(across[12:84]) < 0.97
    slope = np.tan(np.arcsin(np.clip(across, -0.97, 0.97)))
    depth = DepthMap(depth=100.0 - radius_px * np.sqrt(np.maximum(1 - across**2, 0.0)), mask=mask)
    frames = [normals(slope + n[0], n[1], mask) for n in rng.normal(0, 0.005, (2, 2, HEIGHT, WIDTH))]
    tracker = SurfaceTracker(frames[0], depth, CAMERA)
    state = tracker.step(frames[1], depth)
    assert np.median(state.uncertainty_px) > 2.0


def test_a_border_that_another_part_covers_is_not_drawn_to_the_outline_beyond() -> None:
    leg, both = np.zeros((HEIGHT, WIDTH), dtype=bool), np.zeros((HEIGHT, WIDTH), dtype=bool)
    leg[4:92, 40:60], both[4:92, 40:90] = True, True
    flat = np.zeros((HEIGHT, WIDTH))
    first, second = normals(flat, flat, leg), normals(flat, flat, both)
    template = template_from_maps(first, flat_depth(leg), CAMERA)
    lattice = lattice_on_template(template, 8)
    outline = Outline(template, lattice, outline_of_silhouette(leg, slopes_from_normals(first, CAMERA)))
    unturned = np.broadcast_to(np.eye(2), (lattice.count, 2, 2))
    figure = outline_of_silhouette(second.mask, slopes_from_normals(second, CAMERA))
    information, pull, _ = outline.measure(template.positions_px, unturned, figure)
    column, row = lattice.cells.T
    inner = (row > row.min() + 2) & (row < row.max() - 2)
    left, right = inner & (column == column.min()), inner & (column == column.max())
    assert information[left, 0].min() > 1.0
    assert np.abs(pull[right]).max() < 0.01 * information[left, 0].min()


def test_a_surface_may_slip_behind_an_occluding_contour_and_hangs_together_elsewhere() -> None:
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[16:80, 16:112] = True
    column = GRID[..., 0]
    recedes = 4.0 * np.clip((column - 32.0) / 24.0, 0.0, 1.0)
    surfaces = {
        "contour, and what lies behind": np.where(column < 56, recedes, 0.0),
        "crease": np.where(column < 56, recedes, -4.0 * np.clip((79.0 - column) / 24.0, 0.0, 1.0)),
        "rim against the background": 4.0 * np.clip((column - 80.0) / 32.0, 0.0, 1.0),
        "plane that stands obliquely": np.full(mask.shape, 1.5),
    }
    for name, p in surfaces.items():
        first = normals(p, 0 * p, mask)
        slopes = slopes_from_normals(first, CAMERA)
        template = template_from_maps(first, flat_depth(mask), CAMERA)
        lattice = lattice_on_template(template, 8)
        lengths = EdgePrior(lattice, template, CAMERA, slopes)
        still = template.positions_px
        around = LocalJacobians(lattice, still).of(still)
        known = np.ones(lattice.count)
        guess = lengths.at(still, around, slopes, flat_depth(mask), known)
        strain = np.sqrt(guess.variance / np.sum(lengths.along**2, axis=1))
        across = np.abs(lengths.along[:, 0]) > 4
        middle = across & (np.abs(lengths.centres[lengths.edges].mean(axis=1)[:, 0] - 56) < 5)
        if name.startswith("contour"):
            assert strain[middle].min() > 0.9
            assert strain[~across].max() < 0.4
        else:
            assert strain.max() < 0.4, name


def flat_lengths() -> tuple[np.ndarray, np.ndarray, TemplateLattice, EdgePrior]:
    """A flat sheet: mask (h, w), positions (n, 2) in pixels, lattice and lengths."""
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[8:88, 8:120] = True
    flat = normals(np.zeros(mask.shape), np.zeros(mask.shape), mask)
    template = template_from_maps(flat, flat_depth(mask), CAMERA)
    lattice = lattice_on_template(template, 8)
    lengths = EdgePrior(lattice, template, CAMERA, slopes_from_normals(flat, CAMERA))
    return mask, template.positions_px, lattice, lengths


def test_lengths_hold_where_the_surface_is_seen_and_a_body_moves_it_where_it_is_not() -> None:
    """A part of a rigid sheet is read off another slope; or nothing is known of it."""
    mask, pixels, lattice, lengths = flat_lengths()
    known = (lengths.centres[:, 0] < 84).astype(np.float64)
    around = LocalJacobians(lattice, pixels).of(pixels)
    part = (GRID[..., 0] > 88) & mask
    sloping = slopes_from_normals(normals(np.where(part, 0.6, 0.0), np.zeros(mask.shape), mask), CAMERA)
    nothing = np.where(part[..., None], np.float32(0.0), sloping)
    at_part = (lengths.centres[lengths.edges][:, :, 0] > 92).all(axis=1) & (np.abs(lengths.along[:, 0]) > 4)

    def off(slopes: np.ndarray) -> float:
        guess = lengths.at(pixels, around, slopes, flat_depth(mask), known)
        return float(np.median(np.abs(guess.steps - lengths.along)[at_part, 0]))

    turned = 8.0 * (1.0 - 1.0 / np.hypot(1.0, 0.6))
    assert off(sloping) > 0.8 * turned
    assert off(nothing) < 0.1


def test_lengths_are_read_between_the_nodes_of_a_link_so_that_a_narrow_fold_is_not_smoothed_away() -> None:
    mask, pixels, lattice, lengths = flat_lengths()
    first, second = np.sort(lengths.centres[lengths.edges][:, :, 0], axis=1).T
    left = np.unique(first)[6]
    share = 1.0 / np.hypot(1.0, 1.5)  # of its length is left of the fold, which is as wide as a link
    fold = (first == left) & (second > left)
    u = pixels[:, 0]
    moved = pixels - np.stack([(1.0 - share) * np.clip(u - left, 0.0, 8.0), 0 * u], axis=1)
    steep = (GRID[..., 0] >= left) & (GRID[..., 0] < left + 8.0 * share)
    slopes = slopes_from_normals(normals(np.where(steep, 1.5, 0.0), np.zeros(mask.shape), mask), CAMERA)
    around = LocalJacobians(lattice, pixels).of(moved)
    steps, *_ = lengths._by_lengths(moved, around, slopes, flat_depth(mask))
    assert np.median(steps[fold, 0]) == pytest.approx(8.0 * share, abs=0.8)  # 6.2 by the cells at its ends


def test_lengths_err_by_a_share_of_what_is_left_of_them_in_the_image() -> None:
    """Normals that err alike: of a part that is seen obliquely now, and of one that was in the template."""
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[8:88, 8:120] = True
    flat, oblique = (normals(np.full(mask.shape, p), np.zeros(mask.shape), mask) for p in (0.0, 1.5))
    errs = []
    for first, second in ((flat, oblique), (oblique, flat)):
        template = template_from_maps(first, flat_depth(mask), CAMERA)
        lattice = lattice_on_template(template, 8)
        lengths = EdgePrior(lattice, template, CAMERA, slopes_from_normals(first, CAMERA))
        still = template.positions_px
        around = LocalJacobians(lattice, still).of(still)
        steps, strain, _ = lengths._by_lengths(
            still, around, slopes_from_normals(second, CAMERA), flat_depth(mask)
        )
        across = np.abs(lengths.along[:, 0]) > 4
        errs.append(np.median((np.sqrt(strain) * np.hypot(*lengths.along.T) / np.hypot(*steps.T))[across]))
    assert errs[0] == pytest.approx(errs[1], rel=0.01)


def test_lengths_are_as_unsure_as_light_that_is_not_foreseen_makes_them() -> None:
    """Half of an oblique sheet weighs a fifth: 24°, by which its normals are turned, alike in patches."""
    slope, weight, turned = 1.5, 0.2, np.radians(24.0)
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[8:88, 8:120] = True
    level = np.zeros(mask.shape)
    first = normals(level + slope, level, mask)
    template = template_from_maps(first, flat_depth(mask), CAMERA)
    lattice = lattice_on_template(template, 8)
    lengths = EdgePrior(lattice, template, CAMERA, slopes_from_normals(first, CAMERA))
    u, v = GRID[..., 0], GRID[..., 1]
    shaded = u < 60
    sign = np.where((u // 24 + v // 24) % 2 < 1, 1.0, -1.0) * shaded
    now = normals(np.tan(np.arctan(slope) + turned * sign), level, mask)
    now = replace(now, weight=np.where(shaded, weight, 1.0).astype(np.float32) * mask)
    still = template.positions_px
    around = LocalJacobians(lattice, still).of(still)
    steps, strain, _ = lengths._by_lengths(still, around, slopes_from_normals(now, CAMERA), flat_depth(mask))
    x, y = lengths.middles.T
    across = (np.abs(lengths.along[:, 0]) > 4) & (x > 16) & (x < 52) & (y > 16) & (y < 80)
    departs = np.sum((steps - lengths.along) ** 2, axis=1) / np.sum(lengths.along**2, axis=1)
    ratio = np.sqrt(departs[across].mean() / strain[across].mean())
    assert 0.5 < ratio < 1.5


def test_lengths_that_no_motion_of_the_body_explains_are_another_surface_s() -> None:
    before, variance = np.full(3, 0.95), np.full(3, 0.01)
    close, far, farther = share_right(before, np.array([0.01, 0.1, 0.2]), variance)
    assert close > 0.99 > far > 0.5 > farther
    assert share_right(0.0 * before, np.zeros(3), variance).max() == 0.0


def test_an_outline_between_two_cells_tells_no_more_than_one_within_a_cell() -> None:
    told = []
    for bottom in (80, 81):  # the border's pixels are rows 78 and 79, of one cell, or 79 and 80, of two
        mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
        mask[16:bottom, 24:104] = True
        sheet = normals(np.zeros(mask.shape), np.zeros(mask.shape), mask)
        template = template_from_maps(sheet, flat_depth(mask), CAMERA)
        lattice = lattice_on_template(template, 8)
        figure = outline_of_silhouette(mask, slopes_from_normals(sheet, CAMERA))
        unturned = np.broadcast_to(np.eye(2), (lattice.count, 2, 2))
        information, _, _ = Outline(template, lattice, figure).measure(
            template.positions_px, unturned, figure
        )
        column, row = lattice.cells.T
        below = (column > 4) & (column < 11) & (row >= 9)
        assert len(np.unique(row[below & (information[:, 2] > 1.0)])) == bottom - 79
        told.append(information[below, 2].sum())
    assert told[1] == pytest.approx(told[0], rel=0.1)


def test_a_border_that_may_be_a_contour_hardly_follows_the_outline() -> None:
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[8:88, 30:90] = True
    wider = np.zeros_like(mask)
    wider[8:88, 30:93] = True
    across = np.clip((GRID[..., 0] - 60.0) / 30.0, -0.98, 0.98)
    pulls = {}
    for name, tilt in (("sheet", 0.0), ("tilted", 50.0), ("oblique", 63.0), ("round", None)):
        p = np.tan(np.arcsin(across)) if tilt is None else np.full(mask.shape, np.tan(np.radians(tilt)))
        first, second = normals(p, 0 * p, mask), normals(p, 0 * p, wider)
        template = template_from_maps(first, flat_depth(mask), CAMERA)
        lattice = lattice_on_template(template, 8)
        slopes = slopes_from_normals(first, CAMERA)
        outline = Outline(template, lattice, outline_of_silhouette(mask, slopes))
        unturned = np.broadcast_to(np.eye(2), (lattice.count, 2, 2))
        figure = outline_of_silhouette(wider, slopes_from_normals(second, CAMERA))
        information, _, _ = outline.measure(template.positions_px, unturned, figure)
        column, row = lattice.cells.T
        right = (column == column.max()) & (row > row.min() + 1) & (row < row.max() - 1)
        pulls[name] = float(np.median(information[right, 0]))
    assert pulls["sheet"] > 1.0
    assert pulls["tilted"] > 0.5 * pulls["sheet"]  # it faces as much as a border must
    assert pulls["round"] < pulls["oblique"] < 1e-2 * pulls["sheet"]


def test_the_distance_to_an_outline_has_its_sign_and_size() -> None:
    mask = np.zeros((20, 30), dtype=bool)
    mask[5:15, 10:20] = True
    mask[9, 14] = False  # a hole of a pixel is none
    distance = signed_distance(mask)
    assert distance[10, 10] == pytest.approx(-0.5)
    assert distance[10, 9] == pytest.approx(0.5)
    assert distance[10, 25] == pytest.approx(5.5, abs=0.1)
    assert distance[9, 14] < -3


def test_dark_gaps_between_strands_of_hair_are_no_outline_and_a_gap_between_two_parts_is() -> None:
    mask = np.zeros((80, 120), dtype=bool)
    mask[20:70, 10:110] = True
    whole = signed_distance(mask)
    strands = mask.copy()
    strands[20:60, 30:50:5] = False  # they reach the outside
    np.testing.assert_allclose(
        signed_distance(strands)[25:70], whole[25:70], atol=2.1
    )  # but for their open ends
    mask[20:60, 70:84] = False
    assert signed_distance(mask)[40, 77] > 6
    slanted = np.add.outer(np.arange(80), 0.2 * np.arange(120)) > 40  # its steps stay
    np.testing.assert_array_equal(signed_distance(slanted) < 0, slanted)


class SmoothSheet:
    """A sheet without relief that stretches by 4 % while wrinkles travel over it, 2 px a frame."""

    def at(self, x: np.ndarray, frame: int) -> np.ndarray:
        stretch = 1 + 0.04 * np.sin(frame / 12)
        return (x - [63.5, 47.5]) * [stretch, 1.0] + [63.5, 47.5] + [1.5 * np.sin(frame / 9), 0.0]

    def maps(self, frame: int) -> tuple[NormalMap, DepthMap]:
        k = 2 * np.pi / 50
        p = 0.2 * np.cos(k * (GRID[..., 0] - 2 * frame)) + 0.1 * np.cos(k * (GRID[..., 1] + 2 * frame))
        noise = np.random.default_rng(frame).normal(0, 0.01, (2, HEIGHT, WIDTH))
        low, high = self.at(np.array([20.0, 16.0]), frame), self.at(np.array([107.0, 79.0]), frame)
        mask = np.all((low <= GRID) & (high >= GRID), axis=-1)
        return normals(p + noise[0], 0.5 * p + noise[1], mask), flat_depth(mask)


def test_a_smooth_sheet_is_held_by_its_outline_while_wrinkles_travel_over_it() -> None:
    sheet = SmoothSheet()
    tracker = SurfaceTracker(*sheet.maps(0), CAMERA)
    for frame in range(1, 25):
        tracked = tracker.step(*sheet.maps(frame))
    error = np.linalg.norm(tracked.positions_px - sheet.at(tracker.template.positions_px, 24), axis=1)
    assert np.median(error) < 1.0  # the wrinkles have travelled 48 px
    assert np.percentile(error, 95) < 2.5
    assert np.mean(error < tracked.uncertainty_px) > 0.7


def test_nine_in_ten_errors_are_below_the_expected_one_where_relief_fades() -> None:
    """Left the relief that registers, right none: it is carried, and its expected error grows."""
    video = WrinkledVideo(width=WIDTH, height=HEIGHT, sway_px=2.0, noise=0.02)
    plain = normals(*np.zeros((2, HEIGHT, WIDTH)))

    def maps(frame: int) -> tuple[NormalMap, DepthMap]:
        relief, depth = video.maps(frame)
        fade = (video.material(GRID.astype(float), frame)[..., 0] > 64)[..., None]
        mixed = np.where(fade, plain.normals_in_camera, relief.normals_in_camera)
        return NormalMap(normals_in_camera=mixed, mask=relief.mask), depth

    tracker = SurfaceTracker(*maps(0), video.camera)
    below = []
    for frame in range(1, 9):
        tracked = tracker.step(*maps(frame))
        truth = video.warp(tracker.template.positions_px, frame)
        error = np.linalg.norm(tracked.positions_px - truth, axis=1)
        below.append(np.mean(error < tracked.uncertainty_px))
    left, right = tracker.template.pixels[:, 0] < 48, tracker.template.pixels[:, 0] > 96
    assert np.median(tracked.uncertainty_px[right]) > 3 * np.median(tracked.uncertainty_px[left])
    assert np.median(tracked.uncertainty_px[left]) < 0.5
    assert np.mean(below) > 0.8


def test_the_edge_of_a_shadow_is_not_registered_by() -> None:
    flat = normals(*np.zeros((2, HEIGHT, WIDTH)))
    weight = np.where(GRID[..., 0] < 60, 1.0, 0.2).astype(np.float32)
    shaded = NormalMap(normals_in_camera=flat.normals_in_camera, mask=flat.mask, weight=weight)
    jumps = jump_pixels(shaded)
    assert jumps[:, 58:62].all()
    assert not jumps[:, :50].any()
    assert not jumps[:, 70:].any()
    assert not jump_pixels(flat).any()


def test_the_edge_of_a_labelled_shadow_is_not_registered_by_and_its_inside_is() -> None:
    lit = np.where(GRID[..., 0] < 60, 7, 3).astype(np.uint8)  # one light ends
    edges = label_edges(lit, np.ones((HEIGHT, WIDTH), dtype=bool))
    assert edges[:, 58:62].all()
    assert not edges[:, :57].any()
    assert not edges[:, 63:].any()
    assert not label_edges(np.full_like(lit, 5), edges).any()  # a light that is nowhere has no edge
