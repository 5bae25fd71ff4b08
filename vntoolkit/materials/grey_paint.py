"""Whether materials that were found describe the footage clearly better than one paint of the rig's hue.

Normals of a wrong paint are not of length 1. But shading that reaches the camera by other ways (gloss, light
between folds, lamps that are nearer than the rig knows) bends lengths too, over whole parts of a body alike.
So few of these errors are independent, and other paint explains some of them by chance: a hue has two numbers
more, and several materials sort the errors into as many classes. What the spread of lengths falls by beyond
that tells paint.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vntoolkit.arrays import IntArray, Points
from vntoolkit.materials.mixtures import SEAM_PRICE
from vntoolkit.materials.region_labels import agreed, prices_of_regions, spread_of, total_cost
from vntoolkit.materials.region_lengths import lengths_of
from vntoolkit.materials.search import Material, SearchedFrames

# Errors of lengths that are independent: what bends them is as smooth over a subject as a quadratic of the
# place, which has six numbers.
_INDEPENDENT = 6.0
CLEAR = 1.0  # nats by which a description is better than grey paint
# Share of a normal variable's variance that is left by sorting it into 1, 2, 3 … classes (max1960).
_LEFT_IN_CLASSES = np.array(
    [1.0, 0.3634, 0.1902, 0.1175, 0.0799, 0.0580, 0.0440, 0.0345, 0.0279, 0.0229, 0.0192, 0.0163]
)
_ROUNDS = 4


def nats_over_grey(found: list[Material], searched: SearchedFrames) -> float:
    """Return by how many nats materials describe frames better than one grey paint.

    Labels of regions cost what sorting lengths into classes gains by chance, and steps of shading between
    regions then count nothing; or they cost their seams, where these explain steps.
    """
    logs = np.log([each.reflectance.values for each in found])
    grey, nothing = _grey(searched), np.zeros(searched.regions.count, np.int64)
    spread, labels = _spread(logs, searched)
    gain = _INDEPENDENT * float(np.log(_spread(grey, searched)[0] / spread))
    by_chance = -0.5 * np.log(_LEFT_IN_CLASSES[len(found) - 1])
    by_lengths = gain - _INDEPENDENT * by_chance - np.log(_INDEPENDENT)  # of two numbers (schwarz1978)
    if len(found) == 1:
        return float(by_lengths)
    steps, of_grey = (
        total_cost(np.zeros((len(each), len(log))), each, log, searched.regions, SEAM_PRICE)
        for each, log in ((labels, logs), (nothing, grey))
    )
    numbers = 0.5 * (3 * len(found) - 1) * np.log(searched.regions.count)
    return float(max(by_lengths, gain + of_grey - steps - numbers))


def weighed_against_grey(found: list[Material], searched: SearchedFrames) -> list[Material]:
    """Return the materials with the turn of their normals if one grey paint is right after all."""
    grey, share = _grey(searched), 1.0 / (1.0 + np.exp(min(nats_over_grey(found, searched), 50.0)))
    logs = np.log([each.reflectance.values for each in found])
    _, labels = _spread(logs, searched)
    regions, lamps, doubtful = searched.regions, searched.split.lamps, []
    for m, each in enumerate(found):
        own = labels == m
        samples = regions.samples[own][regions.known[own]]
        one, other = (
            (samples * np.exp(-log) - lamps.ambient) @ lamps.inverse.T for log in (logs[m], grey[0])
        )
        cosines = (one * other).sum(axis=1) / np.linalg.norm(one, axis=1) / np.linalg.norm(other, axis=1)
        turn_deg = float(np.degrees(np.arccos(np.median(cosines).clip(-1.0, 1.0)))) if len(cosines) else 0.0
        doubtful.append(replace(each, alternative_deg=float(np.sqrt(share)) * turn_deg))
    return doubtful


def _grey(searched: SearchedFrames) -> Points:
    """(1, 3), log ρ of one paint of the rig's hue: with it the median length of normals is 1."""
    regions, lamps = searched.regions, searched.split.lamps
    normals = (regions.samples[regions.known] - lamps.ambient) @ lamps.inverse.T
    return np.full((1, 3), np.log(np.median(np.linalg.norm(normals, axis=1))))


def _spread(logs: Points, searched: SearchedFrames) -> tuple[float, IntArray]:
    """Return the spread of regions' lengths as materials of log ρ (m, 3), and labels (n,) of these."""
    regions = searched.regions
    lengths = lengths_of(regions, logs, searched.split.lamps)
    labels: IntArray = np.zeros(regions.count, np.int64)
    spread = spread_of(lengths, labels)
    for _ in range(_ROUNDS if len(logs) > 1 else 0):
        labels = agreed(prices_of_regions(lengths, spread), logs, regions, SEAM_PRICE)
        spread = spread_of(lengths, labels)
    return spread.of_regions, labels
