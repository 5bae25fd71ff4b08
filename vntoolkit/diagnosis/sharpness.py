"""How sharp is the picture? The subject's silhouette tells.

Where the subject ends before something darker, light falls in one step, which blur of standard deviation b
spreads over some b pixels. After a further blur of s pixels the steepest slope is the step over √(2π (b² +
s²)): the slopes after two such blurs tell b whatever the step (zhuo2011). Where a surface turns away it gets
darker before it ends, over more pixels than the blur. The slopes after a third blur then tell of a wider one:
such places do not count, and of what remains the sharper quarter does. Motion blurs only edges across its
direction.

Colour is often told by every second pixel only: through a mosaic of filters, or by a codec that halves it.
What lies between is interpolated, which blurs by ½ px², and leaves pixels that are smoother than those beside
them, at every second place (popescu2005).

Sharpening, in a camera or after it, makes the background darker beside a step than farther away, where every
lens makes it brighter. Where the background is black, steps that are steeper than a pixel's own area makes
them tell, with a rim inside them that is too bright. A picture made smaller is steep too, but has no such
rim.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import Array, Float32Array, FloatArray, Mask, box_of
from vntoolkit.diagnosis.evidence import SUBJECT, brightest_channel, silhouette
from vntoolkit.diagnosis.finding import Finding
from vntoolkit.photometry.frame import LinearFrame

_REACH_PX = 4  # of an edge from the outline
_BORDER_PX = 10  # an outline made by the picture's border is none
_SCALES_PX = (1.0, 2.0, 3.0)
# Squared widths that no blur made: a pixel's own area, and differences between the pixels on either side.
_OF_PIXELS = 1 / 12 + 1 / 3
_ALIKE = 0.25  # of 1 + b²: what the two measurements of one step may differ by
_WIDEST_PX = 4.0  # of a blur whose steps are looked for
_LEAST_STEP = 0.2  # of the channel's brightest hundredth
_DARKEST_SIDE = 0.4  # of the brighter side: the darker one is behind the subject
_PROFILE_PX = 7
_MARGIN_PX = 16  # beyond the profiles and the blurs
_FEWEST, _MOST = 100, 20_000  # places in a channel
_SHARPER = 25  # per cent of the places …
_SHARPEST = 5  # … of one direction only, which may be that of a limb, whose sides all turn away
_DIRECTIONS = 4
_OF_WIDE = 0.5  # of what is as wide as blur: where the picture is sharp, nearly all of it turns away
_MOST_ROUGH = 10.0  # times the median: an outline is no noise
_FLAT = 0.015  # a pixel, of the step: beside a surface that turns away nothing tells what is too bright
# Own scenes, another renderer's and photographs have 0.5 to 1.0 pixels, and up to 1.3 along a limb.
_BLURRED_PX = 1.5
OF_INTERPOLATION_PX = math.sqrt(0.5)
# The rougher pixels over the smoother; mosaics make 1.28 to 1.8, other footage up to 1.17.
_EVERY_SECOND = 1.2
_LEAST_BACKGROUND = 0.001  # of the step: what is blacker shows no halo
_HALO = 0.55  # clean footage has 0.6 behind a mosaic and 0.8 to 1.2, sharpened by a half 0.1 to 0.6
_STEEP_PX, _OVERSHOOT = 0.4, 0.03  # a picture made smaller has 0.3 and 0.01, the noisiest 0.5 and 0.03


@dataclass(frozen=True, kw_only=True)
class Sharpness:
    """blur_px: standard deviation of the blur beyond a pixel's own area. overshoot: beside a step, over it.
    halo: light of the background two or three pixels beside a step, over that six pixels away; 1 for unknown.

    widest_px: the blur across the edges of the direction in which it is widest: more than the rest where
    something moved. edges: at how many places it was measured.
    """

    blur_px: float
    widest_px: float
    overshoot: float
    halo: float
    edges: int

    @property
    def over_all_px(self) -> float:
        """The mean of all directions, as for a blur that is alike in all."""
        return math.sqrt((self.blur_px**2 + self.widest_px**2) / 2.0)


def fit_sharpness(frames: Sequence[LinearFrame], mask: Mask | None = None) -> Sharpness | None:
    """Measure how sharp frames of full resolution are, the median; None where too little outline shows.

    mask: (h, w) where the subject is, or None.
    """
    found = [seen for frame in frames if (seen := _of_frame(frame, mask)) is not None]
    if not found:
        return None
    names = ("blur_px", "widest_px", "overshoot", "halo")
    medians = {name: float(np.median([getattr(seen, name) for seen in found])) for name in names}
    return Sharpness(**medians, edges=sum(seen.edges for seen in found))


def colour_is_interpolated(frame: LinearFrame) -> bool:
    """True where red and green differ more smoothly at every second pixel of a frame of full resolution."""
    rgb = np.asarray(frame.rgb, np.float32)
    brightest = cv2.GaussianBlur(brightest_channel(rgb), (0, 0), 2.0)
    subject: Mask = (brightest > SUBJECT * np.percentile(brightest[::4, ::4], 99)) & ~frame.clipped
    inside = cv2.erode(subject.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=0) > 0
    difference = rgb[..., 0] - rgb[..., 1]
    beside = np.array([[0, 0.25, 0], [0.25, -1, 0.25], [0, 0.25, 0]], np.float32)
    rough = np.abs(cv2.filter2D(difference, -1, beside))
    rough = np.minimum(rough, _MOST_ROUGH * float(np.median(rough[inside])) if inside.any() else 0.0)
    four = [(rough[v::2, u::2], inside[v::2, u::2]) for v in range(2) for u in range(2)]
    if min(int(there.sum()) for _, there in four) < _FEWEST:
        return False
    means = [float(values[there].mean()) for values, there in four]
    return max(means) > _EVERY_SECOND * max(min(means), 1e-9)


def findings_from_sharpness(seen: Sharpness) -> list[Finding]:
    """Find footage that is blurred, or sharpened."""
    if seen.widest_px > _BLURRED_PX:
        return [Finding.of("blur", blur_px=seen.widest_px, edges=seen.edges)]
    if seen.blur_px < _STEEP_PX and seen.overshoot > _OVERSHOOT:
        return [Finding.of("sharpening", overshoot=seen.overshoot, edges=seen.edges)]
    if seen.halo < _HALO:
        return [Finding.of("sharpening/halo", darker=1 - seen.halo, edges=seen.edges)]
    return []


def _of_frame(frame: LinearFrame, mask: Mask | None) -> Sharpness | None:
    near = _near_outline(frame, mask)
    seen = box_of(near, _MARGIN_PX)
    near = near[seen]
    channels = [np.ascontiguousarray(frame.rgb[..., k][seen], np.float32) for k in range(3)]
    measured = np.hstack([_edges(channel, near) for channel in channels])
    squares, others, directions, overshoots = measured[:4]
    beside = np.median(measured[4:], axis=1) if len(squares) >= _FEWEST else np.zeros(3)
    halo = float(beside[:2].min() / beside[2]) if beside[2] > _LEAST_BACKGROUND else 1.0
    known = overshoots[np.isfinite(overshoots)]
    overshoot = float(np.median(known)) if len(known) >= _FEWEST else 0.0
    if len(squares) >= 4 * _FEWEST and float(np.median(squares)) <= 0.0:
        return Sharpness(blur_px=0.0, widest_px=0.0, overshoot=overshoot, halo=halo, edges=len(squares))
    blur = _width(squares, others, _SHARPER)
    if blur is None:
        alone = Sharpness(blur_px=0.0, widest_px=0.0, overshoot=0.0, halo=halo, edges=len(squares))
        return alone if halo < _HALO else None
    widest = blur
    for k in range(_DIRECTIONS):
        apart = directions - k * math.pi / _DIRECTIONS
        here = np.abs(np.sin(apart)) < math.sin(math.pi / (2 * _DIRECTIONS))
        widest = max(widest, _width(squares[here], others[here], _SHARPEST) or 0.0)
    return Sharpness(blur_px=blur, widest_px=widest, overshoot=overshoot, halo=halo, edges=len(squares))


def _width(squares: FloatArray, others: FloatArray, percentile: float) -> float | None:
    """Return the blur where two measurements agree (the smaller); None for few, or one of limbs alone."""
    tolerance = _ALIKE * (1.0 + np.maximum(squares, 0.0))
    steps = others - squares < tolerance
    wide = squares > _BLURRED_PX**2
    alike = steps & ((squares - others < tolerance) | wide)
    if int(alike.sum()) < _FEWEST:
        return None
    squares_there = np.where(wide, np.minimum(squares, others), squares)[alike]
    width = math.sqrt(max(float(np.percentile(squares_there, percentile)), 0.0))
    if width > _BLURRED_PX and float(steps[wide].mean()) < _OF_WIDE:
        return None
    return width


def _near_outline(frame: LinearFrame, mask: Mask | None) -> Mask:
    """Return (h, w), pixels on either side of the subject's outline, far from clipped ones."""
    brightest = cv2.GaussianBlur(brightest_channel(np.asarray(frame.rgb, np.float32)), (0, 0), 1.0)
    subject = silhouette(brightest, mask)
    around = np.ones((2 * _REACH_PX + 1, 2 * _REACH_PX + 1), np.uint8)
    near = np.asarray(cv2.dilate(subject, around)) > np.asarray(cv2.erode(subject, around, borderValue=1))
    if frame.clipped.any():
        near &= np.asarray(cv2.dilate(frame.clipped.astype(np.uint8), around)) == 0
    near[:_BORDER_PX] = near[-_BORDER_PX:] = False
    near[:, :_BORDER_PX] = near[:, -_BORDER_PX:] = False
    return near


def _edges(channel: Float32Array, near: Mask) -> FloatArray:
    """Measure one channel, (h, w), at the n places where its slope is steepest across a step.

    Returns (7, n): b² in pixels² by the first two scales, and by the last two; the direction in radians; the
    overshoot, NaN where nothing tells it; the light 2, 3 and 6 pixels before the step, over it.
    """
    slopes = _slopes(channel)
    steep = np.asarray(cv2.magnitude(*slopes), np.float32)
    bright = float(np.percentile(channel[::4, ::4], 99))
    least = _LEAST_STEP * bright / math.sqrt(2 * math.pi * (_WIDEST_PX**2 + _SCALES_PX[0] ** 2))
    v, u = np.nonzero(near & (steep > max(least, 1e-9)))
    v, u = (places[:: 1 + len(v) // _MOST] for places in (v, u))
    towards = np.stack([slope[v, u] / steep[v, u] for slope in slopes])

    def along(image: Float32Array, steps: float) -> Float32Array:
        at_u, at_v = (
            (place + steps * part).astype(np.float32) for place, part in zip((u, v), towards, strict=True)
        )
        if not len(v):
            return np.empty(0, np.float32)
        moved = cv2.remap(image, at_u[:, None], at_v[:, None], cv2.INTER_LINEAR)
        return np.asarray(moved[:, 0], np.float32)

    ridge = (steep[v, u] >= along(steep, 1.0)) & (steep[v, u] >= along(steep, -1.0))
    v, u, towards = v[ridge], u[ridge], towards[:, ridge]
    profile = np.stack([along(channel, t) for t in range(-_PROFILE_PX, _PROFILE_PX + 1)])
    dark, lit = profile[:4].mean(axis=0), profile[-4:].mean(axis=0)
    step = np.maximum(lit - dark, 1e-9)
    slope = (profile[-1] - profile[-4]) / 3.0
    beside = _PROFILE_PX + np.arange(1, 4)
    foretold = profile[-4] - (2 * _PROFILE_PX - 3 - beside[:, None]) * slope
    overshoots = (profile[beside] - foretold).max(axis=0) / step
    overshoots[np.abs(slope) > _FLAT * step] = np.nan
    squared: list[Array] = [steep[v, u] ** 2]
    for scale in _SCALES_PX[1:]:
        smooth = _blurred(channel, scale)
        squared.append(
            0.25 * ((smooth[v, u + 1] - smooth[v, u - 1]) ** 2 + (smooth[v + 1, u] - smooth[v - 1, u]) ** 2)
        )
    widths = []
    for k in range(2):
        ratio = squared[k] / np.maximum(squared[k + 1], 1e-20)
        wide, narrow = _SCALES_PX[k + 1] ** 2, _SCALES_PX[k] ** 2
        widths.append((wide - ratio * narrow) / np.maximum(ratio - 1.0, 1e-3) - _OF_PIXELS)
    good = (lit - dark > _LEAST_STEP * bright) & (dark < _DARKEST_SIDE * lit)
    directions = np.arctan2(towards[1], towards[0])
    before = profile[[_PROFILE_PX - 2, _PROFILE_PX - 3, _PROFILE_PX - 6]] / step
    return np.stack([*widths, directions, overshoots, *before])[:, good]


def _slopes(channel: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return the slopes to the right and down after the least blur, (h, w) each."""
    smooth = _blurred(channel, _SCALES_PX[0])
    across = np.array([[-0.5, 0.0, 0.5]], np.float32)
    right, down = (cv2.filter2D(smooth, -1, k, borderType=cv2.BORDER_REPLICATE) for k in (across, across.T))
    return np.asarray(right, np.float32), np.asarray(down, np.float32)


def _blurred(channel: Float32Array, scale: float) -> Float32Array:
    return np.asarray(cv2.GaussianBlur(channel, (0, 0), scale, borderType=cv2.BORDER_REPLICATE), np.float32)
