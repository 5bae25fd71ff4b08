"""Frames of a plane seen at an angle, resampled onto the plane."""

from __future__ import annotations

import cv2
import numpy as np

from vntoolkit.geometry.rectification import Rectification
from vntoolkit.photometry.frame import LinearFrame


def rectify_frame(frame: LinearFrame, rectification: Rectification) -> LinearFrame:
    """Resample a frame; a pixel that draws on a clipped one, or on none, is clipped."""
    matrix, size = rectification.homography, rectification.size
    rgb = cv2.warpPerspective(frame.rgb, matrix, size, flags=cv2.INTER_LINEAR)
    clipped = cv2.warpPerspective(
        frame.clipped.astype(np.float32), matrix, size, flags=cv2.INTER_LINEAR, borderValue=1.0
    )
    return LinearFrame(rgb=np.asarray(rgb, np.float32), clipped=clipped > 0, number=frame.number)
