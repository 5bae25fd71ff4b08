"""Where a shape's rim should lie: on the silhouette's contour, in every frame.

Where a smooth surface turns away from the viewer, the rays along the contour touch it (cipolla2000). The
place of a contour is known to a fraction of a pixel, better than stereo knows any depth, and a turn of the
head sweeps the rim over most of its sides.
"""

from collections.abc import Iterable

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, Float32Array, FloatArray, IntArray, Mask, Points, Vectors
from vntoolkit.calibration.head.hull import signed_distance_px
from vntoolkit.calibration.head.light import LEAST_COSINE
from vntoolkit.calibration.head.samples import LightFrame, sampled
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh, edges_from_faces
from vntoolkit.photometry.response import LightResponse

_REACH_PX = 4.0  # how far a contour may lie to both sides of the rim
_SOFT_PX = 1.0  # standard deviation of the blur that makes a contour of whole pixels smooth
_NOISE_PX = 0.3  # of a contour of whole pixels: √(1/12)
_ALIKE_PX = 50.0  # along the contour: where it errs, as before dark hair, it errs alike over such lengths
_LEAST_SLOPE = 1e-3  # of the typical brightness of the edges: less is no edge
_BEHIND_PX = 0.1  # a rim so much farther inside than another beside it is hidden by it
_TINY = 1e-30


def rim_targets(
    mesh: Mesh, camera: Camera, frames: Iterable[LightFrame], response: LightResponse
) -> tuple[Points, FloatArray]:
    """Compare the rims of a mesh (head frame, with normals) with the contours of all frames.

    Returns where contours want its vertices (n, 3), and 1 / variance (n,), 0 off rims. A contour counts as
    much as the brightness rises there: before dark hair it is uncertain by more. Where no lamp of M reaches
    the rim, light ends before the surface does.
    """
    assert mesh.normals is not None
    edges = edges_from_faces(mesh.faces)
    rims = [_rims(mesh, edges, camera, each, response.light_directions) for each in frames]
    vertex, share, off, slope, unit = (np.concatenate(column) for column in zip(*rims, strict=True))
    count = len(mesh.vertices)
    if not len(vertex):
        return mesh.vertices, np.zeros(count)
    typical = float(np.median(slope))
    blunt = typical / np.maximum(slope, _LEAST_SLOPE * typical)
    variance = _ALIKE_PX * np.square(_NOISE_PX * np.maximum(blunt, 1.0) * unit)
    weight = np.asarray(np.bincount(vertex, share / variance, count), np.float64)
    moved = np.bincount(vertex, share / variance * off * unit, count) / np.maximum(weight, _TINY)
    return mesh.vertices + moved[:, None] * mesh.normals, weight


def _rims(
    mesh: Mesh, edges: IntArray, camera: Camera, frame: LightFrame, lamps: Vectors
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return vertices (r,) on the rim, shares, pixels to the contour, rise of brightness, a pixel's width."""
    assert mesh.normals is not None
    pose = frame.camera_from_head
    position, normal = pose.apply(mesh.vertices), pose.rotate(mesh.normals)
    facing = -(normal * position).sum(axis=1)
    near, far = edges[(facing[edges[:, 0]] > 0) != (facing[edges[:, 1]] > 0)].T
    near, far = np.where(facing[near] > 0, near, far), np.where(facing[near] > 0, far, near)
    convex = position[far, 2] > position[near, 2]  # else a valley, which covers nothing
    near, far = near[convex], far[convex]
    share = facing[near] / (facing[near] - facing[far])

    def between(values: Points) -> Points:
        return np.asarray(values[near] + share[:, None] * (values[far] - values[near]))

    place, across = between(position), between(normal)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), _TINY)
    outward = across[:, :2] / np.maximum(np.linalg.norm(across[:, :2], axis=1, keepdims=True), _TINY)
    pixel = camera.project(place)
    off, found = _contour_beside(frame.mask, pixel)
    found &= (across @ lamps.T).max(axis=1) > LEAST_COSINE
    near, far, share, off, outward = (each[found] for each in (near, far, share, off, outward))
    contour, unit = pixel[found] + off[:, None] * outward, place[found, 2] / camera.matrix[0, 0]
    column, row = np.round(contour).astype(int).T
    outermost = np.full(frame.mask.shape, np.inf, np.float32)
    np.minimum.at(outermost, (row, column), off)
    outermost = np.asarray(cv2.erode(outermost, np.ones((3, 3), np.uint8)))  # the least around
    grey = np.asarray(cv2.GaussianBlur(frame.frame.rgb.mean(axis=2), (0, 0), _SOFT_PX), np.float32)
    slope = _at(grey, contour - outward) - _at(grey, contour + outward)
    kept = off <= outermost[row, column] + _BEHIND_PX
    near, far, share, off, slope, unit = (each[kept] for each in (near, far, share, off, slope, unit))
    vertex, shares = np.concatenate([near, far]), np.concatenate([1.0 - share, share])
    return vertex, shares, np.tile(off, 2), np.tile(slope, 2), np.tile(unit, 2)


def _contour_beside(mask: Mask, pixel: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return how far outwards the contour lies from pixels (r, 2), and where it is near."""
    distance = cv2.GaussianBlur(signed_distance_px(mask), (0, 0), _SOFT_PX)
    off = _at(np.asarray(distance, np.float32), pixel)
    size, margin = np.array(mask.shape[::-1]), _REACH_PX + 2.0 * _SOFT_PX
    within = ((pixel > margin) & (pixel < size - 1.0 - margin)).all(axis=1)
    return off, within & (np.abs(off) < _REACH_PX)


def _at(image: Float32Array, pixel: FloatArray) -> FloatArray:
    return np.asarray(sampled(image, np.asarray(pixel, np.float32).reshape(-1, 2)), np.float64)
