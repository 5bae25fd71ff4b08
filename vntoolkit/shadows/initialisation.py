"""The start of the surface under shadows: roots where the albedo is known, else the lit surroundings.

Where two lights arrive the energy has two minima, one at each root (`roots`). An albedo that is known says
where the roots lie: the surface is solved from those of the minimum cut. They are frozen until depth has
found where it steps, as from a chin to the neck: a depth that holds together everywhere would turn them over.

An albedo that varies by more than the energy lets it puts the roots anywhere. The ratio of two lights does
not hang on it: the surface goes on from the lit surroundings.
"""

from dataclasses import replace

import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.geometry.slope_grid import FLATTEST_Z
from vntoolkit.photometry.frame import LinearFrame, count_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.contributions import contributions_from_frame
from vntoolkit.shadows.roots import roots_of_labels, spread_of_albedo, with_sides_of_roots
from vntoolkit.shadows.surface import ALBEDO_SPREAD, LabelledImage, Surface, SurfaceOptions
from vntoolkit.spread import robust_deviation

_FEWEST_LOOPS = 100
_FEWEST_PAIRS = 60  # of rows, whose noise stands for the frame's
# Of a pixel that 0 … 3 lights reach: one alone hangs on the albedo; few pixels under two must hold against
# many around.
_TRUST_BY_LIGHTS = (1.0, 0.2, 2.0, 1.0)
_NOISE_PER_SLOPE = 1.7  # noise of a cosine per noise of a slope, on cleaner frames
_LEAST_NOISE = 0.01  # of a cosine
_FROZEN = 4  # steps of the surface that keep the roots, while depth finds where it steps, …
_FREE = 4  # … and those that settle it; of photographs' surfaces more make normals worse


def solve_from_start(labelled: LabelledImage, noise: float | None) -> Surface:
    """Solve the surface of a frame on its working size.

    noise: standard deviation of slopes, None where it is not known.
    """
    light, mask, albedo = labelled.image.light, labelled.image.mask, labelled.albedo
    spread = spread_of_albedo(light.length, albedo, mask & ~labelled.shadow) or ALBEDO_SPREAD
    frozen = _FROZEN if spread <= ALBEDO_SPREAD else 0
    options = SurfaceOptions(spread=spread, iterations=frozen + _FREE, frozen=frozen, final=_FREE)
    if noise is not None:
        options = replace(options, noise=min(options.noise, max(_NOISE_PER_SLOPE * noise, _LEAST_NOISE)))
    by_lights = np.asarray(_TRUST_BY_LIGHTS, dtype=np.float32)[count_lit(labelled.labels)]
    trusted = replace(labelled, trust=(light.trust * by_lights).astype(np.float32))
    if not frozen:
        return trusted.solve(options)
    roots = roots_of_labels(light, albedo, labelled.labels, mask, spread)
    surface = trusted.solve(options, first_normals=roots.normals, assumed=roots.known)
    sides = with_sides_of_roots(surface.normals, roots, labelled.labels, light)
    return replace(surface, normals=sides, mirror_probability=roots.mirror_probability)


# How noisy the normals of one frame are: as far as no surface has them.


def noise_of_frame(rgb: FloatArray, response: LightResponse, known: Mask) -> float | None:
    """Return the standard deviation of a facing normal's slope, or None with too few `known` pixels.

    rgb: (h, w, 3), of which pairs of rows are read. A slope's noise grows with 1 / n_z², which is taken out.
    The median makes steps in depth, where loops do not close either, count for little.
    """
    pairs = max(len(known) // _FEWEST_PAIRS, 2)
    last = len(known) - len(known) % pairs

    def rows(first: int) -> tuple[FloatArray, Mask]:
        part = np.ascontiguousarray(rgb[first:last:pairs])
        frame = LinearFrame(rgb=part, clipped=np.zeros(part.shape[:2], np.bool_))
        return contributions_from_frame(frame, response).normals, known[first:last:pairs]

    return _noise_between(*rows(0), *rows(1))


def _noise_between(upper: FloatArray, known: Mask, lower: FloatArray, also: Mask) -> float | None:
    """upper, lower: (n, w, 3), normals of rows and of the rows below them."""

    def slopes(normals: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        facing = np.maximum(-normals[..., 2], FLATTEST_Z)
        return normals[..., 0] / facing, normals[..., 1] / facing, facing

    (p, q, facing), (p_below, q_below, _) = slopes(upper), slopes(lower)
    along_u = 0.5 * (p[:, :-1] + p[:, 1:] - p_below[:, :-1] - p_below[:, 1:])
    along_v = 0.5 * (q[:, 1:] + q_below[:, 1:] - q_below[:, :-1] - q[:, :-1])
    loops = known[:, :-1] & known[:, 1:] & also[:, :-1] & also[:, 1:]
    if np.count_nonzero(loops) < _FEWEST_LOOPS:
        return None
    sums = np.abs((along_u + along_v) * facing[:, :-1] ** 2)[loops]
    return robust_deviation(sums) / float(np.sqrt(2.0))  # of 8 slopes, a half each
