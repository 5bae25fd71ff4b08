"""Drift correction: the template itself is registered to the current frame.

The frame is warped into template coordinates by the correspondence so far, its slopes are pulled back by the
transposed Jacobian (z(u(x)) has gradient Jᵀ ∇z: normals turn as the surface turns in the image), both are
high-passed (so that shape may bend, and only what sits on the surface is compared), and one step of Lucas and
Kanade against the template moves the correspondence. As the template never changes, errors do not add up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Points2
from vntoolkit.native import njit
from vntoolkit.tracking.jacobians import LocalJacobians
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.lattice_solve import solve_on_lattice
from vntoolkit.tracking.options import DriftOptions
from vntoolkit.tracking.template import TrackingTemplate

# Of lattice smoothing. Under narrower windows, or a softer lattice, errors of a cell's size feed themselves.
_WINDOW_PASSES = 2
_LARGEST_STEP_PX = 3.0
_ROBUST_SIGMAS = 3.0
_USUAL = 1.5  # times the frame's median squared residual passes for noise

Pyramid = list[npt.NDArray[np.float32]]


@dataclass(frozen=True, kw_only=True, eq=False)
class TemplateLevel:
    """What the template looks like at one level.

    features: (n, 2) high-passed slopes. gradients: (n, 4) their derivatives by u, then by v, per pixel of
    full resolution. weight: (n,).
    """

    scale: float
    features: npt.NDArray[np.float64]
    gradients: npt.NDArray[np.float64]
    weight: npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Registration:
    """positions_px: (n, 2), corrected. confidence: (n,) from 0 to 1, how well the frame matches there."""

    positions_px: Points2
    confidence: npt.NDArray[np.float64]


class TemplateRegistration:
    """Registers one template to any frame."""

    def __init__(
        self, template: TrackingTemplate, lattice: TemplateLattice, pyramid: Pyramid, options: DriftOptions
    ) -> None:
        """Prepare the template's features; pyramid: slopes of the template frame."""
        self._lattice, self._options = lattice, options
        self._pixels = template.positions_px
        self._jacobians = LocalJacobians(lattice, self._pixels)
        self._levels = [self._template_level(pyramid[k], 2.0**k) for k in range(options.levels + 1)]

    def register(self, positions_px: Points2, pyramid: Pyramid) -> Registration:
        """Correct positions (n, 2) by the slopes of the frame they lie in, coarse to fine."""
        positions: Points2 = np.array(positions_px, dtype=np.float64)
        confidence = np.ones(len(positions))
        for number in range(self._options.levels, -1, -1):
            iterations = self._options.iterations if number == 0 else 1
            for _ in range(iterations):
                positions, confidence = self._step(positions, pyramid[number], self._levels[number])
        return Registration(positions_px=positions, confidence=confidence)

    def jacobians(self, positions_px: Points2) -> npt.NDArray[np.float64]:
        """Return (nodes, 4) ∂u/∂x, ∂u/∂y, ∂v/∂x, ∂v/∂y of positions (n, 2) by the template's pixels."""
        return self._jacobians.of(positions_px)

    def _step(
        self, positions: Points2, slopes: npt.NDArray[np.float32], level: TemplateLevel
    ) -> tuple[Points2, npt.NDArray[np.float64]]:
        lattice = self._lattice
        jacobian = lattice.at_vertices(self._jacobians.of(positions))
        pulled = _pulled_back(slopes, positions, jacobian, level.scale)
        features = self._high_passed(pulled)
        sigma = _ROBUST_SIGMAS * self._options.noise_slope
        terms = _accumulate(
            lattice.node_of_vertex, lattice.count, features, pulled[:, 2], level.features, level.gradients,
            level.weight, sigma,
        )  # fmt: skip
        terms = lattice.smoothed(terms, _WINDOW_PASSES)
        match = self._match(terms)
        step = solve_on_lattice(lattice, terms[:, :5] * match[:, None] ** 2, self._options.stiffness)
        length = np.linalg.norm(step, axis=1, keepdims=True)
        step *= np.minimum(1.0, level.scale * _LARGEST_STEP_PX / np.maximum(length, 1e-12))
        at_vertices = lattice.at_vertices(np.column_stack([step, match]))
        moved = positions + _transported(jacobian, at_vertices)
        return moved, at_vertices[:, 2] * (pulled[:, 2] > 0)

    def _match(self, terms: FloatArray) -> npt.NDArray[np.float64]:
        """Confidence of a node: 1 where the residual is that of noise, 0 where another surface is seen."""
        weight = np.maximum(terms[:, 7], 1e-12)
        residual, energy = terms[:, 5] / weight, terms[:, 6] / weight
        seen = terms[:, 7] > 0
        usual = float(np.median(residual[seen])) if seen.any() else 0.0  # an occluder hides less than half
        noise = max(self._options.noise_slope**2, _USUAL * usual)
        tolerance = 2 * noise + 0.3 * energy
        visible = np.minimum(1.0, 2 * terms[:, 7] / np.maximum(terms[:, 8], 1e-12))
        return np.asarray(visible / (1.0 + (residual / tolerance) ** 2))

    def _template_level(self, slopes: npt.NDArray[np.float32], scale: float) -> TemplateLevel:
        identity = np.tile([1.0, 0.0, 0.0, 1.0], (len(self._pixels), 1))
        here = _pulled_back(slopes, self._pixels, identity, scale)
        sides = [
            _pulled_back(slopes, self._pixels + scale * np.array(offset), identity, scale)
            for offset in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
        ]
        weight = np.minimum.reduce([here[:, 2], *(side[:, 2] for side in sides)])
        along = [
            self._high_passed(np.column_stack([(ahead - behind)[:, :2] / (2 * scale), weight]))
            for ahead, behind in ((sides[0], sides[1]), (sides[2], sides[3]))
        ]
        return TemplateLevel(
            scale=scale, features=self._high_passed(here), gradients=np.column_stack(along), weight=weight
        )

    def _high_passed(self, weighted: FloatArray) -> npt.NDArray[np.float64]:
        """Subtract the cells' weighted means from weighted (n, 3), two values and their weight.

        What is left are waves shorter than about two cells. Longer ones are folds, which travel over the
        cloth and would drag the template along.
        """
        lattice = self._lattice
        sums = _weighted_sums(lattice.node_of_vertex, weighted, lattice.count)
        means = sums[:, :2] / np.maximum(sums[:, 2:], 1e-9)
        return np.asarray(weighted[:, :2] - lattice.at_vertices(means))


@njit(cache=True)
def _weighted_sums(node, weighted, count):  # type: ignore[no-untyped-def]
    out = np.zeros((count, 3))
    for i in range(len(node)):
        w = weighted[i, 2]
        out[node[i], 0] += w * weighted[i, 0]
        out[node[i], 1] += w * weighted[i, 1]
        out[node[i], 2] += w
    return out


@njit(cache=True)
def _pulled_back(slopes, positions, jacobian, scale):  # type: ignore[no-untyped-def]
    """(n, 3): Jᵀ ∇z at the positions, and the weight there (0 where under a tenth is surface).

    Within half a pixel beyond the outermost centres, which is still the picture, the outermost pixels count.
    """
    h, w = slopes.shape[:2]
    n = positions.shape[0]
    out = np.zeros((n, 3))
    for i in range(n):
        x, y = positions[i, 0] / scale, positions[i, 1] / scale
        if not (x > -0.5 and y > -0.5 and x < w - 0.5 and y < h - 0.5):
            continue
        x, y = min(max(x, 0.0), w - 1.0), min(max(y, 0.0), h - 1.0)
        u, v = min(int(x), w - 2), min(int(y), h - 2)
        a, b = x - u, y - v
        p = q = weight = 0.0
        for dv in range(2):
            for du in range(2):
                share = (a if du else 1 - a) * (b if dv else 1 - b)
                p += share * slopes[v + dv, u + du, 0]
                q += share * slopes[v + dv, u + du, 1]
                weight += share * slopes[v + dv, u + du, 2]
        if weight > 0.1:
            p, q = p / weight, q / weight
            out[i, 0] = jacobian[i, 0] * p + jacobian[i, 2] * q
            out[i, 1] = jacobian[i, 1] * p + jacobian[i, 3] * q
            out[i, 2] = weight
    return out


@njit(cache=True)
def _accumulate(node, count, seen, seen_weight, features, gradients, weight, sigma):  # type: ignore[no-untyped-def]
    """Normal equations (3 + 2), residual, energy, weight and possible weight, summed over each node."""
    out = np.zeros((count, 9))
    for i in range(len(node)):
        j = node[i]
        out[j, 8] += weight[i]
        w = weight[i] * seen_weight[i]
        if w <= 0:
            continue
        r0, r1 = seen[i, 0] - features[i, 0], seen[i, 1] - features[i, 1]
        square = r0 * r0 + r1 * r1
        energy = features[i, 0] ** 2 + features[i, 1] ** 2
        out[j, 5] += w * square
        out[j, 6] += w * energy
        out[j, 7] += w
        w /= 1.0 + square / (sigma * sigma + energy)
        pu, qu, pv, qv = gradients[i, 0], gradients[i, 1], gradients[i, 2], gradients[i, 3]
        out[j, 0] += w * (pu * pu + qu * qu)
        out[j, 1] += w * (pu * pv + qu * qv)
        out[j, 2] += w * (pv * pv + qv * qv)
        out[j, 3] -= w * (pu * r0 + qu * r1)
        out[j, 4] -= w * (pv * r0 + qv * r1)
    return out


@njit(cache=True)
def _transported(jacobian, step):  # type: ignore[no-untyped-def]
    """A step in template pixels becomes one in the frame: J d."""
    out = np.empty((jacobian.shape[0], 2))
    for i in range(jacobian.shape[0]):
        out[i, 0] = jacobian[i, 0] * step[i, 0] + jacobian[i, 1] * step[i, 1]
        out[i, 1] = jacobian[i, 2] * step[i, 0] + jacobian[i, 3] * step[i, 1]
    return out
