"""Rendering of a frame: rays through every pixel, shading by equations 1 to 3, then the sensor."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vntoolkit.arrays import (
    Array,
    ByteArray,
    Float32Array,
    FloatArray,
    Flow,
    Int64Array,
    LinearImage,
    Mask,
    Points,
    VisibilityLabels,
)
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.geometry.mesh import vertex_normals
from vntoolkit.geometry.rays import Hits, RayScene, pixel_rays
from vntoolkit.options.simulation import Nuisances, RenderOptions
from vntoolkit.photometry.frame import LinearFrame, labels_from_lit
from vntoolkit.simulation.nuisances import expose
from vntoolkit.simulation.scene import Scene
from vntoolkit.simulation.shading import Shader

# Sample positions in a pixel, (u, v) from its centre, the centre first: one; a turned square of four round
# it, which treats lines of any direction alike; a 3×3 grid.
_PATTERNS: dict[int, tuple[tuple[float, float], ...]] = {
    1: ((0.0, 0.0),),
    5: ((0.0, 0.0), (-0.15, -0.4), (0.4, -0.15), (0.15, 0.4), (-0.4, 0.15)),
    9: ((0.0, 0.0), *((x / 3, y / 3) for y in (-1, 0, 1) for x in (-1, 0, 1) if (x, y) != (0, 0))),
}


@dataclass(eq=False)
class _Sums:
    """What the samples of the pixels add up to, one row per pixel."""

    colours: FloatArray
    normals: FloatArray
    lit: ByteArray
    met: ByteArray

    @classmethod
    def of(cls, pixels: int) -> "_Sums":
        return cls(
            np.zeros((pixels, 3), np.float32),
            np.zeros((pixels, 3), np.float64),
            np.zeros((pixels, 3), np.uint8),
            np.zeros(pixels, np.uint8),
        )


class Renderer:
    """Renders frames of one scene; what does not change between frames is computed once."""

    def __init__(
        self, scene: Scene, nuisances: Nuisances | None = None, options: RenderOptions | None = None
    ) -> None:
        self.scene = scene
        self.nuisances = nuisances or Nuisances()
        self.options = options or RenderOptions()
        self._shader = Shader(scene, self.nuisances)

    def render(
        self, vertices: Points, next_vertices: Points | None, generator: np.random.Generator, number: int = 0
    ) -> "SimulatedFrame":
        """Render the scene's mesh at `vertices` (n, 3); `next_vertices` give the flow, None for none.

        Raises `BadMesh` where the vertices are not those of the scene's faces.
        """
        for moved in (vertices, next_vertices):
            if moved is not None:
                require_same_topology(moved, self.scene)
        # In float32, as the truth's file holds them: then it does not matter where they come from.
        vertices = np.asarray(vertices, dtype=np.float32).astype(np.float64)
        if next_vertices is not None:
            next_vertices = np.asarray(next_vertices, dtype=np.float32).astype(np.float64)
        sums, centre_hits = self._sample(vertices)
        camera, scene = self.scene.camera, self.scene
        samples = self.options.samples
        radiance = sums.colours + np.float32(scene.background_rgb) * (samples - sums.met[:, None]).astype(
            np.float32
        )
        radiance = (radiance / np.float32(samples)).astype(np.float32)
        radiance = radiance.reshape(camera.height, camera.width, 3)
        stored, linear = expose(radiance, self.nuisances, generator, number)
        return SimulatedFrame(
            number=number,
            radiance=radiance,
            stored=stored,
            linear=linear,
            truth=self._truth(vertices, next_vertices, sums, centre_hits),
        )

    def _sample(self, vertices: Points) -> tuple[_Sums, Hits]:
        """Cast and shade every sample of every pixel; also return what the pixels' centres met."""
        faces = self.scene.surface.faces
        scene = RayScene((vertices, faces), threads=self.options.threads)
        normals = vertex_normals(vertices, faces)
        sums = _Sums.of(self.scene.camera.width * self.scene.camera.height)
        centre_hits: Hits | None = None
        window = self._window(vertices)
        for rays in self._rays:
            hits = scene.first_hits(rays, window)
            if centre_hits is None:
                centre_hits = hits
            shaded = self._shader.shade(vertices, normals, hits, scene)
            sums.colours[hits.rays] += shaded.colours
            sums.normals[hits.rays] += shaded.normals
            sums.lit[hits.rays] += shaded.lit
            sums.met[hits.rays] += 1
        assert centre_hits is not None
        return sums, centre_hits

    def _window(self, vertices: Points) -> Int64Array:
        """Return the indices of the pixels whose rays can meet the mesh: those in its bounding rectangle."""
        camera = self.scene.camera
        pixels = np.arange(camera.width * camera.height).reshape(camera.height, camera.width)
        if vertices[:, 2].min() <= 0:
            return pixels.ravel()
        seen = camera.project(vertices)
        low = np.clip(np.floor(seen.min(axis=0)).astype(int) - 1, 0, [camera.width, camera.height])
        high = np.clip(np.ceil(seen.max(axis=0)).astype(int) + 2, 0, [camera.width, camera.height])
        return pixels[low[1] : high[1], low[0] : high[0]].ravel()

    @cached_property
    def _rays(self) -> list[Float32Array]:
        """Per sample position, the rays of all pixels, (h·w, 6) = (origin, direction)."""
        camera = self.scene.camera
        all_rays = []
        for offset in _PATTERNS[self.options.samples]:
            pixels = (camera.pixel_grid() + np.array(offset)).reshape(-1, 2)
            all_rays.append(np.concatenate(pixel_rays(camera, pixels), axis=1, dtype=np.float32))
        return all_rays

    def _truth(self, vertices: Points, next_vertices: Points | None, sums: _Sums, hits: Hits) -> "FrameTruth":
        camera = self.scene.camera
        shape = (camera.height, camera.width)
        mask = np.zeros(camera.height * camera.width, dtype=np.bool_)
        mask[hits.rays] = True
        lengths = np.linalg.norm(sums.normals[hits.rays], axis=1, keepdims=True)
        normals = np.zeros((mask.size, 3), np.float32)
        normals[hits.rays] = sums.normals[hits.rays] / lengths
        depth = np.zeros(mask.size, np.float32)
        points = self._points_at(vertices, hits)
        depth[hits.rays] = points[:, 2]
        lit = (2 * sums.lit >= np.maximum(sums.met, 1)[:, None]) & mask[:, None]
        mask_image: Mask = mask.reshape(shape)
        return FrameTruth(
            normals=NormalMap(normals_in_camera=normals.reshape(*shape, 3), mask=mask_image),
            depth=DepthMap(depth=depth.reshape(shape), mask=mask_image, unit=LengthUnit.METRE),
            labels=labels_from_lit(lit.reshape(*shape, 3)),
            flow_px=None if next_vertices is None else self._flow(next_vertices, hits),
            vertices=vertices,
        )

    def _flow(self, next_vertices: Points, hits: Hits) -> Flow:
        """Where the point that each pixel's centre sees is seen in the next frame, minus the centre."""
        camera = self.scene.camera
        flow = np.zeros((camera.height * camera.width, 2), np.float32)
        there = camera.project(self._points_at(next_vertices, hits))
        here = np.stack([hits.rays % camera.width, hits.rays // camera.width], axis=1)
        flow[hits.rays] = there - here
        return flow.reshape(camera.height, camera.width, 2)

    def _points_at(self, vertices: Points, hits: Hits) -> Points:
        b = hits.barycentric.astype(np.float64)
        corners = self.scene.surface.faces[hits.faces]
        weights = (1.0 - b[:, 0] - b[:, 1], b[:, 0], b[:, 1])
        parts = (w[:, None] * np.asarray(vertices)[corners[:, i]] for i, w in enumerate(weights))
        return sum(parts, np.zeros((len(b), 3)))


def require_same_topology(vertices: Points, scene: Scene) -> None:
    """Raise `BadMesh` unless `vertices` (n, 3) are as many as the scene's mesh has."""
    count = scene.vertex_count
    if vertices.shape != (count, 3):
        have = " × ".join(map(str, vertices.shape))
        raise BadMesh(f"scene {scene.name}: expected {count} × 3 vertices, got {have}: another topology")


def render_frame(
    scene: Scene,
    index: int,
    *,
    nuisances: Nuisances | None = None,
    options: RenderOptions | None = None,
    seed: int = 0,
) -> "SimulatedFrame":
    """Render frame `index` of a scene, with the flow to the one after it where there is one.

    The noise depends on `seed` and `index` only. For many frames build one `Renderer`.
    """
    if not 0 <= index < scene.frame_count:
        raise BadInput(f"scene {scene.name}: expected a frame from 0 to {scene.frame_count - 1}, got {index}")
    following = scene.vertices(index + 1) if index + 1 < scene.frame_count else None
    renderer = Renderer(scene, nuisances, options)
    return renderer.render(scene.vertices(index), following, frame_generator(seed, index), index)


def frame_generator(seed: int, index: int) -> np.random.Generator:
    """Return the generator of one frame's noise, whichever process renders it."""
    return np.random.default_rng([seed, index])


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameTruth:
    """Ground truth of one frame.

    normals: the shaded normal, relief included; where a pixel has several samples, their mean's direction.
    depth: metres, of the mesh (without relief), at the pixel's centre. Both masks are True where the ray
    through the pixel's centre meets the mesh. labels: (h, w) bit k set where light k reaches at least half
    of the pixel's samples. flow_px: (h, w, 2) to the next frame, 0 outside the mask, or None for the last
    frame. vertices: (n, 3) in the camera frame.
    """

    normals: NormalMap
    depth: DepthMap
    labels: VisibilityLabels
    flow_px: Flow | None
    vertices: Points


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedFrame:
    """One frame as filmed, and its truth.

    radiance: (h, w, 3) linear light before lens and sensor. stored: (h, w, 3) uint8 or uint16 as the file
    holds it. linear: what a reader who knows the transfer gets.
    """

    number: int
    radiance: LinearImage
    stored: Array
    linear: LinearFrame
    truth: FrameTruth
