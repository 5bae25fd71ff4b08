"""The numbers of a text, read at once."""

import warnings

import numpy as np

from vntoolkit.arrays import FloatArray


def numbers_of_text(text: str | bytes) -> FloatArray:
    """Return the numbers of a text, between white space; raise `ValueError` where a word is none."""
    if not text.strip():
        return np.empty(0)
    with warnings.catch_warnings(action="error", category=DeprecationWarning):  # NumPy's for such a word
        try:
            return np.fromstring(text, sep=" ")
        except DeprecationWarning as problem:
            raise ValueError("a word is no number") from problem
