"""Optical flow between consecutive normal maps: DIS, then Lucas and Kanade on a lattice.

DIS (`kroeger2016`) finds the large motions; pyramidal Lucas–Kanade (`bouguet2001`) on all three components of
the normal then gives the sub-pixel part at lattice points, and Gaussian interpolation the rest. Its error on
one pair is no less than DIS's, but it is unbiased, so that it adds up to a quarter over hundreds of frames.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Flow, Mask, Points2
from vntoolkit.checks import require_same_size
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.tracking.flow_slopes import bytes_from_normals
from vntoolkit.tracking.options import FlowMethod, FlowOptions

_OUTLIER_PX = 1.5  # a lattice vector this far from the median of its 5×5 neighbours is not believed
_FAR_CELLS = 8.0  # reach of the extrapolation beyond the mask, lattice spacings
_SMALLEST_DIS_SIDE = 32  # OpenCV's DIS fails below


def flow_between(first: NormalMap, second: NormalMap, options: FlowOptions | None = None) -> Flow:
    """Return the flow (h, w, 2) in pixels that carries `first` to `second`.

    Outside the mask of `first` it is extrapolated from the nearest surface.
    """
    options = options or FlowOptions()
    require_same_size(first.mask, "first normal map", second.mask, "second normal map")
    height, width = first.shape
    if options.method is FlowMethod.NONE or not (first.mask.any() and second.mask.any()):
        return np.zeros((height, width, 2), dtype=np.float32)
    before, after = bytes_from_normals(first), bytes_from_normals(second)
    dense = _dis(before, after)
    if options.method is FlowMethod.DIS:
        return dense
    return _lattice_flow(before, after, dense, first.mask, options)


def _dis(before: npt.NDArray[np.uint8], after: npt.NDArray[np.uint8]) -> Flow:
    """Dense inverse search on a grey mix of n_x and n_y."""
    height, width = before.shape[:2]
    if min(height, width) < _SMALLEST_DIS_SIDE:
        return np.zeros((height, width, 2), dtype=np.float32)
    mix = np.array([[0.55, 0.45, 0.0]], dtype=np.float32)
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    flow = dis.calc(cv2.transform(before, mix), cv2.transform(after, mix), None)  # type: ignore[call-overload]
    return np.asarray(flow, dtype=np.float32)


def _lattice_flow(
    before: npt.NDArray[np.uint8],
    after: npt.NDArray[np.uint8],
    start: Flow,
    mask: Mask,
    options: FlowOptions,
) -> Flow:
    height, width = mask.shape
    step = options.lattice_px
    u, v = np.arange(step // 2, width, step), np.arange(step // 2, height, step)
    points = np.stack(np.meshgrid(u, v), axis=-1).astype(np.float32)
    inside = _share_inside(mask, options.window_px)[v][:, u] * mask[v][:, u]
    follow = inside > 0
    vectors = np.zeros(points.shape, dtype=np.float32)
    weights = np.zeros(points.shape[:2], dtype=np.float32)
    if not follow.any():
        return start
    guess = points[follow] + start[points[follow][:, 1].astype(int), points[follow][:, 0].astype(int)]
    ended, status = _lucas_kanade(before, after, points[follow], guess, options)
    vectors[follow] = ended - points[follow]
    weights[follow] = inside[follow] * status
    weights *= _near_median(vectors, weights)
    smooth = _interpolated(vectors, weights)
    to_lattice = np.array([[1 / step, 0, -u[0] / step], [0, 1 / step, -v[0] / step]])
    dense = cv2.warpAffine(
        smooth, np.linalg.inv(np.vstack([to_lattice, [0, 0, 1]]))[:2], (width, height),
        flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    return np.asarray(dense, dtype=np.float32)


def _lucas_kanade(
    before: npt.NDArray[np.uint8],
    after: npt.NDArray[np.uint8],
    points: Points2,
    guess: Points2,
    options: FlowOptions,
) -> tuple[Points2, npt.NDArray[np.float32]]:
    ended, status, _ = cv2.calcOpticalFlowPyrLK(
        before, after, points.reshape(-1, 1, 2), guess.reshape(-1, 1, 2).astype(np.float32),
        winSize=(options.window_px, options.window_px), maxLevel=options.levels,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 0.01),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW, minEigThreshold=1e-5,
    )  # fmt: skip
    return ended.reshape(-1, 2), status.reshape(-1).astype(np.float32)


def _share_inside(mask: Mask, window_px: int) -> npt.NDArray[np.float32]:
    """Squared share of the window that lies on the surface: silhouettes move unlike the cloth."""
    share = cv2.blur(mask.astype(np.float32), (window_px, window_px))
    return np.asarray(share * share, dtype=np.float32)


def _near_median(vectors: Flow, weights: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    filled = np.where(weights[..., None] > 0, vectors, _interpolated(vectors, weights))
    medians = [cv2.medianBlur(np.ascontiguousarray(filled[..., c], dtype=np.float32), 5) for c in range(2)]
    distance = np.linalg.norm(filled - np.stack(medians, axis=-1), axis=-1)
    return (distance < _OUTLIER_PX).astype(np.float32)


def _interpolated(vectors: Flow, weights: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Weighted Gaussian mean over one lattice spacing; far ones only where there is no near one."""
    stacked = np.concatenate([vectors * weights[..., None], weights[..., None]], axis=-1)
    near = cv2.GaussianBlur(stacked, (0, 0), 1.0)
    far = cv2.GaussianBlur(stacked, (0, 0), _FAR_CELLS)
    total = near + 1e-4 * far
    total[..., :2] += 1e-12 * stacked[..., :2].sum(axis=(0, 1))
    total[..., 2] += 1e-12 * stacked[..., 2].sum()
    return np.asarray(total[..., :2] / np.maximum(total[..., 2:], 1e-30), dtype=np.float32)
