"""Colour, normal and visibility of the surface points that rays meet."""

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import Array, BoolArray, FloatArray, Points
from vntoolkit.geometry.rays import Hits, RayScene
from vntoolkit.native import njit
from vntoolkit.options.simulation import Nuisances
from vntoolkit.simulation.image_formation import exposure_of_scene
from vntoolkit.simulation.lights import MOST_LIGHTS
from vntoolkit.simulation.scene import Detail, Scene

_FAR_M = 100.0  # a parallel light's shadow rays end here
_SHADOW_OFFSET_M = 2e-4  # lifts a shadow ray off its own triangle; float32 at 5 m is exact to 5e-7


@dataclass(frozen=True, kw_only=True, eq=False)
class Shaded:
    """Surface points, one row each.

    colours: (p, 3). normals: (p, 3) that shaded them. lit: (p, 3) by label bit, True where the light arrives.
    """

    colours: FloatArray
    normals: FloatArray
    lit: BoolArray


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

    def shade(self, vertices: Points, normals: Points, hits: Hits, rays: RayScene) -> Shaded:
        """Shade where rays hit the mesh at `vertices` with unit vertex `normals`, both (n, 3)."""
        points, shading, origins = sample_geometry(
            vertices, normals, self._faces, hits.faces, hits.barycentric
        )
        self._tilt(shading, points, vertices, hits)
        lit = self._unblocked(origins, rays)
        exposure, lights = self._exposure, self._scene.lights
        colours = shade(
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
        slopes = sample_texture(self._slopes, self._tiled_uv, hits.faces, hits.barycentric)
        if detail.strength is not None:
            slopes *= self._at_hits(np.asarray(detail.strength, np.float64)[:, None], hits)
        tilt_normals(shading, points, slopes, vertices, self._faces, self._uv, hits.faces)

    def _unblocked(self, origins: Points, rays: RayScene) -> BoolArray:
        lit = np.ones((len(origins), len(self._scene.lights)), dtype=np.bool_)
        if not self._nuisances.shadows:
            return lit
        for k, position in enumerate(self._scene.lights.positions):
            if self._nuisances.near_lights:
                targets = np.broadcast_to(position, origins.shape)
            else:
                targets = origins + _FAR_M * self._exposure.directions[k]
            lit[:, k] = ~rays.blocked(origins, targets=targets)
        return lit

    def _weights(self, hits: Hits) -> FloatArray:
        """Return (p, b) the pigments' weights."""
        if self._vertex_weights is None and self._texture is None:
            reference = np.asarray(self._scene.surface.reference_weights, dtype=np.float64)
            return np.tile(reference, (len(hits.rays), 1))
        weights: FloatArray = np.ones((len(hits.rays), 3))
        if self._vertex_weights is not None:
            weights *= self._at_hits(self._vertex_weights, hits)
        if self._texture is not None and self._uv is not None:
            weights *= sample_texture(self._texture, self._uv, hits.faces, hits.barycentric)
        return weights

    def _at_hits(self, per_vertex: FloatArray, hits: Hits) -> FloatArray:
        """Interpolate (n, c) values to (p, c)."""
        return interpolate(per_vertex, self._faces, hits.faces, hits.barycentric)


def slopes_of(detail: Detail) -> FloatArray:
    """Return (th, tw, 2) dh/du and dh/dv of a tiling height map, in metres per unit of uv."""
    height = np.asarray(detail.height_m, dtype=np.float64)
    rows, columns = height.shape
    along_u = (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) * (columns * detail.repeats[0] / 2)
    along_v = (np.roll(height, -1, axis=0) - np.roll(height, 1, axis=0)) * (rows * detail.repeats[1] / 2)
    return np.stack([along_u, along_v], axis=-1)


def _contiguous(values: FloatArray | None) -> FloatArray | None:
    return None if values is None else np.ascontiguousarray(values)


# Compiled loops over surface samples.


@njit
def sample_geometry(
    vertices: Array, normals: Array, faces: Array, hit_faces: Array, barycentric: Array
) -> tuple[Array, Array, Array]:
    """Return points, unit normals towards the camera, shadow-ray origins: each (p, 3) float64.

    The origin is lifted to the smooth surface that the interpolated normals imply, so that the flat
    triangles of a coarse mesh do not shade themselves (hanika2021).
    """
    count = hit_faces.size
    points = np.empty((count, 3))
    shading = np.empty((count, 3))
    origins = np.empty((count, 3))
    p, n, lift = np.empty(3), np.empty(3), np.empty(3)
    for i in range(count):
        b1, b2 = np.float64(barycentric[i, 0]), np.float64(barycentric[i, 1])
        weights = (1.0 - b1 - b2, b1, b2)
        face = hit_faces[i]
        p[:], n[:], lift[:] = 0.0, 0.0, 0.0
        for c in range(3):
            for axis in range(3):
                p[axis] += weights[c] * vertices[faces[face, c], axis]
                n[axis] += weights[c] * normals[faces[face, c], axis]
        side = _outward_sign(vertices, faces, face, p)
        for c in range(3):
            v = faces[face, c]
            height = 0.0
            for axis in range(3):
                height += side * normals[v, axis] * (p[axis] - vertices[v, axis])
            below = min(0.0, height) * side
            for axis in range(3):
                lift[axis] -= weights[c] * below * normals[v, axis]
        _face_camera(n, p, side)
        for axis in range(3):
            points[i, axis] = p[axis]
            shading[i, axis] = n[axis]
            origins[i, axis] = p[axis] + lift[axis] + _SHADOW_OFFSET_M * n[axis]
    return points, shading, origins


@njit
def _outward_sign(vertices: Array, faces: Array, face: int, p: Array) -> float:
    """+1 where the face's outside looks at the camera (at the origin), −1 where its inside does."""
    a, b, c = vertices[faces[face, 0]], vertices[faces[face, 1]], vertices[faces[face, 2]]
    x = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    y = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    z = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    return 1.0 if x * p[0] + y * p[1] + z * p[2] <= 0.0 else -1.0


@njit
def _face_camera(n: Array, p: Array, side: float) -> None:
    """Normalise n in place, on the camera's side; just past a silhouette it becomes grazing."""
    distance = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    for _ in range(2):
        length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if length == 0.0:
            n[0], n[1], n[2] = -p[0] / distance, -p[1] / distance, -p[2] / distance
            return
        for axis in range(3):
            n[axis] *= side / length
        side = 1.0
        away = _dot(n, p) / distance
        if away <= 0.0:
            return
        for axis in range(3):
            n[axis] -= (away + 1e-6) * p[axis] / distance


@njit
def _texel(texture: Array, u: float, v: float, out: Array) -> None:
    """Bilinear look-up with tiling; texel centres at half-integers."""
    rows, columns = texture.shape[0], texture.shape[1]
    x, y = u * columns - 0.5, v * rows - 0.5
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - x0, y - y0
    left, top = _tiled(x0, columns), _tiled(y0, rows)
    right, bottom = _tiled(left + 1, columns), _tiled(top + 1, rows)
    for b in range(out.size):
        upper = texture[top, left, b] * (1.0 - fx) + texture[top, right, b] * fx
        lower = texture[bottom, left, b] * (1.0 - fx) + texture[bottom, right, b] * fx
        out[b] = upper * (1.0 - fy) + lower * fy


@njit
def _tiled(index: int, count: int) -> int:
    """`index` modulo `count`; mostly it lies within, and a division takes as long as all the rest."""
    return index if 0 <= index < count else index % count


@njit
def sample_texture(texture: Array, uv: Array, hit_faces: Array, barycentric: Array) -> Array:
    """Return (p, b) the texture at the samples."""
    count, bands = hit_faces.size, texture.shape[2]
    values = np.empty((count, bands))
    for i in range(count):
        b1, b2 = np.float64(barycentric[i, 0]), np.float64(barycentric[i, 1])
        corners = uv[hit_faces[i]]
        u = (1.0 - b1 - b2) * corners[0, 0] + b1 * corners[1, 0] + b2 * corners[2, 0]
        v = (1.0 - b1 - b2) * corners[0, 1] + b1 * corners[1, 1] + b2 * corners[2, 1]
        _texel(texture, u, v, values[i])
    return values


@njit
def interpolate(per_vertex: Array, faces: Array, hit_faces: Array, barycentric: Array) -> Array:
    """Return (p, c) the values (n, c) of the vertices at the samples."""
    count, width = hit_faces.size, per_vertex.shape[1]
    values = np.empty((count, width))
    for i in range(count):
        b1, b2 = np.float64(barycentric[i, 0]), np.float64(barycentric[i, 1])
        v0, v1, v2 = faces[hit_faces[i], 0], faces[hit_faces[i], 1], faces[hit_faces[i], 2]
        for c in range(width):
            values[i, c] = (
                (1.0 - b1 - b2) * per_vertex[v0, c] + b1 * per_vertex[v1, c] + b2 * per_vertex[v2, c]
            )
    return values


@njit
def tilt_normals(
    shading: Array, points: Array, slopes: Array, vertices: Array, faces: Array, uv: Array, hit_faces: Array
) -> None:
    """Tilt unit normals (p, 3) in place by the surface gradient of a height map (mikkelsen2010).

    slopes: (p, 2) dh/du and dh/dv in metres per unit of uv.
    """
    e1, e2, n, p = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    along_u, along_v = np.empty(3), np.empty(3)
    across_u, across_v, outward = np.empty(3), np.empty(3), np.empty(3)
    for i in range(hit_faces.size):
        face = hit_faces[i]
        du1, dv1 = uv[face, 1, 0] - uv[face, 0, 0], uv[face, 1, 1] - uv[face, 0, 1]
        du2, dv2 = uv[face, 2, 0] - uv[face, 0, 0], uv[face, 2, 1] - uv[face, 0, 1]
        det = du1 * dv2 - du2 * dv1
        for axis in range(3):
            start = vertices[faces[face, 0], axis]
            e1[axis] = vertices[faces[face, 1], axis] - start
            e2[axis] = vertices[faces[face, 2], axis] - start
            along_u[axis] = dv2 * e1[axis] - dv1 * e2[axis]
            along_v[axis] = du1 * e2[axis] - du2 * e1[axis]
            n[axis], p[axis] = shading[i, axis], points[i, axis]
        _cross(along_v, n, across_u)
        _cross(n, along_u, across_v)
        volume = _dot(along_u, across_u)
        if det == 0.0 or volume == 0.0:
            continue
        # The height grows along the outward normal; seen from inside, n is flipped and so is the slope.
        _cross(e1, e2, outward)
        scale = det / volume if _dot(outward, n) >= 0.0 else -det / volume
        for axis in range(3):
            n[axis] -= scale * (slopes[i, 0] * across_u[axis] + slopes[i, 1] * across_v[axis])
        _face_camera(n, p, 1.0)
        for axis in range(3):
            shading[i, axis] = n[axis]


@njit
def _dot(a: Array, b: Array) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def _cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit
def shade(
    points: Array, shading: Array, weights: Array, gloss: Array, exponent: float, lit: Array,
    positions: Array, directions: Array, distances: Array, near: bool,
    pigment_colours: Array, ambient_colours: Array, gloss_colours: Array,
) -> Array:  # fmt: skip
    """Return (p, 3) colour of the samples: equations 1 to 3 per lamp, plus ambient, plus gloss.

    lit: (p, k) on entry False where a cast shadow lies; on return also where the surface turns away.
    """
    lights, pigments = pigment_colours.shape[0], pigment_colours.shape[1]
    colours = np.zeros((len(points), 3))
    for i in range(len(points)):
        n, p, colour = shading[i], points[i], colours[i]
        distance = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
        for b in range(pigments):
            for c in range(3):
                colour[c] += weights[i, b] * ambient_colours[b, c]
        for k in range(lights):
            if near:
                x, y, z = positions[k, 0] - p[0], positions[k, 1] - p[1], positions[k, 2] - p[2]
                away = np.sqrt(x * x + y * y + z * z)
                x, y, z, power = x / away, y / away, z / away, (distances[k] / away) ** 2
            else:
                x, y, z, power = directions[k, 0], directions[k, 1], directions[k, 2], 1.0
            cosine = n[0] * x + n[1] * y + n[2] * z
            lit[i, k] = lit[i, k] and cosine > 0.0
            if not lit[i, k]:
                continue
            for b in range(pigments):
                for c in range(3):
                    colour[c] += power * cosine * weights[i, b] * pigment_colours[k, b, c]
            if gloss[i] > 0.0:
                hx, hy, hz = x - p[0] / distance, y - p[1] / distance, z - p[2] / distance
                length = np.sqrt(hx * hx + hy * hy + hz * hz)
                mirror = max(0.0, (n[0] * hx + n[1] * hy + n[2] * hz) / length)
                share = gloss[i] * (exponent + 8.0) / 8.0 * mirror**exponent * power * cosine
                for c in range(3):
                    colour[c] += share * gloss_colours[k, c]
    return colours
