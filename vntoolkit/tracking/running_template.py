"""The running template: relief and paint as the frames so far show them, which follow the light.

The template is one frame. A neck that comes out of the chin's shadow, or a flank that turns to the lamps,
soon looks otherwise than there, though it hardly differs from one frame to the next. So what frames show is
laid on the template where the fit puts it, in a running mean. What is fixed to the surface
stays in it. Noise, the steps of dark bytes and the edges of shadows move over the surface and average out: a
comparison with the frame before alone would follow them.

The mean may lie off its place, by errors of variance P. A frame registered by it, with information
J, has these errors and η of variance J⁻¹ besides. Mixed in at a rate α it leaves α η: P grows with α² J⁻¹,
and falls where the template tells again. Where J is so small that P would grow fast, α is less. The
template's errors and these come from the same frames. So they do not add: in every direction the one counts
that tells more.

The fit also obeys the prior of the edges. What was measured alone would have put a node elsewhere: that
`offset` is kept, else the prior would draw anew in each frame, and the surface would creep there. And a prior
errs in one frame as in the next: an elbow bends otherwise than a body does. By what edges were off it they
are expected to be off again, as far as other things than the prior tell of them. So a forearm that nothing
tells of for some frames stays beyond its elbow. Edges that are measured themselves need no such help. There
it would let the surface walk off with the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray
from vntoolkit.tracking.bands import Band
from vntoolkit.tracking.factors import Factor, factor, full_of, upper_of
from vntoolkit.tracking.slopes import gradients

_RATE = 0.1  # of a frame in the mean: noise of ten averages out, light changes over more
_PERSISTS = 0.7  # of a residual of the prior, from one frame to the next
_ALIKE = 3.0  # frames that follow one another err alike, by the same light: so many count as one
_LEAST_VARIANCE = 0.08 * np.eye(2)  # px²: a node's share of a window's is no less, by the windows' accuracy
_CHANNELS = (slice(0, 2), slice(2, 3))  # of relief and of paint
_LEAST_INFORMATION = 1e-8 * np.eye(2)  # 1/px², so that all can be inverted


class Comparison(NamedTuple):
    """What one frame's finest bands tell, in pixels of the template.

    bands: of relief and, where it is read, of paint. fine: by template and running template together.
    against: by the running template alone. more: what that adds to the template.
    """

    bands: tuple[Band, ...]
    fine: Factor
    against: Factor
    more: Factor


@dataclass(frozen=True, kw_only=True, eq=False)
class RunningTemplate:
    """The running mean of what frames show of one template's surface.

    features: (h, w, 2) of relief, or (h, w, 3) of relief and paint, on the template's raster. weights:
    (h, w, 1) or (h, w, 2) theirs. variance: (nodes, 2, 2) P in px² of the template. offset: (nodes, 2).
    residuals: (edges, 2) pixels of the frame, by which edges are expected to be off their prior.
    """

    features: npt.NDArray[np.float32]
    weights: npt.NDArray[np.float32]
    variance: npt.NDArray[np.float64]
    offset: npt.NDArray[np.float64]
    residuals: npt.NDArray[np.float64]

    def beyond(self, fine: Factor, against: Factor) -> Factor:
        """Return what this adds to what the template tells; against: of a comparison with this alone."""
        compared = full_of(against.information) + _LEAST_INFORMATION
        found = np.linalg.solve(compared, against.right_hand_side[..., None])[..., 0] + self.offset
        information = upper_of(np.linalg.inv(self.variance + np.linalg.inv(compared)))
        return what_exceeds(fine, factor(information, found))

    def with_frame(self, frame: Comparison) -> RunningTemplate:
        """Mix in a frame."""
        fine, more = frame.fine.information, frame.more.information
        whole = np.linalg.inv(full_of(fine) + _LEAST_INFORMATION)
        gain = whole @ full_of(more)  # share of the errors of this in those of the frame
        noise = gain @ np.linalg.inv(full_of(frame.against.information) + _LEAST_INFORMATION)
        noise = noise @ gain.mT + whole @ full_of(fine - more) @ whole
        grown = _largest(np.linalg.inv(self.variance + _LEAST_VARIANCE) @ noise)
        rate = np.minimum(_RATE, np.sqrt(_RATE / np.maximum(grown, 1e-12)))  # P grows by a tenth at most
        rate *= fine[:, [0, 2]].any(axis=1)
        each = rate[:, None, None]
        kept = (1.0 - each) * np.eye(2) + each * gain
        offset = np.einsum("nij,nj->ni", whole, frame.fine.right_hand_side)
        features, weights = self.features.copy(), self.weights.copy()
        for k, band in enumerate(frame.bands):
            share = np.where(band.node >= 0, rate[band.node], 0.0)
            own, new = (1.0 - share) * weights[..., k], share * band.weight
            whole = np.maximum(own + new, 1e-30)[..., None]
            mean = (own[..., None] * features[..., _CHANNELS[k]] + new[..., None] * band.features) / whole
            known = (own + new > 0)[..., None]
            features[..., _CHANNELS[k]] = np.where(known, mean, features[..., _CHANNELS[k]])
            weights[..., k] = own + new
        return replace(
            self,
            features=features,
            weights=weights,
            variance=kept @ self.variance @ kept.mT + _ALIKE * each**2 * noise,
            offset=self.offset + rate[:, None] * (offset - self.offset),
        )

    def with_residuals(
        self, residuals: FloatArray, known: FloatArray, measured: FloatArray
    ) -> RunningTemplate:
        """Expect edges to be off their prior as now, (edges, 2).

        known: (edges,) from 0 to 1, how far that is. measured: (edges,) how far edges are.
        """
        return replace(self, residuals=_PERSISTS * (known * (1.0 - measured))[:, None] * residuals)

    def bands(self, node: npt.NDArray[np.int32]) -> tuple[Band, ...]:
        """Return the same as bands to compare with; node: (h, w) of the raster."""
        nowhere = np.zeros(node.shape, dtype=np.bool_)
        out = []
        for k in range(self.weights.shape[2]):
            features = np.ascontiguousarray(self.features[..., _CHANNELS[k]])
            slopes, weight = gradients(features, np.ascontiguousarray(self.weights[..., k]), np.float32(0.5))
            out.append(Band(node=node, features=features, gradients=slopes, weight=weight, beside=nowhere))
        return tuple(out)


def what_exceeds(first: Factor, other: Factor) -> Factor:
    """Return by how much the other exceeds the first, in every direction, at the other's displacement."""
    # More are the parts along generalised eigenvectors of the two, of which the eigenvalue is above 1.
    (a, b, c), (d, e, f) = (
        upper_of(full_of(each.information) + _LEAST_INFORMATION).T for each in (first, other)
    )
    size, other_size = a * c - b * b, d * f - e * e
    half = 0.5 * (c * d - 2.0 * b * e + a * f) / size
    greater = half + np.sqrt(np.maximum(half**2 - other_size / size, 0.0))
    less = other_size / (size * greater)
    share = np.where(less < 1.0, np.maximum(greater - 1.0, 0.0) / np.maximum(greater - less, 1e-12), 1.0)
    more = np.stack([share * (x - np.minimum(less, 1.0) * y) for x, y in ((d, a), (e, b), (f, c))], axis=1)
    u, v = other.right_hand_side.T
    return factor(more, np.stack([f * u - e * v, d * v - e * u], axis=1) / other_size[:, None])


def running_template(bands: tuple[Band, ...], nodes: int, edges: int) -> RunningTemplate:
    """Return that of the template's frame alone, in which everything is in its place."""
    return RunningTemplate(
        features=np.concatenate([band.features for band in bands], axis=-1),
        weights=np.stack([band.weight for band in bands], axis=-1),
        variance=np.zeros((nodes, 2, 2)),
        offset=np.zeros((nodes, 2)),
        residuals=np.zeros((edges, 2)),
    )


def _largest(matrix: FloatArray) -> npt.NDArray[np.float64]:
    """Largest eigenvalue (m,) of products (m, 2, 2) of two positive definite matrices."""
    half = 0.5 * np.trace(matrix, axis1=1, axis2=2)
    return np.asarray(half + np.sqrt(np.maximum(half**2 - np.linalg.det(matrix), 0.0)))
