"""How far apart neighbouring nodes of the template must lie in a frame, and how surely.

Two guesses, each by how well it does where the nodes around are measured:

- Lengths on the surface stay. A step dx on the template is dxᵀ G_t dx long, squared, and dxᵀ Jᵀ G_c J dx in
  the frame, G the metrics that the normals give, so Jᵀ G_c J = G_t. That leaves a turn R open, which is
  that of the surroundings: J = G_c^(−1/2) R G_t^(1/2). At grazing angles, and where the surface is hidden,
  it says little. What the whole stretches by is left open too: `uniform_strains`.
- The whole moves as one body, and a place as what is measured beside it (`body_motion`). It is right for an
  ear behind the cheek's rim.

Lengths are read where a node is believed to be, from what lies between the two nodes (`surface_metric`).
Where another part lies in front (`covering`), or the node has slipped, they are another surface's. So they
are right with some probability only: the less, the worse they agree with the body, by what either may err. A
node that matches badly and is not covered has slipped, mostly by little: its lengths count.

One variance does not do for all places: by that of a torso that hardly bends, the flank beside a raised arm
is foretold too surely. So what is guessed beside the whole varies more where the guesses around are large, as
in a Student-t process (`shah2014`). It may also be wrong altogether, by as much as it departs from the whole,
within two standard deviations: where a fold begins, what is measured beside it foretells the contrary. More
is then left to lengths. How far either guess errs at a place is also learnt from the frames before
(`guess_errors`).

Where the two differ, which of them holds is a doubt that all links share. So is whether a place moves beside
the whole as it seems to, the more, the farther that is beyond what the body departs from the whole elsewhere:
what slips, and draws its surroundings along, looks like that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Points2
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import HALF_WEIGHT_DEG, DepthMap
from vntoolkit.tracking.body_motion import BodyMotion, FittedField
from vntoolkit.tracking.guess_errors import Guess, GuessErrors, usual_errors
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.slopes import Slopes, sample_depth
from vntoolkit.tracking.surface_metric import MeanMetric, SurfaceMetric
from vntoolkit.tracking.template import TrackingTemplate

STRAIN_PASSES = 4  # of lattice smoothing: strain that is not foreseen goes on over some cells
_CONTOUR_STRAIN = 1.0  # across an occluding contour: how much is hidden there is not known
_CONTOUR_STEEPNESS = 3.0  # squared slope, 60°, by which a surface recedes, and then no longer: a contour
_STRAIN = 0.07  # standard deviation of stretch, where none is measured: cloth has 0.03 to 0.1, skin up to 0.3
_PRIOR_LINKS = 0.2  # measured links nearby that the two count for
_NEAR_PASSES = 8  # of lattice smoothing: how far around a guess's success counts
_NORMAL_ERROR = 0.05  # radians: shading that departs from the model turns normals by 3°
_INDEPENDENT = 3.0  # errors by weight in a cell: light that is not foreseen turns most of its normals alike
_MISTAKEN = 0.05  # share of lengths that are another surface's where nothing is known to be hidden
_SLOW_DEGREE = 2  # of the polynomials in place that vary slowly
_TURN = 0.1  # standard deviation of a turn in one step of the fit, radians
_TURN_PASSES = 2  # of lattice smoothing: the turn in the image is that of the surroundings
_LEAST_WEIGHT = 1e-3  # mean of the slopes' in a cell that is divided by
# Nine in ten errors in the plane are within √(ln 10) = 1.5 of a root mean square that is known, and within 3
# of one that a single departure tells (F with 2 and 2 degrees of freedom).
_SINGLE = 2.0
_MOST_SIGMAS = 2.0  # of what places depart from the whole by: no guess is doubted by more
_LEAST_RELIABLE = 1e-4  # of a node that is not measured, in the fit of one body


class LinkGuess(NamedTuple):
    """steps: (links, 2). variance: (links,) by direction, px². field: of the body, for the frame's next step.

    torn: (links,) the share of the variance that an occluding contour between the two adds. doubt: (links, 2,
    k) deviations of all steps together: by which of the guesses holds, and by what is not known of the body.
    away_px: (links,) by how much farther from the camera the surface is at the second node. lengths, body:
    the two that it is made of.
    """

    steps: npt.NDArray[np.float64]
    variance: npt.NDArray[np.float64]
    torn: npt.NDArray[np.float64]
    doubt: npt.NDArray[np.float64]
    field: FittedField
    away_px: npt.NDArray[np.float64]
    lengths: Guess
    body: Guess


class LinkLengths:
    """Guesses the links of one template's lattice in any frame."""

    def __init__(
        self, lattice: TemplateLattice, template: TrackingTemplate, camera: Camera, slopes: Slopes
    ) -> None:
        """Measure the template; slopes: of its frame."""
        self._lattice, self._camera = lattice, camera
        self._counts = np.bincount(lattice.node_of_vertex, minlength=lattice.count)
        self.centres = lattice.sums(template.positions_px) / self._counts[:, None]
        rows = np.repeat(np.arange(lattice.count), np.diff(lattice.starts))
        once = rows < lattice.neighbours
        self.links = np.stack([rows[once], lattice.neighbours[once]], axis=1).astype(np.int64)
        self.along = self.centres[self.links[:, 1]] - self.centres[self.links[:, 0]]
        self._square = np.sum(self.along**2, axis=1)
        self.middles = self.centres[self.links].mean(axis=1)
        self._depth = template.vertices_in_camera[:, 2]
        self._metric = SurfaceMetric(
            lattice, camera, template.positions_px, self.centres, self.links, self.along
        )
        nodes, self._template_metric = self._metric.read(
            slopes, template.positions_px, np.ones(len(template.pixels))
        )
        self._contour = self._at_contours(nodes, self.along)
        self._root = self._template_metric.root
        self._inverse_root = np.linalg.inv(self._root)
        self._motion = BodyMotion(lattice, template, camera, self.links, self.along)

    def nodes(self, positions_px: Points2) -> npt.NDArray[np.float64]:
        """Return (nodes, 2) the means of positions (n, 2)."""
        return self._lattice.sums(positions_px) / self._counts[:, None]

    def steps(self, positions_px: Points2) -> npt.NDArray[np.float64]:
        """Return (links, 2) the steps from node to node of positions (n, 2)."""
        nodes = self.nodes(positions_px)
        return np.asarray(nodes[self.links[:, 1]] - nodes[self.links[:, 0]])

    def tested(self, hidden: FloatArray, measured: FloatArray) -> npt.NDArray[np.float64]:
        """Return (links,) how far each is measured, by its ends: (nodes,) share hidden, how far known."""
        known = (1.0 - hidden) * measured
        return np.minimum(*known[self.links.T])

    def guessed(
        self,
        positions_px: Points2,
        around: FloatArray,
        slopes: Slopes,
        depth_map: DepthMap,
        hidden: FloatArray,
        behind: FloatArray,
        measured: FloatArray,
        errors: GuessErrors,
        field: FittedField | None = None,
    ) -> LinkGuess:
        """Return the steps from node to node.

        around: (nodes, 4) Jacobians of positions (n, 2). hidden: (nodes,) share that is not seen there.
        behind: (nodes,) share of it that lies behind another part. measured: (nodes,) from 0 to 1, how far a
        node's place is known. errors: of guesses around each link, as `around` returns them. field: of an
        earlier step in the same frame.
        """
        a, b = self.links.T
        by_lengths, of_normals, contour, away_px = self._by_lengths(positions_px, around, slopes, depth_map)
        in_sight = 1.0 - np.maximum(behind[a], behind[b])
        now = self.nodes(positions_px)
        reliable = (1.0 - hidden) * measured + _LEAST_RELIABLE
        tested = self.tested(hidden, measured) + _LEAST_RELIABLE
        likely = np.minimum((contour + self._contour) / _CONTOUR_STEEPNESS, 1.0)
        whole, own, field = self._motion.guessed(now - self.centres, reliable, tested, likely, field)
        by_body = self.along + whole + own
        steps = now[b] - now[a]
        square = self._square
        of_lengths = self._near_mean(_strain(steps - by_lengths, square), tested, _STRAIN**2)
        given = of_lengths + of_normals
        of_lengths = errors.lengths * given
        departs = np.sum(own**2, axis=1) / square
        usual = 2.0 * field.variance
        varies = 1.0 + self._near_mean(departs, np.ones_like(departs), 0.0) / usual
        of_field = np.sqrt(varies)[:, None, None] * field.errors
        of_body = self._near_mean(_strain(steps - by_body, square), tested, errors.body)
        of_body += np.square(of_field).sum(axis=(1, 2))
        of_body += (1.0 - tested) * _SINGLE**2 * np.minimum(departs, _MOST_SIGMAS**2 * field.variance)
        apart = np.sum((by_lengths - by_body) ** 2, axis=1) / square
        right = share_right((1.0 - _MISTAKEN) * in_sight, apart, of_lengths + of_body)
        share = right * of_body / (of_lengths + of_body)
        mean = share[:, None] * by_lengths + (1.0 - share)[:, None] * by_body
        unlikely = departs / (departs + usual)
        other = [
            np.sqrt(share * (1.0 - share))[:, None] * (by_lengths - by_body),
            (_SINGLE * (1.0 - share) * np.sqrt(unlikely))[:, None] * own,
        ]
        drawn = ((1.0 - share) * np.sqrt(square))[:, None, None] * of_field
        variance = square * np.minimum(of_lengths + 1.0 - in_sight, of_body)
        slip, ones = square * (_CONTOUR_STRAIN * likely) ** 2, np.ones_like(square)
        return LinkGuess(
            steps=mean,
            variance=variance + slip,
            torn=slip / (variance + slip),
            doubt=np.concatenate([np.stack(other, axis=2), drawn], axis=2),
            field=field,
            away_px=away_px,
            lengths=Guess(steps=by_lengths, strain=of_lengths, unit=given, right=right),
            body=Guess(steps=by_body, strain=of_body, unit=ones, right=ones),
        )

    def learnt(
        self, errors: GuessErrors, guess: LinkGuess, positions_px: Points2, told: FloatArray
    ) -> GuessErrors:
        """Return what is known of the guesses' errors after a frame, fitted at positions (n, 2).

        guess: of the last step. told: (links,) from 0 to 1, how far links are known better than by it.
        """
        steps, square = self.steps(positions_px), self._square
        by_body, by_lengths = (_strain(steps - each.steps, square) for each in (guess.body, guess.lengths))
        left = (1.0 - told) * (1.0 - guess.torn) * guess.variance / square
        return errors.learnt((guess.body, guess.lengths), (by_body, by_lengths), left)

    def around(self, errors: GuessErrors) -> GuessErrors:
        """Return how far guesses around each link err in the mean, or its own if more: rifts are thin."""
        ones, usual = np.ones(len(self.links)), usual_errors(len(self.links))
        means = (self._near_mean(own, ones, prior) for own, prior in zip(errors, usual, strict=True))
        return GuessErrors(*(np.maximum(*each) for each in zip(errors, means, strict=True)))

    def _by_lengths(
        self, positions_px: Points2, around: FloatArray, slopes: Slopes, depth_map: DepthMap
    ) -> tuple[npt.NDArray[np.float64], ...]:
        """(links, 2) steps, squared strain by errors of the normals, `_at_contours`, and away_px (links,)."""
        scale = np.ones(len(positions_px))
        if self._camera.is_perspective:
            depth, found = sample_depth(depth_map.depth, depth_map.mask, positions_px)
            scale = np.where(found, depth / self._depth, 1.0)
        of_nodes, of_links = self._metric.read(slopes, positions_px, scale)
        root = of_links.root
        a, b = self.links.T
        sums = self._lattice.smoothed(np.hstack([around, np.ones((len(around), 1))]), _TURN_PASSES)
        sums = sums[a] + sums[b]
        mean = (sums[:, :4] / sums[:, 4:]).reshape(-1, 2, 2)
        wanted = np.linalg.inv(root) @ _nearest_turn(root @ mean @ self._inverse_root) @ self._root
        steps = np.einsum("eab,eb->ea", wanted, self.along)
        nodes = self.nodes(positions_px)
        now = nodes[b] - nodes[a]
        weight = np.clip(np.minimum(of_links.weight, self._template_metric.weight), _LEAST_WEIGHT, 1.0)
        turned = _NORMAL_ERROR**2 + np.radians(HALF_WEIGHT_DEG) ** 2 / _INDEPENDENT * (1.0 / weight - 1.0)
        # By its own length: a link that is foreshortened to a third errs by a third as many pixels.
        errs = turned * (of_links.steepness + self._template_metric.steepness + turned)
        strain = errs * np.sum(steps**2, axis=1) / self._square
        away_px = 0.5 * np.sum((of_nodes.slope[a] + of_nodes.slope[b]) * now, axis=1)
        return steps, strain, self._at_contours(of_nodes, now), away_px

    def _at_contours(self, nodes: MeanMetric, steps: FloatArray) -> npt.NDArray[np.float64]:
        """(links,) squared slope by which the surface recedes and then no longer, as at an occluding contour.

        A crease that is as steep on either side hides nothing.
        """
        unit = steps / np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-9)
        first, second = (
            np.sign(np.sum(nodes.slope[end] * unit, axis=1))
            * np.sqrt(np.maximum(np.einsum("ei,eij,ej->e", unit, nodes.metric[end], unit) - 1.0, 0.0))
            for end in self.links.T
        )
        onward, back = first - np.abs(second), -second - np.abs(first)
        return np.asarray(np.square(np.maximum(np.maximum(onward, back), 0.0)))

    def _near_mean(
        self, value: FloatArray, weight: FloatArray, prior: FloatArray | float
    ) -> npt.NDArray[np.float64]:
        """(links,) weighted mean of a value of the links around each, beside the prior's few."""
        count = self._lattice.count
        sums = np.zeros((count, 2))
        for end in self.links.T:
            sums[:, 0] += np.bincount(end, weight * value, minlength=count)
            sums[:, 1] += np.bincount(end, weight, minlength=count)
        sums = self._lattice.smoothed(sums, _NEAR_PASSES) / 3.0**_NEAR_PASSES
        means = [
            (sums[end, 0] + _PRIOR_LINKS * prior) / (sums[end, 1] + _PRIOR_LINKS) for end in self.links.T
        ]
        return np.asarray(0.5 * (means[0] + means[1]))


def share_right(before: FloatArray, apart: FloatArray, variance: FloatArray) -> npt.NDArray[np.float64]:
    """Return (links,) how likely guesses are right that differ from others by so much, squared strain.

    before: how likely that is by itself. variance: of the difference where they are right, by direction.
    Where they are wrong they err by as much as the link is long.
    """
    right = before / variance * np.exp(-0.5 * apart / variance)
    wrong = (1.0 - before) / (1.0 + variance) * np.exp(-0.5 * apart / (1.0 + variance))
    return np.asarray(right / (right + wrong))


def modes_of_the_whole(
    steps: FloatArray, away_px: FloatArray, middles: FloatArray
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return what the whole may do beside the guesses: (links, 2, k) by unit, (k,) inverse variances of it.

    It stretches and shears, turns in the image and tilts out of it. Guesses alone would need hundreds of fits
    to follow a turn: they read surface and surroundings where they were. steps: (links, 2) as guessed.
    away_px: (links,) by how much the second end of each lies farther. middles: (links, 2) of the links,
    pixels.
    """
    strains = uniform_strains(steps)
    turns = np.concatenate([slow_turns(steps, middles), tilts(away_px)], axis=2)
    precision = np.repeat([_STRAIN**-2, _TURN**-2], [strains.shape[2], turns.shape[2]])
    return np.concatenate([strains, turns], axis=2), precision


def uniform_strains(steps: FloatArray) -> npt.NDArray[np.float64]:
    """Return (links, 2, 3) what stretch along u, along v, and shear of the whole add to steps (links, 2)."""
    x, y = steps.T
    none = np.zeros_like(x)
    return np.stack([np.stack(mode, axis=1) for mode in ((x, none), (none, y), (y, x))], axis=2)


def slow_turns(steps: FloatArray, centres: FloatArray) -> npt.NDArray[np.float64]:
    """Return (links, 2, k): what slow turns of 1 radian, one a monomial, add to steps (links, 2).

    centres: (links, 2), middles of the links in pixels.
    """
    if len(steps) == 0:
        return np.zeros((0, 2, 0))
    across = np.stack([-steps[:, 1], steps[:, 0]], axis=1)
    return across[:, :, None] * slow_monomials(centres)[:, None, :]


def tilts(away_px: FloatArray) -> npt.NDArray[np.float64]:
    """Return (links, 2, 2): what turns of the whole by 1 radian about v and about u add to steps.

    away_px: (links,) by how much the second end of each lies farther.
    """
    none = np.zeros_like(away_px)
    return np.stack([np.stack(mode, axis=1) for mode in ((away_px, none), (none, away_px))], axis=2)


def slow_monomials(places: FloatArray) -> npt.NDArray[np.float64]:
    """Return (m, k) the monomials of places (m, 2) that vary slowly over the figure, by rising degree."""
    x, y = ((places - places.mean(axis=0)) / np.maximum(places.std(axis=0), 1.0)).T
    powers = [(degree - j, j) for degree in range(_SLOW_DEGREE + 1) for j in range(degree + 1)]
    return np.stack([x**i * y**j for i, j in powers], axis=1)


def _strain(difference: FloatArray, square: FloatArray) -> npt.NDArray[np.float64]:
    """Squared departure of a link by its squared length, by direction, bounded: beyond, it is just wrong."""
    u, v = difference.T
    return np.asarray(np.minimum((u * u + v * v) / square, 1.0))


def _nearest_turn(matrix: FloatArray) -> npt.NDArray[np.float64]:
    """Return the rotation (m, 2, 2) nearest to each matrix."""
    cosine, sine = matrix[:, 0, 0] + matrix[:, 1, 1], matrix[:, 1, 0] - matrix[:, 0, 1]
    length = np.maximum(np.hypot(cosine, sine), 1e-9)
    cosine, sine = cosine / length, sine / length
    return np.stack([cosine, -sine, sine, cosine], axis=1).reshape(-1, 2, 2)
