"""How far the guesses of links err, learnt link by link from frame to frame.

A skull moves as one body, but the neck below it may rest while it turns. Normals err less under one rig than
under another. Where nothing is measured now, something may have told of the place before. So each guess's
errors are learnt by expectation maximisation (`dempster1977`). Where the solution, whose own error has the
variance P, departs from a guess by d, that guess errs by d² + P in the mean squared. Where nothing but the
guess tells of a link, P is the guess's own variance and d is zero: nothing is learnt.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray

_LEARNS = 0.1  # of what one frame shows: frames that follow one another show nearly the same
_BODY = 0.3**2  # before any frame: of a surface taken for one body, a face that talks, a cloth that swings
_FARTHEST = 4.0  # times the variance that lengths are given, and as small a part of it


class Guess(NamedTuple):
    """steps: (links, 2) pixels. strain: (links,) squared, expected. right: (links,) how likely it holds."""

    steps: npt.NDArray[np.float64]
    strain: npt.NDArray[np.float64]
    right: npt.NDArray[np.float64]


class GuessErrors(NamedTuple):
    """What is learnt. body: (links,) squared strain. lengths: (links,) factor on the squared strain given."""

    body: npt.NDArray[np.float64]
    lengths: npt.NDArray[np.float64]

    def learnt(
        self,
        around: GuessErrors,
        guesses: tuple[Guess, Guess],
        found: tuple[FloatArray, FloatArray],
        left: FloatArray,
    ) -> GuessErrors:
        """Return what is known after a frame.

        around: what the guesses used of this, with the links around each. guesses: by the body and by
        lengths. found: (links,) squared strains by which the solution departs from them. left: (links,) that
        to expect of the solution itself.
        """
        (body, lengths), (by_body, by_lengths) = guesses, found
        factor = _changed(self.lengths, lengths, by_lengths, left, lengths.strain / around.lengths)
        return GuessErrors(
            body=_changed(self.body, body, by_body, left, np.ones_like(left)),
            lengths=np.clip(factor, 1.0 / _FARTHEST, _FARTHEST),
        )


def usual_errors(links: int) -> GuessErrors:
    """Return what is known of so many links before any frame."""
    return GuessErrors(body=np.full(links, _BODY), lengths=np.ones(links))


def _changed(
    before: FloatArray, guess: Guess, found: FloatArray, left: FloatArray, unit: FloatArray
) -> npt.NDArray[np.float64]:
    """(links,) what was known before, in units (links,) of squared strain, and what is found besides."""
    shown = np.clip(1.0 - left / guess.strain, 0.0, 1.0)
    return np.asarray(before + _LEARNS * guess.right * (found / unit - shown * before))
