"""How the surface is taken to move where nothing measures it: as one body, or as what is measured beside it.

Seen from afar, a body moves in the image by an affine map of its points (u, v, depth). That of the whole is
fitted robustly, and on it every piece that hangs together has its own.

By what a place moves otherwise is an affine map of its own, and a random field over the surface (kriging,
`matheron1963`): near what it is around, and zero in the mean. Its variance, and that of single links beside
it, are learnt from what is measured in the frame (empirical Bayes, `morris1983`). A head hardly departs from
one body, and so its neck is not moved as its jaw is. A sweater does, and so a flank that turns away moves as
what is measured beside it. Farther off the field falls back to the motion of the whole, and its error grows.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from vntoolkit.arrays import FloatArray, IntArray
from vntoolkit.geometry.camera import Camera
from vntoolkit.tracking.lattice import NODES_BY_PASS, TemplateLattice, lattice_on_template
from vntoolkit.tracking.lattice_system import LatticePattern, least_fill
from vntoolkit.tracking.template import TrackingTemplate

LINKS_ALIKE = NODES_BY_PASS  # a link and its neighbours err together: in a fit, so many tell one thing
_ROUNDS = 8  # of reweighting in the fit of one body
_RIDGE = np.array([0.1, 0.1, 0.1, 1e-3])  # in measured nodes, by unit coordinates: of the whole
_PIECE_RIDGE = np.array([0.3, 0.3, 3.0, 0.03])  # of a piece's own motion beside the whole's
_PIECE_LEAST = 4.0  # measured nodes that show a motion of their own
_LEAST_SCALE_PX = 1.0  # of the fit's residuals; closer fits are not worth more
_SIGMAS = 1.5  # of a normal distribution in the median of its size
_BLOCK_CELLS = 2  # side of the blocks of the field, whose reach is so long that they tell what nodes would
_REACH = 3.0  # blocks, over which the field falls back
_PER_SQUARE = np.log(1.0 + 32.0 * _REACH**2) / (4.0 * np.pi)  # variance on a grid, of unit precision
_USUAL, _FEW = 0.05, 20.0  # standard deviation of field and links before any are measured; counts as so many
_LEAST = 0.005  # the same, at least
_LOOSE = 3.0  # the field beside the usual one while its variance is learnt: it is hardly shrunk
_MEAN_BY_MEDIAN = 1.44  # of the squared length of a normal distribution in the plane
_HELD = 0.01  # how far what an occluding contour divides still holds together
_SAMPLES = 8


class FittedField(NamedTuple):
    """weight: (e,) of links in the fit. factor: of its matrix. errors: (e, 2, k) parts of the strains'.

    The squares of the parts add up. variance: of the field, by entry of its maps.
    """

    weight: npt.NDArray[np.float64]
    factor: Any
    errors: npt.NDArray[np.float64]
    variance: float


class BodyMotion:
    """Guesses the links of one template's lattice from those that are measured."""

    def __init__(
        self,
        lattice: TemplateLattice,
        template: TrackingTemplate,
        camera: Camera,
        links: IntArray,
        along: FloatArray,
    ) -> None:
        """Lay out the unknowns. links: (e, 2) nodes. along: (e, 2) from one to the other, pixels."""
        points = template.points_px(camera)
        points -= points.mean(axis=0)
        scale = max(float(points[:, :2].std()), 1e-9)
        counts = np.bincount(lattice.node_of_vertex, minlength=lattice.count)
        nodes = lattice.sums(points / scale) / counts[:, None]
        self._nodes = np.column_stack([nodes, np.ones(len(nodes))])
        adjacent = sp.csr_array(
            (np.ones(len(lattice.neighbours), dtype=np.int8), lattice.neighbours, lattice.starts),
            shape=(lattice.count, lattice.count),
        )
        self._pieces, self._piece = connected_components(adjacent, directed=False)
        self._links, self._square = links, np.sum(along**2, axis=1)
        self._towards = scale * (nodes[links[:, 1]] - nodes[links[:, 0]])
        blocks = lattice_on_template(template, _BLOCK_CELLS * lattice.cell_px)
        block = np.empty(lattice.count, dtype=np.int64)
        block[lattice.node_of_vertex] = blocks.node_of_vertex
        self._field = _AffineField(block[links], blocks.count)

    def guessed(
        self,
        displacements: FloatArray,
        weight: FloatArray,
        tested: FloatArray,
        slip: FloatArray,
        field: FittedField | None = None,
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], FittedField]:
        """Return (e, 2) by how much links change with the whole, (e, 2) beside it, and the field of that.

        displacements: (m, 2) of the nodes. weight: (m,) from 0 to 1, how far each is known. tested: (e,) the
        same of links. slip: (e,) from 0 to 1, how likely an occluding contour runs there. field: of an
        earlier step in the same frame: what is measured is nearly the same, and factoring takes the time.
        """
        a, b = self._links.T
        whole = self._whole(displacements, weight)
        by_whole = whole[b] - whole[a]
        left = displacements[b] - displacements[a] - by_whole
        length = np.sqrt(self._square)[:, None]
        x, y = self._towards / length, left / length
        if field is None:
            field = self._field.learnt(x, y, tested * (1.0 - slip), np.maximum(1.0 - slip, _HELD))
        return by_whole, length * self._field.strains(x, y, field), field

    def _whole(self, displacements: FloatArray, weight: FloatArray) -> npt.NDArray[np.float64]:
        """Return (m, 2) the motion of one body, and of its pieces."""
        motion: npt.NDArray[np.float64] = self._nodes @ _robust_fit(
            self._nodes, displacements, weight, _RIDGE
        )
        if self._pieces == 1:
            return motion
        seen = np.bincount(self._piece, weight, minlength=self._pieces)
        for piece in np.flatnonzero(seen >= _PIECE_LEAST):
            inside = self._piece == piece
            own = displacements[inside] - motion[inside]
            motion[inside] += self._nodes[inside] @ _robust_fit(
                self._nodes[inside], own, weight[inside], _PIECE_RIDGE
            )
        return motion


class _AffineField:
    """Fits affine maps C (m, 3, 2) of blocks to strains of links: y = x ½ (C_a + C_b) and noise.

    The precision of C is that of a Markov field on the blocks, (κ² + L) of the reach 1 / κ and their
    Laplacian L: neighbours are alike, and all are drawn to zero.
    """

    def __init__(self, ends: IntArray, count: int) -> None:
        """Lay out the unknowns. ends: (e, 2) blocks that a link starts and ends in, of so many."""
        self._ends, self._count, (first, second) = ends, count, np.sort(ends, axis=1).T
        self._crosses = first != second
        pairs, self._pair = np.unique((count * first + second)[self._crosses], return_inverse=True)
        a, b = self._beside = np.stack(np.divmod(pairs, count))
        i, (upper, lower) = np.arange(count), np.triu_indices(3)
        order = (3 * least_fill(self._beside.T, count)[:, None] + np.arange(3)).ravel()
        rows: list[IntArray] = [3 * i + p for p in np.r_[upper, 1, 2, 2]]
        columns: list[IntArray] = [3 * i + q for q in np.r_[lower, 0, 0, 1]]
        for p in range(3):
            rows += [3 * a + p, 3 * b + p]
            columns += [3 * b + p, 3 * a + p]
        self._pattern = LatticePattern(order, rows, columns)
        self._upper, self._lower = upper, lower
        each, ones = np.arange(len(pairs)), np.ones(len(pairs))
        self._differences = sp.csr_array(
            (np.r_[-ones, ones], (np.r_[a, b], np.r_[each, each])), shape=(count, len(pairs))
        )
        rng = np.random.default_rng(0)
        self._noise = rng.standard_normal((count, 3, _SAMPLES))
        self._between = rng.standard_normal((len(pairs), 3 * _SAMPLES))
        self._own = rng.standard_normal((count, 3, _SAMPLES))

    def learnt(self, x: FloatArray, y: FloatArray, tested: FloatArray, held: FloatArray) -> FittedField:
        """Learn how large the field and the noise of links are, and factor with that.

        x: (e, 3), y: (e, 2) strains. tested: (e,) how far each link is measured. held: (e,) how far it holds
        the maps of its ends together.
        """
        held = np.bincount(self._pair, held[self._crosses]) / np.bincount(self._pair)
        noise, field = _USUAL**2, (_LOOSE * _USUAL) ** 2
        weight = tested / (LINKS_ALIKE * noise)
        factor, _ = self._factored(x, weight, field, held)
        maps = self._maps(x, y, weight, factor)
        well, count = tested > 0.5, float(tested.sum())
        departs = np.sum((y - self._along(x, maps))[well] ** 2, axis=1)
        usual = _MEAN_BY_MEDIAN * float(np.median(departs)) if well.any() else 0.0
        noise = max(_LEAST**2, _with_usual(usual, count))
        known = self._at_blocks(0.5 * tested[:, None])[:, 0]
        square = 0.25 * np.square(maps[:, :2]).sum(axis=(1, 2))
        field = max(_LEAST**2, _with_usual(float(known @ square) / max(count, 1e-9), count))
        weight = tested / (LINKS_ALIKE * noise)
        factor, information = self._factored(x, weight, field, held)
        errors = np.sqrt(2.0 / _SAMPLES) * self._along(x, self._drawn(factor, information, field, held))
        errors = errors.reshape(len(x), 2, _SAMPLES // 2)
        return FittedField(weight=np.asarray(weight), factor=factor, errors=errors, variance=field)

    def strains(self, x: FloatArray, y: FloatArray, fitted: FittedField) -> npt.NDArray[np.float64]:
        """Return (e, 2) those of the field that fits y."""
        return self._along(x, self._maps(x, y, fitted.weight, fitted.factor))

    def _maps(self, x, y, weight, factor):  # type: ignore[no-untyped-def]
        right = self._at_blocks(0.5 * weight[:, None] * (x[:, :, None] * y[:, None, :]).reshape(len(x), 6))
        return self._pattern.solved(factor, right.reshape(-1, 2)).reshape(-1, 3, 2)

    def _factored(self, x, weight, field, held):  # type: ignore[no-untyped-def]
        """The factor, and (m, 6) what links tell of the maps, upper triangles."""
        information = self._at_blocks(0.5 * weight[:, None] * (x[:, self._upper] * x[:, self._lower]))
        precision = _PER_SQUARE / field
        stiffness = sum(np.bincount(end, held, self._count) for end in self._beside)
        degree = precision * (_REACH**-2 + stiffness)
        diagonal = [
            information[:, k] + (degree if p == q else 0.0)
            for k, (p, q) in enumerate(zip(self._upper, self._lower, strict=True))
        ]
        mirrored = [diagonal[k] for k in (1, 2, 4)]
        return self._pattern.factored([*diagonal, *mirrored, *[-precision * held] * 6]), information

    def _drawn(self, factor, information, field, held):  # type: ignore[no-untyped-def]
        """(m, 3, k) errors of the maps: what the solution makes of noise and fields as large as expected."""
        precision = _PER_SQUARE / field
        full = np.zeros((self._count, 3, 3))
        full[:, self._upper, self._lower] = full[:, self._lower, self._upper] = information
        right = np.linalg.cholesky(full + 1e-9 * np.eye(3)) @ self._noise
        right += np.sqrt(precision) / _REACH * self._own
        pulls = np.sqrt(precision * held)[:, None] * self._between
        right += (self._differences @ pulls).reshape(right.shape)
        return self._pattern.solved(factor, right.reshape(-1, _SAMPLES)).reshape(right.shape)

    def _along(self, x: FloatArray, maps: FloatArray) -> npt.NDArray[np.float64]:
        """(e, k) of maps (m, 3, k)."""
        a, b = self._ends.T
        return np.asarray(np.einsum("ei,eik->ek", x, 0.5 * (maps[a] + maps[b])))

    def _at_blocks(self, values: FloatArray) -> npt.NDArray[np.float64]:
        """(m, k) sums over the ends of links (e, k) in each block."""
        a, b = self._ends.T
        sums = [np.bincount(a, v, self._count) + np.bincount(b, v, self._count) for v in values.T]
        return np.stack(sums, axis=1)


def _with_usual(measured: float, count: float) -> float:
    """A variance that so many tell, beside the usual one."""
    return (count * measured + _FEW * _USUAL**2) / (count + _FEW)


def _robust_fit(
    points: FloatArray, values: FloatArray, weight: FloatArray, ridge: FloatArray
) -> npt.NDArray[np.float64]:
    """Return the (4, 2) map of points (m, 4) to values (m, 2) by reweighted least squares (Cauchy)."""
    trust = np.asarray(weight, dtype=np.float64)
    counted = weight > 0.3 * float(weight.max(initial=0.0))
    motion: npt.NDArray[np.floating] = np.zeros((points.shape[1], values.shape[1]))
    for _ in range(_ROUNDS):
        weighted = trust[:, None] * points
        motion = np.linalg.solve(points.T @ weighted + np.diag(ridge), weighted.T @ values)
        u, v = (values - points @ motion).T
        residual = np.sqrt(u * u + v * v)  # twenty times as fast as a norm over an axis of two
        usual = float(np.median(residual[counted])) if counted.any() else 0.0
        trust = weight / (1.0 + (residual / max(_LEAST_SCALE_PX, _SIGMAS * usual)) ** 2)
    return np.asarray(motion)
