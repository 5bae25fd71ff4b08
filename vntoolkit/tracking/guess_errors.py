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
    """One guess of all links.

    steps: (links, 2) pixels. strain: (links,) squared, expected. unit: (links,) squared strain, in which what
    is learnt of it counts. right: (links,) from 0 to 1, how likely it holds.
    """

    steps: npt.NDArray[np.float64]
    strain: npt.NDArray[np.float64]
    unit: npt.NDArray[np.float64]
    right: npt.NDArray[np.float64]


class GuessErrors(NamedTuple):
    """What is learnt. body: (links,) squared strain. lengths: (links,) factor on the squared strain given."""

    body: npt.NDArray[np.float64]
    lengths: npt.NDArray[np.float64]

    def learnt(
        self, guesses: tuple[Guess, Guess], found: tuple[FloatArray, FloatArray], left: FloatArray
    ) -> GuessErrors:
        """Return what is known after a frame.

        guesses: by the body and by lengths. found: (links,) squared strains by which the solution departs
        from them. left: (links,) squared strain to expect of the solution itself.
        """
        body, lengths = (_changed(*each, left) for each in zip(self, guesses, found, strict=True))
        return GuessErrors(body=body, lengths=np.clip(lengths, 1.0 / _FARTHEST, _FARTHEST))


def usual_errors(links: int) -> GuessErrors:
    """Return what is known of so many links before any frame."""
    return GuessErrors(body=np.full(links, _BODY), lengths=np.ones(links))


def _changed(
    before: FloatArray, guess: Guess, found: FloatArray, left: FloatArray
) -> npt.NDArray[np.float64]:
    """(links,) what was known before of a guess's errors, and what is found besides."""
    shown = np.clip(1.0 - left / guess.strain, 0.0, 1.0)
    return np.asarray(before + _LEARNS * guess.right * (found / guess.unit - shown * before))
