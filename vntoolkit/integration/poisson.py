"""Poisson's equation: by cosine or Fourier transform on a rectangle, by conjugate gradients inside a mask.

Both find the depth whose differences fit the wanted ones best in the least-squares sense, with the border
free. Mirroring the image about its border makes it periodic without a seam, which is what Frankot and
Chellappa's projection (`frankot1988`) needs to be right on a surface that is not periodic; the cosine
transform is that mirrored Fourier transform without the copies.
"""

from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
import scipy.fft

from vntoolkit.arrays import Array, DTypeLike, Float32Array, Float64Array, FloatArray, Int64Array, Mask
from vntoolkit.errors import SolverFailed
from vntoolkit.integration.edges import EdgeField, FarEdges
from vntoolkit.native import njit
from vntoolkit.solvers import GridHierarchy, grid_hierarchy, multigrid_cycle


class RectangleSolver(Protocol):
    """Solves Laplacian z = divergence on one rectangle; mean z = 0."""

    def solve(self, divergence: FloatArray) -> FloatArray:
        """Return z, (h, w), in the dtype of the solver; `divergence` may be overwritten."""


class CosineSolver:
    """By the type 2 cosine transform of the rows, then one tridiagonal system a frequency along the columns.

    That is Hockney's way (`hockney1965`). The systems are factored once. To transform the columns too, forth
    and back, takes twice as long.
    """

    def __init__(self, height: int, width: int, dtype: DTypeLike = np.float32) -> None:
        self._dtype = dtype
        self._pivots = np.empty((height, width))  # their inverses
        eigenvalues, before = laplacian_eigenvalues(width), np.zeros(width)
        for v in range(height):
            pivot = eigenvalues - before - (v > 0) - (v < height - 1)
            before = np.divide(1.0, pivot, out=np.zeros(width), where=pivot != 0)  # 0: the mean is free
            self._pivots[v] = before

    def solve(self, divergence: FloatArray) -> FloatArray:
        """Return z, (h, w), of mean 0; a `divergence` of the solver's dtype is overwritten."""
        field = divergence.astype(self._dtype, copy=False)
        spectrum = scipy.fft.dct(field, type=2, norm="ortho", workers=1, overwrite_x=True)
        spectrum[:, 0] -= spectrum[:, 0].mean(dtype=np.float64)
        _solve_columns(spectrum, self._pivots)
        spectrum[:, 0] -= spectrum[:, 0].mean(dtype=np.float64)
        return scipy.fft.idct(spectrum, type=2, norm="ortho", workers=1, overwrite_x=True)


_COLUMNS = 64  # taken together: their rows stay in the cache


@njit
def _solve_columns(spectrum, pivots):  # type: ignore[no-untyped-def]
    """Elimination down every column and substitution back up, in place; in double precision throughout.

    The lowest frequencies lose in each row what single precision rounds off, and there are many rows.
    """
    height, width = spectrum.shape
    for stripe in range((width + _COLUMNS - 1) // _COLUMNS):
        first = stripe * _COLUMNS
        last = min(first + _COLUMNS, width)
        rows, row = np.empty((height, last - first)), np.zeros(last - first)
        for v in range(height):
            given, factors, to = spectrum[v, first:last], pivots[v, first:last], rows[v]
            for u in range(last - first):
                row[u] = (given[u] - row[u]) * factors[u]
                to[u] = row[u]
        row[:] = 0.0
        for v in range(height - 1, -1, -1):
            given, factors, to = rows[v], pivots[v, first:last], spectrum[v, first:last]
            for u in range(last - first):
                row[u] = given[u] - factors[u] * row[u]
                to[u] = row[u]


class FourierSolver:
    """Frankot and Chellappa's projection on the image mirrored to twice its height and width.

    The wave numbers are those of differences between neighbouring pixels, so that the result is the exact
    discrete least squares rather than one of a derivative that the sampled, mirrored surface does not have.
    """

    def __init__(self, height: int, width: int, dtype: DTypeLike = np.float32) -> None:
        self._shape = (height, width)
        rows = laplacian_eigenvalues(height, 2 * height)
        columns = laplacian_eigenvalues(width, width + 1)
        eigenvalues = rows[:, None] + columns
        eigenvalues[0, 0] = np.inf
        self._inverse = np.asarray(1.0 / eigenvalues, dtype=dtype)

    def solve(self, divergence: FloatArray) -> FloatArray:
        """Return z, (h, w), of mean 0."""
        height, width = self._shape
        field = divergence.astype(self._inverse.dtype)
        field = np.concatenate([field, field[::-1]], axis=0)
        field = np.concatenate([field, field[:, ::-1]], axis=1)
        spectrum = scipy.fft.rfft2(field, workers=1)
        spectrum *= self._inverse
        depth = scipy.fft.irfft2(spectrum, s=field.shape, workers=1, overwrite_x=True)
        return np.ascontiguousarray(depth[:height, :width])


def laplacian_eigenvalues(length: int, count: int | None = None) -> Float64Array:
    """Eigenvalues 2 cos(pi k / n) - 2, k = 0 … count-1 (n-1), of the second difference with a free border.

    Written as -4 sin², which keeps its digits at small k where the cosine would lose them.
    """
    index = np.arange(length if count is None else count)
    return -4.0 * np.sin(np.pi * index / (2.0 * length)) ** 2


class MaskedSolver:
    """Least squares over the edges of one domain; keeps what depends on the domain alone."""

    def __init__(self, domain: Mask, *, tolerance: float = 1e-5, most_iterations: int = 1000) -> None:
        rows, columns = np.flatnonzero(domain.any(axis=1)), np.flatnonzero(domain.any(axis=0))
        self._box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        self._shape = domain.shape
        self._tolerance = tolerance
        self._most_iterations = most_iterations
        inside = domain[self._box]
        height, width = (scipy.fft.next_fast_len(n, real=True) for n in inside.shape)
        self._inside = np.zeros((height, width), dtype=bool)
        self._inside[: inside.shape[0], : inside.shape[1]] = inside
        self._levels: GridHierarchy | None = None
        self.iterations = 0

    @cached_property
    def _cosine(self) -> CosineSolver:
        return CosineSolver(*self._inside.shape)

    @cached_property
    def _outside_negative(self) -> Float32Array:
        """0 outside; -1 inside, since the cosine transform solves with the other sign."""
        return -self._inside.astype(np.float32)

    def solve(
        self,
        edges: EdgeField,
        start: FloatArray | None = None,
        *,
        weighted: bool = False,
        known: tuple[FloatArray, FloatArray] | None = None,
        far: FarEdges | None = None,
        tolerance: float | None = None,
        most_iterations: int | None = None,
    ) -> Float64Array:
        """Return the depth (h, w) whose differences fit `edges` best; offsets per component are arbitrary.

        weighted: whether the weights differ between edges of the domain. known: depth (h, w) and its weights,
        beside those of the edges; needs `weighted`. far: edges between pixels that lie apart. start: a first
        guess (h, w), for example the frame before. tolerance, most_iterations: where it stops, as a step
        among others need not be solved to the end. Without: those of the solver; raises `SolverFailed` where
        they do not suffice.
        """
        right, down = (self._padded(weight) for weight in edges.weight)
        self._levels = _levels_of(right, down) if weighted else None
        load, depth = np.zeros(right.shape), np.zeros(right.shape)
        _load(*(self._padded(each) for each in edges.difference), right, down, load)
        operator = _Operator(right, down)
        if known is not None:
            known_weight = self._padded(known[1])
            operator = operator._replace(known_weight=known_weight)
            load += known_weight * self._padded(known[0])
        if far is not None:
            first, last = (self._flat_padded(ends) for ends in (far.first, far.last))
            operator = operator._replace(far=(first, last, far.weight))
            _spread(first, last, far.weight * far.difference, load.reshape(-1))
        if start is not None and load.any():  # else 0 is the solution
            depth[1:-1, 1:-1] = self._padded(start)[1:-1, 1:-1]
        self._iterate(operator, depth, load, tolerance, most_iterations)
        out = np.zeros(self._shape)
        box_height, box_width = (s.stop - s.start for s in self._box)
        out[self._box] = depth[1 : box_height + 1, 1 : box_width + 1]
        return out

    def _iterate(
        self,
        operator: "_Operator",
        depth: Float64Array,
        load: Float64Array,
        given_tolerance: float | None,
        given_most: int | None,
    ) -> None:
        """Preconditioned conjugate gradients, in place; only directions may be of single precision."""
        tolerance = self._tolerance if given_tolerance is None else given_tolerance
        most = self._most_iterations if given_most is None else given_most
        direction, product = np.zeros(depth.shape, np.float32), np.zeros(depth.shape)
        scaled, sums = np.empty(self._inside.shape, np.float32), np.zeros(len(depth))
        operator.apply(depth, product, sums)
        residual = load - product
        scale = _energy(depth, load)
        largest = _largest(residual) or 1.0
        residual *= 1.0 / largest  # so that single precision holds its smallest parts
        step, energy = 0.0, np.inf
        self.iterations = 0
        while self.iterations <= most:
            _update(depth, residual, direction, product, step, step * largest, scaled)
            correction = self._precondition(scaled)
            _dot(residual, correction, sums)
            previous, energy = energy, float(sums.sum())
            left = energy * largest**2
            scale = max(scale, left) if self.iterations == 0 else scale
            if left <= tolerance**2 * scale:
                scale = _energy(depth, load) or 1.0  # the solution's own energy, not the start's error
                if left <= tolerance**2 * scale:
                    return
            _advance(direction, correction, energy / previous)
            operator.apply(direction, product, sums)
            step = energy / float(sums.sum())
            self.iterations += 1
        if given_most is not None:
            return
        raise SolverFailed(
            f"masked Poisson did not converge in {self._most_iterations} iterations (relative "
            f"residual {np.sqrt(energy * largest**2 / scale):.1e}, wanted {tolerance:.1e}): "
            "leave out the normals that contradict each other, or take --integrator discontinuity"
        )

    def _precondition(self, residual: Float32Array) -> Float32Array:
        """Solve on the rectangle, or by one multigrid cycle: this may be rounded, the operator may not."""
        if self._levels is not None:
            return multigrid_cycle(self._levels, residual)
        solution = self._cosine.solve(residual)
        solution *= self._outside_negative
        return solution

    def _flat_padded(self, places: Int64Array) -> Int64Array:
        """Return flat indices (n,) of rows and columns (n, 2) in an image with a rim."""
        rows, columns = self._box
        width = self._inside.shape[1] + 2
        return (places[:, 0] - rows.start + 1) * width + places[:, 1] - columns.start + 1

    def _padded(self, image: FloatArray) -> FloatArray:
        """Crop to the box and put a rim of zeros around, so that no kernel asks for a border."""
        height, width = self._inside.shape
        out = np.zeros((height + 2, width + 2), dtype=image.dtype)
        cropped = image[self._box]
        out[1 : cropped.shape[0] + 1, 1 : cropped.shape[1] + 1] = cropped
        return out


class _Operator(NamedTuple):
    """The matrix A of the normal equations, over images with a rim of zeros.

    right, down: weights of edges. known_weight: of known depths. far: pixels (n,) that edges between pixels
    apart lead from and to, as flat indices, and their weights.
    """

    right: Float32Array
    down: Float32Array
    known_weight: FloatArray | None = None
    far: tuple[Int64Array, Int64Array, FloatArray] | None = None

    def apply(self, x: FloatArray, out: Float64Array, sums: Float64Array) -> None:
        """Fill out with A x; sums (h,), which add up to x · A x."""
        _apply(self.right, self.down, x, out, sums)
        if self.known_weight is not None:
            known_part = self.known_weight * x
            out += known_part
            sums += np.einsum("vu,vu->v", known_part, x)
        if self.far is not None:
            first, last, weight = self.far
            difference = x.ravel()[last] - x.ravel()[first].astype(np.float64)
            _spread(first, last, weight * difference, out.reshape(-1))
            sums[1] += np.einsum("n,n,n->", weight, difference, difference)


def _spread(first: Int64Array, last: Int64Array, values: FloatArray, out: Float64Array) -> None:
    """Add values (n,) to the pixels that edges lead to, and take them from those they lead from."""
    np.add.at(out, last, values)
    np.subtract.at(out, first, values)


def _energy(first: Float64Array, second: Float64Array) -> float:
    """Return the sum of products, without a BLAS whose threads would spin."""
    return float(np.einsum("vu,vu->", first, second))


def _levels_of(right: Array, down: Array) -> GridHierarchy:
    """The grids of the weights (h + 2, w + 2) inside their rim."""
    edges = np.empty((2, right.shape[0] - 2, right.shape[1] - 2), np.float32)
    edges[0], edges[1] = right[1:-1, 1:-1], down[1:-1, 1:-1]
    return grid_hierarchy(edges)


# Compiled loops over images with a rim of zeros. Sums are kept by rows: the same for any number of threads.


@njit
def _load(right, down, right_weight, down_weight, out):  # type: ignore[no-untyped-def]
    """Right-hand side: the weighted divergence of the wanted differences, with the sign of A z = b."""
    height, width = out.shape
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            out[v, u] = (
                np.float64(right_weight[v, u - 1]) * right[v, u - 1]
                - np.float64(right_weight[v, u]) * right[v, u]
                + np.float64(down_weight[v - 1, u]) * down[v - 1, u]
                - np.float64(down_weight[v, u]) * down[v, u]
            )


@njit
def _apply(right, down, x, out, sums):  # type: ignore[no-untyped-def]
    """out = A x; sums (h,): x · A x of each row."""
    height, width = x.shape
    for v in range(1, height - 1):
        here, west, east = x[v, 1 : width - 1], x[v], x[v, 2:]
        above, below, to = x[v - 1, 1 : width - 1], x[v + 1, 1 : width - 1], out[v, 1 : width - 1]
        to_west, to_east = right[v], right[v, 1 : width - 1]
        up, to_below = down[v - 1, 1 : width - 1], down[v, 1 : width - 1]
        total = 0.0
        for u in range(width - 2):
            own = np.float64(here[u])
            value = (
                to_east[u] * (own - east[u]) + to_west[u] * (own - west[u])
                + to_below[u] * (own - below[u]) + up[u] * (own - above[u])
            )  # fmt: skip
            to[u] = value
            total += own * value
        sums[v] = total


@njit
def _largest(padded):  # type: ignore[no-untyped-def]
    largest = 0.0
    for v in range(padded.shape[0]):
        for u in range(padded.shape[1]):
            largest = max(largest, abs(padded[v, u]))
    return largest


@njit
def _update(depth, residual, direction, product, step, depth_step, scaled):  # type: ignore[no-untyped-def]
    """Take a step along the direction; fill scaled (h, w), float32, with what is left."""
    height, width = scaled.shape
    for v in range(height):
        z, left, to = depth[v + 1, 1 : width + 1], residual[v + 1, 1 : width + 1], scaled[v]
        way, image = direction[v + 1, 1 : width + 1], product[v + 1, 1 : width + 1]
        for u in range(width):
            z[u] += depth_step * way[u]
            left[u] -= step * image[u]
            to[u] = left[u]


@njit
def _dot(padded, inner, sums):  # type: ignore[no-untyped-def]
    height, width = inner.shape
    for v in range(height):
        first, second, total = padded[v + 1, 1 : width + 1], inner[v], 0.0
        for u in range(width):
            total += first[u] * second[u]
        sums[v + 1] = total


@njit
def _advance(direction, correction, factor):  # type: ignore[no-untyped-def]
    height, width = correction.shape
    for v in range(height):
        to, more = direction[v + 1, 1 : width + 1], correction[v]
        for u in range(width):
            to[u] = np.float32(factor) * to[u] + more[u]
