"""What stays at the camera's pixels while the surface moves: the fixed pattern of its sensor.

Pixels differ in gain by about 1 %, the same in every frame. Slopes then hold a fixed relief of some tenths of
a degree. On a smooth surface it is the strongest there is, and a mesh registered by it stands still.

A surface's slopes have no curl. White noise of both slopes has as much curl as gradient along either axis.
Noise of the frames' own has nothing in common at a pixel, the pattern has its curl. Where a painted surface
is at rest in all frames its paint has curl in common too. But the pattern is as white as noise: of its power
little is left at half the resolution, and of paint's a third and more. Paint itself is a scalar and has no
curl: there the gradients along both axes stand for it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.tracking.paint import PaintImage
from vntoolkit.tracking.slopes import Slopes, gradient_bands

FRAMES_COMPARED = 8  # so many tell the pattern's power to a hundredth of the noise's
_FEWEST_FRAMES = 4
_AROUND_PX = 33  # of the band: side of the window that the power is averaged over
_WHITE = (1.0, 1 / 12.4, 1 / 180.0)  # powers of bands, of white noise; measured
_OF_PAINT = 3.0  # power of paint over that in the next band, at most
Power = npt.NDArray[np.float32]


def fixed_pattern(frames: Iterable[Slopes | PaintImage]) -> tuple[Power, ...]:
    """Return, for each band, (h, w) the power of gradients along either axis that the pattern makes.

    frames: (h, w, 3) slopes, or (h, w, 2) paint, of frames from all over a video. Empty for fewer than four.
    """
    sums: list[npt.NDArray[np.float32]] = []
    count = 0
    for image in frames:
        bands = gradient_bands(image[..., :-1], image[..., -1])
        for k, (_, gradients, weight) in enumerate(itertools.islice(bands, 2)):
            common = gradients if gradients.shape[2] == 2 else gradients[..., 2:3] - gradients[..., 1:2]
            weighted = np.dstack([weight[..., None] * common, weight])
            if k == len(sums):
                sums.append(np.zeros((2, *weighted.shape), np.float32))
            sums[k] += np.stack([weighted, weighted * weighted])
        count += 1
    if count < _FEWEST_FRAMES or len(sums) < 2:
        return ()
    fine, coarse = (_common_power(*each) for each in sums)
    paint = _OF_PAINT * np.asarray(cv2.resize(coarse, fine.shape[::-1]))
    white = np.asarray(np.maximum(fine - paint, 0.0) / (1.0 - _OF_PAINT * _WHITE[1]), np.float32)
    return tuple(np.float32(share) * white[:: 2**k, :: 2**k] for k, share in enumerate(_WHITE))


def _common_power(total: Power, squares: Power) -> Power:
    """Return (h, w) the mean product of two frames' values around every pixel, at least 0.

    total, squares: (h, w, k + 1), sums over frames of weighted values, weights last; and of their squares.
    """
    products = cv2.blur(total * total - squares, (_AROUND_PX, _AROUND_PX))
    power = np.maximum(products[..., :-1].sum(axis=-1), 0.0) / np.maximum(products[..., -1], 1e-3)
    return np.asarray(power, np.float32)
