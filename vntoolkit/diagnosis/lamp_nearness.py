"""How near do the lamps stand? What M's change over the picture does to the lengths |M⁻¹(r − a)| tells.

Lamps that are near light one side of the picture more, and from another direction than the other side. That
changes the lengths with the place and the normal together, as nothing else does that is the same all over the
picture: an M that is wrong (what depends on the normal), vignetting and paint (what depends on the place).
Lamps of a rig stand about equally far: what the three tell is averaged.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.evidence import FEWEST_PIXELS, Evidence
from vntoolkit.diagnosis.finding import Finding
from vntoolkit.diagnosis.surface_pixels import SurfacePixels, regress_lengths, surface_pixels, without_levels
from vntoolkit.photometry.response import LightResponse, changes_of_near_lamps
from vntoolkit.spread import robust_deviation

_FEWEST_IN_PART = 40  # pixels of two by two blocks
_LIKE_LAMPS = 0.5  # of the squares of what is left over wide parts
_LEAST_ERROR = 0.02  # what renderings and photographs under far lamps are off by, all three lamps alike


@dataclass(frozen=True, kw_only=True)
class Nearness:
    """value ± error: half of the picture's larger side, at the surface, over the lamps' distance."""

    value: float
    error: float

    @property
    def established(self) -> float:
        """What of it is established: 0 within two standard errors, shrunk by its error beyond (james1961)."""
        if self.value <= 2.0 * self.error:
            return 0.0
        return self.value * (1.0 - (self.error / self.value) ** 2)


def fit_nearness(evidence: Evidence) -> Nearness | None:
    """Fit how near the lamps are; None where M varies already, or too little of the surface is in sight.

    The fit is made three times, with other things allowed besides; by how much the three differ counts as an
    error. Gloss, and light from one part of the subject on another, make patterns as wide as the subject,
    which blocks left out do not tell of: see `_error_of_patterns`.
    """
    response = evidence.rig.response
    if response.variation is not None:
        return None
    # what a lamp does not reach is shorter, whatever the lamps' distance, and blurred into what is beside it
    seen = replace(evidence, clipped=evidence.clipped | ~evidence.lit)
    pixels = surface_pixels(seen)
    if len(pixels) < FEWEST_PIXELS:
        return None
    near = changes_with_nearness(pixels, response)
    vignetting = (pixels.positions**2).sum(axis=1)
    wrong_m, uneven, logs = pixels.of_wrong_m, pixels.of_uneven_light, pixels.log_lengths
    fits = []
    for besides in ([*wrong_m, vignetting], wrong_m + uneven, [*pixels.normals.T[:2], *wrong_m, *uneven]):
        columns = np.column_stack([*near, *besides])
        fit = regress_lengths(columns, logs, pixels, widely=True)
        if fit is None:
            return None
        fits.append(fit)
    slopes = np.stack([fit.slopes[:3] for fit in fits])
    errors = np.stack([fit.errors[:3] for fit in fits])
    each = np.hypot(np.maximum(errors.max(axis=0), 1e-4), np.ptp(slopes, axis=0) / 2)
    worth = each**-2.0
    value = float((worth * slopes.mean(axis=0)).sum() / worth.sum())
    by_patterns = _error_of_patterns(columns, logs, fits[-1].slopes, pixels)  # the last fit allows most
    error = max(1.0 / math.sqrt(worth.sum()), by_patterns)
    return Nearness(value=value, error=math.hypot(_LEAST_ERROR, error))


def changes_with_nearness(pixels: SurfacePixels, response: LightResponse) -> list[FloatArray]:
    """Return how log lengths follow each lamp's nearness, three of (n,)."""
    normals = pixels.normals
    changes = np.einsum("ij,akjl->akil", response.inverse, changes_of_near_lamps(response))
    return list(np.einsum("na,akij,ni,nj->kn", pixels.positions, changes, normals, normals, optimize=True))


def _error_of_patterns(
    columns: FloatArray, logs: FloatArray, slopes: FloatArray, pixels: SurfacePixels
) -> float:
    """Return the error of the nearness if half of what is left over wide parts looks as near lamps make it.

    On skin, under light from one part of a face on another, quarters of blocks are 4 to 6 % too bright or too
    dark, on cloth 0.4 %. columns: (n, k), three of them of lamps, fitted to log lengths (n,) by slopes (k,).
    """
    left = without_levels(logs - columns @ slopes, pixels.frames)
    most = 3.0 * robust_deviation(left)
    row, column = np.divmod(pixels.blocks, pixels.blocks_a_side)
    part = np.unique((row // 2) * pixels.blocks_a_side + column // 2, return_inverse=True)[1]
    counts = np.bincount(part)
    means = np.bincount(part, np.clip(left, -most, most)) / counts
    means = means[counts >= _FEWEST_IN_PART]
    others = np.column_stack([columns[:, 3:], np.ones(len(logs))])
    lamps = columns[:, :3].sum(axis=1)
    alone = lamps - others @ np.linalg.lstsq(others, lamps, rcond=None)[0]
    if len(means) < 2:
        return math.inf
    return math.sqrt(_LIKE_LAMPS) * float(means.std()) / max(float(alone.std()), 1e-9)


def finding_from_nearness(near: Nearness) -> Finding:
    """Note lamps that stand near, where M is one for the whole picture."""
    sides = [0.5 / value for value in (near.value, near.value + near.error, near.value - near.error)]
    return Finding.of("near-lamps", distance=sides[0], least=sides[1], most=sides[2])
