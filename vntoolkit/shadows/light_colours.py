"""Light colours from the footage's own shadow edges: across one, exactly one c_k l_kᵀn disappears.

M alone does not say how much of each channel belongs to which light. The change of colour across the edge of
a cast shadow does, as albedo and normal are the same on both sides: it points along c_k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Matrix3
from vntoolkit.checks import require_in_range, require_mask
from vntoolkit.errors import BadCalibration
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse


@dataclass(frozen=True, kw_only=True)
class LightColourOptions:
    """How shadow edges are read.

    reach_px: distance from the edge at which its two sides are measured. left: at an edge of light k's shadow
    at most this part of its contribution is left on the dark side. spill: the two others change by at most
    this part of what it loses. darkest: pixels darker than this share of the frame's 99th percentile do not
    count. rounds: the colours found select the edges anew; both bounds are doubled in the first round, when
    colours are channels. fewest: edge pixels needed per light.
    """

    reach_px: int = 3
    left: float = 0.25
    spill: float = 0.15
    darkest: float = 0.05
    rounds: int = 4
    fewest: int = 30

    def __post_init__(self) -> None:
        for name in ("left", "spill", "darkest"):
            require_in_range(getattr(self, name), 0.0, 1.0, f"light colours: {name}")
        for name in ("reach_px", "rounds", "fewest"):
            require_in_range(getattr(self, name), 1, 1e9, f"light colours: {name}")


def response_with_light_colours(
    frames: Sequence[LinearFrame],
    response: LightResponse,
    mask: Mask | None = None,
    options: LightColourOptions | None = None,
) -> LightResponse:
    """Return `response` with its light colours estimated from the shadow edges in `frames`.

    Light k is the one that channel k sees best. Raises `BadCalibration` where a light throws too few edges.
    """
    options = options or LightColourOptions()
    sides = [_sides(frame, response.ambient, mask, options) for frame in frames]
    pairs = np.concatenate(sides) if sides else np.zeros((0, 2, 3))
    directions: Matrix3 = np.eye(3)
    for looseness in np.linspace(2.0, 1.0, options.rounds):
        bounds = (looseness * options.left, looseness * options.spill)
        directions = np.stack(
            [_colour_of_light(k, pairs, directions, bounds, options.fewest) for k in range(3)]
        )
    strengths = np.linalg.norm(np.linalg.inv(directions.T) @ response.matrix, axis=1)
    return replace(response, light_colours=directions * strengths[:, None])


def _sides(
    frame: LinearFrame, ambient: FloatArray, mask: Mask | None, options: LightColourOptions
) -> FloatArray:
    """(n, 2, 3): the colours at either side of every pixel, across both axes and both ways round."""
    inside: Mask = ~frame.clipped
    if mask is not None:
        require_mask(mask, frame.shape)
        inside = inside & mask
    rgb = np.nan_to_num(frame.rgb - ambient.astype(np.float32)).astype(np.float64)
    bright = np.linalg.norm(rgb, axis=-1)
    if inside.any():
        inside = inside & (bright > options.darkest * np.percentile(bright[inside], 99))
    found = []
    step = 2 * options.reach_px
    for image, valid in ((rgb, inside), (rgb.swapaxes(0, 1), inside.T)):
        both = valid[step:] & valid[:-step]
        found.append(np.stack([image[step:][both], image[:-step][both]], axis=1))
    pairs = np.concatenate(found)
    return np.concatenate([pairs, pairs[:, ::-1]])


def _colour_of_light(
    light: int, pairs: FloatArray, directions: Matrix3, bounds: tuple[float, float], fewest: int
) -> FloatArray:
    """Unit colour: the median change over the pairs in which this light alone disappears."""
    contributions = pairs @ np.linalg.inv(directions)
    before, after = contributions[:, 0], contributions[:, 1]
    others = [k for k in range(3) if k != light]
    lost = before[:, light] - after[:, light]
    alone = (before > 0).all(axis=1) & (np.abs(after[:, light]) < bounds[0] * before[:, light])
    for k in others:
        alone &= np.abs(before[:, k] - after[:, k]) < bounds[1] * lost
    if np.count_nonzero(alone) < fewest:
        raise BadCalibration(
            f"light colours: {np.count_nonzero(alone)} shadow edge pixels of light {light}, "
            f"{fewest} are needed: film the subject where its parts throw shadows on each other, "
            "or calibrate with single lights"
        )
    change = pairs[alone, 0] - pairs[alone, 1]
    colour = np.maximum(np.median(change / np.linalg.norm(change, axis=1, keepdims=True), axis=0), 0.0)
    return colour / np.linalg.norm(colour)
