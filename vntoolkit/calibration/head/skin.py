"""Normals and albedo of the skin from its colours in many poses (brostow2011, equation 1, in many frames).

A point of the skin turns with the head under lamps that stand still: r_f = diag(g) M_f R_f b in frame f. R_f
is the head's rotation into the camera frame, b the normal times the albedo, g the tint of the skin at that
point, near 1, and M_f is M where the point is in that frame, as lamps are near. One frame gives b where g is
1, two or three frames give both. Robust least squares over all frames leaves out shadow and gloss.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, IntArray, Mask, Points, read_only
from vntoolkit.calibration.head.samples import LEAST_FACING, RIM_PX, HeadRays, LightFrame
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.native import njit
from vntoolkit.photometry.response import LightResponse

_ERRORS = 12  # of the light: nine of M, three of nearness
_LEAST_COSINE = 0.08  # to a row of M: flatter, the shape's error decides whether light arrives
_TINT_SPREAD = 0.05  # standard deviation of the logarithm of the tint on skin
_ROUNDS, _FIXED_ROUNDS = 8, 2  # with the tint, and with the tint held
_LEAST_FRAMES = 2
_HOLD = 1e-6  # of the system's trace: its determinant is not 0
_BLACK = 1e-6
_MOST_TINT = 4.0
_AGREEING = 0.25  # of its first weight: with less left, a colour is an outlier
_LEAST_NOISE = 0.004  # of the colour's length: below it registration decides, not the sensor
Array = npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinColours:
    """Colours of the vertices of a mesh in frames. rgb: (f, n, 3) float32. weight: (f, n) float32.

    weight: cosine to the viewer, 0 where a frame does not show the vertex unclipped. vertices: (n, 3), head
    frame. camera_from_head: of every frame.
    """

    rgb: Array
    weight: Array
    vertices: Points
    camera_from_head: tuple[RigidTransform, ...]

    @property
    def rotations(self) -> FloatArray:
        """(f, 3, 3)."""
        return np.stack([pose.rotation for pose in self.camera_from_head])

    @property
    def offsets(self) -> FloatArray:
        """(f, 3): where the head frame's origin is in each camera frame, from its mean place."""
        places = np.stack([pose.translation for pose in self.camera_from_head])
        middle = self.rotations @ self.vertices.mean(axis=0) + places
        return np.asarray(places - middle.mean(axis=0))

    def __post_init__(self) -> None:
        object.__setattr__(self, "rgb", read_only(self.rgb))
        object.__setattr__(self, "weight", read_only(self.weight))


def skin_colours(mesh: Mesh, camera: Camera, frames: Iterable[LightFrame]) -> SkinColours:
    """Take the colours of the vertices of a mesh (head frame, with normals) in every frame."""
    assert mesh.normals is not None
    rays = HeadRays(mesh)
    rgb, weight, poses = [], [], []
    for each in frames:
        pose = each.camera_from_head
        position = pose.apply(mesh.vertices)
        towards = -position / np.linalg.norm(position, axis=1, keepdims=True)
        facing = (pose.rotate(mesh.normals) * towards).sum(axis=1)
        pixel = camera.project(position).astype(np.float32)
        trusted = _sampled(_trusted(each).astype(np.float32), pixel)
        seen = np.flatnonzero((facing > LEAST_FACING) & (trusted > 0.99))
        seen = seen[rays.free(seen, pose.inverse().rotate(towards[seen]))]
        shown = np.zeros(len(pixel), np.float32)
        shown[seen] = facing[seen]
        rgb.append(_sampled(each.frame.rgb, pixel))
        weight.append(shown)
        poses.append(pose)
    return SkinColours(
        rgb=np.stack(rgb), weight=np.stack(weight), vertices=mesh.vertices, camera_from_head=tuple(poses)
    )


def _trusted(each: LightFrame) -> Mask:
    """True well inside the silhouette, where no pixel is clipped."""
    kernel = np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), np.uint8)
    inner = np.asarray(cv2.erode(each.mask.astype(np.uint8), kernel)) > 0
    clipped = np.asarray(cv2.dilate(each.frame.clipped.astype(np.uint8), np.ones((3, 3), np.uint8))) > 0
    return inner & ~clipped


_ROW = 1024  # OpenCV resamples images, no lists: points are laid out in rows


def _sampled(image: Array, pixel: Array) -> Array:
    """Return the image (h, w) or (h, w, 3) at pixels (n, 2), bilinear, 0 outside."""
    count = len(pixel)
    padded = np.full((-(-count // _ROW) * _ROW, 2), -9.0, np.float32)
    padded[:count] = pixel
    u, v = (np.ascontiguousarray(padded[:, k].reshape(-1, _ROW)) for k in range(2))
    sampled = cv2.remap(np.asarray(image), u, v, cv2.INTER_LINEAR, borderValue=0)
    return np.asarray(sampled.reshape(-1, *image.shape[2:])[:count])


def without_shadow(colours: SkinColours, mesh: Mesh, response: LightResponse) -> SkinColours:
    """Return the colours with weight 0 where the mesh says that the rows of M do not reach a vertex."""
    assert mesh.normals is not None
    rays = HeadRays(mesh)
    weight = colours.weight.copy()
    for own, pose in zip(weight, colours.camera_from_head, strict=True):
        for direction in response.light_directions:
            in_head = pose.inverse().rotate(direction)
            own[mesh.normals @ in_head < _LEAST_COSINE] = 0
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


@njit(cache=True)
def _row_kernel(
    row: FloatArray,
    nearness: float,
    rotation: FloatArray,
    place: FloatArray,
    out: FloatArray,
    change: FloatArray,
) -> None:
    """Turn a row of M at a place from the camera into the head frame, with its change by nearness."""
    length = np.sqrt(row[0] ** 2 + row[1] ** 2 + row[2] ** 2)
    along = (row[0] * place[0] + row[1] * place[1] + row[2] * place[2]) / length
    for j in range(3):
        out[j], change[j] = 0.0, 0.0
        for k in range(3):
            moved = 3.0 * along * row[k] - length * place[k]
            out[j] += (row[k] + nearness * moved) * rotation[k, j]
            change[j] += moved * rotation[k, j]


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinNormals:
    """What the colours say of every vertex: (n, 3) each, n for the vertices.

    normals: unit, head frame, 0 where too little is seen. albedo: (n, 3), over the skin's median. noise: (n,)
    standard deviation of the direction in radians, infinite where there is no normal. scaled, tint: (n, 3),
    b and g. weight: (f, n), how far the solution explains a colour. agrees: (f, n) bool, where it does.
    """

    normals: Points
    albedo: FloatArray
    noise: FloatArray
    scaled: Points
    tint: FloatArray
    weight: Array
    agrees: npt.NDArray[np.bool_]

    @property
    def known(self) -> npt.NDArray[np.bool_]:
        """(n,) where there is a normal."""
        return np.asarray(np.isfinite(self.noise))


def skin_normals(colours: SkinColours, light: SkinLight, *, tint_is_free: bool = True) -> SkinNormals:
    """Solve r_f = diag(g) M_f R_f b at every vertex for b and g, robustly, or with g = 1."""
    rgb = colours.rgb - light.response.ambient.astype(np.float32)
    weight = colours.weight.copy()
    count = weight.shape[1]
    scaled, tint = np.zeros((count, 3)), np.ones((count, 3))
    spread = np.full(count, np.inf)

    def solve(rounds: int, tint_is_free: bool) -> None:
        _solve_kernel(
            rgb,
            colours.weight,
            colours.vertices,
            weight,
            np.asarray(light.response.matrix),
            light.nearness,
            colours.rotations,
            colours.offsets,
            scaled,
            tint,
            spread,
            rounds,
            tint_is_free,
        )

    solve(_ROUNDS, tint_is_free)
    known = np.isfinite(spread) & scaled.any(axis=1)
    if tint_is_free and known.any():
        # M holds the skin's typical colour: left to the tint, a wrong balance of its rows stays.
        tint /= np.median(tint[known], axis=0)
        solve(_FIXED_ROUNDS, False)
    length = np.linalg.norm(scaled, axis=1)
    normals = np.divide(scaled, length[:, None], out=np.zeros_like(scaled), where=known[:, None])
    albedo = np.where(known[:, None], tint * length[:, None], 1.0)
    return SkinNormals(
        normals=normals,
        albedo=albedo / np.median(albedo[known], axis=0) if known.any() else albedo,
        noise=np.where(known, spread, np.inf),
        scaled=scaled,
        tint=tint,
        weight=weight,
        agrees=(weight > _AGREEING * colours.weight) & known,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class LightErrors:
    """What errors of the light do to the solution.

    Of 12 errors, the first nine are those of E, row by row, where M (I + E) is right, then three of nearness.
    turned: (n, 3, 12), normals less those by the right light, per unit of error. system: (r, 12, 12), right:
    (r, 12), the normal equations for the errors of what the frames' disagreement says, by region. They leave
    open what every b can follow: E that commutes with the turn, such as the scale along its axis.
    """

    turned: FloatArray
    system: FloatArray
    right: FloatArray


def light_errors(
    colours: SkinColours, skin: SkinNormals, light: SkinLight, share: FloatArray, region: IntArray
) -> LightErrors:
    """Differentiate the solutions by the light.

    share: (n,) independent observations that a vertex stands for. region: (n,) its region, 0 to r − 1.
    """
    turned = np.zeros((len(skin.normals), 3, _ERRORS))
    regions = int(region.max()) + 1
    system, right = np.zeros((regions, _ERRORS, _ERRORS)), np.zeros((regions, _ERRORS))
    _derivatives_kernel(
        colours.rgb - light.response.ambient.astype(np.float32),
        skin.weight,
        colours.vertices,
        np.asarray(light.response.matrix),
        light.nearness,
        colours.rotations,
        colours.offsets,
        np.where(skin.known[:, None], skin.scaled, 0.0),
        skin.tint,
        share,
        region,
        turned,
        system,
        right,
    )
    along = np.einsum("ni,nik->nk", skin.normals, turned)
    turned -= skin.normals[:, :, None] * along[:, None, :]
    return LightErrors(turned=turned, system=system, right=right)


@njit(cache=True)
def _derivatives_kernel(
    rgb: Array,
    weight: Array,
    vertices: Points,
    matrix: FloatArray,
    nearness: FloatArray,
    rotations: FloatArray,
    offsets: FloatArray,
    scaled: Points,
    tint: FloatArray,
    share: FloatArray,
    region: IntArray,
    turned: FloatArray,
    system: FloatArray,
    right: FloatArray,
) -> None:
    frames, count = weight.shape
    own, inverse = np.empty((3, 3)), np.empty((3, 3))
    mixed, both = np.empty((3, _ERRORS)), np.empty((_ERRORS, _ERRORS))
    slope, off, followed = np.empty(_ERRORS), np.empty(_ERRORS), np.empty((3, _ERRORS))
    row, change, place = np.empty(3), np.empty(3), np.empty(3)
    for i in range(count):
        b, g = scaled[i], tint[i]
        size = b[0] ** 2 + b[1] ** 2 + b[2] ** 2
        if size == 0.0:
            continue
        length = np.sqrt(size)
        own[:], mixed[:], both[:], off[:] = 0.0, 0.0, 0.0, 0.0
        squares, total, brightness = 0.0, 0.0, 0.0
        for f in range(frames):
            w = weight[f, i]
            if w == 0.0:
                continue
            total += w
            turn = rotations[f]
            for k in range(3):
                place[k] = offsets[f, k]
                for j in range(3):
                    place[k] += turn[k, j] * vertices[i, j]
            for c in range(3):
                _row_kernel(matrix[c], nearness[c], turn, place, row, change)
                value = 0.0
                slope[9:] = 0.0
                for k in range(3):
                    row[k] *= g[c]
                    value += row[k] * b[k]
                    slope[9 + c] += g[c] * change[k] * b[k]
                    seen = turn[k, 0] * b[0] + turn[k, 1] * b[1] + turn[k, 2] * b[2]
                    for j in range(3):
                        slope[3 * j + k] = g[c] * matrix[c, j] * seen
                left = rgb[f, i, c] - value
                squares += w * left**2
                brightness += w * value**2
                for k in range(_ERRORS):
                    off[k] += w * slope[k] * left
                    for j in range(_ERRORS):
                        both[k, j] += w * slope[k] * slope[j]
                    for j in range(3):
                        mixed[j, k] += w * row[j] * slope[k]
                for k in range(3):
                    for j in range(3):
                        own[k, j] += w * row[k] * row[j]
        for k in range(3):
            own[k, k] += _HOLD * brightness / size
        _invert(own, inverse)
        noise = max(squares, _LEAST_NOISE**2 * brightness) / (3.0 * total)
        for k in range(3):
            for j in range(_ERRORS):
                followed[k, j] = (
                    inverse[k, 0] * mixed[0, j] + inverse[k, 1] * mixed[1, j] + inverse[k, 2] * mixed[2, j]
                )
                turned[i, k, j] = followed[k, j] / length
        for k in range(_ERRORS):
            right[region[i], k] += share[i] / noise * off[k]
            for j in range(_ERRORS):
                kept = both[k, j]
                for m in range(3):
                    kept -= mixed[m, k] * followed[m, j]
                system[region[i], k, j] += share[i] / noise * kept


@njit(cache=True)
def _invert(a: FloatArray, out: FloatArray) -> None:
    """Invert a symmetric 3×3 matrix that is positive definite."""
    out[0, 0] = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    out[0, 1] = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    out[0, 2] = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    out[1, 1] = a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]
    out[1, 2] = a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]
    out[2, 2] = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    determinant = a[0, 0] * out[0, 0] + a[0, 1] * out[0, 1] + a[0, 2] * out[0, 2]
    for k in range(3):
        for j in range(3):
            out[k, j] /= determinant


@njit(cache=True)
def _solve_kernel(
    rgb: Array,
    given: Array,
    vertices: Points,
    weight: Array,
    matrix: FloatArray,
    nearness: FloatArray,
    rotations: FloatArray,
    offsets: FloatArray,
    scaled: FloatArray,
    tint: FloatArray,
    spread: FloatArray,
    rounds: int,
    tint_is_free: bool,
) -> None:
    frames, count = given.shape
    system, inverse, right = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    shading, errors, shown = np.empty((frames, 3)), np.empty(frames), np.empty(frames, np.int64)
    rows, change, place = np.empty((frames, 3, 3)), np.empty(3), np.empty(3)
    for i in range(count):
        n = 0
        for f in range(frames):
            if given[f, i] > 0:
                shown[n] = f
                n += 1
        if n < _LEAST_FRAMES:
            continue
        for f in shown[:n]:
            for k in range(3):
                place[k] = offsets[f, k]
                for j in range(3):
                    place[k] += rotations[f, k, j] * vertices[i, j]
            for c in range(3):
                _row_kernel(matrix[c], nearness[c], rotations[f], place, rows[f, c], change)
        b = scaled[i]
        noise = 0.0
        for _ in range(rounds):
            system[:] = 0.0
            right[:] = 0.0
            for f in shown[:n]:
                w = weight[f, i]
                for c in range(3):
                    value = rgb[f, i, c] / tint[i, c]
                    for k in range(3):
                        right[k] += w * rows[f, c, k] * value
                        for j in range(3):
                            system[k, j] += w * rows[f, c, k] * rows[f, c, j]
            hold = _HOLD * (system[0, 0] + system[1, 1] + system[2, 2])
            for k in range(3):
                system[k, k] += hold
            _invert(system, inverse)
            for k in range(3):
                b[k] = inverse[k, 0] * right[0] + inverse[k, 1] * right[1] + inverse[k, 2] * right[2]
            total, mean = 0.0, 0.0
            for at in range(n):
                f = shown[at]
                off, size = 0.0, 0.0
                for c in range(3):
                    row = rows[f, c]
                    shading[at, c] = row[0] * b[0] + row[1] * b[1] + row[2] * b[2]
                    off += (rgb[f, i, c] - tint[i, c] * shading[at, c]) ** 2
                    size += rgb[f, i, c] ** 2
                errors[at] = np.sqrt(off)
                total += given[f, i]
                mean += given[f, i] * np.sqrt(size)
            noise = max(np.median(errors[:n]), _LEAST_NOISE * mean / total, _BLACK)
            for at in range(n):
                f = shown[at]
                weight[f, i] = given[f, i] / (1.0 + (errors[at] / (2.0 * noise)) ** 2) ** 2
            if not tint_is_free:
                continue
            prior = (noise / _TINT_SPREAD) ** 2 / 3.0  # draws the tint to 1 as far as noise leaves it open
            product = 1.0
            for c in range(3):
                over, under = prior, prior
                for at in range(n):
                    w = weight[shown[at], i]
                    over += w * rgb[shown[at], i, c] * shading[at, c]
                    under += w * shading[at, c] ** 2
                tint[i, c] = min(max(over / under, 1.0 / _MOST_TINT), _MOST_TINT)
                product *= tint[i, c]
            for c in range(3):
                tint[i, c] /= product ** (1.0 / 3.0)
        length = np.sqrt(b[0] ** 2 + b[1] ** 2 + b[2] ** 2)
        if length > 0:
            along = 0.0
            for k in range(3):
                for j in range(3):
                    along += b[k] * inverse[k, j] * b[j] / length**2
            across = inverse[0, 0] + inverse[1, 1] + inverse[2, 2] - along
            spread[i] = noise * np.sqrt(max(across, 0.0) / 2.0) / length
