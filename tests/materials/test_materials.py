"""Reflectances from the unit length of normals: exact without noise, bounded with it, or refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage
from scipy.ndimage import gaussian_filter

from vntoolkit.geometry.camera import Camera
from vntoolkit.materials.grey_paint import CLEAR, nats_over_grey
from vntoolkit.materials.label_moves import LabelEnergy
from vntoolkit.materials.labelling import LabelState, MaterialLabeller
from vntoolkit.materials.mixtures import Seams, Spread
from vntoolkit.materials.reflectance import (
    Lamps,
    Reflectance,
    best_fit,
    lamps_from_response,
    reflectance_from_fit,
)
from vntoolkit.materials.relighting import colours_of, relit
from vntoolkit.materials.search import WORST_ERROR_DEG, find_materials, searched_frames
from vntoolkit.materials.split_frame import block_size, blocks_moved, cells_of, split_frame
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse, rgb_from_normals

DIRECTIONS = np.array([[0.5, 0.0, -0.866], [-0.25, 0.433, -0.866], [-0.25, -0.433, -0.866]])
COLOURS = np.array([[0.7, 0.1, 0.02], [0.08, 0.6, 0.1], [0.02, 0.12, 0.65]])
RESPONSE = LightResponse(matrix=COLOURS.T @ DIRECTIONS, light_colours=COLOURS)
PAINTS = np.array([[0.9, 0.5, 0.3], [0.4, 0.8, 0.9], [0.8, 0.75, 0.3]])
LEVEL = 1 / 255


class Followed:
    """Frames of one subject, one after another."""

    def __init__(
        self, rho: np.ndarray, pigments: np.ndarray | None = None, camera: Camera | None = None
    ) -> None:
        known = {"reflectances": rho, "pigments": pigments, "camera": camera}
        self.labeller, self.state = MaterialLabeller(response=RESPONSE, **known), LabelState()
        self.turned_deg: np.ndarray | None = None

    def labels(self, frame: LinearFrame, mask: np.ndarray) -> np.ndarray:
        found, self.state = self.labeller.labels(frame, mask, self.state)
        return found

    def relit(self, frame: LinearFrame, labels: np.ndarray, mask: np.ndarray | None = None) -> LinearFrame:
        found, self.turned_deg, self.state = self.labeller.relit(frame, labels, self.state, mask)
        return found

    def pigments(self, frame: LinearFrame, mask: np.ndarray, labels: np.ndarray) -> list[Any]:
        return self.labeller.pigments_of(frame, mask, labels, self.state)

    def restart(self) -> None:
        self.state = LabelState(statistics=self.state.statistics)


def dome(size: int = 120) -> tuple[np.ndarray, np.ndarray]:
    """Normals (size, size, 3) of a sphere's cap that faces the camera within 50 degrees, and its mask."""
    v, u = (np.indices((size, size)) - (size - 1) / 2) / (size / 2)
    radius = u * u + v * v
    mask = radius < 1.0
    x, y = 0.75 * u, 0.75 * v
    z = -np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
    return np.stack([x, y, z], axis=-1), mask


def painted(
    labels: np.ndarray, noise: float = LEVEL, seed: int = 0
) -> tuple[LinearFrame, np.ndarray, np.ndarray]:
    normals, mask = dome(len(labels))
    light = np.maximum(normals @ DIRECTIONS.T, 0.0) * PAINTS[labels] @ COLOURS
    light += np.random.default_rng(seed).normal(0.0, noise, light.shape)
    return LinearFrame((light * mask[..., None]).astype(np.float32)), normals, mask


def sectors(size: int = 120) -> np.ndarray:
    """Eight sectors in three paints."""
    v, u = np.indices((size, size)) - (size - 1) / 2
    return np.array([0, 1, 2, 0, 2, 1, 0, 1])[((np.arctan2(v, u) / np.pi + 1) * 3.999).astype(int)]


def angles_deg(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((one * other).sum(axis=-1), -1.0, 1.0)))


def fitted(s: np.ndarray, lamps: Lamps) -> Reflectance:
    log, normal_matrix, _ = best_fit(s, lamps, 1e-4)
    return reflectance_from_fit(log, np.linalg.inv(normal_matrix), s, lamps)


def test_one_paint_is_exact_without_noise() -> None:
    normals, mask = dome(60)
    shares = normals[mask] @ DIRECTIONS.T
    lit = (shares > 0.05).all(axis=1)
    found = fitted(shares[lit] * PAINTS[0], lamps_from_response(RESPONSE, np.full(3, 1e-6)))
    assert np.allclose(found.values, PAINTS[0], rtol=1e-4)
    assert found.error_deg < 0.01


def test_the_error_of_a_reflectance_is_that_of_its_normal_equations() -> None:
    normals, mask = dome(40)
    shares = normals[mask] @ DIRECTIONS.T
    shares = shares[(shares > 0.2).all(axis=1)]
    lamps = lamps_from_response(RESPONSE, np.full(3, LEVEL))
    departures = []
    for seed in range(12):
        noise = np.random.default_rng(seed).normal(0.0, LEVEL, shares.shape) @ lamps.split.T
        found = fitted(shares * PAINTS[1] + noise, lamps)
        step = np.log(found.values / PAINTS[1])
        departures.append(step @ np.linalg.solve(found.covariance, step) / 3.0)
    assert 0.4 < np.mean(departures) < 2.5  # χ² of three numbers, over its mean


def test_three_paints_are_found_and_leave_no_seam_in_the_normals() -> None:
    labels = sectors()
    frame, normals, mask = painted(labels)
    found = find_materials(searched_frames([frame], [mask], RESPONSE))
    assert len(found) == 3
    values = np.array([material.reflectance.values for material in found])
    nearest = np.abs(np.log(values[:, None] / PAINTS)).max(axis=2)
    assert nearest.min(axis=0).max() < 0.03
    labeller = Followed(values)
    given = labeller.labels(frame, mask)
    assert np.mean(nearest.argmin(axis=1)[given][mask] == labels[mask]) > 0.98
    map_of_one = normals_from_frame(labeller.relit(frame, given), RESPONSE, mask)
    truth = normals_from_frame(
        painted(np.zeros_like(labels))[0], RESPONSE, mask
    )  # as if one paint were known
    inside = map_of_one.mask & truth.mask
    error = angles_deg(map_of_one.normals_in_camera, normals)[inside].mean()
    unpainted = angles_deg(normals_from_frame(frame, RESPONSE, mask).normals_in_camera, normals)[
        inside
    ].mean()
    assert error < 2.0 < 8.0 < unpainted


def knitted_with_logo(size: int = 120) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals of knitted cloth over a dome, its mask, and a round logo of four quarters."""
    normals, mask = dome(size)
    v, u = np.indices((size, size)) - (size - 1) / 2
    normals = normals + 0.1 * np.stack([np.sin(2.4 * u), np.sin(2.1 * v), 0 * u], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return normals, mask, np.where(np.hypot(u, v) < 0.3 * size, 1 + 2 * (u > 0) + (v > 0), 0)


def test_a_logo_on_knitted_cloth_is_found_though_its_quarters_are_nearly_flat() -> None:
    normals, mask, logo = knitted_with_logo()
    yarns = np.array(
        [[0.66, 0.63, 0.58], [0.6, 0.19, 0.17], [0.66, 0.53, 0.16], [0.2, 0.42, 0.24], [0.2, 0.25, 0.46]]
    )
    errors = []
    for labels in (logo, np.zeros_like(logo)):
        light = np.maximum(normals @ DIRECTIONS.T, 0.0) * yarns[labels] @ COLOURS
        light += np.random.default_rng(5).normal(0.0, LEVEL, light.shape)
        frame = LinearFrame((light * mask[..., None]).astype(np.float32))
        found = find_materials(searched_frames([frame], [mask], RESPONSE))
        assert len(found) == labels.max() + 1
        labeller = Followed(np.array([each.reflectance.values for each in found]))
        seen = labeller.relit(frame, labeller.labels(frame, mask))
        result = normals_from_frame(seen, RESPONSE, mask)
        errors.append(angles_deg(result.normals_in_camera, normals)[result.mask].mean())
    assert errors[0] < errors[1] + 1.0


def test_blurred_stripes_of_six_pixels_on_knitted_cloth_turn_normals_by_less_than_a_degree() -> None:
    normals, mask, _ = knitted_with_logo()
    v, u = np.indices(mask.shape)
    stripes = (u + v // 3) // 6 % 2
    yarns = np.array([[0.66, 0.63, 0.58], [0.2, 0.25, 0.46]])
    inner = gaussian_filter(mask.astype(float), 2.0) > 0.99
    labeller, errors = Followed(yarns), []
    for labels in (stripes, np.zeros_like(stripes)):
        light = np.maximum(normals @ DIRECTIONS.T, 0.0) * yarns[labels] @ COLOURS * mask[..., None]
        light = gaussian_filter(light, (1.0, 1.0, 0.0))
        light += np.random.default_rng(5).normal(0.0, LEVEL, light.shape)
        frame = LinearFrame(light.astype(np.float32))
        seen = labeller.relit(frame, labeller.labels(frame, inner))
        result = normals_from_frame(seen, RESPONSE, inner)
        errors.append(angles_deg(result.normals_in_camera, normals)[result.mask].mean())
        labeller.restart()
    assert errors[0] < errors[1] + 1.0  # labels that leave the mixtures out of account: 2.6 more


def test_one_paint_is_one_material_and_a_number_is_kept() -> None:
    frame, _, mask = painted(np.full((120, 120), 2))
    assert len(find_materials(searched_frames([frame], [mask], RESPONSE))) == 1
    assert len(find_materials(searched_frames([frame], [mask], RESPONSE), 2)) == 2


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_grey_paint_is_beaten_by_a_hue_and_by_prints_and_not_by_gloss(seed: int) -> None:
    """Gloss and light between folds change light by a tenth, smoothly from place to place, for each lamp."""
    normals, mask = dome(160)
    rng = np.random.default_rng(seed)
    v, u = (np.indices(mask.shape) - 79.5) / 80.0
    smooth = gaussian_filter(rng.normal(size=(*mask.shape, 3)), (10.0, 10.0, 0.0))
    gloss = np.exp(0.1 * smooth / smooth.std())
    squares = rng.integers(0, 3, (8, 8))[((v + 1) * 3.99).astype(int), ((u + 1) * 3.99).astype(int)]
    grey, hue, prints = np.full(3, 0.8), PAINTS[0], PAINTS[squares]
    nats = []
    for rho, gain in ((grey, gloss), (hue, 1.0), (prints, 1.0), (hue, gloss)):
        light = np.maximum(normals @ DIRECTIONS.T, 0.0) * rho * gain @ COLOURS
        light += rng.normal(0.0, LEVEL, light.shape)
        frame = LinearFrame((light * mask[..., None]).astype(np.float32))
        searched = searched_frames([frame], [mask], RESPONSE)
        nats.append(nats_over_grey(find_materials(searched), searched))
    assert nats[0] < CLEAR < min(nats[1:])


def test_paints_that_differ_by_six_per_cent_are_two_where_lengths_are_exact() -> None:
    paints = np.array([*PAINTS[:2], PAINTS[0] * np.exp([0.06, -0.03, 0.03])])
    normals, mask = dome()
    light = np.maximum(normals @ DIRECTIONS.T, 0.0) * paints[sectors()] @ COLOURS
    light += np.random.default_rng(0).normal(0.0, LEVEL, light.shape)
    frame = LinearFrame((light * mask[..., None]).astype(np.float32))
    found = find_materials(searched_frames([frame], [mask], RESPONSE))
    values = np.array([each.reflectance.values for each in found])
    assert len(values) == 3
    assert np.abs(np.log(values[:, None] / paints)).max(axis=2).min(axis=0).max() < 0.02


def test_print_of_the_rigs_hue_has_the_normals_of_the_rigs_material() -> None:
    """Grey on white, on a surface so flat that it tells hues to some per cent, and a colour beside it."""
    normals, mask = dome(160)
    normals = np.stack([0.4 * normals[..., 0], 0.4 * normals[..., 1], -np.ones(mask.shape)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    paints = np.array([[0.9, 0.9, 0.9], [0.5, 0.5, 0.5], [0.8, 0.4, 0.6]])
    rng = np.random.default_rng(3)
    for colour_too in (False, True):
        labels = sectors(160) % (3 if colour_too else 2)
        light = np.maximum(normals @ DIRECTIONS.T, 0.0) * paints[labels] @ COLOURS
        light += rng.normal(0.0, LEVEL, light.shape)
        frame = LinearFrame((light * mask[..., None]).astype(np.float32))
        found = sorted(
            find_materials(searched_frames([frame], [mask], RESPONSE)),
            key=lambda each: -each.reflectance.values[1],
        )
        values = np.array([each.reflectance.values for each in found])
        assert len(found) == 2 + colour_too
        assert np.allclose(values, paints[: len(found)], rtol=0.04)
        assert np.allclose(np.ptp(values[:2], axis=1), 0.0, atol=1e-9)


def test_frames_are_searched_together_and_again_with_the_same_result() -> None:
    frame, _, mask = painted(sectors(), seed=1)
    other, _, _ = painted(sectors()[::-1], seed=2)
    found = [find_materials(searched_frames([frame, other], [mask, mask], RESPONSE)) for _ in range(2)]
    assert len(found[0]) == 3
    assert np.array_equal(found[0][0].reflectance.values, found[1][0].reflectance.values)


def blurred_stripes(width: int, blur_px: float) -> tuple[LinearFrame, np.ndarray]:
    """Stripes of two paints on a dome, seen through a lens."""
    size = 160
    normals, mask = dome(size)
    light = (
        np.maximum(normals @ DIRECTIONS.T, 0.0) * PAINTS[np.indices((size, size))[1] // width % 2] @ COLOURS
    )
    light = gaussian_filter(light, blur_px, axes=(0, 1))
    light += np.random.default_rng(width).normal(0.0, LEVEL, light.shape)
    return LinearFrame((light * mask[..., None]).astype(np.float32)), mask


def test_mixtures_on_the_edges_of_stripes_do_not_bend_their_reflectances() -> None:
    frame, mask = blurred_stripes(10, 1.5)
    found = find_materials(searched_frames([frame], [mask], RESPONSE))
    assert len(found) == 2
    values = np.array([each.reflectance.values for each in found])
    apart = np.abs(np.log(values[:, None] / PAINTS[:2])).max(axis=2)
    assert apart.min(axis=0).max() < 0.01  # 0.02 with the pixels on edges


def test_one_frame_in_small_blocks_is_looked_at_where_stripes_are_narrow() -> None:
    for width, frames in ((8, 1), (16, 2)):
        frame, mask = blurred_stripes(width, 1.0)
        searched = searched_frames([frame, frame], [mask, mask], RESPONSE)
        assert len(searched.split.lit) == pytest.approx(frames * len(mask), rel=0.05)


def test_a_shadow_is_no_material() -> None:
    normals, mask = dome()
    shares = np.maximum(normals @ DIRECTIONS.T, 0.0) * PAINTS[0]
    shares[40:60, 30:70, 1] = 0.0  # something keeps lamp 1 away
    noise = np.random.default_rng(0).normal(0.0, LEVEL, shares.shape)
    frame = LinearFrame(((shares @ COLOURS + noise) * mask[..., None]).astype(np.float32))
    assert len(find_materials(searched_frames([frame], [mask], RESPONSE))) == 1


def test_a_flat_patch_tells_that_it_tells_nothing() -> None:
    normal = np.array([0.2, -0.1, -0.97]) / np.linalg.norm([0.2, -0.1, -0.97])
    flat = rgb_from_normals(np.broadcast_to(normal, (60, 60, 3)), RESPONSE) * 0.5
    noisy = flat + np.random.default_rng(0).normal(0.0, LEVEL, flat.shape)
    mask = np.ones((60, 60), np.bool_)
    found = find_materials(searched_frames([LinearFrame(noisy.astype(np.float32))], [mask], RESPONSE))
    assert found[0].reflectance.error_deg > WORST_ERROR_DEG


def test_relighting_the_calibration_material_changes_nothing() -> None:
    frame, _, _ = painted(np.zeros((40, 40), int))
    same = relit(frame, RESPONSE, np.zeros((40, 40), np.uint8), np.ones((1, 3)))
    assert np.allclose(same.rgb, frame.rgb, atol=1e-6)
    assert np.allclose(colours_of(np.ones((1, 3)), RESPONSE), 1.0)


def test_labels_are_carried_along_with_a_turning_subject() -> None:
    labels, shares, unlike = sectors(), [], []
    labeller = Followed(PAINTS)
    for step in range(8):
        turned = rotated(labels, 1.5 * step)
        frame, _, mask = painted(turned, seed=step)
        carried = labeller.labels(frame, mask)
        alone = Followed(PAINTS).labels(frame, mask)
        shares.append(np.mean(carried[mask] == turned[mask]))
        unlike.append(np.mean(carried[mask] != alone[mask]))
    assert min(shares) > 0.97
    assert max(unlike) < 0.02


def test_labels_that_no_longer_fit_are_decided_anew() -> None:
    first, _, mask = painted(sectors())
    other, _, _ = painted(sectors()[::-1], seed=3)
    labeller = Followed(PAINTS)
    labeller.labels(first, mask)
    carried = labeller.labels(other, mask)
    assert np.mean(carried[mask] == sectors()[::-1][mask]) > 0.97


def test_labels_are_decided_as_a_whole_again_once_the_picture_has_moved_past_what_is_looked_at() -> None:
    labeller, as_alone = Followed(PAINTS), []
    for step in range(16):
        frame, _, mask = painted(np.roll(sectors(), step, axis=1), seed=step, noise=3 * LEVEL)
        carried = labeller.labels(frame, mask)
        alone = Followed(PAINTS)
        alone.state = LabelState(statistics=labeller.state.statistics)
        as_alone.append(np.array_equal(carried, alone.labels(frame, mask)))
    assert as_alone[0]
    assert 2 <= sum(as_alone) < 16, as_alone


def test_a_first_frame_that_one_lamp_does_not_reach_does_not_stop_the_next() -> None:
    frame, _, mask = painted(sectors())
    light = frame.rgb @ RESPONSE.contributions_from_rgb.T * [0.0, 1.0, 1.0]
    dark = LinearFrame((light @ np.linalg.inv(RESPONSE.contributions_from_rgb).T).astype(np.float32))
    part = mask & (np.indices(mask.shape)[1] < 60) & (np.indices(mask.shape)[0] < 60)
    labeller = Followed(PAINTS)
    assert not labeller.labels(dark, part).any()
    alone = Followed(PAINTS)
    assert np.array_equal(labeller.labels(frame, mask), alone.labels(frame, mask))


def test_what_a_frame_told_of_noise_and_blur_is_kept_but_not_for_a_subject_of_another_size() -> None:
    first, _, mask = painted(sectors(), noise=3 * LEVEL)
    turned = rotated(sectors(), 40.0)
    later, _, _ = painted(turned, seed=3)
    labeller = Followed(PAINTS)
    labeller.labels(first, mask)
    told = labeller.state.seams
    for _ in range(2):
        labeller.restart()
        assert np.mean(labeller.labels(later, mask)[mask] == turned[mask]) > 0.97
        assert labeller.state.seams == told
    alone = Followed(PAINTS)
    larger, around = (each.repeat(6, axis=0).repeat(6, axis=1) for each in (later.rgb, mask))
    labeller.restart()
    assert block_size(around) > block_size(mask)
    frame = LinearFrame(larger)
    assert np.array_equal(labeller.labels(frame, around), alone.labels(frame, around))
    assert labeller.state.seams == alone.state.seams != told


def test_a_sequence_that_starts_anew_owes_nothing_to_the_frames_before() -> None:
    """Else workers that had other frames before would write other bytes."""
    first, _, mask = painted(sectors(), noise=6 * LEVEL)
    long, short = Followed(PAINTS), Followed(PAINTS)
    for labeller in (long, short):
        labeller.labels(first, mask)
    for number in range(1, 9):
        later, _, _ = painted(rotated(sectors(), 3.0 * number), noise=8 * LEVEL, seed=1000 + number)
        long.labels(later, mask)
    for labeller in (long, short):
        labeller.restart()
    assert np.array_equal(long.labels(later, mask), short.labels(later, mask))


def test_a_frame_in_which_the_picture_jumped_is_decided_as_if_it_were_alone() -> None:
    first, _, mask = painted(sectors(), noise=3 * LEVEL)
    later, _, _ = painted(rotated(sectors(), 40.0), seed=3)
    labeller = Followed(PAINTS)
    labeller.labels(first, mask)
    alone = Followed(PAINTS)
    alone.state = LabelState(statistics=labeller.state.statistics)
    assert np.array_equal(labeller.labels(later, mask), alone.labels(later, mask))


@pytest.mark.parametrize("moved", [(0, 0), (0, 2), (4, 0), (3, 3)])
def test_how_far_a_picture_moved_is_told_to_a_third(moved: tuple[int, int]) -> None:
    still, _, mask = painted(sectors())
    frames = [still.rgb, painted(sectors(), seed=1)[0].rgb]
    first, later = (
        split_frame(LinearFrame(np.pad(rgb, ((8, 8), (8, 8), (0, 0)))), RESPONSE, np.pad(mask, 8))
        for rgb in frames
    )
    later = replace(later, colours=np.roll(later.colours, moved, (0, 1)))
    told = blocks_moved(*(cells_of(split.colours) for split in (first, later)))
    assert told == pytest.approx(np.hypot(*moved), rel=0.33, abs=0.2)


def test_stripes_that_jump_in_half_of_a_blurred_picture_are_decided_anew() -> None:
    normals, mask, _ = knitted_with_logo()
    yarns = np.array([[0.66, 0.63, 0.58], [0.2, 0.25, 0.46]])
    labeller, rng = Followed(yarns), np.random.default_rng(5)
    _, u = np.indices(mask.shape)
    smooth = gaussian_filter(rng.normal(size=mask.shape), 5.0)
    strange = smooth > np.quantile(smooth, 0.9)  # of no material, and so doubtful in every frame
    for jump in (0, 20):
        stripes = (u + jump * (u < 60)) // 20 % 2
        light = np.maximum(normals @ DIRECTIONS.T, 0.0) * yarns[stripes]
        light = np.where(strange[..., None], light * [1.0, 0.3, 2.0], light) @ COLOURS * mask[..., None]
        light = gaussian_filter(light, (1.0, 1.0, 0.0)) + rng.normal(0.0, LEVEL, light.shape)
        labels = labeller.labels(LinearFrame(light.astype(np.float32)), mask)
        plain = mask & ~strange
        assert np.mean(labels[plain] == stripes[plain]) > 0.97


def test_labels_are_carried_along_with_a_subject_that_crosses_the_picture() -> None:
    labels = sectors()
    labeller, unlike = Followed(PAINTS), []
    for step in range(8):
        still, _, inside = painted(labels, seed=step)
        rgb, mask = np.zeros((200, 400, 3), np.float32), np.zeros((200, 400), np.bool_)
        there = np.s_[10 + 6 * step : 130 + 6 * step, 3 * step : 117 + 3 * step]
        rgb[there], mask[there] = still.rgb[:, :117], inside[:, :117]
        carried = labeller.labels(LinearFrame(rgb), mask)
        unlike.append(np.mean(carried[there][inside[:, :117]] != labels[:, :117][inside[:, :117]]))
        assert not carried[~mask].any()
    assert max(unlike) < 0.03


def test_the_loop_of_label_moves_finds_what_the_plain_energy_does() -> None:
    """The label that a pixel gets is the one around it with which the whole picture costs least."""
    labels = sectors(40).astype(np.uint8)
    frame, _, mask = painted(sectors(40))
    split = split_frame(frame, RESPONSE, mask)
    seams = Seams(1.0, 0.02**2, 0.02**2, (0.01, 0.01, 0.01))
    energy = LabelEnergy.of(split.colours, split.lit, split.lamps, PAINTS, Spread(0.02, 0.02), seams)
    rng, alone = np.random.default_rng(3), np.zeros(mask.shape, np.bool_)
    for v, u in rng.integers(8, 32, (12, 2)):
        start = labels.copy()
        start[v, u] = (labels[v, u] + 1) % 3
        costs = []
        for m in range(3):
            each = start.copy()
            each[v, u] = m
            costs.append(energy.prices(each).sum())
        alone[:] = False
        alone[v, u] = True
        found = energy.followed(start, alone)
        around = np.unique(start[v - 1 : v + 2, u - 1 : u + 2])
        assert energy.prices(found).sum() == pytest.approx(min(costs[m] for m in around), abs=0.05)


YARNS = np.array([[0.86, 0.28, 0.25], [0.26, 0.62, 0.39], [0.25, 0.33, 0.66]])


def tartan(size: int, seed: int) -> tuple[LinearFrame, np.ndarray]:
    """A knitted dome in a tartan of three yarns, of squares of 8 to 20 pixels, blurred; and its mask."""
    normals, mask, _ = knitted_with_logo(size)
    of_thread = np.searchsorted([20, 35, 43], np.arange(size) % 43, side="right")
    cloth = 0.5 * (YARNS[of_thread][:, None] + YARNS[of_thread])
    light = np.maximum(normals @ DIRECTIONS.T, 0.0) * cloth @ COLOURS * mask[..., None]
    light = gaussian_filter(light, (0.7, 0.7, 0.0))
    light += np.random.default_rng(seed).normal(0.0, LEVEL, light.shape)
    return LinearFrame(light.astype(np.float32)), mask


def test_a_tartan_too_fine_for_the_blocks_of_three_frames_is_looked_at_in_one() -> None:
    frames, masks = zip(*(tartan(240, seed) for seed in (3, 4, 5)), strict=True)
    searched = searched_frames(frames, masks, RESPONSE)
    assert len(searched.split.lit) <= 240


def rotated(labels: np.ndarray, degrees: float) -> np.ndarray:
    """Labels turned about the middle of the picture."""
    middle = (len(labels) - 1) / 2
    v, u = np.indices(labels.shape) - middle
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    places = np.stack([cosine * v - sine * u, sine * v + cosine * u]) + middle
    return labels[tuple(places.round().astype(int).clip(0, len(labels) - 1))]


MELANIN = np.array([0.3, 0.62, 1.15])


def freckled(seed: int = 0, noise: float = LEVEL) -> tuple[LinearFrame, np.ndarray, np.ndarray]:
    """A dome of skin with 300 freckles of melanin, in 8 bits; its normals and mask."""
    rng = np.random.default_rng(seed)
    normals, mask = dome(180)
    v, u = np.indices(mask.shape)
    freckles = np.zeros(mask.shape)
    for a, b, strength in zip(*rng.uniform(0, 180, (2, 300)), rng.uniform(0.1, 0.5, 300), strict=True):
        freckles += strength * np.exp(-((v - a) ** 2 + (u - b) ** 2) / 2 / 2.5**2)
    skin = np.array([0.9, 0.65, 0.5]) * np.exp(-freckles[..., None] * MELANIN)
    light = np.maximum(normals @ DIRECTIONS.T, 0.0) * skin @ COLOURS
    light += rng.normal(0.0, noise, light.shape)
    return LinearFrame((light * mask[..., None]).astype(np.float32)), normals, mask


@pytest.mark.slow
def test_freckles_are_found_as_a_pigment_and_hardly_turn_normals() -> None:
    frame, normals, mask = freckled()
    values = find_materials(searched_frames([frame], [mask], RESPONSE), 1)[0].reflectance.values[None]
    labels = np.zeros(mask.shape, np.uint8)
    plain = Followed(values)
    found = plain.pigments(frame, mask, labels)[0]
    assert found is not None
    direction, log = found
    assert direction[0] < direction[1] < direction[2]  # melanin takes most of the blue
    with_pigment = Followed(np.exp(log)[None], direction[None])
    before, after = (
        angles_deg(result.normals_in_camera, normals)[result.mask].mean()
        for result in (
            normals_from_frame(each.relit(frame, labels), RESPONSE, mask) for each in (plain, with_pigment)
        )
    )
    assert after < 0.7 * before


def test_a_pigment_is_taken_out_to_unit_length_inside_the_mask_alone() -> None:
    frame, _, mask = freckled(noise=0.0)
    line, skin = (MELANIN / np.linalg.norm(MELANIN))[None], np.array([[0.9, 0.65, 0.5]])
    labels = np.zeros(mask.shape, np.uint8)
    half = mask & (np.indices(mask.shape)[1] < 90)
    plain, part = (relit(frame, RESPONSE, labels, skin, line, mask=each) for each in (mask, half))
    assert np.array_equal(plain.rgb[half], part.rgb[half])
    bare = relit(frame, RESPONSE, labels, skin)
    np.testing.assert_allclose(part.rgb[~half], bare.rgb[~half], atol=1e-6)
    off = [
        np.abs(np.linalg.norm(each.rgb[half] @ np.linalg.inv(RESPONSE.matrix).T, axis=1) - 1.0).mean()
        for each in (bare, part)
    ]
    assert off[1] < 0.6 * off[0]  # what is left is trust in other reasons, such as gloss


@pytest.mark.parametrize("colour", [MELANIN, np.array([0.31, 0.77, 0.58]), np.array([1.3, 1.4, 1.6])])
def test_the_surface_tells_spots_of_any_colour_better_than_lengths_do(colour: np.ndarray) -> None:
    frame, normals, mask = freckled()  # of melanin; then spots of melanin, of lips, of brows
    v, u = np.indices(mask.shape)
    spots = (np.hypot(v % 30 - 15, u % 30 - 15) < 4) & mask
    contributions = frame.rgb @ RESPONSE.contributions_from_rgb.T * np.exp(-0.6 * spots[..., None] * colour)
    frame = LinearFrame((contributions @ COLOURS).astype(np.float32))
    line, skin = (MELANIN / np.linalg.norm(MELANIN))[None], np.array([[0.9, 0.65, 0.5]])
    labels = np.zeros(mask.shape, np.uint8)
    told = Followed(skin, line).relit(frame, labels, mask)
    by_lengths = relit(frame, RESPONSE, labels, skin, line, mask=mask)
    assert np.array_equal(told.rgb[~mask], by_lengths.rgb[~mask])
    off = [
        angles_deg(normals_from_frame(each, RESPONSE, mask).normals_in_camera, normals)[mask]
        for each in (told, by_lengths)
    ]
    assert off[0].mean() < 0.7 * off[1].mean()


def test_the_surface_tells_more_than_lengths_of_dark_hair_too() -> None:
    frame, normals, mask = freckled()
    noise = np.random.default_rng(0).normal(0.0, LEVEL, frame.rgb.shape) * mask[..., None]
    dark = LinearFrame((0.05 * frame.rgb + noise).astype(np.float32))
    line, hair = (MELANIN / np.linalg.norm(MELANIN))[None], 0.05 * np.array([[0.9, 0.65, 0.5]])
    labels = np.zeros(mask.shape, np.uint8)
    both = (
        Followed(hair, line).relit(dark, labels, mask),
        relit(dark, RESPONSE, labels, hair, line, mask=mask),
    )
    told, by_lengths = (
        angles_deg(normals_from_frame(each, RESPONSE, mask).normals_in_camera, normals)[mask].mean()
        for each in both
    )
    assert told < 0.8 * by_lengths


def test_how_far_paint_turned_normals_is_how_far_they_are_in_doubt() -> None:
    frame, normals, mask = freckled()
    line, skin = (MELANIN / np.linalg.norm(MELANIN))[None], np.array([[0.9, 0.65, 0.5]])
    labeller, labels = Followed(skin, line), np.zeros(mask.shape, np.uint8)
    told = labeller.relit(frame, labels, mask)
    off = angles_deg(normals_from_frame(told, RESPONSE, mask).normals_in_camera, normals)
    doubt = labeller.turned_deg
    assert doubt is not None
    wrong = mask & (off > 3.0)
    assert wrong.any()
    assert np.mean(doubt[wrong]) > 1.4 * np.mean(doubt[mask & (off < 1.0)])


@pytest.mark.slow
def test_a_surface_that_moves_is_sought_from_the_frame_before_and_anew_where_that_is_far() -> None:
    rgb, normals, mask = (
        np.pad(each, ((0, 0), (0, 50), (0, 0))[: each.ndim]) for each in (freckled()[0].rgb, *freckled()[1:])
    )
    line, skin = (MELANIN / np.linalg.norm(MELANIN))[None], np.array([[0.9, 0.65, 0.5]])
    following, labels = Followed(skin, line), np.zeros(mask.shape, np.uint8)
    went_on = []
    for shift in (*np.arange(0.0, 8.0, 0.4), 40.0):
        seen, there, inside = (
            ndimage.shift(each, (0, shift, 0)[: each.ndim], order=1)
            for each in (rgb, normals, mask.astype(np.float32))
        )
        inside, off = inside > 0.99, []
        moved = LinearFrame(seen * inside[..., None])
        followed, alone = (
            labeller.relit(moved, labels, inside) for labeller in (following, Followed(skin, line))
        )
        for each in (followed, alone):
            found = normals_from_frame(each, RESPONSE, inside).normals_in_camera
            off.append(angles_deg(found, there)[inside].mean())
        went_on.append(not np.array_equal(followed.rgb, alone.rgb))
        assert off[0] < 1.03 * off[1]
    assert not went_on[0]
    assert not went_on[-1]
    assert went_on[1]
    assert not all(went_on[1:-1])  # by pieces of a block it moved farther than steps follow


def test_a_surface_without_paint_stays_as_it_is_through_a_wide_lens_too() -> None:
    size, focal_px = 180, 108.0
    camera = Camera.pinhole(width=size, height=size, focal_px=focal_px)
    v, u = np.indices((size, size)) - (size - 1) / 2
    depth = np.exp(0.3 * np.sin(u / 25) * np.cos(v / 20) + 0.4 * (u**2 + v**2) / size**2)
    places = np.stack([u, v, np.full(u.shape, focal_px)], axis=-1) * depth[..., None]
    normals = np.cross(np.gradient(places, axis=0), np.gradient(places, axis=1))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    light = np.maximum(normals @ DIRECTIONS.T, 0.0)
    mask, labels = light.min(axis=2) > 0.1, np.zeros(u.shape, np.uint8)
    frame = LinearFrame((light @ COLOURS).astype(np.float32))
    line, rho = (MELANIN / np.linalg.norm(MELANIN))[None], np.ones((1, 3))
    through, flat = (Followed(rho, line, each).relit(frame, labels, mask) for each in (camera, None))
    off, off_flat = (
        angles_deg(normals_from_frame(each, RESPONSE, mask).normals_in_camera, normals)[mask].mean()
        for each in (through, flat)
    )
    assert off < 0.3
    assert off_flat > 2.0  # slopes along parallel rays are those of no depth


def test_noise_does_not_bend_the_line_of_a_pigment() -> None:
    frame, _, mask = freckled(noise=3.0 * LEVEL)
    values = find_materials(searched_frames([frame], [mask], RESPONSE), 1)[0].reflectance.values[None]
    found = Followed(values).pigments(frame, mask, np.zeros(mask.shape, np.uint8))[0]
    assert found is not None
    assert angles_deg(found[0], MELANIN / np.linalg.norm(MELANIN)) < 10.0  # single pixels tell none


def test_one_colour_has_no_pigment() -> None:
    frame, _, mask = painted(np.full((120, 120), 1))
    labeller = Followed(PAINTS[1:2])
    assert labeller.pigments(frame, mask, np.zeros(mask.shape, np.uint8)) == [None]


def test_a_material_too_small_to_tell_shares_the_pigment_of_the_largest() -> None:
    frame, _, mask = freckled()
    values = find_materials(searched_frames([frame], [mask], RESPONSE), 1)[0].reflectance.values[None]
    labels = (np.indices(mask.shape)[0] < 32).astype(np.uint8)
    large, small = Followed(values.repeat(2, 0)).pigments(frame, mask, labels)
    assert large is not None
    assert small is not None
    assert np.array_equal(large[0], small[0])
    assert Followed(values).pigments(frame, mask & (labels > 0), 0 * labels) == [None]


def test_turn_by_lamps_in_doubt_is_what_lamps_that_are_off_do() -> None:
    """M known, directions drawn with their doubts: ρ is fitted and normals are told under each draw."""
    doubts_deg, rng = np.array([3.0, 2.0, 4.0]), np.random.default_rng(5)
    normals, mask = dome(40)
    normals = normals[mask]
    rgb = np.maximum(normals @ DIRECTIONS.T, 0.0) * PAINTS[0] @ COLOURS
    said, turns = [], []
    for _ in range(60):
        axes = np.cross(DIRECTIONS, rng.normal(size=(3, 3)))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        lengths = np.linalg.norm(rng.normal(size=(3, 2)), axis=1)  # of two independent standard deviations
        moved = DIRECTIONS + np.cross(axes, DIRECTIONS) * (np.radians(doubts_deg) * lengths)[:, None]
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
        colours = (RESPONSE.matrix @ np.linalg.inv(moved)).T
        response = replace(RESPONSE, light_colours=colours, light_doubts_deg=doubts_deg)
        lamps = lamps_from_response(response, np.zeros(3))
        contributions = rgb @ lamps.split.T
        log, normal_matrix, _ = best_fit(contributions, lamps, 0.02)
        fitted = reflectance_from_fit(log, np.linalg.inv(normal_matrix), contributions, lamps)
        told = (contributions / fitted.values) @ lamps.inverse.T
        told /= np.linalg.norm(told, axis=1, keepdims=True)
        turns.append(np.mean(angles_deg(told, normals) ** 2))
        said.append(fitted.lamps_deg**2)
    assert np.sqrt(np.mean(said)) == pytest.approx(np.sqrt(np.mean(turns)), rel=0.3)


def test_lamps_in_doubt_do_not_turn_the_rigs_own_material() -> None:
    lamps = lamps_from_response(replace(RESPONSE, light_doubts_deg=np.full(3, 4.0)), np.zeros(3))
    normals, mask = dome(40)
    contributions = normals[mask] @ DIRECTIONS.T
    fitted = reflectance_from_fit(np.zeros(3), 1e-8 * np.eye(3), contributions, lamps)
    assert fitted.lamps_deg < 1e-6
