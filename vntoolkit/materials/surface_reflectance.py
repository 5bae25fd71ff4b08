"""Reflectance of every vertex of a tracked surface, from many frames.

Each frame tells paint from relief by itself (`paint`): its normals say how much of each lamp's light arrives
at a vertex, and what is returned beyond that is the vertex's reflectance. On a tracked surface a vertex keeps
it, so that frames are averaged; those that were sure of the normal count most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, IntArray, Mask, Matrix3, Points, Vectors

_LEAST_FACING = 0.1  # cosine to a lamp: less is nearly in shadow
_SURE_DEG = 2.0  # no normal is better than that
_OF_MEDIAN = 1.4826  # standard deviation over the median of absolute values

Single = npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceLooks:
    """How a surface of n vertices looked in f frames.

    contributions: (f, n, 3) of the lamps, without ambient light. seen: (f, n), where these are sound and all
    lamps arrive. normals: (f, n, 3) that the frames were found to have, error_deg: (f, n), their expected
    errors. materials: (n,) number of each vertex's. logs: (n, 3), log ρ of its material.
    """

    contributions: Single
    seen: Mask
    normals: Single
    error_deg: Single
    materials: IntArray
    logs: Points


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceReflectance:
    """logs: (n, 3), log ρ of each vertex. lines: of each material, (m, 3), the line of log ρ along which
    paint varies, of length 1. spreads: (m,), robust standard deviation along it.
    """

    logs: Points
    lines: Points
    spreads: FloatArray


def mean_surface_reflectance(looks: SurfaceLooks, lights: Matrix3) -> SurfaceReflectance:
    """Return the reflectance of each vertex. lights: (3, 3), row k so that contribution k is row k · n.

    A vertex that no frame shows has that of its material.
    """
    paint, total = np.zeros(looks.logs.shape), np.zeros(len(looks.logs))
    frames = zip(looks.contributions, looks.seen, looks.normals, looks.error_deg, strict=True)
    for light, seen, normals, error_deg in frames:
        arrives = normals @ lights.T
        weight = (seen & (arrives.min(axis=1) > _LEAST_FACING)) / np.maximum(error_deg, _SURE_DEG) ** 2
        returned = np.log(np.maximum(light, 1e-6) / np.maximum(arrives, _LEAST_FACING)) - looks.logs
        paint += weight[:, None] * returned
        total += weight
    is_told = total > 0
    paint[is_told] /= total[is_told, None]
    count = int(looks.materials.max()) + 1
    lines, spreads = np.full((count, 3), 3.0**-0.5), np.zeros(count)
    for m in range(count):
        own = paint[is_told & (looks.materials == m)]
        if len(own):
            lines[m], spreads[m] = _line_of_paint(own)
    return SurfaceReflectance(logs=looks.logs + paint, lines=lines, spreads=spreads)


def _line_of_paint(paint: Points) -> tuple[Vectors, float]:
    """Return the main line (3,) of paint (n, 3), and its robust spread along it."""
    apart = paint - np.median(paint, axis=0)
    line = np.linalg.eigh(apart.T @ apart)[1][:, 2]
    line = line * np.sign(line.sum() or 1.0)
    return line, _OF_MEDIAN * float(np.median(np.abs(apart @ line)))
