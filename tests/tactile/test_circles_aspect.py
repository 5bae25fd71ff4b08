"""The shape of a contact is told whatever the light: a circle is one, an ellipse is measured."""

import numpy as np
import pytest

from vntoolkit.diagnosis.press_checks import check_round
from vntoolkit.tactile.circles import aspect_of_contact, find_contact_circle


def _aspects(seed: int, aspect: float) -> np.ndarray:
    """Return the aspects found of eight presses of a ball, pixels so many times as high as wide."""
    rng = np.random.default_rng([seed, 8])
    found = []
    colours = rng.normal(0, 0.2, (3, 2))  # of slopes
    for _ in range(8):
        v, u = np.mgrid[:240, :320].astype(float)
        x, y = u - rng.uniform(110, 210), (v - rng.uniform(90, 150)) / aspect
        away, radius = np.hypot(x, y), rng.uniform(25, 35)
        inside = away < radius
        slope = np.where(inside, away / 48, radius / 48 * np.exp(-(away - radius) / 9))
        slopes = np.stack([x, y], -1) * (slope / np.maximum(away, 1e-6))[..., None]
        change = slopes @ colours.T + rng.normal(0, 0.002, (240, 320, 3))
        change = change.astype(np.float32)
        circle = find_contact_circle(change)
        assert circle is not None
        found.append(aspect_of_contact(change, circle))
    return np.array([each for each in found if each is not None])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("aspect", [0.88, 1.0, 1.1])
def test_the_aspect_of_contacts_is_measured_and_named_where_it_is_not_1(seed: int, aspect: float) -> None:
    found = _aspects(seed, aspect)
    assert len(found) == 8
    assert np.median(found) == pytest.approx(aspect, rel=0.03)
    assert [finding.check for finding in check_round(found)] == (["contacts"] if aspect != 1 else [])


def test_few_presses_tell_nothing() -> None:
    assert check_round(np.array([1.2, 1.2, 1.2])) == []
