"""The head's silhouette before a dark background, and checks of the footage."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import binary_fill_holes

from vntoolkit.arrays import ByteArray, FloatArray, LinearImage, Mask
from vntoolkit.errors import BadCalibration
from vntoolkit.spread import robust_deviation

logger = logging.getLogger(__name__)
_SIGMAS = 6.0  # of the background's noise
_BAND_PX = 4  # to either side of the first contour, where it is moved to the subject's edge
_EDGE_PX = 2  # inside of it; farther in the subject may be brighter by its shading
_EDGE_HEIGHT = 0.4  # of the rise of brightness there: below a half, since a rim that turns away is darker
_LEAST_RISE = 0.01  # of the subject's brightness: stray light on the backdrop stays below
_SMALLEST_SHARE = 0.01  # of the image: anything smaller is no head
_LARGEST_SHARE = 0.75  # of the image: beyond, the background itself counts as subject
_RIVAL_SHARE = 0.35  # area of the second region over the first's from which on there are two people
_CUT_SHARE = 0.12  # of the silhouette's width or height that may lie on the image's edge
_BORDER_PX = 12  # about its box: windows of features and of stereo reach so far
_BRIGHTEST_BACKDROP = 0.3  # of the subject's brightness
_UNEVEN_BACKDROP = 0.02  # of it: so much cuts off an eighth of its brightness; sensors have 0.001
_LIT_EDGE = 0.2  # of the image's top and upper sides that may be bright
_UPPER = 0.6  # of the height; below, shoulders may reach the edge
_MOST = 0.2  # share of the frames that may show a fault


@dataclass(frozen=True, kw_only=True, eq=False)
class Silhouette:
    """One frame's silhouette.

    mask: (h, w) bool, largest region without holes, up to its edge. bright: the same up to the threshold, for
    tracks: M and mesh gain by the edge, poses do not. rival_share: area of the second largest region
    over the largest's. cut_share: how much of its width or height lies on the image's top, left or right
    edge; shoulders may be cut. edge_share: how much of those edges is bright at all.
    backdrop, unrest: its level over the subject's, and the level's spread; 0 where the threshold was given.
    """

    mask: Mask
    bright: Mask
    rival_share: float
    cut_share: float
    edge_share: float = 0.0
    backdrop: float = 0.0
    unrest: float = 0.0


def find_silhouette(rgb: LinearImage, threshold: float | None = None) -> Silhouette:
    """Return the largest region of linear rgb (h, w, 3) that stands out; an empty one where nothing does.

    threshold: of grey, 0 to 1; None for the one that the image's border tells.
    """
    grey = cv2.GaussianBlur(np.asarray(rgb, dtype=np.float32).mean(axis=2), (0, 0), 0.7)
    level, noise, found = _level_and_threshold(grey)
    subject = max(float(np.percentile(grey, 99)), 1e-6) if threshold is None else np.inf
    threshold = found if threshold is None else threshold
    backdrop, unrest = level / subject, noise / subject
    bright = (grey > threshold).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=4)
    if count < 2:
        empty = np.zeros(grey.shape, np.bool_)
        return Silhouette(
            mask=empty, bright=empty, rival_share=0.0, cut_share=0.0, backdrop=backdrop, unrest=unrest
        )
    areas = stats[1:, cv2.CC_STAT_AREA].astype(float)
    order = np.argsort(areas)[::-1]
    region = binary_fill_holes(labels == 1 + order[0])
    mask = _moved_to_edge(region, grey, level, threshold)
    rival = float(areas[order[1]] / areas[order[0]]) if len(order) > 1 else 0.0
    edge = np.concatenate([bright[0], *(bright[: int(_UPPER * len(bright)), k] for k in (0, -1))])
    return Silhouette(
        mask=mask,
        bright=region,
        rival_share=rival,
        cut_share=_cut_share(mask),
        edge_share=float(edge.mean()),
        backdrop=backdrop,
        unrest=unrest,
    )


def require_head(silhouettes: Sequence[Silhouette]) -> None:
    """Raise `BadCalibration` where the footage shows nobody, two people, no dark backdrop or a cut head."""
    shares = np.array([s.mask.mean() for s in silhouettes])
    if np.mean(shares < _SMALLEST_SHARE) > _MOST:
        raise BadCalibration(
            f"silhouettes: nothing head-sized stands out from the background in "
            f"{np.mean(shares < _SMALLEST_SHARE):.0%} of the frames; film one head, lit, before a dark "
            "backdrop, filling a third of the picture"
        )
    if np.mean(shares > _LARGEST_SHARE) > _MOST:
        raise BadCalibration(
            "silhouettes: no contrast between head and background (nearly all of the picture counts as "
            "head); film before a dark, unlit backdrop, or give --threshold"
        )
    backdrops = np.array([s.backdrop for s in silhouettes])
    if np.median(backdrops) > _BRIGHTEST_BACKDROP:
        raise BadCalibration(
            f"silhouettes: no contrast: the backdrop is {np.median(backdrops):.0%} as bright as the subject; "
            "film before a dark, unlit backdrop, or give --threshold"
        )
    unrest = float(np.median([s.unrest for s in silhouettes]))
    if unrest > _UNEVEN_BACKDROP:
        logger.warning(
            "the backdrop is uneven: it varies by %.1f %% of the subject's brightness; what of the head is "
            "below %.0f %% is cut off, and M may be off by some percent; film before a plain, dark, unlit "
            "backdrop that does not move",
            100 * unrest,
            100 * _SIGMAS * unrest,
        )
    lit = np.mean([s.edge_share > _LIT_EDGE for s in silhouettes])
    if lit > _MOST:
        raise BadCalibration(
            f"silhouettes: bright up to the picture's edge in {lit:.0%} of the frames: the head is cut off "
            "or the backdrop lit; film the whole head before a dark backdrop, with a margin"
        )
    rivals = np.array([s.rival_share for s in silhouettes])
    if np.mean(rivals > _RIVAL_SHARE) > _MOST:
        raise BadCalibration(
            f"silhouettes: two subjects in {np.mean(rivals > _RIVAL_SHARE):.0%} of the frames; film "
            "one person alone, with nothing else lit, or mask the other out"
        )
    cuts = np.array([s.cut_share for s in silhouettes])
    if np.mean(cuts > _CUT_SHARE) > _MOST:
        raise BadCalibration(
            f"silhouettes: the head is cut off by the picture's edge in {np.mean(cuts > _CUT_SHARE):.0%} "
            "of the frames, or the backdrop is lit; film the whole head before a dark backdrop, with a margin"
        )


def _level_and_threshold(grey: FloatArray) -> tuple[float, float, float]:
    """Return level and noise of the border (without the bottom, where shoulders are), and a threshold."""
    rim = max(2, round(0.02 * grey.shape[1]))
    border = np.concatenate([grey[:rim].ravel(), grey[:, :rim].ravel(), grey[:, -rim:].ravel()])
    level = float(np.median(border))
    noise = robust_deviation(border - level)
    rise = max(_SIGMAS * noise, _LEAST_RISE * (float(np.percentile(grey, 99)) - level), 1e-6)
    return level, noise, level + rise


def _moved_to_edge(mask: Mask, grey: FloatArray, level: float, threshold: float) -> Mask:
    """Return the mask (h, w) with its contour where brightness rises from the backdrop beside it.

    One threshold for the whole picture lies outside the edge of bright skin, which is blurred, and inside
    that of dark hair. Where nothing rises by more than noise the contour stays.
    """
    backdrop = grey[~mask & (grey < threshold)]
    noise = float(np.sqrt(np.mean((backdrop - level) ** 2))) if backdrop.size else 0.0
    highest = cv2.dilate(grey, _disc(_EDGE_PX))
    lowest = cv2.erode(grey, _disc(_BAND_PX))
    kernel, bits = _disc(_BAND_PX), mask.astype(np.uint8)
    band = (cv2.dilate(bits, kernel) != cv2.erode(bits, kernel)) & (highest - lowest > _SIGMAS * noise)
    moved = np.where(band, grey > lowest + _EDGE_HEIGHT * (highest - lowest), mask).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(moved, connectivity=4)
    if count < 2:
        return mask
    return binary_fill_holes(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def _disc(radius_px: int) -> ByteArray:
    size = 2 * radius_px + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)


def _cut_share(mask: Mask) -> float:
    rows = np.flatnonzero(mask.any(axis=1))
    columns = np.flatnonzero(mask.any(axis=0))
    height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
    upper = slice(rows[0], rows[0] + max(1, int(_UPPER * height)))
    sides = max(mask[upper, 0].sum(), mask[upper, -1].sum()) / height
    return float(max(mask[0].sum() / width, sides))


def box_of_mask(mask: Mask) -> tuple[slice, slice]:
    """Return the rows and columns that hold the mask (h, w), not empty, with a border about it."""
    places = np.argwhere(mask)
    low = np.maximum(places.min(axis=0) - _BORDER_PX, 0)
    high = np.minimum(places.max(axis=0) + 1 + _BORDER_PX, mask.shape)
    return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))
