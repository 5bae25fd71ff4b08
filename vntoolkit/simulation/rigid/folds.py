"""Folds, seams and pockets of a garment as heights over its unrolled cloth; all in metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class Fold:
    """A bent ridge over cloth coordinates (s, t).

    start: its one end. angle_rad, length: direction and reach, s towards t. bend: sideways deviation at its
    middle. width: of the ridge's flank. height: of its crest. lean: −1 to 1, which flank is the steeper.
    """

    start: tuple[float, float]
    angle_rad: float
    length: float
    bend: float
    width: float
    height: float
    lean: float


def fold_height(s: FloatArray, t: FloatArray, fold: Fold) -> FloatArray:
    """Return the height that one fold adds at (s, t)."""
    cos, sin = np.cos(fold.angle_rad), np.sin(fold.angle_rad)
    along = (cos * (s - fold.start[0]) + sin * (t - fold.start[1])) / fold.length
    across = -sin * (s - fold.start[0]) + cos * (t - fold.start[1])
    inside = np.clip(along, 0.0, 1.0)
    across = across - 4.0 * fold.bend * inside * (1.0 - inside)
    # A fold is narrow where it springs from and spreads as it runs out.
    x = across / (fold.width * (0.6 + 0.8 * inside))
    flank = np.where(x * fold.lean > 0, 1.0 + 1.2 * abs(fold.lean), 1.0 - 0.35 * abs(fold.lean))
    fade = np.where((along > 0) & (along < 1), np.sin(np.pi * np.sqrt(inside)) ** 1.5, 0.0)
    return fold.height * fade * (1.0 - np.tanh(1.6 * x * flank) ** 2)


def scattered_folds(
    count: int,
    *,
    s_range: tuple[float, float],
    t_range: tuple[float, float],
    angles_deg: tuple[float, float],
    length: float,
    width: float,
    height: float,
    generator: np.random.Generator,
) -> list[Fold]:
    """Draw `count` folds that start in a rectangle and run at some angle in `angles_deg`, sizes ± 40 %."""
    folds = []
    for _ in range(count):
        size = generator.uniform(0.6, 1.4, 3)
        folds.append(
            Fold(
                start=(float(generator.uniform(*s_range)), float(generator.uniform(*t_range))),
                angle_rad=float(np.deg2rad(generator.uniform(*angles_deg))),
                length=length * float(size[0]),
                bend=float(generator.normal(0.0, 0.08)) * length,
                width=width * float(size[1]),
                height=height * float(size[2]),
                lean=float(generator.uniform(-1, 1)),
            )
        )
    return folds


def sum_of_folds(s: FloatArray, t: FloatArray, folds: list[Fold]) -> FloatArray:
    """Add up folds; where several meet, the higher one swallows part of the lower."""
    total = np.zeros_like(s)
    for fold in folds:
        total += fold_height(s, t, fold) * (1.0 - 0.5 * np.clip(total / 0.02, 0.0, 1.0))
    return total


def groove(distance: FloatArray, width: float) -> FloatArray:
    """Return 1 on a line and 0 away from it: the dent of a seam."""
    return np.exp(-np.square(distance / width))


def patch(s: FloatArray, t: FloatArray, centre: tuple[float, float], size: tuple[float, float]) -> FloatArray:
    """Return the distance to a rectangle's outline, positive inside: pockets and flaps."""
    away_s = size[0] / 2 - np.abs(s - centre[0])
    away_t = size[1] / 2 - np.abs(t - centre[1])
    return np.minimum(away_s, away_t)


def step(distance: FloatArray, softness: float) -> FloatArray:
    """Return 0 outside, 1 inside, with a soft edge."""
    return 0.5 * (1.0 + np.tanh(distance / softness))
