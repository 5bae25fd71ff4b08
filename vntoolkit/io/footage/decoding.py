"""Encoded samples to a linear frame in one pass over the pixels; undistorted or rectified as the rig asks."""

from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import Array, Float32Array, LinearImage, Mask
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, decoding_table


@dataclass(frozen=True, kw_only=True, eq=False)
class EncodedFrame:
    """One frame as stored.

    values: (h, w, 3) RGB, uint8, uint16 or float32 (EXR: linear already). bits: significant bits of an
    integer sample, so that 2**bits - 1 is full scale. number: counted from 0 in the capture. name: the file,
    or file and frame number, for messages.
    """

    values: Array
    bits: int
    number: int
    name: str


def linear_frame_from_encoded(
    frame: EncodedFrame, transfer: Transfer, background: LinearImage | None = None
) -> LinearFrame:
    """Undo the transfer curve, remove the black level or the background, mark clipped pixels.

    background: (h, w, 3) linear, of the same size, subtracted; None for none. A pixel is clipped where any
    channel, before subtraction, reached `transfer.white_level`. Float values are linear by definition: the
    curve does not apply to them, the levels do. A float picture that goes beyond 1 has no full scale there:
    a white level of 1 clips none of it.
    """
    values = np.ascontiguousarray(frame.values)
    rgb = np.empty(values.shape, dtype=np.float32)
    clipped = np.empty(values.shape[:2], dtype=np.bool_)
    if values.dtype == np.float32:
        np.subtract(values, np.float32(transfer.black_level), out=rgb)
        rgb *= np.float32(1.0 / (1.0 - transfer.black_level))
        white = transfer.white_level if transfer.white_level < 1 or values.max() <= 1 else np.inf
        np.any(values >= np.float32(white), axis=2, out=clipped)
    else:
        table = decoding_table(transfer, frame.bits, values.dtype.itemsize * 8)
        _look_up(values, table, clipping_code(transfer, table, frame.bits), rgb, clipped)
    if background is not None:
        rgb -= background
    return LinearFrame(rgb=rgb, clipped=clipped, number=frame.number)


def clipping_code(transfer: Transfer, table: Float32Array, bits: int) -> int:
    """Return the smallest stored integer that counts as clipped under `table`."""
    saturation = (transfer.white_level - transfer.black_level) / (1.0 - transfer.black_level)
    code = int(np.searchsorted(table, np.float32(saturation * (1.0 - 1e-6))))
    return min(code, 2**bits - 1)


@njit
def _look_up(values, table, clip_code, rgb, clipped):  # type: ignore[no-untyped-def]  # pragma: no cover
    for v in range(values.shape[0]):
        for u in range(values.shape[1]):
            r, g, b = values[v, u, 0], values[v, u, 1], values[v, u, 2]
            rgb[v, u, 0] = table[r]
            rgb[v, u, 1] = table[g]
            rgb[v, u, 2] = table[b]
            clipped[v, u] = r >= clip_code or g >= clip_code or b >= clip_code


class Undistorter:
    """Resamples the frames of one distorted camera onto `camera`, its counterpart without distortion.

    inside: (h, w) of what the distorted camera saw. changes_frames: False where there is no distortion and
    frames pass through.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera.without_distortion()
        self.changes_frames = camera.model is CameraModel.OPENCV
        self.inside: Mask = np.ones((camera.height, camera.width), dtype=np.bool_)
        if self.changes_frames:
            grid = camera.pixel_grid()
            seen_at = camera.project(self.camera.unproject(grid, np.ones(grid.shape[:2])))
            columns, rows = np.moveaxis(seen_at.astype(np.float32), -1, 0)
            self._maps = np.ascontiguousarray(columns), np.ascontiguousarray(rows)
            self.inside = np.all((seen_at >= 0) & (seen_at <= [camera.width - 1, camera.height - 1]), -1)

    def frame(self, frame: LinearFrame) -> LinearFrame:
        """Return the undistorted frame: 0 outside `inside`, clipped where a clipped pixel has a share."""
        if not self.changes_frames:
            return frame
        rgb = np.asarray(cv2.remap(np.array(frame.rgb), *self._maps, cv2.INTER_LINEAR), dtype=np.float32)
        rgb[~self.inside] = 0
        clipped = cv2.remap(frame.clipped.astype(np.float32), *self._maps, cv2.INTER_LINEAR)
        return LinearFrame(rgb=rgb, clipped=clipped > 0, number=frame.number)

    def mask(self, mask: Mask) -> Mask:
        """Return the undistorted mask: True where the nearest pixel was and the camera saw anything."""
        if not self.changes_frames:
            return mask
        moved = cv2.remap(mask.astype(np.uint8), *self._maps, cv2.INTER_NEAREST)
        return (moved > 0) & self.inside


class Rectifier:
    """Resamples frames as filmed to the rectangle of a plane; `Undistorter`'s counterpart for a gel."""

    changes_frames = True

    def __init__(self, rectification: Rectification) -> None:
        self._matrix, self._size = rectification.homography, rectification.size

    def frame(self, frame: LinearFrame) -> LinearFrame:
        """Return the rectified frame; a pixel that draws on a clipped one, or on none, is clipped."""
        rgb = cv2.warpPerspective(frame.rgb, self._matrix, self._size, flags=cv2.INTER_LINEAR)
        clipped = cv2.warpPerspective(
            frame.clipped.astype(np.float32),
            self._matrix,
            self._size,
            flags=cv2.INTER_LINEAR,
            borderValue=1.0,
        )
        return LinearFrame(rgb=np.asarray(rgb, np.float32), clipped=clipped > 0, number=frame.number)

    def mask(self, mask: Mask) -> Mask:
        """Return the rectified mask: True where the nearest pixel was."""
        moved = cv2.warpPerspective(mask.astype(np.uint8), self._matrix, self._size, flags=cv2.INTER_NEAREST)
        return np.asarray(moved > 0)


def resampler_of(rig: Rig) -> Undistorter | Rectifier:
    """What takes frames as filmed to those that a rig's response belongs to."""
    if rig.gel is not None and rig.gel.rectification is not None:
        return Rectifier(rig.gel.rectification)
    return Undistorter(rig.camera)
