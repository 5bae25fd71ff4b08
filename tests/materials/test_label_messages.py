"""Messages give a line the labels of least cost, and turn a patch that no step within it turns."""

from itertools import product

import numpy as np
import pytest

from vntoolkit.materials.messages import labels_by_messages
from vntoolkit.materials.reflectance import CAP

LOGS = np.log([[0.9, 0.5, 0.3], [0.3, 0.8, 0.5], [0.5, 0.3, 0.9]]).astype(np.float32)
SEAM = 1.0


def cost_of(labels, prices, steps, reach) -> float:
    """What the labels (h, w) cost, written out."""
    h, w = labels.shape
    total = 0.0
    for v, u in np.ndindex(h, w):
        total += prices[v, u, labels[v, u]]
        for way, (a, b) in enumerate([(v, u + reach), (v + reach, u)]):
            if a < h and b < w and steps[v, u, way, 3] > 0:
                m, n = labels[v, u], labels[a, b]
                t = ((steps[v, u, way, :3] + LOGS[m] - LOGS[n]) ** 2 * steps[v, u, way, 3:]).sum()
                total += 0.5 * t / (1 + t / CAP**2) + SEAM / reach * (m != n)
    return total


def problem(rng, truth, reach):
    """Prices that tell little and steps that tell more, of true labels (h, w)."""
    h, w = truth.shape
    prices = rng.uniform(0, 2, (h, w, 3)).astype(np.float32)
    steps = np.zeros((h, w, 2, 6), np.float32)
    places = np.indices(truth.shape)
    for way in range(2):
        v, u = places[0] + way * reach, places[1] + (1 - way) * reach
        inside = (v < h) & (u < w)
        drawn = (
            LOGS[truth[v[inside], u[inside]]] - LOGS[truth[inside]] + rng.normal(0, 0.3, (inside.sum(), 3))
        )
        steps[inside, way, :3], steps[inside, way, 3:] = drawn, 4.0
    return prices, steps


@pytest.mark.parametrize("reach", [1, 3])
@pytest.mark.parametrize("seed", range(4))
def test_a_line_gets_the_labels_of_least_cost(reach, seed) -> None:
    rng = np.random.default_rng(seed)
    truth = rng.integers(0, 3, (1, 7)).astype(np.uint8)
    prices, steps = problem(rng, truth, reach)
    steps[:, :, 1] = 0.0
    found = labels_by_messages(
        np.zeros_like(truth), np.ones_like(truth, bool), prices, steps, LOGS, reach, SEAM
    )
    every = (np.array(each, np.uint8)[None] for each in product(range(3), repeat=7))
    least = min(cost_of(each, prices, steps, reach) for each in every)
    assert cost_of(found, prices, steps, reach) == pytest.approx(least, abs=1e-4)


def test_a_patch_is_turned_as_a_whole() -> None:
    """Its own pixels tell nothing; turned in part it costs a longer seam."""
    truth = np.zeros((20, 20), np.uint8)
    prices = np.zeros((20, 20, 3), np.float32)
    prices[:, :4, 1:], prices[..., 2] = 5.0, 5.0
    steps = np.zeros((20, 20, 2, 6), np.float32)
    steps[:, :-1, 0, 3:], steps[:-1, :, 1, 3:] = 4.0, 4.0
    start = truth.copy()
    start[:, 8:] = 1
    found = labels_by_messages(start, np.ones_like(truth, bool), prices, steps, LOGS, 1, SEAM)
    np.testing.assert_array_equal(found, truth)


def test_pixels_that_are_not_decided_keep_their_labels_and_are_asked() -> None:
    prices, steps = np.zeros((1, 5, 3), np.float32), np.zeros((1, 5, 2, 6), np.float32)
    steps[0, :-1, 0, 3:] = 9.0
    labels = np.array([[2, 0, 0, 0, 0]], np.uint8)
    active = np.array([[False, True, True, True, False]])
    prices[0, 1:4, 0] = 4.0
    found = labels_by_messages(labels, active, prices, steps, LOGS, 1, SEAM)
    assert found[0, 0] == 2
    assert found[0, 1] == 2
    assert found[0, 4] == 0
