"""Points of the skin found again in all frames, by patches of the shape (bouguet2001).

Tracks go from frame to frame: where shading moves over the skin it takes them along, and their errors add up.
A shape tells what a patch of skin looks like from any side, so each is compared with the frame that sees it
best, however far the head has turned. Images are logarithms: light that is smooth over a patch only adds.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.spatial import cKDTree

from vntoolkit.arrays import ByteArray, FloatArray, IntArray, LinearImage, Points, read_only
from vntoolkit.calibration.head.hull import SilhouetteView
from vntoolkit.calibration.head.samples import HeadRays
from vntoolkit.calibration.head.tracks import Tracks
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rays import RayScene
from vntoolkit.native import njit

_SMOOTH_PX = 6.0  # standard deviation of the window whose mean is light
_FLOOR = 3.5 / 255.0  # of full scale: darker is noise
_WIDEST_VALUE = 0.4  # of the logarithm, that becomes black or white in 8 bits
_HALF_PX = 6  # of a patch's side, as the windows of tracks have
_SOFT = 0.5  # standard deviation of the weight within a patch, of half its side
_RIM_PX = 6  # nearer to the silhouette's edge, a patch hangs over
_LEAST_FACING = 0.4  # cosine to the viewer
_NEAR = 0.01  # of the diagonal: how far a point may lie off the shape, and a patch's relief off its plane
_LEAST_CORRELATION = 0.75
_MOST_PX = 3.0  # off the expected place: poses are known better
_LEAST_FRAMES = 4
_STEPS, _SETTLED_PX = 8, 0.01
_LEAST_CORNER = 1e-4  # determinant over the squared trace: less is an edge, which slides
_TINY = 1e-9


def detail_in_8_bits(rgb: LinearImage) -> ByteArray:
    """Return the logarithm of the brightness of rgb (h, w, 3) less its mean around, (h, w)."""
    level = np.log(np.asarray(rgb, dtype=np.float32).mean(axis=2) + np.float32(_FLOOR))
    detail = level - cv2.GaussianBlur(level, (0, 0), _SMOOTH_PX)
    return np.clip(127.5 + 127.5 / _WIDEST_VALUE * detail, 0, 255).astype(np.uint8)


def find_again(
    views: Sequence[SilhouetteView],
    details: Sequence[ByteArray],
    mesh: Mesh,
    points: Points,
) -> tuple[Tracks, Points, IntArray]:
    """Find points (n, 3) of the mesh (head frame, with normals) in every frame that sees them.

    details: (h, w) of every view. Returns the tracks of those that several frames show, their places on the
    mesh (t, 3), and which points they are (t,).
    """
    assert mesh.normals is not None
    vertex = cKDTree(mesh.vertices).query(points)[1]
    near = np.flatnonzero(np.linalg.norm(mesh.vertices[vertex] - points, axis=1) < _NEAR * mesh.diagonal)
    vertex, pixel = vertex[near], 1.0 / views[0].camera.matrix[0, 0]  # the head's distance is 1
    patches = _patches(mesh, points[near], mesh.normals[vertex], pixel)
    middle = patches[:, patches.shape[1] // 2]
    facing = _facing(views, mesh, vertex, middle)
    place, correlation = np.zeros((*facing.shape, 2)), np.zeros(facing.shape)
    poses = [view.camera_from_head for view in views]
    _search_kernel(
        np.stack(details),
        np.asarray(views[0].camera.matrix),
        np.stack([pose.rotation for pose in poses]),
        np.stack([pose.translation for pose in poses]),
        patches,
        facing,
        _weights(),
        place,
        correlation,
    )
    found = correlation > _LEAST_CORRELATION
    found &= found.sum(axis=0) >= _LEAST_FRAMES
    kept = np.flatnonzero(found.any(axis=0))
    point, frame = np.nonzero(found.T)
    tracks = Tracks(
        point=np.searchsorted(kept, point),
        frame=frame,
        positions_px=place[frame, point],
        frame_count=len(views),
    )
    return tracks, middle[kept], near[kept]


def _weights() -> FloatArray:
    across = np.exp(-0.5 * np.square(np.arange(-_HALF_PX, _HALF_PX + 1) / (_SOFT * _HALF_PX)))
    weights = np.outer(across, across).ravel()
    return np.asarray(weights / weights.sum())


def _patches(mesh: Mesh, points: Points, normals: Points, pixel: float) -> FloatArray:
    """Return (n, k, 3): a square grid across each normal, a pixel apart, laid onto the mesh along it."""
    across = np.cross([0.0, 1.0, 0.0], normals)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), _TINY)
    steps = pixel * np.arange(-_HALF_PX, _HALF_PX + 1)
    first, second = (each.ravel()[:, None] for each in np.meshgrid(steps, steps, indexing="ij"))
    flat = points[:, None] + first * across[:, None] + second * np.cross(normals, across)[:, None]
    above = 2.0 * _NEAR * mesh.diagonal
    down = np.broadcast_to(-normals[:, None], flat.shape).reshape(-1, 3)
    starts = flat.reshape(-1, 3) - above * down
    rays = np.concatenate([starts, down], axis=1, dtype=np.float32)
    hits = RayScene((mesh.vertices, mesh.faces), threads=1).first_hits(rays)
    way = np.full(len(rays), above)
    way[hits.rays] = hits.distances
    way[np.abs(way - above) > _NEAR * mesh.diagonal] = above  # beyond a step of the shape
    return np.asarray((starts + way[:, None] * down).reshape(flat.shape))


def _facing(views: Sequence[SilhouetteView], mesh: Mesh, vertex: IntArray, middle: Points) -> FloatArray:
    """Return (f, n) the cosine to every viewer that sees a point of the mesh, else 0."""
    assert mesh.normals is not None
    rays, facing = HeadRays(mesh), np.zeros((len(views), len(middle)))
    for own, view in zip(facing, views, strict=True):
        pose = view.camera_from_head
        position = pose.apply(middle)
        towards = -position / np.linalg.norm(position, axis=1, keepdims=True)
        cosine = (pose.rotate(mesh.normals[vertex]) * towards).sum(axis=1)
        kernel = np.ones((2 * _RIM_PX + 1, 2 * _RIM_PX + 1), np.uint8)
        inner = np.asarray(cv2.erode(view.mask.astype(np.uint8), kernel)) > 0
        column, row = np.round(view.camera.project(position)).astype(int).T
        seen = (cosine > _LEAST_FACING) & (column >= 0) & (column < inner.shape[1])
        seen &= (row >= 0) & (row < inner.shape[0])
        seen[seen] = inner[row[seen], column[seen]]
        seen[seen] = rays.free(vertex[seen], pose.inverse().rotate(towards[seen]))
        own[seen] = cosine[seen]
    return read_only(facing)


@njit(cache=True)
def _value(image: ByteArray, u: float, v: float) -> float:
    column, row = int(u), int(v)
    a, b = u - column, v - row
    above = (1.0 - a) * image[row, column] + a * image[row, column + 1]
    return (1.0 - b) * above + b * ((1.0 - a) * image[row + 1, column] + a * image[row + 1, column + 1])


@njit(cache=True)
def _project(
    patch: FloatArray, camera: FloatArray, turn: FloatArray, move: FloatArray, pixels: FloatArray
) -> None:
    for q in range(len(patch)):
        for k in range(3):
            place = move[k]
            for j in range(3):
                place += turn[k, j] * patch[q, j]
            pixels[q, k] = place
        for k in range(2):
            pixels[q, k] = camera[k, k] * pixels[q, k] / pixels[q, 2] + camera[k, 2]


@njit(cache=True)
def _inside(pixels: FloatArray, shape: tuple[int, int]) -> bool:
    margin = _MOST_PX + 2.0
    for q in range(len(pixels)):
        if not margin < pixels[q, 0] < shape[1] - 1.0 - margin:
            return False
        if not margin < pixels[q, 1] < shape[0] - 1.0 - margin:
            return False
    return True


@njit(cache=True)
def _search_kernel(
    details: ByteArray,
    camera: FloatArray,
    rotations: FloatArray,
    translations: FloatArray,
    patches: FloatArray,
    facing: FloatArray,
    weights: FloatArray,
    place: FloatArray,
    correlation: FloatArray,
) -> None:
    """Shift every patch in every frame until it agrees with the frame that faces it best."""
    count = patches.shape[1]
    pixels, pattern, value = np.empty((count, 3)), np.empty(count), np.empty(count)
    for i in range(len(patches)):
        best = np.argmax(facing[:, i])
        if facing[best, i] == 0.0:
            continue
        _project(patches[i], camera, rotations[best], translations[best], pixels)
        if not _inside(pixels, details.shape[1:]):
            continue
        mean, own = 0.0, 0.0
        for q in range(count):
            pattern[q] = _value(details[best], pixels[q, 0], pixels[q, 1])
            mean += weights[q] * pattern[q]
        for q in range(count):
            pattern[q] -= mean
            own += weights[q] * pattern[q] ** 2
        place[best, i, :], correlation[best, i] = pixels[count // 2, :2], 1.0
        for f in range(len(details)):
            if f == best or facing[f, i] == 0.0:
                continue
            _project(patches[i], camera, rotations[f], translations[f], pixels)
            if _inside(pixels, details.shape[1:]):
                correlation[f, i] = _shifted(details[f], pixels, pattern, own, weights, value, place[f, i])


@njit(cache=True)
def _shifted(
    detail: ByteArray,
    pixels: FloatArray,
    pattern: FloatArray,
    own: float,
    weights: FloatArray,
    value: FloatArray,
    place: FloatArray,
) -> float:
    """Write where the middle of the patch is found; return the correlation there, 0 where it is not."""
    count, u, v, found = len(pattern), 0.0, 0.0, 0.0
    slope = np.empty((count, 2))
    for _ in range(_STEPS):
        mean, mean_u, mean_v = 0.0, 0.0, 0.0
        for q in range(count):
            x, y = pixels[q, 0] + u, pixels[q, 1] + v
            value[q] = _value(detail, x, y)
            slope[q, 0] = 0.5 * (_value(detail, x + 1.0, y) - _value(detail, x - 1.0, y))
            slope[q, 1] = 0.5 * (_value(detail, x, y + 1.0) - _value(detail, x, y - 1.0))
            mean += weights[q] * value[q]
            mean_u += weights[q] * slope[q, 0]
            mean_v += weights[q] * slope[q, 1]
        shared, other = 0.0, 0.0
        for q in range(count):
            value[q] -= mean
            shared += weights[q] * value[q] * pattern[q]
            other += weights[q] * value[q] ** 2
        gain = shared / max(own, _TINY)
        uu, uv, vv, along_u, along_v = 0.0, 0.0, 0.0, 0.0, 0.0
        for q in range(count):
            left = gain * pattern[q] - value[q]
            a, b = slope[q, 0] - mean_u, slope[q, 1] - mean_v
            uu += weights[q] * a * a
            uv += weights[q] * a * b
            vv += weights[q] * b * b
            along_u += weights[q] * a * left
            along_v += weights[q] * b * left
        determinant = uu * vv - uv * uv
        if determinant <= _LEAST_CORNER * (uu + vv) ** 2:
            return 0.0
        step_u = (vv * along_u - uv * along_v) / determinant
        step_v = (uu * along_v - uv * along_u) / determinant
        u, v, found = u + step_u, v + step_v, shared / np.sqrt(max(own * other, _TINY))
        if max(abs(u), abs(v)) > _MOST_PX:
            return 0.0
        if max(abs(step_u), abs(step_v)) < _SETTLED_PX:
            break
    place[0], place[1] = pixels[count // 2, 0] + u, pixels[count // 2, 1] + v
    return found
