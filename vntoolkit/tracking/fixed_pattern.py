"""What stays at the camera's pixels while the surface moves: the fixed pattern of its sensor.

Pixels differ in gain by about 1 %, the same in every frame. Slopes then hold a fixed relief of some tenths of
a degree. On a smooth surface it is the strongest there is, and a mesh registered by it stands still.

A surface's slopes have no curl. White noise of both slopes has as much curl as gradient along either axis.
Curl that two frames have in common at one pixel is therefore of the pattern; noise of the frames' own has
nothing in common. Where a painted surface is at rest in all frames its paint counts as pattern too.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.tracking.slopes import Slopes, gradient_bands

FRAMES_COMPARED = 8  # so many tell the pattern's power to a hundredth of the noise's
_FEWEST_FRAMES = 4
_AROUND_PX = 33  # of the band: side of the window that the power is averaged over
Power = npt.NDArray[np.float32]


def fixed_pattern(frames: Iterable[Slopes]) -> tuple[Power, ...]:
    """Return, for each band, (h, w) the power of gradients along either axis that the pattern makes.

    frames: (h, w, 3) slopes of frames from all over a video. Empty for fewer than four.
    """
    sums: list[npt.NDArray[np.float32]] = []
    count = 0
    for slopes in frames:
        for k, (_, gradients, weight) in enumerate(gradient_bands(slopes[..., :2], slopes[..., 2])):
            seen = weight > 0
            curl = np.where(seen, gradients[..., 2] - gradients[..., 1], np.float32(0.0))
            if k == len(sums):
                sums.append(np.zeros((*curl.shape, 3), np.float32))
            sums[k] += np.stack([curl, curl * curl, seen], axis=-1, dtype=np.float32)
        count += 1
    if count < _FEWEST_FRAMES:
        return ()
    return tuple(_common_power(*np.moveaxis(each, 2, 0)) for each in sums)


def _common_power(total: Power, squares: Power, count: Power) -> Power:
    """Return the mean product of two different frames' values around every pixel, at least 0."""
    window = (_AROUND_PX, _AROUND_PX)
    products = cv2.blur(total * total - squares, window)
    pairs = cv2.blur(count * (count - 1.0), window)
    return np.asarray(np.maximum(products, 0.0) / np.maximum(pairs, 1e-3), np.float32)
