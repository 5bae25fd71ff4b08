"""Detectors against known shadows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_flow

from vntoolkit.errors import BadInput
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.photometry.frame import LinearFrame, lit_from_labels
from vntoolkit.shadows.detector import ShadowDetector, lit_by_edges
from vntoolkit.shadows.robust import lit_by_cut, weights_of_light


def overlap(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Intersection over union of the shadow of each light."""
    dark_found, dark_true = ~lit_from_labels(found), ~lit_from_labels(true)
    return (dark_found & dark_true).sum((0, 1)) / (dark_found | dark_true).sum((0, 1))


def square(dark: float) -> np.ndarray:
    image = np.ones((60, 80, 3))
    image[20:40, 30:55, 1] = dark
    return image


def test_a_square_of_shadow_is_found_exactly_by_edges_and_flood() -> None:
    lit = lit_by_edges(square(0.1), np.ones((60, 80), bool))
    assert lit[..., 0].all()
    assert lit[..., 2].all()
    inside = np.zeros((60, 80), bool)
    inside[22:38, 32:53] = True
    near = np.zeros((60, 80), bool)
    near[18:42, 28:57] = True
    assert not lit[inside, 1].any()
    assert lit[~near, 1].all()


def test_published_rejects_what_is_too_faint_or_too_small() -> None:
    mask = np.ones((60, 80), bool)
    assert lit_by_edges(square(0.97), mask).all()
    assert not lit_by_edges(square(0.85), mask).all()
    speck = np.ones((60, 80, 3))
    speck[30:32, 40:42] = 0.1
    assert lit_by_edges(speck, mask).all()


def test_robust_labels_overlap_the_truth_and_beat_the_published_ones(stage) -> None:
    robust = ShadowDetector(stage.response).labels(stage.frame, stage.mask)
    published = ShadowDetector(stage.response, ShadowMethod.PUBLISHED).labels(stage.frame)
    assert overlap(robust, stage.labels).min() >= 0.8
    assert (overlap(robust, stage.labels) > overlap(published, stage.labels)).all()


def test_light_colours_take_crosstalk_apart(stage_with_crosstalk) -> None:
    stage = stage_with_crosstalk
    assert overlap(ShadowDetector(stage.response).labels(stage.frame), stage.labels).min() >= 0.8


def test_dark_paint_is_not_shadow(build_stage) -> None:
    v, u = np.mgrid[:80, :90]
    paint = np.where((u > 40) & (v > 20) & (v < 50), 0.12, 0.8)
    flat = build_stage(0.002 * ((u - 45.0) ** 2 + (v - 40.0) ** 2), albedo=paint, noise=0.001)
    assert (ShadowDetector(flat.response).labels(flat.frame) == 7).mean() > 0.99


@pytest.mark.parametrize("method", list(ShadowMethod))
@pytest.mark.parametrize("level", [0.0, 0.5])
def test_uniform_frames_pass_through(stage, method: ShadowMethod, level: float) -> None:
    frame = LinearFrame(rgb=np.full((33, 47, 3), level, np.float32), clipped=np.zeros((33, 47), bool))
    labels = ShadowDetector(stage.response, method).labels(frame)
    assert labels.shape == (33, 47)
    assert labels.max() <= 7


def test_a_frame_owes_nothing_to_the_frame_before(stage) -> None:
    """What another subject, turned and of other colours, left behind leads into the wrong valley."""
    other = LinearFrame(rgb=stage.frame.rgb[::-1, ::-1, ::-1].copy(), clipped=stage.frame.clipped)
    detector = ShadowDetector(stage.response)
    detector.labels(other, stage.mask)
    labels = detector.labels(stage.frame, stage.mask)
    alone = ShadowDetector(stage.response)
    assert np.array_equal(labels, alone.labels(stage.frame, stage.mask))
    assert alone.surface is not None
    assert np.array_equal(detector.surface.normals, alone.surface.normals)


def test_where_no_light_is_weak_nothing_is_solved(build_stage) -> None:
    v, u = np.mgrid[:60, :70]
    flat = build_stage(0.001 * ((u - 35.0) ** 2 + (v - 30.0) ** 2), noise=0.001)
    detector = ShadowDetector(flat.response)
    assert (detector.labels(flat.frame, flat.mask) == 7).all()
    assert detector.surface is None
    dark = flat.frame.rgb.copy()
    dark[20:40, 30:50, 1] = 0.0
    labels = detector.labels(LinearFrame(rgb=dark, clipped=flat.frame.clipped), flat.mask)
    assert detector.surface is not None
    assert (labels[22:38, 32:48] == 5).mean() > 0.95


def test_pixels_that_need_no_cut_are_labelled_as_the_cut_labels_them() -> None:
    generator = np.random.default_rng(7)
    log_odds = generator.normal(0.0, 2.0, (40, 50))
    weights = generator.random((40, 50)), generator.random((40, 50))
    mask = generator.random((40, 50)) < 0.9
    every = lit_by_cut(log_odds, lambda _: weights, mask, strongest=1e9)  # all of them enter
    assert np.array_equal(lit_by_cut(log_odds, lambda _: weights, mask, 1.0), every)
    assert every[~mask].all()


def test_cut_is_the_cheapest_labelling() -> None:
    """Against all 2⁹ labellings of a 3×3 image."""
    generator = np.random.default_rng(3)
    log_odds = generator.normal(size=(3, 3))
    east, south = generator.random((3, 3)), generator.random((3, 3))
    east[:, -1] = south[-1] = 0.0

    def price(lit: np.ndarray) -> float:
        wrong = np.where(lit != (log_odds > 0), np.abs(log_odds), 0.0).sum()
        across = (east[:, :-1] * (lit[:, 1:] != lit[:, :-1])).sum()
        return wrong + across + (south[:-1] * (lit[1:] != lit[:-1])).sum()

    every = [price(np.array([(i >> k) & 1 == 1 for k in range(9)]).reshape(3, 3)) for i in range(512)]
    found = lit_by_cut(log_odds, lambda _: (east, south), np.ones((3, 3), bool), 1.0)
    assert price(found) == pytest.approx(min(every))


@pytest.mark.parametrize(("strength", "seed"), [(0.1, 0), (1.0, 1), (10.0, 2)])
def test_cut_costs_what_the_maximum_flow_carries(strength, seed) -> None:
    """The two are equal, whatever the graph; SciPy's flow knows no grid, but whole numbers only."""
    generator = np.random.default_rng(seed)
    h, w = 37, 29
    log_odds = generator.integers(-50, 51, (h, w))
    east, south = (generator.integers(0, int(20 * strength) + 1, (h, w)) for _ in range(2))
    east[:, -1] = south[-1] = 0
    weights = east.astype(float), south.astype(float)
    lit = lit_by_cut(log_odds.astype(float), lambda _: weights, np.ones((h, w), bool), 20 * strength)
    price = np.abs(log_odds)[lit != (log_odds > 0)].sum()
    price += east[:, :-1][lit[:, 1:] != lit[:, :-1]].sum() + south[:-1][lit[1:] != lit[:-1]].sum()

    number = np.arange(h * w).reshape(h, w)
    source, sink = h * w, h * w + 1
    arcs = [(np.full(h * w, source), number.ravel(), np.maximum(log_odds, 0).ravel())]
    arcs += [(number.ravel(), np.full(h * w, sink), np.maximum(-log_odds, 0).ravel())]
    for a, b, room in ((number[:, :-1], number[:, 1:], east[:, :-1]), (number[:-1], number[1:], south[:-1])):
        arcs += [(a.ravel(), b.ravel(), room.ravel()), (b.ravel(), a.ravel(), room.ravel())]
    rows, columns, rooms = (np.concatenate(part) for part in zip(*arcs, strict=True))
    graph = csr_array((rooms.astype(np.int32), (rows, columns)), shape=(h * w + 2, h * w + 2))
    assert price == maximum_flow(graph, source, sink).flow_value
    assert 0 < np.count_nonzero(lit) < h * w or strength > 1


def test_of_equally_cheap_cuts_the_one_with_the_most_light_is_taken() -> None:
    weights = np.array([[1.0, 1.0, 0.0]]), np.zeros((1, 3))
    assert lit_by_cut(np.array([[1.0, 0.0, -1.0]]), lambda _: weights, np.ones((1, 3), bool), 1.0).all()
    apart = np.array([[0.5, 0.5, 0.0]]), np.zeros((1, 3))
    found = lit_by_cut(np.array([[1.0, 0.0, -1.0]]), lambda _: apart, np.ones((1, 3), bool), 1.0)
    assert found.tolist() == [[True, True, False]]


def test_bonds_give_way_to_one_light_alone() -> None:
    cosines = np.full((1, 3, 3), 0.8)
    cosines[:, 1:] *= 0.5  # all three: paint
    cosines[:, 2:, 0] = 0.02  # light 0 alone: shadow
    weights, _ = weights_of_light(cosines, 0, np.zeros((1, 3), np.int32), 1.0, 0.3)
    assert weights[0, 0] > 0.95
    assert weights[0, 1] < 0.1


def test_refusals(stage) -> None:
    with pytest.raises(BadInput, match="mask: expected shape 120 × 160"):
        ShadowDetector(stage.response).labels(stage.frame, np.ones((4, 4), bool))
    with pytest.raises(BadInput, match="mask: expected booleans, got uint8"):
        ShadowDetector(stage.response).labels(stage.frame, np.full((120, 160), 255, np.uint8))
