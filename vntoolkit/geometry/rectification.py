"""A plane seen at an angle, turned into a map with square pixels of known size: four corners say how."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import Matrix3, Points2
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera


@dataclass(frozen=True, kw_only=True)
class Rectification:
    """A rectangle of a plane and where its corners appear in the image.

    corners_px: u, v of the top left, top right, bottom left and bottom right corner, eight numbers. width_mm,
    height_mm: size of the rectangle. pixel_mm: side of a pixel of the rectified image.
    """

    corners_px: tuple[float, ...]
    width_mm: float
    height_mm: float
    pixel_mm: float

    def __post_init__(self) -> None:
        if len(self.corners_px) != 8:
            raise BadInput(f"rectification: expected four corners, eight numbers, got {len(self.corners_px)}")
        if not (self.width_mm > 0 and self.height_mm > 0 and self.pixel_mm > 0):
            raise BadInput("rectification: expected positive sizes in millimetres")
        if not 8 <= min(self.size) <= max(self.size) <= 20000:
            raise BadInput(f"rectification: the pixel size makes an image of {self.size[0]}×{self.size[1]}")
        if not _smallest_triangle(np.reshape(self.corners_px, (4, 2))) > 1.0:
            raise BadInput("rectification: three of the corners lie on a line")

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the rectified image in pixels."""
        return round(self.width_mm / self.pixel_mm), round(self.height_mm / self.pixel_mm)

    @property
    def homography(self) -> Matrix3:
        """(3, 3), rectified from image pixel: the corners map to those of (0, 0) … (width, height)."""
        w, h = self.width_mm / self.pixel_mm, self.height_mm / self.pixel_mm
        rows = []
        targets = [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)]
        for (u, v), (x, y) in zip(np.reshape(self.corners_px, (4, 2)), targets, strict=True):
            rows.append([u, v, 1, 0, 0, 0, -x * u, -x * v, -x])
            rows.append([0, 0, 0, u, v, 1, -y * u, -y * v, -y])
        matrix = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
        return matrix / matrix[2, 2]

    @property
    def camera(self) -> Camera:
        """The orthographic camera of the rectified image, lengths in metres."""
        width, height = self.size
        return Camera.orthographic(width=width, height=height, pixels_per_unit=1000.0 / self.pixel_mm)


def _smallest_triangle(corners: Points2) -> float:
    """Smallest area, in square pixels, of the triangles that three of the four corners make."""
    areas = []
    for left_out in range(4):
        a, b, c = np.delete(corners, left_out, axis=0)
        areas.append(0.5 * abs(float(np.linalg.det(np.stack([b - a, c - a])))))
    return min(areas)
