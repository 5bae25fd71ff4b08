"""Which part of the template's gradients a turn of the surface in place explains, and so tells of no shift.

A surface that turns about itself, as a vase on a wheel, slides along itself: its profile stays where it is.
By a small turn ω about the depth of a window its bands change by T ω, by a shift d by F d, and the two may
look alike. T is known: from the template's own frame, read where a turned template would lie. So ω, of the
variance τ² beforehand, is solved for beside d (`frisch1933`): F gives way to F − T K, with K = (Σ TᵀT +
σ²/τ²)⁻¹ Σ TᵀF, and T K is the part of F that turns explain.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.tracking.bands import LEAST_NOISE, Band, TemplateRaster, curl_of
from vntoolkit.tracking.lattice import NODES_BY_PASS, TemplateLattice
from vntoolkit.tracking.slopes import LEAST_WEIGHT, Relief, gradient_bands

_TURNED = 0.01  # radians, either way, over which changes by a turn are taken
_TURN = 0.03  # standard deviation of a turn in place that is not foreseen, radians


def explained_by_turns(
    raster: TemplateRaster,
    lattice: TemplateLattice,
    bands: list[Band],
    passes: list[int],
    points_px: Points,
    relief: Relief,
) -> list[npt.NDArray[np.float32]]:
    """Return T K for each of the template's bands (h, w, 4), laid out as their gradients.

    passes: of lattice smoothing that make the windows of each band. points_px: (n, 3) the template's
    vertices, and their depth in pixels: as far as a turn moves them in the image. relief: of its frame.
    """
    changes = _changes(raster, points_px, relief)
    sums = lattice.sums(np.column_stack([points_px[:, 2], np.ones(len(points_px))]))
    depth_px = sums[:, 0] / sums[:, 1]
    return [
        _explained(lattice, band, changes[k], passes[k], 4.0**k, depth_px) for k, band in enumerate(bands)
    ]


def _changes(raster: TemplateRaster, points_px: Points, relief: Relief) -> list[npt.NDArray[np.float32]]:
    """(h, w, 4) for each band: by how much a turn about v, and one about u, changes slopes, per radian.

    0 where the frame does not show the turned surface.
    """
    pixels = np.ascontiguousarray(points_px[:, :2])
    own, weight = raster.read(relief, pixels)
    slopes = own / np.maximum(weight, LEAST_WEIGHT)[..., None]
    frames = []
    for axis in (0, 1):
        for turn in (np.float32(_TURNED), np.float32(-_TURNED)):
            moved = np.array(pixels)
            moved[:, axis] += turn * points_px[:, 2]
            values, weight = raster.read(relief, moved)
            values += turn * slopes * values[..., axis, None]  # Jᵀ a, J = I + ω e ∇zᵀ at every pixel
            frames.append([(band, kept) for band, _, kept in gradient_bands(values, weight)])
    out = []
    for turned in zip(*frames, strict=True):
        (one, back, other, other_back), kept = zip(*turned, strict=True)
        seen = np.minimum.reduce(kept) > 0
        changes = np.concatenate([one - back, other - other_back], axis=2)
        out.append(changes * (seen[..., None] / np.float32(2.0 * _TURNED)))
    return out


def _explained(
    lattice: TemplateLattice,
    band: Band,
    turned: npt.NDArray[np.float32],
    passes: int,
    noise_by_curl: float,
    depth_px: FloatArray,
) -> npt.NDArray[np.float32]:
    """T K of one band; noise_by_curl: variance of noise over that of its curl. depth_px: (nodes,)."""
    inside = (band.node >= 0) & (band.weight > 0)
    node, weight = band.node[inside], band.weight[inside].astype(np.float64)
    own, turns = (each[inside].reshape(-1, 2, 2).astype(np.float64) for each in (band.gradients, turned))
    pairs = [np.einsum("pik,pjk->pij", *pair) for pair in ((own, own), (own, turns), (turns, turns))]
    columns = (
        *np.concatenate(pairs, axis=1).reshape(-1, 12).T,
        noise_by_curl * np.square(curl_of(band)[inside]),
        depth_px[node],
        np.ones(len(node)),
    )
    by_node = [np.bincount(node, weight * each, lattice.count) for each in columns]
    sums = lattice.smoothed(np.asarray(by_node, dtype=np.float64).T, passes) / 3.0**passes
    ff, ft, tt = np.moveaxis(sums[:, :12].reshape(-1, 3, 2, 2), 1, 0)
    noise, centre = sums[:, 12:14].T[..., None, None] / np.maximum(sums[:, 14:], 1e-9)[..., None]
    tt = tt - centre * (ft + np.swapaxes(ft, 1, 2)) + centre**2 * ff
    of_both = 2.0 * (noise + LEAST_NOISE**2)  # template and frame
    unforeseen = of_both / (_TURN**2 * NODES_BY_PASS * passes) * np.eye(2)
    shares = np.linalg.solve(tt + unforeseen, np.swapaxes(ft - centre * ff, 1, 2))
    explained = np.zeros_like(band.gradients)
    about = turns - centre[node] * own
    explained[inside] = np.einsum("ptk,ptd->pdk", about, shares[node]).reshape(-1, 4)
    return explained
