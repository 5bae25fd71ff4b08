"""How far guesses of links err is learnt from the frames in which something else told of them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tracking.test_tracking_information import flat_depth, flat_lengths
from vntoolkit.tracking.guess_errors import Guess, GuessErrors, usual_errors
from vntoolkit.tracking.lattice import LocalJacobians

LINKS = 200


def learnt(errs: float, noise: float, frames: int, seed: int = 0) -> GuessErrors:
    """Guesses by a body that err by errs, squared, beside measurements of such variance; fitted by both."""
    rng = np.random.default_rng(seed)
    errors, ones = usual_errors(LINKS), np.ones(LINKS)
    for _ in range(frames):
        strain = np.full(LINKS, errors.body.mean())
        error, other = np.sqrt([errs, noise])[:, None] * rng.standard_normal((2, LINKS))
        departs = strain / (strain + noise) * (other - error)  # of the solution from the guess
        guess = Guess(steps=np.zeros((LINKS, 2)), strain=strain, unit=ones, right=ones)
        left = strain * noise / (strain + noise)
        errors = errors.learnt((guess, guess), (departs**2, departs**2), left)
    return errors


@pytest.mark.parametrize("errs", [0.001, 0.01, 0.5])
@pytest.mark.parametrize("noise", [1e-4, 0.01])
def test_errors_of_the_body_are_found_whatever_they_are(errs: float, noise: float) -> None:
    found = float(learnt(errs, noise, frames=3000).body.mean())
    assert found == pytest.approx(errs, rel=0.3)


def test_nothing_is_learnt_where_only_the_guess_tells() -> None:
    before = usual_errors(LINKS)
    after = learnt(0.001, noise=1e9, frames=50)
    np.testing.assert_allclose(after.body, before.body, rtol=1e-3)
    np.testing.assert_allclose(after.lengths, before.lengths, rtol=1e-3)


def test_a_guess_that_is_not_right_teaches_nothing_and_lengths_are_never_far_from_what_they_are_given() -> (
    None
):
    before, none = usual_errors(2), np.zeros(2)
    strain, ones = np.full(2, 0.01), np.ones(2)
    lengths = Guess(steps=np.zeros((2, 2)), strain=strain, unit=strain, right=np.array([0.0, 1.0]))
    body = Guess(steps=np.zeros((2, 2)), strain=before.body, unit=ones, right=ones)
    errors = before
    for _ in range(100):
        errors = errors.learnt((body, lengths), (ones, ones), none)
    assert errors.lengths[0] == 1.0
    assert 2.0 < errors.lengths[1] < 20.0
    for _ in range(100):
        errors = errors.learnt((body, lengths), (none, none), none)
    assert 0.05 < errors.lengths[1] < 0.5


def test_a_body_that_holds_is_soon_taken_for_one_and_a_rift_in_it_stays_loose() -> None:
    """The right half of a flat sheet slides along the left one."""
    mask, pixels, lattice, lengths = flat_lengths()
    sheet = np.zeros((*mask.shape, 3), np.float32)
    moved = pixels + 3.0 * np.stack([0 * pixels[:, 0], pixels[:, 0] > 64], axis=1)
    around, known = LocalJacobians(lattice, pixels).of(moved), np.ones(lattice.count)
    errors = usual_errors(len(lengths.links))
    for _ in range(60):
        guess = lengths.guessed(
            moved, around, sheet, flat_depth(mask), 0 * known, 0 * known, known, lengths.around(errors)
        )
        errors = lengths.learnt(errors, guess, moved, np.ones(len(lengths.links)))
    unseen = lengths.guessed(
        moved, around, sheet, flat_depth(mask), 0 * known, 0 * known, 0 * known, lengths.around(errors)
    )
    first = lengths.guessed(
        moved,
        around,
        sheet,
        flat_depth(mask),
        0 * known,
        0 * known,
        0 * known,
        usual_errors(len(lengths.links)),
    )
    across = np.ptp(np.sign(lengths.centres[lengths.links][:, :, 0] - 64), axis=1) > 0
    far = np.abs(lengths.middles[:, 0] - 64) > 40
    sd, before = (np.sqrt(each.body.strain) for each in (unseen, first))
    assert np.median(sd[far]) < 0.5 * np.median(before[far])
    assert np.median(sd[across]) > 0.7 * np.median(before[across])
