"""Local contrast: an image in which skin texture stays and the shading that moves over it does not."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, LinearImage
from vntoolkit.errors import BadInput

_WIDEST_VALUE = 4.0  # that becomes black or white in 8 bits


@dataclass(frozen=True, kw_only=True)
class ContrastOptions:
    """How shading is taken out of an image.

    contrast_px: standard deviation in pixels of the window whose mean and spread are divided out.
    contrast_floor: spread, in levels of 255, that is taken for noise and not amplified.
    """

    contrast_px: float = 6.0
    contrast_floor: float = 3.5

    def __post_init__(self) -> None:
        if not (self.contrast_px > 0 and self.contrast_floor > 0):
            raise BadInput("contrast_px, contrast_floor: expected positive numbers")


def local_contrast(rgb: LinearImage, options: ContrastOptions) -> FloatArray:
    """Return (x − mean) / (spread + floor) of the channels' mean x (h, w, 3); float32 (h, w), about −3 to 3.

    Multiplying the light by a smooth factor changes it little, so that a moving shading does not pull what
    is followed in it. The mean of the channels is taken since compressed colour is coarse (4:2:0).
    """
    grey = 255.0 * np.asarray(rgb, dtype=np.float32).mean(axis=2)
    mean = cv2.GaussianBlur(grey, (0, 0), options.contrast_px)
    deviation = grey - mean
    spread = np.sqrt(cv2.GaussianBlur(deviation * deviation, (0, 0), options.contrast_px))
    return np.asarray(deviation / (spread + np.float32(options.contrast_floor)))


def contrast_in_8_bits(contrast: FloatArray) -> npt.NDArray[np.uint8]:
    """Return local contrast (h, w) as the 8-bit image in which skin is followed and compared."""
    return np.clip(127.5 + 127.5 / _WIDEST_VALUE * contrast, 0, 255).astype(np.uint8)
