"""Normals and albedo of the skin from its colours in many poses (brostow2011, equation 1, in many frames).

A point of the skin turns with the head under lamps that stand still: r_f = M_f R_f b in frame f. R_f is the
head's rotation into the camera frame, b the normal times the albedo, and M_f is M where the point is in that
frame, as lamps are near. Robust least squares over all frames leaves out shadow and gloss.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from vntoolkit.arrays import BoolArray, Float32Array, FloatArray, IntArray, Points
from vntoolkit.calibration.head.light import LEAST_COSINE
from vntoolkit.calibration.head.samples import HeadRays, SkinColours
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.photometry.response import LightResponse

_ROUNDS = 8  # of robust least squares
_FEWEST_FRAMES = 2
RIDGE = 1e-6  # of the system's trace: it can be solved where all frames show one side
LEAST_RESIDUAL = 0.004  # of the colour's length: below it registration decides, not the sensor
_INLIER_WEIGHT = 0.25  # of its first weight: with less left, a colour is an outlier
_VERTICES = 10_000  # solved at a time


def without_shadow(colours: SkinColours, mesh: Mesh, response: LightResponse) -> SkinColours:
    """Return the colours with weight 0 where the mesh says that the rows of M do not reach a vertex."""
    assert mesh.normals is not None
    rays = HeadRays(mesh)
    weight = colours.weight.copy()
    for own, pose in zip(weight, colours.camera_from_head, strict=True):
        for direction in response.light_directions:
            in_head = pose.inverse().rotate(direction)
            own[mesh.normals @ in_head < LEAST_COSINE] = 0
            left = np.flatnonzero(own)
            own[left[~rays.free(left, np.broadcast_to(in_head, (len(left), 3)))]] = 0
    return replace(colours, weight=weight)


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinLight:
    """What lights the skin. response: M at the head's mean place. nearness: (3,), 1 / distance of the lamps.

    Each channel is taken for one lamp, in the direction m̂ of its row m of M. Light from a distance d, at x
    from the mean place, has the row m + |m| (3 (m̂ · x) m̂ − x) / d, but for squares of |x| / d.
    """

    response: LightResponse
    nearness: FloatArray = field(default_factory=lambda: np.zeros(3))


def rows_at(colours: SkinColours, light: SkinLight, part: slice) -> tuple[FloatArray, FloatArray]:
    """Return the rows of M_f R_f at some vertices, (f, n, 3, 3), and their change by nearness."""
    matrix = np.asarray(light.response.matrix)
    places = colours.vertices[part] @ colours.rotations.transpose(0, 2, 1) + colours.offsets[:, None]
    length = np.linalg.norm(matrix, axis=1)
    along = places @ (matrix / length[:, None]).T
    change = 3.0 * along[..., None] * matrix - length[:, None] * places[:, :, None]
    turns = colours.rotations[:, None]
    return (matrix + light.nearness[:, None] * change) @ turns, change @ turns


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinNormals:
    """What the colours say of every vertex: (n, 3) each, n for the vertices.

    normals: unit, head frame, 0 where too little is seen. albedo: (n, 3), over the skin's median. noise: (n,)
    standard deviation of the direction in radians, infinite where there is no normal. scaled: (n, 3), b.
    weight: (f, n), how far the solution explains a colour. agrees: (f, n) bool, where it does.
    """

    normals: Points
    albedo: FloatArray
    noise: FloatArray
    scaled: Points
    weight: Float32Array
    agrees: BoolArray

    @property
    def known(self) -> BoolArray:
        """(n,) where there is a normal."""
        return np.asarray(np.isfinite(self.noise))


def skin_normals(colours: SkinColours, light: SkinLight) -> SkinNormals:
    """Solve r_f = M_f R_f b at every vertex for b, robustly."""
    parts = [
        _solved(rows_at(colours, light, part)[0], rgb, given) for part, rgb, given in parts_of(colours, light)
    ]
    scaled, albedo, noise = (np.concatenate([part[k] for part in parts]) for k in range(3))
    weight = np.concatenate([part[3] for part in parts], axis=1)
    known = np.isfinite(noise)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    albedo = np.where(known[:, None] & (albedo > 0), albedo, 1.0)
    return SkinNormals(
        normals=np.divide(scaled, length, out=np.zeros_like(scaled), where=known[:, None]),
        albedo=albedo / np.median(albedo[known], axis=0) if known.any() else albedo,
        noise=noise,
        scaled=scaled,
        weight=weight.astype(np.float32),
        agrees=(weight > _INLIER_WEIGHT * colours.weight) & known,
    )


def parts_of(colours: SkinColours, light: SkinLight) -> Iterator[tuple[slice, FloatArray, FloatArray]]:
    """Yield vertices, some at a time, with their colours (f, n, 3) less ambient light, and weights (f, n)."""
    for start in range(0, colours.weight.shape[1], _VERTICES):
        part = slice(start, start + _VERTICES)
        rgb = colours.rgb[:, part].astype(np.float64) - light.response.ambient
        yield part, rgb, colours.weight[:, part].astype(np.float64)


def _solved(
    rows: FloatArray, rgb: FloatArray, given: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return b (n, 3), albedo by channel (n, 3), noise of the direction (n,) and final weights (f, n)."""
    shown, weight = given > 0, given
    count, total = shown.sum(axis=0), np.maximum(given.sum(axis=0), 1e-9)
    least = LEAST_RESIDUAL * (given * np.linalg.norm(rgb, axis=2)).sum(axis=0) / total + 1e-9
    for _ in range(_ROUNDS):
        system = np.einsum("fn,fnck,fncl->nkl", weight, rows, rows, optimize=True)
        ridge = RIDGE * np.trace(system, axis1=1, axis2=2) + 1e-12
        inverse = np.linalg.inv(system + ridge[:, None, None] * np.eye(3))
        right = np.einsum("fn,fnck,fnc->nk", weight, rows, rgb, optimize=True)
        scaled = (inverse @ right[..., None])[..., 0]
        seen = (rows @ scaled[:, :, None])[..., 0]
        errors = np.linalg.norm(rgb - seen, axis=2)
        noise = np.maximum(_median_shown(errors, shown, count), least)
        weight = given / (1.0 + (errors / (2.0 * noise)) ** 2) ** 2
    size = np.square(scaled).sum(axis=1)
    known = (count >= _FEWEST_FRAMES) & (size > 0)
    across = np.trace(inverse, axis1=1, axis2=2) * size - np.einsum("nk,nkl,nl->n", scaled, inverse, scaled)
    spread = np.sqrt(np.maximum(noise**2 / 3.0 * across / 2.0, 0.0)) / np.where(known, size, 1.0)
    fit = (weight[..., None] * seen * rgb).sum(axis=0) / ((weight[..., None] * seen**2).sum(axis=0) + 1e-12)
    return scaled, fit * np.sqrt(size)[:, None], np.where(known, spread, np.inf), weight


def _median_shown(errors: FloatArray, shown: BoolArray, count: IntArray) -> FloatArray:
    """Return the median (n,) of errors (f, n) over the frames that show a vertex."""
    ordered = np.sort(np.where(shown, errors, np.inf), axis=0)
    middle = np.stack([np.maximum(count - 1, 0) // 2, np.minimum(count, len(errors) - 1) // 2])
    return np.where(count > 0, np.take_along_axis(ordered, middle, axis=0).mean(axis=0), 0.0)
