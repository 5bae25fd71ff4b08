"""Poisson's equation on a full rectangle, by cosine transform or by Fourier transform of the mirrored image.

Both find the depth whose differences fit the wanted ones best in the least-squares sense, with the border
free. Mirroring the image about its border makes it periodic without a seam, which is what Frankot and
Chellappa's projection (`frankot1988`) needs to be right on a surface that is not periodic; the cosine
transform is that mirrored Fourier transform without the copies.
"""

from __future__ import annotations

from typing import Any, Protocol

import numba
import numpy as np
import numpy.typing as npt
import scipy.fft

_MOST_WORKERS = 2  # more wait for each other at this size

Image = npt.NDArray[np.floating[Any]]


class RectangleSolver(Protocol):
    """Solves Laplacian z = divergence on one rectangle; mean z = 0."""

    def solve(self, divergence: Image) -> Image:
        """Return z, (h, w), in the dtype of the solver; `divergence` may be overwritten."""


class CosineSolver:
    """By the type 2 discrete cosine transform; the eigenvalues are computed once."""

    def __init__(self, height: int, width: int, dtype: npt.DTypeLike = np.float32) -> None:
        eigenvalues = laplacian_eigenvalues(height)[:, None] + laplacian_eigenvalues(width)
        eigenvalues[0, 0] = np.inf  # the mean is free: it becomes 0
        self._inverse = np.asarray(1.0 / eigenvalues, dtype=dtype)

    def solve(self, divergence: Image) -> Image:
        """Return z, (h, w), of mean 0; a `divergence` of the solver's dtype is overwritten."""
        field = divergence.astype(self._inverse.dtype, copy=False)
        spectrum = scipy.fft.dctn(field, type=2, norm="ortho", workers=_workers(), overwrite_x=True)
        spectrum *= self._inverse
        return scipy.fft.idctn(spectrum, type=2, norm="ortho", workers=_workers(), overwrite_x=True)


class FourierSolver:
    """Frankot and Chellappa's projection on the image mirrored to twice its height and width.

    The wave numbers are those of differences between neighbouring pixels, so that the result is the exact
    discrete least squares rather than one of a derivative that the sampled, mirrored surface does not have.
    """

    def __init__(self, height: int, width: int, dtype: npt.DTypeLike = np.float32) -> None:
        self._shape = (height, width)
        rows = laplacian_eigenvalues(height, 2 * height)
        columns = laplacian_eigenvalues(width, width + 1)
        eigenvalues = rows[:, None] + columns
        eigenvalues[0, 0] = np.inf
        self._inverse = np.asarray(1.0 / eigenvalues, dtype=dtype)

    def solve(self, divergence: Image) -> Image:
        """Return z, (h, w), of mean 0."""
        height, width = self._shape
        field = divergence.astype(self._inverse.dtype)
        field = np.concatenate([field, field[::-1]], axis=0)
        field = np.concatenate([field, field[:, ::-1]], axis=1)
        spectrum = scipy.fft.rfft2(field, workers=_workers())
        spectrum *= self._inverse
        depth = scipy.fft.irfft2(spectrum, s=field.shape, workers=_workers(), overwrite_x=True)
        return np.ascontiguousarray(depth[:height, :width])


def _workers() -> int:
    """Threads of a transform; no more than compiled loops may use, so that one limit rules both."""
    return min(_MOST_WORKERS, numba.get_num_threads())


def laplacian_eigenvalues(length: int, count: int | None = None) -> npt.NDArray[np.float64]:
    """Eigenvalues 2 cos(pi k / n) - 2, k = 0 … count-1 (n-1), of the second difference with a free border.

    Written as -4 sin², which keeps its digits at small k where the cosine would lose them.
    """
    index = np.arange(length if count is None else count)
    return -4.0 * np.sin(np.pi * index / (2.0 * length)) ** 2
