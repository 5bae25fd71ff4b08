"""The calibration board: a chessboard with markers in the white squares and a square hole in the middle.

Section III-A of brostow2011: the plane's pose comes from the pattern, its colour from the sample in the hole.
Pure geometry; whoever draws or detects the markers takes them from `MARKER_DICTIONARY`.

Board frame: origin in the top left corner, x right, y down along the print, z into the board, millimetres.
The side that is seen therefore has the normal (0, 0, −1).
"""

import math
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import ArrayLike, FloatArray, IntArray, Mask
from vntoolkit.errors import BadInput

MARKER_DICTIONARY = "DICT_4X4_250"  # OpenCV's name
MARKER_COUNT = 250
NORMAL_IN_BOARD = (0.0, 0.0, -1.0)


@dataclass(frozen=True, kw_only=True)
class BoardLayout:
    """Sizes of a board; the defaults fit on A4 and have a hole of 45 % of the width."""

    columns: int = 11
    """Squares across, odd, so that the hole is centred on squares."""
    rows: int = 11
    """Squares down, odd, so that the hole is centred on squares."""
    square_mm: float = 16.0
    """Side of a square, millimetres."""
    marker_share: float = 0.7
    """Side of a marker over that of its square."""
    hole_squares: int = 5
    """Side of the hole in squares, odd; 0 for none."""

    def __post_init__(self) -> None:
        if self.columns % 2 == 0 or self.rows % 2 == 0 or min(self.columns, self.rows) < 3:
            raise BadInput(
                f"board: expected odd numbers of squares from 3 on, got {self.columns} × {self.rows}"
            )
        if not 0 < self.square_mm < math.inf:
            raise BadInput(f"board: expected squares of a positive size in mm, got {self.square_mm:g}")
        if not 0.3 <= self.marker_share <= 0.9:
            raise BadInput(f"board: expected markers of 0.3 to 0.9 of a square, got {self.marker_share:g}")
        if self.hole_squares < 0 or (self.hole_squares != 0 and self.hole_squares % 2 == 0):
            raise BadInput(
                f"board: expected a hole of an odd number of squares, got {self.hole_squares}; 0 for none"
            )
        if self.hole_squares > min(self.columns, self.rows) - 4:
            raise BadInput("board: the hole leaves no ring of two squares around it; use more squares")
        if self.columns * self.rows // 2 > MARKER_COUNT:
            raise BadInput(
                f"board: {self.columns} × {self.rows} squares need more than {MARKER_COUNT} markers"
            )

    @property
    def width_mm(self) -> float:
        """Width of the pattern."""
        return self.columns * self.square_mm

    @property
    def height_mm(self) -> float:
        """Height of the pattern."""
        return self.rows * self.square_mm

    @property
    def marker_mm(self) -> float:
        """Side of a marker, border included."""
        return self.square_mm * self.marker_share

    @property
    def hole_mm(self) -> FloatArray:
        """The hole's corners (4, 2) in the board frame, from the top left one round by the top right."""
        half = 0.5 * self.hole_squares * self.square_mm
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return np.array([self.width_mm, self.height_mm]) / 2 + half * signs

    @property
    def corners_mm(self) -> FloatArray:
        """Inner chessboard corners (n, 2) in the board frame, by id: row by row, from the top left."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        return np.column_stack([x.ravel(), y.ravel()]) * self.square_mm

    @property
    def sound_corner_ids(self) -> IntArray:
        """Ids of the corners that exist: those in the hole or on its edge are cut away."""
        reach = (0.5 * self.hole_squares + 0.25) * self.square_mm if self.hole_squares else -1.0
        offset = np.abs(self.corners_mm - np.array([self.width_mm, self.height_mm]) / 2)
        return np.flatnonzero(offset.max(axis=1) > reach)

    @property
    def marker_squares(self) -> IntArray:
        """(column, row) of the square of every marker, (n, 2), by id: the white squares row by row."""
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        return np.column_stack([column, row])[(row + column) % 2 == 1]

    @property
    def sound_marker_ids(self) -> IntArray:
        """Ids of the markers outside the hole."""
        return np.flatnonzero(~self.in_hole(self.marker_squares))

    def in_hole(self, squares: ArrayLike) -> Mask:
        """Whether squares (..., 2), given as (column, row), are cut away: (...) bool."""
        middle = np.array([self.columns - 1, self.rows - 1]) // 2
        reach = np.abs(np.asarray(squares) - middle).max(axis=-1)
        return np.asarray(reach < self.hole_squares / 2)
