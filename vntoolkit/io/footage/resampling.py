"""Resampling of frames: undistortion to a pinhole camera, and rectification of a plane."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Mask
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig

Single = npt.NDArray[np.float32]


class Undistorter:
    """Resamples the frames of one distorted camera onto `camera.without_distortion()`."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._maps: tuple[Single, Single] | None = None
        if camera.model is CameraModel.OPENCV:
            pinhole = camera.without_distortion()
            grid = camera.pixel_grid()
            seen_at = camera.project(pinhole.unproject(grid, np.ones(grid.shape[:2])))
            columns, rows = np.moveaxis(seen_at.astype(np.float32), -1, 0)
            self._maps = np.ascontiguousarray(columns), np.ascontiguousarray(rows)
            self.inside: Mask = np.all(
                (seen_at >= 0) & (seen_at <= [camera.width - 1, camera.height - 1]), -1
            )
        else:
            self.inside = np.ones((camera.height, camera.width), dtype=np.bool_)

    @property
    def camera(self) -> Camera:
        """The pinhole camera of the undistorted frames."""
        return self._camera.without_distortion()

    @property
    def changes_frames(self) -> bool:
        """False where the camera has no distortion and frames pass through."""
        return self._maps is not None

    def frame(self, frame: LinearFrame) -> LinearFrame:
        """Return the undistorted frame: 0 outside `inside`, clipped where a clipped pixel has a share."""
        if self._maps is None:
            return frame
        rgb = np.asarray(cv2.remap(np.array(frame.rgb), *self._maps, cv2.INTER_LINEAR), dtype=np.float32)
        rgb[~self.inside] = 0
        clipped = cv2.remap(frame.clipped.astype(np.float32), *self._maps, cv2.INTER_LINEAR)
        return LinearFrame(rgb=rgb, clipped=clipped > 0, number=frame.number)

    def mask(self, mask: Mask) -> Mask:
        """Return the undistorted mask: True where the nearest pixel was and the camera saw anything."""
        if self._maps is None:
            return mask
        moved = cv2.remap(mask.astype(np.uint8), *self._maps, cv2.INTER_NEAREST)
        return (moved > 0) & self.inside


class Rectifier:
    """Resamples frames as filmed to the rectangle of a plane; `Undistorter`'s counterpart for a gel."""

    changes_frames = True

    def __init__(self, rectification: Rectification) -> None:
        self._rectification = rectification

    @property
    def camera(self) -> Camera:
        """The orthographic camera of the rectified frames."""
        return self._rectification.camera

    def frame(self, frame: LinearFrame) -> LinearFrame:
        """Return the rectified frame."""
        return rectify_frame(frame, self._rectification)

    def mask(self, mask: Mask) -> Mask:
        """Return the rectified mask: True where the nearest pixel was."""
        matrix, size = self._rectification.homography, self._rectification.size
        moved = cv2.warpPerspective(mask.astype(np.uint8), matrix, size, flags=cv2.INTER_NEAREST)
        return np.asarray(moved > 0)


def resampler_of(rig: Rig) -> Undistorter | Rectifier:
    """What takes frames as filmed to those that a rig's response belongs to."""
    if rig.gel is not None and rig.gel.rectification is not None:
        return Rectifier(rig.gel.rectification)
    return Undistorter(rig.camera)


def rectify_frame(frame: LinearFrame, rectification: Rectification) -> LinearFrame:
    """Resample a frame; a pixel that draws on a clipped one, or on none, is clipped."""
    matrix, size = rectification.homography, rectification.size
    rgb = cv2.warpPerspective(frame.rgb, matrix, size, flags=cv2.INTER_LINEAR)
    clipped = cv2.warpPerspective(
        frame.clipped.astype(np.float32), matrix, size, flags=cv2.INTER_LINEAR, borderValue=1.0
    )
    return LinearFrame(rgb=np.asarray(rgb, np.float32), clipped=clipped > 0, number=frame.number)
