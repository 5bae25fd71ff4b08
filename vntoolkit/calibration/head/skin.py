"""Normals and albedo of the skin from its colours in many poses (brostow2011, equation 1, in many frames).

A point of the skin turns with the head under lamps that stand still: r_f = diag(g) M_f R_f b in frame f. R_f
is the head's rotation into the camera frame, b the normal times the albedo, g the tint of the skin at that
point, near 1, and M_f is M where the point is in that frame, as lamps are near. One frame gives b where g is
1, two or three frames give both. Robust least squares over all frames leaves out shadow and gloss.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, Float32Array, FloatArray, IntArray, Mask, Points, read_only
from vntoolkit.calibration.head.samples import LEAST_FACING, RIM_PX, HeadRays, LightFrame
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.native import njit
from vntoolkit.photometry.response import LightResponse

_ERRORS = 12  # of the light: nine of M, three of nearness
LEAST_COSINE = 0.08  # to a row of M: flatter, the shape's error decides whether light arrives
# Scatter of the logarithm of the tint: while nobody knows how it follows the darkness, and where it is held
_FREE_TINT, _HELD_TINT = 1.0, 1e-4
_LEAST_SCATTER, _MOST_SCATTER = 0.005, 0.05  # about what the darkness tells
_CURVES = 2  # times that the typical tint is found
_CURVE_STEP = 0.1  # of the logarithm of the darkness: a freckle has five
_CURVE_END = 0.5  # percent of the vertices beyond each end
_LEAST_ON_CURVE = 50  # vertices in a step
_ROUNDS, _FIXED_ROUNDS = 8, 2  # with the tint, and with the tint held
_LEAST_FRAMES = 2
_HOLD = 1e-6  # of the system's trace: its determinant is not 0
_BLACK = 1e-6
_DAMPING, _LONGEST_STEP = 1e-4, 0.5  # rad, and logarithm of the albedo
_AGREEING = 0.25  # of its first weight: with less left, a colour is an outlier
_LEAST_NOISE = 0.004  # of the colour's length: below it registration decides, not the sensor


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinColours:
    """Colours of the vertices of a mesh in frames. rgb: (f, n, 3) float32. weight: (f, n) float32.

    weight: cosine to the viewer, 0 where a frame does not show the vertex unclipped. vertices: (n, 3), head
    frame. camera_from_head: of every frame.
    """

    rgb: Float32Array
    weight: Float32Array
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
        trusted = sampled(_trusted(each).astype(np.float32), pixel)
        seen = np.flatnonzero((facing > LEAST_FACING) & (trusted > 0.99))
        seen = seen[rays.free(seen, pose.inverse().rotate(towards[seen]))]
        shown = np.zeros(len(pixel), np.float32)
        shown[seen] = facing[seen]
        rgb.append(sampled(each.frame.rgb, pixel))
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


def sampled(image: Float32Array, pixel: Float32Array) -> Float32Array:
    """Return the image (h, w) or (h, w, 3) at pixels (n, 2), bilinear, 0 outside."""
    count = len(pixel)
    padded = np.full((max(1, -(-count // _ROW)) * _ROW, 2), -9.0, np.float32)
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
    weight: Float32Array
    agrees: BoolArray

    @property
    def known(self) -> BoolArray:
        """(n,) where there is a normal."""
        return np.asarray(np.isfinite(self.noise))


def skin_normals(colours: SkinColours, light: SkinLight, *, tint_is_free: bool = True) -> SkinNormals:
    """Solve r_f = diag(g) M_f R_f b at every vertex for b and g, robustly, or with g = 1.

    What is common to all frames, such as an error of M, looks like a tint and a turn of the normal together.
    But the more pigment darkens the skin, the more it tints it, in the same way all over a head. So every g
    is drawn to the one typical of skin as dark, which the vertices tell together.
    """
    rgb = colours.rgb - light.response.ambient.astype(np.float32)
    weight = colours.weight.copy()
    count = weight.shape[1]
    scaled, tint = np.zeros((count, 3)), np.ones((count, 3))
    spread = np.full(count, np.inf)

    def solve(rounds: int, curve: FloatArray, lowest: float = 0.0) -> None:
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
            curve,
            lowest,
        )

    solve(_ROUNDS, _flat(_FREE_TINT if tint_is_free else _HELD_TINT))
    known = np.isfinite(spread) & scaled.any(axis=1)
    if tint_is_free and known.any():
        for _ in range(_CURVES):
            curve, lowest = _tint_curve(scaled[known], tint[known])
            tint[:] = 1.0
            solve(_ROUNDS, curve, lowest)
        # M holds the skin's typical colour: left to the tint, a wrong balance of its rows stays.
        tint /= np.median(tint[known], axis=0)
        noise = spread.copy()  # with that of the tint
        solve(_FIXED_ROUNDS, _flat(_HELD_TINT))
        spread = noise
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


def _flat(scatter: float) -> FloatArray:
    return np.tile([0.0, 0.0, 0.0, scatter], (2, 1))


def _tint_curve(scaled: Points, tint: Points) -> tuple[FloatArray, float]:
    """Return tint by darkness, log |b|, in steps (k, 4): log of typical, scatter; and of the first."""
    darkness = np.log(np.linalg.norm(scaled, axis=1))
    lowest, highest = np.percentile(darkness, [_CURVE_END, 100.0 - _CURVE_END])
    steps = np.arange(int((highest - lowest) / _CURVE_STEP) + 2)
    at = np.round((darkness - lowest) / _CURVE_STEP)
    filled = [k for k in steps if np.count_nonzero(at == k) >= _LEAST_ON_CURVE]
    if not filled:
        return _flat(_MOST_SCATTER), float(lowest)
    curve = np.full((len(steps), 4), _MOST_SCATTER)
    own = {k: np.log(tint[at == k]) for k in filled}
    middle = np.stack([np.median(own[k], axis=0) for k in filled])
    curve[:, :3] = np.stack([np.interp(steps, filled, column) for column in middle.T], axis=1)
    scatter = [1.4826 * np.median(np.abs(own[k] - curve[k, :3])) for k in filled]
    curve[filled, 3] = np.clip(scatter, _LEAST_SCATTER, _MOST_SCATTER)
    return curve, float(lowest)


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
    rgb: Float32Array,
    weight: Float32Array,
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
    rgb: Float32Array,
    given: Float32Array,
    vertices: Points,
    weight: Float32Array,
    matrix: FloatArray,
    nearness: FloatArray,
    rotations: FloatArray,
    offsets: FloatArray,
    scaled: FloatArray,
    tint: FloatArray,
    spread: FloatArray,
    rounds: int,
    curve: FloatArray,
    lowest: float,
) -> None:
    """Turn the direction and change the logarithm of the albedo per channel, by Gauss and Newton."""
    frames, count = given.shape
    first, inverse, right = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    errors, shown = np.empty(frames), np.empty(frames, np.int64)
    rows, change, place = np.empty((frames, 3, 3)), np.empty(3), np.empty(3)
    normal, side, albedo, drawn = np.empty(3), np.empty((2, 3)), np.empty(3), np.empty(3)
    system, step, slope = np.empty((5, 5)), np.empty(5), np.empty(2)
    for i in range(count):
        n = 0
        for f in range(frames):
            if given[f, i] > 0:
                shown[n] = f
                n += 1
        if n < _LEAST_FRAMES:
            continue
        first[:], right[:] = 0.0, 0.0
        total, mean = 0.0, 0.0
        for f in shown[:n]:
            w = given[f, i]
            size = 0.0
            for k in range(3):
                place[k] = offsets[f, k]
                for j in range(3):
                    place[k] += rotations[f, k, j] * vertices[i, j]
            for c in range(3):
                row = rows[f, c]
                _row_kernel(matrix[c], nearness[c], rotations[f], place, row, change)
                size += rgb[f, i, c] ** 2
                for k in range(3):
                    right[k] += w * row[k] * rgb[f, i, c] / tint[i, c]
                    for j in range(3):
                        first[k, j] += w * row[k] * row[j]
            total += w
            mean += w * np.sqrt(size)
        hold = _HOLD * (first[0, 0] + first[1, 1] + first[2, 2])
        for k in range(3):
            first[k, k] += hold
        _invert(first, inverse)
        length = 0.0
        for k in range(3):
            normal[k] = inverse[k, 0] * right[0] + inverse[k, 1] * right[1] + inverse[k, 2] * right[2]
            length += normal[k] ** 2
        length = np.sqrt(length)
        if length == 0.0:
            continue
        for k in range(3):
            normal[k] /= length
            albedo[k] = length * tint[i, k]
            drawn[k] = np.log(tint[i, k])  # the tint is drawn to where it starts
        for _ in range(rounds):
            for at in range(n):
                f = shown[at]
                off = 0.0
                for c in range(3):
                    row = rows[f, c]
                    seen = row[0] * normal[0] + row[1] * normal[1] + row[2] * normal[2]
                    off += (rgb[f, i, c] - albedo[c] * seen) ** 2
                errors[at] = np.sqrt(off)
            noise = max(np.median(errors[:n]), _LEAST_NOISE * mean / total, _BLACK)
            _sides(normal, side)
            system[:], step[:] = 0.0, 0.0
            for at in range(n):
                f = shown[at]
                w = given[f, i] / (1.0 + (errors[at] / (2.0 * noise)) ** 2) ** 2
                weight[f, i] = w
                for c in range(3):
                    row = rows[f, c]
                    seen = albedo[c] * (row[0] * normal[0] + row[1] * normal[1] + row[2] * normal[2])
                    left = rgb[f, i, c] - seen
                    for s in range(2):
                        slope[s] = albedo[c] * (
                            row[0] * side[s, 0] + row[1] * side[s, 1] + row[2] * side[s, 2]
                        )
                        step[s] += w * slope[s] * left
                        system[s, 2 + c] += w * slope[s] * seen
                    system[0, 0] += w * slope[0] ** 2
                    system[0, 1] += w * slope[0] * slope[1]
                    system[1, 1] += w * slope[1] ** 2
                    system[2 + c, 2 + c] += w * seen**2
                    step[2 + c] += w * seen * left
            # errors of light and shape are alike in all frames: more frames do not tell the tint better
            _draw_tint(system, step, albedo, drawn, curve, lowest, total * noise**2 / 3.0)
            hold = _HOLD * (system[0, 0] + system[1, 1])
            for k in range(5):
                system[k, k] += _DAMPING * system[k, k] + hold
                for j in range(k):
                    system[k, j] = system[j, k]
            variance = noise**2 / 3.0 * _solve_five(system, step)
            shrink = 1.0
            for k in range(5):
                shrink = min(shrink, _LONGEST_STEP / max(abs(step[k]), _BLACK))
            length = 0.0
            for k in range(3):
                normal[k] += shrink * (step[0] * side[0, k] + step[1] * side[1, k])
                length += normal[k] ** 2
                albedo[k] *= np.exp(shrink * step[2 + k])
            for k in range(3):
                normal[k] /= np.sqrt(length)
        size = (albedo[0] * albedo[1] * albedo[2]) ** (1.0 / 3.0)
        for k in range(3):
            scaled[i, k] = size * normal[k]
            tint[i, k] = albedo[k] / size
        spread[i] = np.sqrt(variance / 2.0)


@njit(cache=True)
def _draw_tint(
    system: FloatArray,
    step: FloatArray,
    albedo: FloatArray,
    drawn: FloatArray,
    curve: FloatArray,
    lowest: float,
    variance: float,
) -> None:
    """Add to the equations that the logarithm of the tint is `drawn` and what the curve says."""
    darkness = (np.log(albedo[0]) + np.log(albedo[1]) + np.log(albedo[2])) / 3.0
    place = min(max((darkness - lowest) / _CURVE_STEP, 0.0), len(curve) - 1.001)
    below, share = int(place), place - int(place)
    pull = variance / (curve[below, 3] + share * (curve[below + 1, 3] - curve[below, 3])) ** 2
    for c in range(3):
        rise = curve[below + 1, c] - curve[below, c]
        off = np.log(albedo[c]) - darkness - drawn[c] - curve[below, c] - share * rise
        shared = (1.0 + rise / _CURVE_STEP) / 3.0  # of a change of any channel
        for j in range(3):
            own = (1.0 if c == j else 0.0) - shared
            step[2 + j] -= pull * own * off
            for k in range(3):
                system[2 + j, 2 + k] += pull * own * ((1.0 if c == k else 0.0) - shared)


@njit(cache=True)
def _sides(normal: FloatArray, side: FloatArray) -> None:
    """Write two unit vectors at right angles to a normal and to each other."""
    least = 0
    for k in range(1, 3):
        if abs(normal[k]) < abs(normal[least]):
            least = k
    length = np.sqrt(1.0 - normal[least] ** 2)
    for k in range(3):
        side[0, k] = ((1.0 if k == least else 0.0) - normal[least] * normal[k]) / length
    for k in range(3):
        side[1, k] = normal[(k + 1) % 3] * side[0, (k + 2) % 3] - normal[(k + 2) % 3] * side[0, (k + 1) % 3]


@njit(cache=True)
def _solve_five(a: FloatArray, b: FloatArray) -> float:
    """Solve a x = b for x in b, a (5, 5) symmetric; return the first two diagonal entries of 1 / a, added."""
    for p in range(4, 1, -1):
        for k in range(p):
            share = a[k, p] / a[p, p]
            b[k] -= share * b[p]
            for j in range(p):
                a[k, j] -= share * a[p, j]
    determinant = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    trace = (a[0, 0] + a[1, 1]) / determinant
    x = (a[1, 1] * b[0] - a[0, 1] * b[1]) / determinant
    b[1] = (a[0, 0] * b[1] - a[1, 0] * b[0]) / determinant
    b[0] = x
    for p in range(2, 5):
        for k in range(p):
            b[p] -= a[p, k] * b[k]
        b[p] /= a[p, p]
    return trace
