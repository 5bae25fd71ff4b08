"""Which lights reach each pixel: the published detector, the robust one, or none.

The published one (brostow2011, Section VI-A) finds edges, then fills conservatively from them.
Per light: a Laplacian edge detector; the gradient's direction at an edge pixel by looking along the eight
cardinal directions at a distance of ±2 pixels; pixels with a gradient below τ rejected; neighbours of
agreeing direction joined into connected components, small ones rejected; the dark side of the rest seeds a
flood fill that spreads to neighbours of equal or lower intensity.
The robust one is `labels_by_surface`.
"""

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, Float32Array, FloatArray, Int64Array, Mask, VisibilityLabels
from vntoolkit.checks import checks_kinds, require_mask
from vntoolkit.geometry.camera import Camera
from vntoolkit.native import njit
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame, labels_from_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.contributions import (
    contributions_from_frame,
    frame_in_window,
    in_whole_image,
    window_around,
)
from vntoolkit.shadows.robust import labels_by_surface
from vntoolkit.shadows.surface import Surface

# Of the published detector.
_DIRECTIONS = np.array(
    [[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]], dtype=np.int64
)  # (du, dv), counted by eighths of a turn
_GRADIENT_THRESHOLD = 0.05  # τ: smallest change over the two reaches, as a part of the channel's maximum
_REACH_PX = 2  # how far to look to either side of an edge, as published
_SMALLEST_COMPONENT = 20  # edge components with fewer pixels are rejected
_DIRECTION_TOLERANCE = 1  # neighbouring edge pixels agree within so many eighths of a turn
_BLUR_PX = 1.0  # standard deviation of the Gaussian before the Laplacian


class ShadowDetector:
    """Finds the shadows of one frame after another; each frame stands alone.

    response: with light colours known, a light is told from a channel; else a channel stands for a light.
    camera: for perspective; None for orthographic.
    """

    @checks_kinds
    def __init__(
        self,
        response: LightResponse,
        method: ShadowMethod = ShadowMethod.ROBUST,
        camera: Camera | None = None,
    ) -> None:
        self._method = method
        self._response = response
        self._camera = camera
        self.surface: Surface | None = None  # of the last frame, for `recover_normals`; None without one

    @checks_kinds
    def labels(self, frame: LinearFrame, mask: Mask | None = None) -> VisibilityLabels:
        """Return (h, w) labels, bit k set where light k arrives; 7 outside `mask`, where nobody may look."""
        inside = np.ones(frame.shape, dtype=np.bool_) if mask is None else np.asarray(mask)
        require_mask(inside, frame.shape)
        self.surface = None
        if self._method is ShadowMethod.NONE or not inside.any():
            return np.full(frame.shape, ALL_LIT, dtype=np.uint8)
        window = window_around(inside)
        part, near = frame_in_window(frame, window), np.array(inside[window])
        if self._method is ShadowMethod.PUBLISHED:
            contributions = contributions_from_frame(part, self._response).contributions
            found = labels_from_lit(lit_by_edges(contributions, near))
        else:
            camera = None if self._camera is None else self._camera.cropped(*window)
            found, self.surface = labels_by_surface(part, self._response, near, camera)
        labels = np.where(near, found, ALL_LIT).astype(np.uint8)
        return in_whole_image(labels, window, frame.shape, ALL_LIT)


def lit_by_edges(contributions: FloatArray, mask: Mask) -> BoolArray:
    """Return (h, w, 3): which lights arrive, from the (h, w, 3) contributions of the lights.

    The published detection (brostow2011, Section VI-A).
    """
    lit = np.ones((*mask.shape, 3), dtype=np.bool_)
    for k in range(3):
        lit[..., k] = ~_shadow_of_light(contributions[..., k], mask)
    return lit


def _shadow_of_light(contribution: FloatArray, mask: Mask) -> Mask:
    image = np.where(mask, np.nan_to_num(contribution), 0.0).astype(np.float32)
    brightest = float(image.max(initial=0.0))
    if not brightest > 0.0:
        return np.zeros(mask.shape, dtype=np.bool_)
    image = np.asarray(cv2.GaussianBlur(image / brightest, (0, 0), _BLUR_PX), dtype=np.float32)
    direction = _edge_directions(image, mask)
    kept = _large_components(direction, _DIRECTION_TOLERANCE, _SMALLEST_COMPONENT)
    return _flood(image, mask, kept, _REACH_PX)


def _edge_directions(image: FloatArray, mask: Mask) -> Int64Array:
    """(h, w): direction of the brighter side in eighths of a turn at edge pixels, −1 elsewhere."""
    laplacian = cv2.Laplacian(image, cv2.CV_32F, ksize=3)
    sign = laplacian > 0
    edge = np.zeros(mask.shape, dtype=np.bool_)
    edge[:, :-1] |= sign[:, :-1] != sign[:, 1:]
    edge[:-1] |= sign[:-1] != sign[1:]
    reach = _REACH_PX
    padded = np.pad(image, reach, mode="edge")
    inside = np.pad(mask, reach, constant_values=False)
    h, w = mask.shape
    changes = np.full((8, h, w), -1.0, dtype=np.float32)
    for i, (du, dv) in enumerate(_DIRECTIONS * reach):
        ahead = (slice(reach + dv, reach + dv + h), slice(reach + du, reach + du + w))
        behind = (slice(reach - dv, reach - dv + h), slice(reach - du, reach - du + w))
        both = inside[ahead] & inside[behind]
        changes[i] = np.where(both, padded[ahead] - padded[behind], -1.0)
    steepest = changes.argmax(axis=0)
    edge &= mask & (changes.max(axis=0) >= _GRADIENT_THRESHOLD)
    return np.where(edge, steepest, -1)


@njit
def _large_components(direction: Int64Array, tolerance: int, smallest: int) -> Int64Array:
    """Keep edge pixels in eight-connected components of agreeing direction that are large enough."""
    h, w = direction.shape
    kept = np.full((h, w), -1, np.int64)
    seen = np.zeros((h, w), np.bool_)
    stack = np.empty((h * w, 2), np.int64)
    for v0 in range(h):
        for u0 in range(w):
            if direction[v0, u0] < 0 or seen[v0, u0]:
                continue
            stack[0, 0], stack[0, 1] = v0, u0
            seen[v0, u0] = True
            done, count = 0, 1
            while done < count:
                v, u = stack[done, 0], stack[done, 1]
                done += 1
                for i in range(v - 1, v + 2):
                    for j in range(u - 1, u + 2):
                        if i < 0 or j < 0 or i >= h or j >= w or seen[i, j] or direction[i, j] < 0:
                            continue
                        turn = (direction[i, j] - direction[v, u]) % 8
                        if min(turn, 8 - turn) <= tolerance:
                            seen[i, j] = True
                            stack[count, 0], stack[count, 1] = i, j
                            count += 1
            if count >= smallest:
                for i in range(count):
                    v, u = stack[i, 0], stack[i, 1]
                    kept[v, u] = direction[v, u]
    return kept


@njit
def _flood(
    image: Float32Array,
    mask: BoolArray,
    direction: Int64Array,
    reach: int,
) -> BoolArray:
    """Spread from the dark side of the edges to four-neighbours of equal or lower intensity."""
    h, w = image.shape
    flooded = np.zeros((h, w), np.bool_)
    stack = np.empty((h * w, 2), np.int64)
    count = 0
    for v in range(h):
        for u in range(w):
            if direction[v, u] < 0:
                continue
            step = _DIRECTIONS[direction[v, u]]
            i, j = v - reach * step[1], u - reach * step[0]
            if 0 <= i < h and 0 <= j < w and mask[i, j] and not flooded[i, j]:
                flooded[i, j] = True
                stack[count, 0], stack[count, 1] = i, j
                count += 1
    while count > 0:
        count -= 1
        v, u = stack[count, 0], stack[count, 1]
        for n in range(0, 8, 2):
            i, j = v + _DIRECTIONS[n, 1], u + _DIRECTIONS[n, 0]
            if i < 0 or j < 0 or i >= h or j >= w or flooded[i, j] or not mask[i, j]:
                continue
            if image[i, j] <= image[v, u]:
                flooded[i, j] = True
                stack[count, 0], stack[count, 1] = i, j
                count += 1
    return flooded
