"""Points of the skin found again in all frames, by patches of the shape (bouguet2001).

Tracks go from frame to frame: where shading moves over the skin it takes them along, and their errors add up.
A shape tells what a patch of skin looks like from any side, so each is compared with the frame that sees it
best, however far the head has turned. Images are logarithms: light that is smooth over a patch only adds.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.spatial import cKDTree

from vntoolkit.arrays import BoolArray, ByteArray, FloatArray, IntArray, LinearImage, Points, read_only
from vntoolkit.calibration.head.hull import SilhouetteView
from vntoolkit.calibration.head.samples import HeadRays, sampled
from vntoolkit.calibration.head.tracks import LEAST_FRAMES, Tracks
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rays import RayScene

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
_STEPS, _CONVERGED_PX = 8, 0.01
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
    place, correlation = _found_in_frames(views, details, patches, facing)
    found = correlation > _LEAST_CORRELATION
    found &= found.sum(axis=0) >= LEAST_FRAMES
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


def _found_in_frames(
    views: Sequence[SilhouetteView], details: Sequence[ByteArray], patches: FloatArray, facing: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the places (f, n, 2) of the patches' middles, and their correlation (f, n), 0 where not found.

    Every patch (n, k, 3) is shifted in each frame until it agrees with the frame that faces it best.
    """
    place, correlation = np.zeros((*facing.shape, 2)), np.zeros(facing.shape)
    best = facing.argmax(axis=0)
    pattern = np.zeros(patches.shape[:2])
    shown = np.zeros(facing.shape, np.bool_)
    for f, (view, detail) in enumerate(zip(views, details, strict=True)):
        own = np.flatnonzero(facing[f] > 0)
        pixels = _pixels(view, patches[own])
        shown[f, own] = _inside(pixels, detail.shape)
        own = own[(best[own] == f) & shown[f, own]]
        pixels = _pixels(view, patches[own])
        pattern[own] = sampled(detail.astype(np.float32), pixels.reshape(-1, 2)).reshape(pixels.shape[:2])
        place[f, own], correlation[f, own] = pixels[:, pixels.shape[1] // 2], 1.0
    weights = _weights()
    pattern -= (pattern @ weights)[:, None]
    known = np.take_along_axis(correlation, best[None], axis=0)[0] > 0
    for f, (view, detail) in enumerate(zip(views, details, strict=True)):
        others = np.flatnonzero(shown[f] & known & (best != f))
        pixels = _pixels(view, patches[others])
        shift, correlation[f, others] = _shifts(detail, pixels, pattern[others], weights)
        place[f, others] = pixels[:, pixels.shape[1] // 2] + shift
    return place, correlation


def _pixels(view: SilhouetteView, patches: FloatArray) -> FloatArray:
    return view.camera.project(view.camera_from_head.apply(patches))


def _inside(pixels: FloatArray, shape: tuple[int, ...]) -> BoolArray:
    margin = _MOST_PX + 2.0
    high = np.array(shape[::-1]) - 1.0 - margin
    return np.asarray(((pixels > margin) & (pixels < high)).all(axis=(1, 2)))


def _shifts(
    detail: ByteArray, pixels: FloatArray, pattern: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the shifts (n, 2) of patches at pixels (n, k, 2), by Lucas and Kanade, and correlations (n,)."""
    image = detail.astype(np.float32)
    down, right = np.gradient(image)
    layers = np.stack([image, right, down], axis=-1)
    shift, found = np.zeros((len(pixels), 2)), np.zeros(len(pixels))
    size = np.square(pattern) @ weights
    moving = np.arange(len(pixels))
    for _ in range(_STEPS):
        at = pixels[moving] + shift[moving, None]
        seen = sampled(layers, at.reshape(-1, 2)).reshape(*at.shape[:2], 3).astype(np.float64)
        seen -= (weights @ seen)[:, None]
        value, slope = seen[..., 0], seen[..., 1:]
        shared = (value * pattern[moving]) @ weights
        left = (shared / np.maximum(size[moving], _TINY))[:, None] * pattern[moving] - value
        normal = np.einsum("k,nki,nkj->nij", weights, slope, slope, optimize=True)
        corner = np.linalg.det(normal) > _LEAST_CORNER * np.trace(normal, axis1=1, axis2=2) ** 2
        normal[~corner] = np.eye(2)
        step = np.linalg.solve(normal, np.einsum("k,nki,nk->ni", weights, slope, left)[..., None])[..., 0]
        shift[moving] += step
        found[moving] = shared / np.sqrt(np.maximum(size[moving] * (np.square(value) @ weights), _TINY))
        found[moving[~corner | (np.abs(shift[moving]).max(axis=1) > _MOST_PX)]] = 0.0
        moving = moving[(found[moving] > 0) & (np.abs(step).max(axis=1) >= _CONVERGED_PX)]
    return shift, found
