"""Reflectance of every vertex of a tracked surface, from many frames.

A free reflectance of three bands is not told from a turn of the normal in one frame. On a tracked surface a
vertex keeps its reflectance ρ and its place in the surface, so that log s_k = log ρ_k + log(l_k · R n), with
the known turn R of the surface since the template. Three things tell ρ from relief, each as far as it goes:
normals are of unit length, they turn with the surface, and from vertex to vertex they change less than paint
does. How much less, and along which line of log ρ paint varies, the footage tells (dempster1977): with one
paint normals stay as they are. Paint has a heavy tail, for freckles and lips (lange1989).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, IntArray, Mask, Matrix3, Points, Vector3
from vntoolkit.native import njit

_ROUNDS = 10
_FIRST_NOISE, _LEAST_NOISE = 0.03, 0.01  # standard deviation of log s, of one frame
# Independent looks that ever so many frames are worth: track, gloss and light between folds err alike in all.
_WORTH = 2.3
_FIRST_LINE = np.array([0.45, 0.55, 0.70])  # along which paint varies: most pigments take blue before red
_FIRST_SPREAD = 0.25  # of log ρ along that line
_ASIDE = 0.2  # spread of log ρ across the line, over that along it
_TAIL = 0.5  # degrees of freedom of the spread of paint (Student's t): most skin is plain, freckles are not
_STEEP = 2.0  # usual steps of the normal from which a larger one is an edge
_OF_MEDIAN = 1.18  # median of a length of two normal components, over their standard deviation
_CAP = 3.0  # standard deviations at which a frame stops to count more
_LEAST_FACING = 0.1  # cosine to a lamp: less is nearly in shadow
_LONGEST_STEP = 0.4  # of a normal, in one round
_ITERATIONS, _ENOUGH = 120, 1e-6  # of conjugate gradients, and what remains of the squared residual
_FIRM = 1e-3  # keeps a normal that nothing tells where it is
_LEAST_VARIANCE = 1e-6

Single = npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceLooks:
    """How a surface of n vertices looked in f frames.

    contributions: (f, n, 3) of the lamps, without ambient light. seen: (f, n), where these are sound and all
    lamps arrive. turns: (f, n, 3, 3), rotations from the template's pose to the frame's. edges: (e, 2) of
    the mesh. materials: (n,) number of each vertex's. logs: (n, 3), log ρ of its material.
    """

    contributions: Single
    seen: Mask
    turns: Single
    edges: IntArray
    materials: IntArray
    logs: Points


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceReflectance:
    """logs: (n, 3), log ρ of each vertex. lines: of each material, (m, 3), the line of log ρ along which
    paint varies, of length 1. spreads: (m,), standard deviation along it.
    """

    logs: Points
    lines: Points
    spreads: FloatArray


def fit_surface_reflectance(looks: SurfaceLooks, lights: Matrix3) -> SurfaceReflectance:
    """Return the reflectance of each vertex. lights: (3, 3), row k so that contribution k is row k · n.

    Reflectances and normals are solved for together, by Gauss–Newton with reweighted residuals; the spread of
    paint and its line are those of the last round (expectation maximisation, with the vertices' own blocks of
    the inverse).
    """
    seen_in = looks.seen.sum(axis=0)
    light_log = np.log(np.maximum(looks.contributions, np.float32(1e-6)))
    normals = _mean_normals(looks, lights)
    neighbours = _Neighbours.of(looks.edges, seen_in > 0)
    usual = neighbours.usual_step(normals) / _OF_MEDIAN
    count = int(looks.materials.max()) + 1
    lines, spreads = np.tile(_FIRST_LINE, (count, 1)), np.full(count, _FIRST_SPREAD)
    means: Points = np.zeros((count, 3))
    paint: Points = np.zeros(looks.logs.shape)
    heavy: FloatArray = np.ones(len(looks.logs))
    noise = _FIRST_NOISE
    for done in range(_ROUNDS):
        basis = _tangents(normals)
        if done:
            noise = max(_spread_of_residuals(looks, light_log, lights, normals, paint), _LEAST_NOISE)
        matrix, right = np.zeros((len(normals), 5, 5)), np.zeros((len(normals), 5))
        _add_frames(
            light_log, looks.seen, looks.turns, lights, looks.logs, normals, basis, paint, noise,
            _CAP if done else np.inf, 1.0 / (noise**2 * (1.0 + seen_in / _WORTH)), matrix, right,
        )  # fmt: skip
        precision = _precision(lines, spreads)
        own = precision[looks.materials] * heavy[:, None, None]
        matrix[:, :3, :3] += own
        right[:, :3] += np.einsum("nij,nj->ni", own, means[looks.materials])
        matrix[:, 3:, 3:] += _FIRM * np.eye(2)
        smooth = neighbours.weights(normals, usual)
        right[:, 3:] -= np.einsum("nij,ni->nj", basis, neighbours.pull(normals, smooth))
        found, blocks = neighbours.solved(matrix, right, basis, smooth, paint)
        paint = found[:, :3]
        turn = found[:, 3:]
        turn *= np.minimum(1.0, _LONGEST_STEP / np.maximum(np.linalg.norm(turn, axis=1), 1e-9))[:, None]
        normals = _unit(normals + np.einsum("nij,nj->ni", basis, turn))
        for m in range(count):
            of = looks.materials == m
            apart = paint[of] - means[m]
            squares = np.einsum("ni,ij,nj->n", apart, precision[m], apart)
            heavy[of] = (_TAIL + 3.0) / (_TAIL + squares)
            of = np.flatnonzero(of)[seen_in[of] > 0]
            if of.size:
                means[m], lines[m], spreads[m] = _spread_of_paint(paint[of], heavy[of], blocks[of], means[m])
    return SurfaceReflectance(logs=looks.logs + paint, lines=lines, spreads=spreads)


def _mean_normals(looks: SurfaceLooks, lights: Matrix3) -> Points:
    """(n, 3), in the template's pose: the mean over the frames of what the materials alone tell."""
    inverse, rho = np.linalg.inv(lights), np.exp(looks.logs)
    total = np.zeros(looks.logs.shape)
    for s, seen, turn in zip(looks.contributions, looks.seen, looks.turns, strict=True):
        found = _unit((s / rho) @ inverse.T)
        total += np.where(seen[:, None], np.einsum("nij,ni->nj", turn, found), 0.0)
    total[~looks.seen.any(axis=0)] = [0.0, 0.0, -1.0]
    return _unit(total)


def _tangents(normals: Points) -> FloatArray:
    """(n, 3, 2), two directions square to each normal and to each other."""
    first = _unit(np.cross(normals, [0.0, 1.0, 0.0]) + 1e-9)
    return np.stack([first, np.cross(normals, first)], axis=-1)


def _precision(lines: Points, spreads: FloatArray) -> FloatArray:
    """(m, 3, 3), the inverse covariance of paint."""
    along = lines[:, :, None] * lines[:, None, :]
    variance = spreads[:, None, None] ** 2
    across = np.eye(3) - along
    return np.asarray(
        along / (variance + _LEAST_VARIANCE) + across / (_ASIDE**2 * variance + _LEAST_VARIANCE)
    )


def _spread_of_paint(
    paint: Points, heavy: FloatArray, blocks: FloatArray, before: Vector3
) -> tuple[Vector3, Vector3, float]:
    """Return the mean of paint (n, 3), its main line and the spread along it.

    heavy: (n,), weights. blocks: (n, 3, 3), covariances that the data leave.
    """
    apart = paint - before
    covariance = (np.einsum("n,ni,nj->ij", heavy, apart, apart) + blocks.sum(axis=0)) / len(paint)
    values, vectors = np.linalg.eigh(covariance)
    mean = before + (heavy[:, None] * apart).sum(axis=0) / heavy.sum()
    line = vectors[:, 2] * np.sign(vectors[:, 2].sum() or 1.0)
    return mean, line, float(np.sqrt(values[2]))


def _spread_of_residuals(
    looks: SurfaceLooks, light_log: Single, lights: Matrix3, normals: Points, paint: Points
) -> float:
    """Robust standard deviation of log s, over frames and vertices."""
    found = []
    for log, seen, turn in zip(light_log, looks.seen, looks.turns, strict=True):
        arrives = np.einsum("nij,nj->ni", turn, normals) @ lights.T
        used = seen & (arrives > _LEAST_FACING).all(axis=1)
        found.append((log - looks.logs - paint)[used] - np.log(arrives[used]))
    residuals = np.abs(np.concatenate(found))
    return 1.4826 * float(np.median(residuals)) if residuals.size else _FIRST_NOISE


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


@dataclass(frozen=True, eq=False)
class _Neighbours:
    """Edges between vertices that were seen. ends: (e, 2). starts: (n + 1,) and others, at: of each vertex
    its neighbours and the edges to them.
    """

    ends: IntArray
    starts: IntArray
    others: IntArray
    at: IntArray

    @classmethod
    def of(cls, edges: IntArray, seen: Mask) -> _Neighbours:
        ends = edges[seen[edges].all(axis=1)]
        first, second = np.concatenate([ends, ends[:, ::-1]]).T
        order = np.argsort(first, kind="stable")
        starts = np.concatenate([[0], np.cumsum(np.bincount(first, minlength=len(seen)))])
        return cls(ends, starts, second[order], np.tile(np.arange(len(ends)), 2)[order])

    def usual_step(self, normals: Points) -> float:
        """Median length of the step of normals along an edge."""
        steps = np.linalg.norm(normals[self.ends[:, 0]] - normals[self.ends[:, 1]], axis=1)
        return max(float(np.median(steps)), 1e-4) if len(steps) else 1.0

    def weights(self, normals: Points, usual: float) -> FloatArray:
        """(e,), of the squared steps of normals; steep ones count less (Cauchy's)."""
        steps = ((normals[self.ends[:, 0]] - normals[self.ends[:, 1]]) ** 2).sum(axis=1) / usual**2
        return np.asarray(1.0 / usual**2 / (1.0 + steps / (2.0 * _STEEP**2)))

    def pull(self, values: Points, weights: FloatArray) -> Points:
        """(n, 3), half the gradient of the weighted squared steps of values (n, 3)."""
        out = np.zeros(values.shape)
        _pull(values, self.starts, self.others, self.at, weights, out)
        return out

    def solved(
        self, matrix: FloatArray, right: FloatArray, basis: FloatArray, weights: FloatArray, start: Points
    ) -> tuple[FloatArray, FloatArray]:
        """Solve for (n, 5), paint and turn of the normal, by conjugate gradients; and (n, 3, 3), what its own
        block of the inverse leaves of each vertex's paint.

        matrix: (n, 5, 5), right: (n, 5), of the vertices alone. start: (n, 3).
        """
        degrees = np.bincount(self.ends.ravel(), np.repeat(weights, 2), len(right))
        blocks = matrix.copy()
        blocks[:, 3:, 3:] += degrees[:, None, None] * np.eye(2)
        inverse = np.linalg.inv(blocks)
        x = np.concatenate([start, np.zeros((len(right), 2))], axis=1)
        product = np.empty_like(x)

        def multiplied(values: FloatArray) -> FloatArray:
            moved = np.einsum("nij,nj->ni", basis, values[:, 3:])
            np.einsum("nij,nj->ni", matrix, values, out=product)
            product[:, 3:] += np.einsum("nij,ni->nj", basis, self.pull(moved, weights))
            return product

        rest = right - multiplied(x)
        eased = np.einsum("nij,nj->ni", inverse, rest)
        way, size = eased.copy(), float((rest * eased).sum())
        enough = _ENOUGH * size
        for _ in range(_ITERATIONS):
            if size <= enough:
                break
            bent = multiplied(way)
            step = size / float((way * bent).sum())
            x += step * way
            rest -= step * bent
            eased = np.einsum("nij,nj->ni", inverse, rest)
            before, size = size, float((rest * eased).sum())
            way = eased + size / before * way
        return x, inverse[:, :3, :3]


@njit(cache=True, parallel=True)
def _pull(values: Any, starts: Any, others: Any, at: Any, weights: Any, out: Any) -> None:
    for i in prange(len(out)):
        for e in range(starts[i], starts[i + 1]):
            for k in range(3):
                out[i, k] += weights[at[e]] * (values[i, k] - values[others[e], k])


@njit(cache=True, parallel=True, error_model="numpy")
def _add_frames(
    light_log: Any, seen: Any, turns: Any, lights: Any, logs: Any, normals: Any, basis: Any, paint: Any,
    noise: float, cap: float, precision: Any, matrix: Any, right: Any,
) -> None:  # fmt: skip
    """Add to each vertex's normal equations what its frames tell. precision: (n,), weight of a frame."""
    for i in prange(len(normals)):
        n, arrives, rest = np.empty(3), np.empty(3), np.empty(3)
        rows = np.zeros((3, 5))
        for f in range(len(seen)):
            if not seen[f, i]:
                continue
            for a in range(3):
                n[a] = 0.0
                for b in range(3):
                    n[a] += turns[f, i, a, b] * normals[i, b]
            least, squares = np.inf, 0.0
            for k in range(3):
                arrives[k] = lights[k, 0] * n[0] + lights[k, 1] * n[1] + lights[k, 2] * n[2]
                least = min(least, arrives[k])
            if least < _LEAST_FACING:
                continue
            for k in range(3):
                rest[k] = light_log[f, i, k] - np.log(arrives[k]) - logs[i, k]
                squares += (rest[k] - paint[i, k]) ** 2
                rows[k, k] = 1.0
                for j in range(2):
                    rows[k, 3 + j] = 0.0
                    for a in range(3):
                        turned = 0.0
                        for b in range(3):
                            turned += turns[f, i, a, b] * basis[i, b, j]
                        rows[k, 3 + j] += lights[k, a] * turned / arrives[k]
            weight = precision[i] / (1.0 + squares / (3.0 * noise * noise * cap * cap)) ** 2
            for k in range(3):
                for a in range(5):
                    right[i, a] += weight * rows[k, a] * rest[k]
                    for b in range(5):
                        matrix[i, a, b] += weight * rows[k, a] * rows[k, b]
