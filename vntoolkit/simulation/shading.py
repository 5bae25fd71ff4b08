"""Colour, normal and visibility of the surface points that rays meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.simulation import surface_kernels
from vntoolkit.simulation.image_formation import exposure_of_scene
from vntoolkit.simulation.lights import MOST_LIGHTS
from vntoolkit.simulation.nuisances import Nuisances
from vntoolkit.simulation.ray_casting import Hits, RayCaster
from vntoolkit.simulation.scene import Detail, Scene

_FAR_M = 100.0  # a parallel light's shadow rays end here


@dataclass(frozen=True, kw_only=True, eq=False)
class Shaded:
    """Surface points, one row each.

    colours: (p, 3). normals: (p, 3) that shaded them. lit: (p, 3) by label bit, True where the light arrives.
    """

    colours: FloatArray
    normals: FloatArray
    lit: npt.NDArray[np.bool_]


class Shader:
    """Shades points of one scene's surface."""

    def __init__(self, scene: Scene, nuisances: Nuisances) -> None:
        self._scene = scene
        self._nuisances = nuisances
        self._exposure = exposure_of_scene(scene, nuisances)
        surface = scene.surface
        self._faces = np.ascontiguousarray(surface.faces)
        self._uv = None if surface.uv is None else np.ascontiguousarray(surface.uv, dtype=np.float64)
        self._texture = _contiguous(surface.texture) if nuisances.texture else None
        self._vertex_weights = _contiguous(surface.vertex_weights) if nuisances.texture else None
        self._slopes = None if surface.detail is None else slopes_of(surface.detail)
        self._tiled_uv = None
        if surface.detail is not None and self._uv is not None:
            self._tiled_uv = np.ascontiguousarray(self._uv * np.array(surface.detail.repeats))
        self._gloss = np.broadcast_to(
            np.asarray(surface.gloss if nuisances.gloss else 0.0, np.float64), (scene.vertex_count,)
        )

    def shade(self, vertices: Points, normals: Points, hits: Hits, caster: RayCaster) -> Shaded:
        """Shade where rays hit the mesh at `vertices` with unit vertex `normals`, both (n, 3)."""
        points, shading, origins = surface_kernels.sample_geometry(
            vertices, normals, self._faces, hits.faces, hits.barycentric
        )
        self._tilt(shading, points, vertices, hits)
        lit = self._unblocked(origins, caster)
        exposure, lights = self._exposure, self._scene.lights
        colours = surface_kernels.shade(
            points, shading, self._weights(hits), self._at_hits(self._gloss[:, None], hits)[:, 0],
            self._scene.surface.gloss_exponent, lit,
            np.ascontiguousarray(lights.positions), exposure.directions, exposure.distances_m,
            self._nuisances.near_lights,
            exposure.pigment_colours, exposure.ambient_colours, exposure.gloss_colours,
        )  # fmt: skip
        by_bit = np.zeros((len(points), MOST_LIGHTS), dtype=np.bool_)
        by_bit[:, list(lights.bits)] = lit
        return Shaded(colours=colours, normals=shading, lit=by_bit)

    def _tilt(self, shading: Points, points: Points, vertices: Points, hits: Hits) -> None:
        detail = self._scene.surface.detail
        if detail is None or self._slopes is None or self._uv is None or self._tiled_uv is None:
            return
        slopes = surface_kernels.sample_texture(self._slopes, self._tiled_uv, hits.faces, hits.barycentric)
        if detail.strength is not None:
            slopes *= self._at_hits(np.asarray(detail.strength, np.float64)[:, None], hits)
        surface_kernels.tilt_normals(shading, points, slopes, vertices, self._faces, self._uv, hits.faces)

    def _unblocked(self, origins: Points, caster: RayCaster) -> npt.NDArray[np.bool_]:
        lit = np.ones((len(origins), len(self._scene.lights)), dtype=np.bool_)
        if not self._nuisances.shadows:
            return lit
        for k, position in enumerate(self._scene.lights.positions):
            if self._nuisances.near_lights:
                targets = np.broadcast_to(position, origins.shape)
            else:
                targets = origins + _FAR_M * self._exposure.directions[k]
            lit[:, k] = ~caster.blocked(origins, targets)
        return lit

    def _weights(self, hits: Hits) -> FloatArray:
        """Return (p, b) the pigments' weights."""
        if self._vertex_weights is None and self._texture is None:
            reference = np.asarray(self._scene.surface.reference_weights, dtype=np.float64)
            return np.tile(reference, (len(hits.rays), 1))
        weights: FloatArray = np.ones((len(hits.rays), len(self._scene.surface.pigments)))
        if self._vertex_weights is not None:
            weights *= self._at_hits(self._vertex_weights, hits)
        if self._texture is not None and self._uv is not None:
            weights *= surface_kernels.sample_texture(self._texture, self._uv, hits.faces, hits.barycentric)
        return weights

    def _at_hits(self, per_vertex: FloatArray, hits: Hits) -> FloatArray:
        """Interpolate (n, c) values to (p, c)."""
        return surface_kernels.interpolate(per_vertex, self._faces, hits.faces, hits.barycentric)


def slopes_of(detail: Detail) -> FloatArray:
    """Return (th, tw, 2) dh/du and dh/dv of a tiling height map, in metres per unit of uv."""
    height = np.asarray(detail.height_m, dtype=np.float64)
    rows, columns = height.shape
    along_u = (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) * (columns * detail.repeats[0] / 2)
    along_v = (np.roll(height, -1, axis=0) - np.roll(height, 1, axis=0)) * (rows * detail.repeats[1] / 2)
    return np.stack([along_u, along_v], axis=-1)


def _contiguous(values: FloatArray | None) -> FloatArray | None:
    return None if values is None else np.ascontiguousarray(values)
