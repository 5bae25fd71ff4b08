"""Relief and paint as the frames so far show them: a second template, which follows the light.

The template is one frame. A neck that comes out of the chin's shadow, or a flank that turns to the lamps,
soon looks otherwise than there, though it hardly differs from one frame to the next. So what frames show is
laid on the template where the fit puts it, and remembered as a running mean. What is fixed to the surface
stays in it. Noise, the steps of dark bytes and the edges of shadows move over the surface and average out: a
comparison with the frame before alone would follow them.

What is remembered may lie off its place, by errors of variance P. A frame registered by it, with information
J, has these errors and η of variance J⁻¹ besides. Mixed in at a rate α it leaves α η: P grows with α² J⁻¹,
and falls where the template tells again. Where J is so small that P would grow fast, α is less. The
template's errors and these come from the same frames. So they do not add: in every direction the one counts
that tells more.

The fit also obeys lengths, which only guess. What was measured alone would have put a node elsewhere: that
`offset` is kept, else a guess would pull anew in each frame, and the surface would creep there. And a guess
errs in one frame as in the next: an elbow bends otherwise than a body does. By what links departed from it
they are expected to depart again, as far as other things told of that: by the share that these take off the
guess's variance. So a forearm that nothing tells of for some frames stays beyond its elbow. Links that are
measured themselves need no such help. There it would let the surface walk off with the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Points2
from vntoolkit.native import njit
from vntoolkit.tracking.bands import Band
from vntoolkit.tracking.guess_errors import GuessErrors
from vntoolkit.tracking.slopes import gradients

_RATE = 0.1  # of a frame in the mean: noise of ten averages out, light changes over more
_PERSISTS = 0.7  # of a departure from a guess, from one frame to the next
_ALIKE = 3.0  # frames that follow one another err alike, by the same light: so many count as one
_LEAST_VARIANCE = 0.08 * np.eye(2)  # px²: a node's share of a window's is no less, by the windows' accuracy
_CHANNELS = (slice(0, 2), slice(2, 3))  # of relief and of paint
_LEAST_INFORMATION = 1e-8 * np.eye(2)  # 1/px², so that all can be inverted


class Finest(NamedTuple):
    """What one frame's finest bands tell, in 1/px² of the template.

    bands: of relief and, where it is read, of paint. information: (nodes, 3) and pull: (nodes, 2) I d, of
    template and memory together. against: (nodes, 3) J of the comparison with the memory. more: (nodes, 3)
    what the memory adds.
    """

    bands: tuple[Band, ...]
    information: npt.NDArray[np.float64]
    pull: npt.NDArray[np.float64]
    against: npt.NDArray[np.float64]
    more: npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Remembered:
    """What is remembered of one template's surface.

    features: (h, w, 2) of relief, or (h, w, 3) of relief and paint, on the template's raster. weights:
    (h, w, 1) or (h, w, 2) theirs. variance: (nodes, 2, 2) P in px² of the template. offset: (nodes, 2).
    nodes_px: (nodes, 2) where the nodes were when last seen. departures: (links, 2) pixels of the frame, by
    which links are expected to be off their guesses. body_errors, length_errors: (links,) of those guesses,
    as in `GuessErrors`.
    """

    features: npt.NDArray[np.float32]
    weights: npt.NDArray[np.float32]
    variance: npt.NDArray[np.float64]
    offset: npt.NDArray[np.float64]
    nodes_px: npt.NDArray[np.float64]
    departures: npt.NDArray[np.float64]
    body_errors: npt.NDArray[np.float64]
    length_errors: npt.NDArray[np.float64]

    @property
    def guess_errors(self) -> GuessErrors:
        """How far guesses of links err."""
        return GuessErrors(body=self.body_errors, lengths=self.length_errors)

    def beyond(
        self, fine: FloatArray, against: FloatArray, pull: FloatArray
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return information (nodes, 3) and pull (nodes, 2) that this adds to what the template tells.

        fine: (nodes, 3) of the template. against, pull: (nodes, 3), (nodes, 2) J and J d of a comparison.
        """
        compared = _full(against) + _LEAST_INFORMATION
        found = np.linalg.solve(compared, pull[..., None])[..., 0] + self.offset
        information = np.linalg.inv(self.variance + np.linalg.inv(compared))
        return what_exceeds(fine, _upper(information), np.einsum("nij,nj->ni", information, found))

    def with_frame(self, frame: Finest, nodes_px: Points2) -> Remembered:
        """Mix in a frame, where it was measured; nodes_px: (nodes, 2) there."""
        whole = np.linalg.inv(_full(frame.information) + _LEAST_INFORMATION)
        gain = whole @ _full(frame.more)  # share of the errors of what is remembered in those of the frame
        noise = gain @ np.linalg.inv(_full(frame.against) + _LEAST_INFORMATION) @ _transposed(gain)
        noise += whole @ _full(frame.information - frame.more) @ whole
        grown = _largest(np.linalg.inv(self.variance + _LEAST_VARIANCE) @ noise)
        rate = np.minimum(_RATE, np.sqrt(_RATE / np.maximum(grown, 1e-12)))  # P grows by a tenth at most
        rate *= frame.information[:, [0, 2]].any(axis=1)
        each = rate[:, None, None]
        kept = (1.0 - each) * np.eye(2) + each * gain
        offset = np.einsum("nij,nj->ni", whole, frame.pull)
        features, weights = self.features.copy(), self.weights.copy()
        for k, band in enumerate(frame.bands):
            parts = features[..., _CHANNELS[k]], weights[..., k]
            _mix_in(band.node, rate, *parts, band.features, band.weight)
        return replace(
            self,
            features=features,
            weights=weights,
            variance=kept @ self.variance @ _transposed(kept) + _ALIKE * each**2 * noise,
            offset=self.offset + rate[:, None] * (offset - self.offset),
            nodes_px=np.asarray(nodes_px),
        )

    def with_guesses(
        self, errors: GuessErrors, departures: FloatArray, told: FloatArray, tested: FloatArray
    ) -> Remembered:
        """Expect guesses of links to err by so much, and links to depart from them as now, (links, 2).

        told: (links,) from 0 to 1, how far that is known. tested: (links,) how far links are measured.
        """
        return replace(
            self,
            departures=_PERSISTS * (told * (1.0 - tested))[:, None] * departures,
            body_errors=errors.body,
            length_errors=errors.lengths,
        )

    def bands(self, node: npt.NDArray[np.int32]) -> tuple[Band, ...]:
        """Return the same as bands to compare with; node: (h, w) of the raster."""
        nowhere = np.zeros(node.shape, dtype=np.bool_)
        out = []
        for k in range(self.weights.shape[2]):
            features = np.ascontiguousarray(self.features[..., _CHANNELS[k]])
            slopes, weight = gradients(features, np.ascontiguousarray(self.weights[..., k]), np.float32(0.5))
            out.append(Band(node=node, features=features, gradients=slopes, weight=weight, beside=nowhere))
        return tuple(out)


def what_exceeds(
    information: FloatArray, other: FloatArray, pull: FloatArray
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return by how much the other information (m, 3) exceeds, in every direction, and its pull (m, 2).

    pull: (m, 2) all of the other's.
    """
    # More are the parts along generalised eigenvectors of the two, of which the eigenvalue is above 1.
    (a, b, c), (d, e, f) = (_upper(_full(each) + _LEAST_INFORMATION).T for each in (information, other))
    size, other_size = a * c - b * b, d * f - e * e
    half = 0.5 * (c * d - 2.0 * b * e + a * f) / size
    greater = half + np.sqrt(np.maximum(half**2 - other_size / size, 0.0))
    less = other_size / (size * greater)
    share = np.where(less < 1.0, np.maximum(greater - 1.0, 0.0) / np.maximum(greater - less, 1e-12), 1.0)
    more = np.stack([share * (x - np.minimum(less, 1.0) * y) for x, y in ((d, a), (e, b), (f, c))], axis=1)
    found = np.stack([f * pull[:, 0] - e * pull[:, 1], d * pull[:, 1] - e * pull[:, 0]], axis=1)
    return more, np.einsum("nij,nj->ni", _full(more), found / other_size[:, None])


def remembered_template(bands: tuple[Band, ...], nodes_px: Points2, errors: GuessErrors) -> Remembered:
    """Return the memory of the template frame alone, in which everything is in its place.

    errors: of guesses of the lattice's links, before any frame.
    """
    count = len(nodes_px)
    return Remembered(
        features=np.concatenate([band.features for band in bands], axis=-1),
        weights=np.stack([band.weight for band in bands], axis=-1),
        variance=np.zeros((count, 2, 2)),
        offset=np.zeros((count, 2)),
        nodes_px=np.asarray(nodes_px),
        departures=np.zeros((len(errors.body), 2)),
        body_errors=errors.body,
        length_errors=errors.lengths,
    )


def _full(information: FloatArray) -> npt.NDArray[np.float64]:
    """(m, 2, 2) of (m, 3)."""
    return np.asarray(information[:, [0, 1, 1, 2]].reshape(-1, 2, 2))


def _upper(matrix: FloatArray) -> npt.NDArray[np.float64]:
    """(m, 3) of symmetric (m, 2, 2)."""
    return np.stack([matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]], axis=1)


def _transposed(matrix: FloatArray) -> npt.NDArray[np.float64]:
    return np.swapaxes(matrix, 1, 2)


def _largest(matrix: FloatArray) -> npt.NDArray[np.float64]:
    """Largest eigenvalue (m,) of products (m, 2, 2) of two positive definite matrices."""
    half = 0.5 * np.trace(matrix, axis1=1, axis2=2)
    return np.asarray(half + np.sqrt(np.maximum(half**2 - np.linalg.det(matrix), 0.0)))


@njit(cache=True)
def _mix_in(node, rate, features, weight, new_features, new_weight):  # type: ignore[no-untyped-def]
    """Overwrite weighted means (h, w, k) and weights (h, w): new ones come in at each node's rate."""
    h, w = node.shape
    for v in range(h):
        for u in range(w):
            j = node[v, u]
            if j < 0 or rate[j] <= 0:
                continue
            own, new = (1.0 - rate[j]) * weight[v, u], rate[j] * new_weight[v, u]
            weight[v, u] = own + new
            if own + new > 0:
                for c in range(features.shape[2]):
                    features[v, u, c] = (own * features[v, u, c] + new * new_features[v, u, c]) / (own + new)
