"""Labels beside seams, decided together with the blur of lens and Bayer pattern.

A pixel beside a seam shows a mixture. Light adds, so that the map of reflectances is blurred as the picture,
and a change of one label changes the mixtures around it. A change is made where with it normals are nearer to
unit length and shading goes on more evenly from pixel to pixel, by more than the longer seam costs. Blocks of
pixels are tried first, then pixel after pixel (besag1986).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vntoolkit.arrays import Float32Array, FloatArray, Mask, MaterialLabels, Points
from vntoolkit.materials.mixtures import (
    SEAM_PRICE,
    Seams,
    Spread,
    blur_weights,
    blurred_reflectances,
    likeliest_blur_px,
    near_seams,
)
from vntoolkit.materials.reflectance import CAP, Lamps
from vntoolkit.materials.split_frame import noise_of
from vntoolkit.native import njit
from vntoolkit.spread import MEDIAN_TO_DEVIATION, robust_deviation

_FIRST_BLUR_PX = 1.0  # of a lens and a Bayer pattern; sharper pictures show it, and are decided again
_SHARED = 4.0  # pixels that share their errors: texture and blur reach over 2 × 2
_BLOCK_PX = 4  # side of a block
_BLOCK_SWEEPS, _SWEEPS = 4, 5  # at most, of blocks and of pixels
_FINAL = 0.01  # share of the pixels beside seams that change when all is decided
_LEAST_STEP = 0.01  # of log s from pixel to pixel
_JUDGED = 20_000  # pixels that tell how shading changes
_LEAST_LIGHT = np.float32(1e-4)
_LEAST_GAIN = 1e-4  # in nats: less is rounding
_REACH_PX = 2  # of the blur
_MARGIN_PX = _REACH_PX + 1  # of a window around a block
MARGIN_PX = _REACH_PX + 3  # around a pixel that may change, where its change is felt
_NONE, _ONE = np.float32(0.0), np.float32(1.0)
_HALF_MOST, _MOST = np.float32(0.5 * CAP * CAP), np.float32(CAP * CAP)


@dataclass(frozen=True, kw_only=True, eq=False)
class LabelEnergy:
    """What labels (h, w) of a frame cost, in nats: lengths of normals, steps of shading, and seams.

    s: (h, w, 3) float32, contributions. lit: (h, w), where they count. rho: (m, 3).
    """

    s: Float32Array
    lit: Mask
    lamps: Lamps
    rho: Points
    spread: Spread
    seams: Seams

    @classmethod
    def of(
        cls, rgb: FloatArray, lit: Mask, lamps: Lamps, rho: Points, spread: Spread, seams: Seams
    ) -> LabelEnergy:
        """rgb: (h, w, 3), colours."""
        s = np.maximum(rgb @ lamps.split.T, _LEAST_LIGHT).astype(np.float32)
        return cls(s=s, lit=lit, lamps=lamps, rho=rho, spread=spread, seams=seams)

    @property
    def precisions(self) -> tuple[np.float32, np.float32]:
        """1 over the variances of a length and of a step."""
        of_lengths = self.spread.of_pixels**2 + _SHARED * self.spread.of_regions**2
        return np.float32(1.0 / of_lengths), np.float32(1.0 / (_SHARED * self.seams.steps))

    def prices(self, labels: MaterialLabels) -> FloatArray:
        """(h, w), the price of each length, of the steps to the right and below, and of seams there."""
        of_lengths, of_steps = self.precisions
        mean = blurred_reflectances(labels, self.rho, self.seams.blur_px, _REACH_PX)
        normals = (self.s / mean - self.lamps.ambient) @ self.lamps.inverse.T
        t = (np.sqrt((normals**2).sum(axis=2)) - 1.0) ** 2 * of_lengths
        paid, shade = t / (_MOST + t) * self.lit, np.log(self.s / mean)
        for one, other in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
            both = self.lit[one] & self.lit[other]
            t = ((shade[other] - shade[one]) ** 2).sum(axis=2) * of_steps
            paid[one] += both * t / (_MOST + t)
            paid[one] += both * (labels[other] != labels[one]) * SEAM_PRICE / _HALF_MOST
        return np.asarray(_HALF_MOST * paid)

    def decided(self, labels: MaterialLabels, active: Mask) -> MaterialLabels:
        """Return labels (h, w) of little cost from labels that may be wrong in patches.

        active: (h, w), where blocks are tried with every label; then pixels with those around them.
        """
        return self._moved(labels, active & self.lit, _BLOCK_SWEEPS, _SWEEPS)

    def followed(self, labels: MaterialLabels, active: Mask) -> MaterialLabels:
        """Return labels of little cost from labels whose seams are off by a pixel, by one sweep of pixels."""
        return self._moved(labels, active & self.lit, 0, 1)

    def _moved(self, labels: MaterialLabels, active: Mask, of_blocks: int, of_pixels: int) -> MaterialLabels:
        found = labels.copy()
        mean = blurred_reflectances(labels, self.rho, self.seams.blur_px, _REACH_PX)
        known = (
            self.s, mean, np.log(self.s / mean), self.rho.astype(np.float32),
            blur_weights(self.seams.blur_px, _REACH_PX).astype(np.float32),
            self.lamps.ambient.astype(np.float32), self.lamps.inverse.astype(np.float32), *self.precisions,
        )  # fmt: skip
        most_left = _FINAL * np.count_nonzero(near_seams(labels, 1)) if of_pixels > 1 else 0
        for side, sweeps in ((_BLOCK_PX, of_blocks), (1, of_pixels)):
            for _ in range(sweeps):
                if _move(found, self.lit, active, *known, side) <= most_left:
                    break
        return found


def labels_and_energy(
    rgb: FloatArray, lit: Mask, labels: MaterialLabels, lamps: Lamps, rho: Points, spread: Spread,
    active: Mask, near: Mask | None = None,
) -> tuple[MaterialLabels, LabelEnergy]:  # fmt: skip
    """Return labels (h, w) of a first frame, and the energy with what that tells of its seams.

    rgb: (h, w, 3), colours. active: (h, w), where blocks of labels may be wrong. near: (h, w), given where
    seams alone are off, by a pixel at most.
    """
    s = rgb @ lamps.split.T
    noise = np.linalg.norm(lamps.split * noise_of(rgb, lit), axis=1)
    tolerance, steps = (
        _variance_of_lengths(s, lit, lamps, rho, labels),
        _variance_of_steps(s, lit, lamps, labels),
    )
    seams = Seams(_FIRST_BLUR_PX, tolerance, steps, (float(noise[0]), float(noise[1]), float(noise[2])))
    energy = LabelEnergy.of(rgb, lit, lamps, rho, spread, seams)
    found = energy.decided(labels, active) if near is None else energy.followed(labels, near)
    blur_px = likeliest_blur_px(s, lit, lamps, rho, spread.of_pixels**2 + spread.of_regions**2, found)
    if blur_px != _FIRST_BLUR_PX:
        energy = replace(energy, seams=seams._replace(blur_px=blur_px))
        found = energy.decided(labels, active) if near is None else energy.followed(labels, near)
    return found, energy


def _variance_of_lengths(
    s: FloatArray, lit: Mask, lamps: Lamps, rho: Points, labels: MaterialLabels
) -> float:
    """Robust variance of the normals' lengths: of noise, texture, gloss, and light between folds."""
    chosen = np.flatnonzero(lit)[:: max(1, lit.size // _JUDGED)]
    normals = (s.reshape(-1, 3)[chosen] / rho[labels.ravel()[chosen]] - lamps.ambient) @ lamps.inverse.T
    return max(robust_deviation(np.linalg.norm(normals, axis=1) - 1.0) ** 2, 1e-6)


def _variance_of_steps(s: FloatArray, lit: Mask, lamps: Lamps, labels: MaterialLabels) -> float:
    """Robust variance of the step of log s from pixel to pixel within materials, mean over the lamps."""
    rows = slice(None, None, max(1, int(lit.sum()) // _JUDGED))
    both = lit[rows, 1:] & lit[rows, :-1] & (labels[rows, 1:] == labels[rows, :-1])
    if not both.any():
        return _LEAST_STEP**2
    here, there = (np.maximum(part[both], lamps.noise) for part in (s[rows, :-1], s[rows, 1:]))
    steps = np.median(np.abs(np.log(there / here)), axis=0)
    return float(max((MEDIAN_TO_DEVIATION**2 * steps**2).mean(), _LEAST_STEP**2))


@njit
def _move(
    labels: Any, lit: Any, active: Any, s: Any, mean: Any, shade: Any, rho: Any, weights: Any, ambient: Any,
    inverse: Any, of_lengths: Any, of_steps: Any, side: int,
) -> int:  # fmt: skip
    """Give each pixel, or each of overlapping blocks, the label that costs least.

    A block inside may get any label, others those beside them. Returns how many changed.

    s, mean, shade: (h, w, 3), contributions, mixtures, and log of the ratio of the two. of_lengths, of_steps:
    one over the variances.
    """
    h, w = labels.shape
    stride, size = max(side // 2, 1), side + 2 * _MARGIN_PX
    known = ambient, inverse, of_lengths, of_steps
    new, new_shade = np.empty((size, size, 3), np.float32), np.empty((size, size, 3), np.float32)
    changes = 0
    for v in range(_MARGIN_PX, h - size - 1 + _MARGIN_PX, stride):
        for u in range(_MARGIN_PX, w - size - 1 + _MARGIN_PX, stride):
            around = _labels_to_try(labels, lit, active, v, u, side, len(rho))
            if around == 0:
                continue
            top, left, best = v - _MARGIN_PX, u - _MARGIN_PX, -1
            least = _price(lit, s, mean, shade, top, left, top, left, size, *known)
            least += _seam(labels, v, u, side, -1)
            for m in range(len(rho)):
                if (around >> m) & 1:
                    _mix(labels, s, mean, shade, rho, weights, v, u, side, m, new, new_shade)
                    price = _seam(labels, v, u, side, m)
                    price += _price(lit, s, new, new_shade, top, left, 0, 0, size, *known)
                    if price < least - _LEAST_GAIN:
                        least, best = price, m
            if best < 0:
                continue
            changes += 1
            _mix(labels, s, mean, shade, rho, weights, v, u, side, best, new, new_shade)
            mean[top : top + size, left : left + size] = new
            shade[top : top + size, left : left + size] = new_shade
            labels[v : v + side, u : u + side] = best
    return changes


@njit
def _labels_to_try(labels: Any, lit: Any, active: Any, v: int, u: int, side: int, count: int) -> int:
    """Return which labels a block may get, bit m for label m; 0 for none.

    On the subject's outline, where a dark label would explain the mixture with what is behind, those that are
    near alone.
    """
    own, may_change, is_inside, around = 0, False, True, 0
    for a in range(v, v + side):
        for b in range(u, u + side):
            may_change |= active[a, b]
            is_inside &= lit[a, b]
            own |= 1 << labels[a, b]
    if not may_change:
        return 0
    look = max(side // 2, 1)
    for a in range(v - look, v + side + look):
        for b in range(u - look, u + side + look):
            around |= (1 << labels[a, b]) * lit[a, b]
    if side > 1 and is_inside:
        around = (1 << count) - 1
    return around & ~own if own & (own - 1) == 0 else around


@njit
def _mix(
    labels: Any, s: Any, mean: Any, shade: Any, rho: Any, weights: Any, v: int, u: int, side: int, m: int,
    new: Any, new_shade: Any,
) -> None:  # fmt: skip
    """Fill mixtures and shading of the window around a block with label m in all of it."""
    size, top, left = len(new), v - _MARGIN_PX, u - _MARGIN_PX
    new[:] = mean[top : top + size, left : left + size]
    new_shade[:] = shade[top : top + size, left : left + size]
    for a in range(side):
        for b in range(side):
            own = labels[v + a, u + b]
            if own != m:
                for i in range(len(weights)):
                    for j in range(len(weights)):
                        for k in range(3):
                            new[a + 1 + i, b + 1 + j, k] += (
                                weights[i] * weights[j] * (rho[m, k] - rho[own, k])
                            )
    for a in range(1, size - 1):
        for b in range(1, size - 1):
            for k in range(3):
                new_shade[a, b, k] = np.log(s[top + a, left + b, k] / new[a, b, k])


@njit
def _price(
    lit: Any, s: Any, mean: Any, shade: Any, top: int, left: int, row: int, column: int, size: int,
    ambient: Any, inverse: Any, of_lengths: Any, of_steps: Any,
) -> Any:  # fmt: skip
    """Price of the lengths and of the steps of shading that a change in a window's middle changes.

    top, left: of the window in the frame. row, column: of the window in `mean` and `shade`.
    """
    total = _NONE
    for a in range(size - 1):
        for b in range(size - 1):
            v, u, i, j = top + a, left + b, row + a, column + b
            if not lit[v, u]:
                continue
            if a > 0 and b > 0:
                x0, x1 = s[v, u, 0] / mean[i, j, 0] - ambient[0], s[v, u, 1] / mean[i, j, 1] - ambient[1]
                x2, squared = s[v, u, 2] / mean[i, j, 2] - ambient[2], _NONE
                for k in range(3):
                    n = inverse[k, 0] * x0 + inverse[k, 1] * x1 + inverse[k, 2] * x2
                    squared += n * n
                e = np.sqrt(squared) - _ONE
                t = e * e * of_lengths
                total += t / (_MOST + t)
            if a > 0 and lit[v, u + 1]:
                t = _NONE
                for k in range(3):
                    t += (shade[i, j + 1, k] - shade[i, j, k]) ** 2
                t *= of_steps
                total += t / (_MOST + t)
            if b > 0 and lit[v + 1, u]:
                t = _NONE
                for k in range(3):
                    t += (shade[i + 1, j, k] - shade[i, j, k]) ** 2
                t *= of_steps
                total += t / (_MOST + t)
    return _HALF_MOST * total


@njit
def _seam(labels: Any, v: int, u: int, side: int, m: int) -> float:
    """Price of the seams along the sides of a block and in it; m: its label, −1 for those it has."""
    count = 0.0
    for a in range(-1, side):
        for b in range(-1, side):
            here = m if a >= 0 and b >= 0 and m >= 0 else labels[v + a, u + b]
            if b >= 0:
                count += here != (m if a + 1 < side and m >= 0 else labels[v + a + 1, u + b])
            if a >= 0:
                count += here != (m if b + 1 < side and m >= 0 else labels[v + a, u + b + 1])
    return SEAM_PRICE * count
