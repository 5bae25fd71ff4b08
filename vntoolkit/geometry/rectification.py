"""Rectification: four corners define how a tilted plane is mapped to square pixels of known size."""

import math
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Matrix3, Points2
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
        sizes = (self.width_mm, self.height_mm, self.pixel_mm)
        if not all(0 < size < math.inf for size in sizes):
            raise BadInput(
                "rectification: expected positive sizes in millimetres, got "
                + ", ".join(f"{size:g}" for size in sizes)
            )
        if not 8 <= min(self.size) <= max(self.size) <= 20000:
            raise BadInput(f"rectification: the pixel size makes an image of {self.size[0]}×{self.size[1]}")
        areas = _areas_of_triangles(np.reshape(self.corners_px, (4, 2)))
        if not np.abs(areas).min() > 1.0:
            raise BadInput("rectification: three of the corners lie on a line")
        if np.ptp(np.sign(areas)):
            raise BadInput(
                "rectification: the corners make no convex outline; give them in the order top left, "
                "top right, bottom left, bottom right"
            )

    @classmethod
    def as_filmed(cls, corners_px: tuple[float, ...], width_mm: float, height_mm: float) -> "Rectification":
        """As many pixels as the rectangle has in the image: their side follows from the areas."""
        cls(corners_px=corners_px, width_mm=8.0, height_mm=8.0, pixel_mm=1.0)  # refuses bad corners
        a, b, c, d = np.reshape(corners_px, (4, 2))
        area_px = 0.5 * abs(float(np.linalg.det(np.stack([d - a, c - b]))))
        side_mm = math.sqrt(width_mm * height_mm / area_px)
        return cls(corners_px=corners_px, width_mm=width_mm, height_mm=height_mm, pixel_mm=side_mm)

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


def _areas_of_triangles(corners: Points2) -> FloatArray:
    """Signed areas (4,), square pixels, of the triangles at the corners, in order round the outline."""
    outline = corners[[0, 1, 3, 2]]
    before, after = np.roll(outline, 1, axis=0) - outline, np.roll(outline, -1, axis=0) - outline
    return np.asarray(0.5 * (after[:, 0] * before[:, 1] - after[:, 1] * before[:, 0]))
