"""The outline of the figure, where an open surface ends, and the occluding contours within it.

Beyond the outline nothing of the surface is in sight. A smooth body turns away from the viewer at a contour
within the figure: its slope grows until it is seen edge-on, and beside it another surface goes on that is
less steep. So a contour is where the surface recedes steeply towards a side, and within a few pixels no
longer. It is the outline of what lies before: it moves with that and tells nothing of what lies behind, and
across it nothing holds the two together. Where a shadow told how far one lies behind the other, the depth has
a step that the slopes do not.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from vntoolkit.arrays import FloatArray, Mask, Points2, box_of
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.tracking.factors import Factor, total
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.slopes import Slopes, sample_image
from vntoolkit.tracking.template import TrackingTemplate

_SIGMA_PX = 0.3  # of the outline along one cell: pixels are whole
# Cosine to the viewing ray at the outline: from an occluding contour, which slides, to a border. Its square
# falls to 0 at a contour, in proportion to the distance: it is measured in two boxes and extrapolated.
_OPEN_FACING = (0.35, 0.6)
_BOXES_PX = (7, 15)
# Around the figure: no mean, and no step across a contour that touches it, reaches beyond.
_MARGIN_PX = _BOXES_PX[-1]
_PER_BOX = np.float32(_BOXES_PX[0] / (_BOXES_PX[1] - _BOXES_PX[0]))
_BAND_PX = 2.0  # of vertices that are the border
_BORDER_PX = 4  # beside the image's own border there is no outline
_NARROW_GAP_PX = 9  # width of gaps that are no outline: dark pixels, as between strands of hair, come and go
_UNFILLED_PX = 2  # from the outline: gaps are filled farther in only, or a slanted outline would move
_INSIDE_SIGMA_PX = 2.0  # of a node whose vertices lie off the figure
_HUBER_PX = 6.0
_FAR_PX = 12.0  # of a border from its outline: beyond, it has likely lost it
_LEAST_WEIGHT = np.float32(1e-4)  # mean of the slopes' around a pixel: by less it has no slope
# Of occluding contours within the figure.
_STEEP, _TURN = np.radians((45.0, 30.0))  # by which a surface recedes there, and by which it then turns back
_SURELY_STEEP, _SURE_TURN = np.radians((65.0, 45.0))  # the same, of a contour that is surely one
_REACH_PX = 3  # to either side: the picture and its slopes are blurred by a pixel each
_LEAST_SLOPE_WEIGHT = 0.05  # of a slope: by less its normal may be off by 45° and more, as in a shadow
_STEP_PX = 2.0  # of depth beyond the slopes, from which its sides part: a turn by 30° moves them 1 px apart
_TWO_SIDES_PX = 2.0  # between the nearest pixels beside a contour: those on one side of it are nearer


class Outline:
    """Compares the border of one template with the outline of a figure."""

    def __init__(
        self, template: TrackingTemplate, lattice: TemplateLattice, silhouette: npt.NDArray[np.float32]
    ) -> None:
        """Find the border. silhouette: (h, w, 4), `outline_of_silhouette` of the template's frame."""
        self._lattice, self._pixels = lattice, template.positions_px
        at = sample_image(silhouette, self._pixels)
        border = np.flatnonzero(at[:, 0] > -_BAND_PX)
        h, w = silhouette.shape[:2]
        p = self._pixels[border]
        inside = np.all((p >= _BORDER_PX) & (p <= [w - 1 - _BORDER_PX, h - 1 - _BORDER_PX]), axis=1)
        self._border = border[inside]
        self._own = at[self._border, 0]
        self._outward = at[self._border, 1:3]
        self._node = lattice.node_of_vertex[self._border]
        self._open = at[self._border, 3]

    def measure(self, positions_px: Points2, inverse: FloatArray, field: npt.NDArray[np.float32]) -> Factor:
        """Return what it tells, in pixels of the frame. inverse: (m, 2, 2) J⁻¹ at nodes.

        An outline that is far off, or that faces another way, is not this border's: a leg has none on its
        inner side while the other passes before it. As far as it may be an occluding contour, the surface may
        have slid beneath it, and it tells that much less.
        """
        h, w = field.shape[:2]
        position = positions_px[self._border]
        at = sample_image(field, position)
        in_image = np.all(
            (position >= _BORDER_PX) & (position <= [w - 1 - _BORDER_PX, h - 1 - _BORDER_PX]), axis=1
        )
        openness = self._open * in_image
        foot = position - at[:, :1] * at[:, 1:3]
        openness = openness * sample_image(field, foot)[:, 3]
        openness = openness * np.all(
            (foot >= _BORDER_PX) & (foot <= [w - 1 - _BORDER_PX, h - 1 - _BORDER_PX]), axis=1
        )
        outward = np.einsum("nji,nj->ni", inverse[self._node], self._outward)
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
        residual = self._own - at[:, 0]
        likely = np.maximum((outward * at[:, 1:3]).sum(axis=1), 0.0) / (1.0 + (residual / _FAR_PX) ** 2) ** 2
        weight = openness * likely / (_SIGMA_PX**2 + (1.0 - openness) * _FAR_PX**2)
        border = self._gathered(self._node, at[:, 1:3], residual, weight)
        u, v = np.floor(positions_px + 0.5).astype(np.int64).T
        off = np.flatnonzero((u >= 0) & (u < w) & (v >= 0) & (v < h))
        off = off[field[v[off], u[off], 0] > 0.5]
        at = sample_image(field, positions_px[off])
        node, whole = self._lattice.node_of_vertex[off], np.full(len(off), _INSIDE_SIGMA_PX**-2)
        return total([border, self._gathered(node, at[:, 1:3], 0.5 - at[:, 0], whole)])

    def _gathered(self, node, normal, residual, weight) -> Factor:  # type: ignore[no-untyped-def]
        count = self._lattice.count
        robust = weight / np.maximum(1.0, np.abs(residual) / _HUBER_PX)
        terms = (
            np.column_stack(
                [
                    normal[:, 0] ** 2,
                    normal[:, 0] * normal[:, 1],
                    normal[:, 1] ** 2,
                    normal[:, 0] * residual,
                    normal[:, 1] * residual,
                ]
            )
            * robust[:, None]
        )
        # The band may lie across two cells: either then has its part of what one outline tells.
        number = np.maximum(np.bincount(node, minlength=count), _BAND_PX * self._lattice.cell_px)
        sums = np.stack([np.bincount(node, terms[:, k], minlength=count) / number for k in range(5)], axis=1)
        return Factor(sums[:, :3], sums[:, 3:], np.zeros(count))


def outline_of_silhouette(mask: Mask, slopes: Slopes) -> npt.NDArray[np.float32]:
    """(h, w, 4): signed distance, its gradient, and openness, of one frame."""
    distance = signed_distance(mask)
    down, right = np.gradient(cv2.GaussianBlur(distance, (0, 0), 2.0))
    length = np.maximum(np.hypot(right, down), np.float32(1e-6))
    smooth = cv2.GaussianBlur(distance, (0, 0), 1.0)
    silhouette = cv2.merge([smooth, right / length, down / length, np.zeros_like(smooth)])
    box = box_of(mask, _MARGIN_PX)
    silhouette[(*box, 3)] = _openness(slopes[box])
    return np.asarray(silhouette, np.float32)


def _openness(slopes: Slopes) -> npt.NDArray[np.float32]:
    """(h, w) from 0 to 1, by the cosine to the viewing ray that mean slopes extrapolate to the rim."""
    means = [cv2.blur(slopes, (px, px)) for px in _BOXES_PX]
    squares = [np.square(each) for each in means]
    near, far = (each[..., 2] / np.maximum(each.sum(axis=-1), np.float32(1e-12)) for each in squares)
    low, high = _OPEN_FACING
    facing = np.sqrt(np.clip(near + _PER_BOX * (near - far), 0.0, 1.0))
    known = means[0][..., 2] > _LEAST_WEIGHT
    return np.asarray(known * np.clip((facing - low) / (high - low), 0.0, 1.0), np.float32)


def contour_distance(silhouette: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """(h, w) distance in pixels from the nearest occluding contour on the outline (h, w, 4) of a figure."""
    contour = (np.abs(silhouette[..., 0]) < 1.0) & (silhouette[..., 3] < 0.5)  # rather closed than open
    if not contour.any():
        return np.full(contour.shape, np.inf, np.float32)
    return np.asarray(cv2.distanceTransform((~contour).astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def signed_distance(mask: Mask) -> npt.NDArray[np.float32]:
    """Return (h, w) distance in pixels from the outline: positive outside, negative inside."""
    filled = _without_gaps(mask).astype(np.uint8)
    if filled.all():
        return np.full(mask.shape, -1e3, dtype=np.float32)
    distance = np.asarray(cv2.distanceTransform(1 - filled, cv2.DIST_L2, 5), np.float32) - np.float32(0.5)
    box = box_of(mask, _MARGIN_PX)
    inside = cv2.distanceTransform(filled[box], cv2.DIST_L2, 5)
    distance[box] = np.where(filled[box], np.float32(0.5) - inside, distance[box])
    return distance


def _without_gaps(mask: Mask) -> Mask:
    """Fill holes, which may be something dark that passes before the figure, and narrow gaps."""
    if not mask.any():
        return mask
    box = box_of(mask, _MARGIN_PX)
    grow, shrink = (np.ones((n, n), np.uint8) for n in (_NARROW_GAP_PX, _NARROW_GAP_PX + 2 * _UNFILLED_PX))
    deep = cv2.erode(cv2.dilate(mask[box].astype(np.uint8), grow), shrink) > 0
    filled = mask.copy()
    filled[box] = ndimage.binary_fill_holes(mask[box] | deep)
    return filled


def occluding_contours(slopes: Slopes, mask: Mask) -> Mask:
    """Return (h, w) True within reach of an occluding contour.

    A faint one counts where it prolongs a sure one.
    """
    contours, box = np.zeros_like(mask), box_of(mask, _MARGIN_PX)
    faint, sure = _receding(slopes[box], mask[box])
    if not sure.any():
        return contours
    count, labels = cv2.connectedComponents(faint.astype(np.uint8), connectivity=8)
    kept = np.zeros(count, dtype=np.bool_)
    kept[labels[sure]] = True
    contours[box] = kept[labels] & faint
    return contours


def depth_steps(depth_map: DepthMap, slopes: Slopes, camera: Camera) -> Mask:
    """Return (h, w) True on either side of a step of depth that the slopes do not have."""
    known = depth_map.mask & (slopes[..., 2] > _LEAST_SLOPE_WEIGHT)
    depth = np.where(known, depth_map.depth, 1.0)
    depth = np.log(depth) if camera.is_perspective else depth
    steps = np.zeros_like(known)
    for axis, along in ((1, 0), (0, 1)):
        slope = np.where(known, slopes[..., along], 0.0) / np.where(known, slopes[..., 2], 1.0)
        ends = (slice(None, -1), slice(1, None))
        first, second = (end if axis == 0 else (slice(None), end) for end in ends)
        left = camera.matrix[along, along] * np.diff(depth, axis=axis) - 0.5 * (slope[first] + slope[second])
        bend = 0.5 * np.abs(slope[first] - slope[second])
        stepped = known[first] & known[second] & (np.abs(left) > _STEP_PX + bend)
        steps[first] |= stepped
        steps[second] |= stepped
    return steps


def edges_beside(
    edges: npt.NDArray[np.int32], pixels: npt.NDArray[np.int32], contours: Mask
) -> npt.NDArray[np.int32]:
    """Return the edges (e, 2) of adjacent pixels (n, 2) that do not cross the middle of a contour (h, w)."""
    if not contours.any():
        return edges
    u, v = pixels.T
    elsewhere: Mask = np.ones(contours.shape, dtype=np.bool_)
    elsewhere[v, u] = contours[v, u]
    near = ndimage.distance_transform_edt(elsewhere, return_distances=False, return_indices=True)
    beside = near[:, v, u].T.astype(np.float64)
    first, second = edges.T
    return edges[np.linalg.norm(beside[first] - beside[second], axis=1) <= _TWO_SIDES_PX]


def _receding(slopes: Slopes, mask: Mask) -> tuple[Mask, Mask]:
    """(h, w) pixels between two, of which one recedes towards the other: at least faintly, and surely."""
    faint, sure = np.zeros_like(mask), np.zeros_like(mask)
    known = slopes[..., 2] >= _LEAST_SLOPE_WEIGHT
    for axis, along in ((1, 0), (0, 1)):
        slope = np.where(known, slopes[..., along], np.nan) / np.where(known, slopes[..., 2], 1.0)
        angle = np.moveaxis(np.arctan(slope), axis, 0)  # all comparisons fail where it is unknown
        within, faintly, surely = (np.moveaxis(each, axis, 0) for each in (mask, faint, sure))
        for reach in range(1, _REACH_PX + 1):
            between = slice(reach, len(angle) + 1 - reach)
            before, after = angle[: 1 - 2 * reach], angle[2 * reach - 1 :]
            turns = within[between] & ((before >= _STEEP) | (after <= -_STEEP))
            faintly[between] |= turns & (before - after > _TURN)
            steepest = np.maximum(before, -after)
            surely[between] |= turns & (before - after > _SURE_TURN) & (steepest > _SURELY_STEEP)
    return faint, sure
