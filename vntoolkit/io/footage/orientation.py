"""How a camera was held: what video and image files state about it, and the picture turned upright."""

import struct
from enum import Enum

import numpy as np

from vntoolkit.arrays import Array

_UNIT = 1 << 16  # display matrices are 16.16 fixed point, their last column 2.30


class Orientation(Enum):
    """What turns a stored picture upright, in the order of the values 1 to 8 of the EXIF and TIFF tag 274.

    Of each: whether it is transposed, then mirrored, then flipped upside down, and this in words.
    """

    UPRIGHT = (False, False, False, "")
    MIRRORED = (False, True, False, "mirrored")
    HALF_TURN = (False, True, True, "turned by 180°")
    FLIPPED = (False, False, True, "flipped upside down")
    TRANSPOSED = (True, False, False, "mirrored and turned by 270°")
    QUARTER_TURN = (True, True, False, "turned by 90°")
    TRANSVERSE = (True, True, True, "mirrored and turned by 90°")
    THREE_QUARTER_TURN = (True, False, True, "turned by 270°")

    def __init__(self, transposed: bool, mirrored: bool, flipped: bool, text: str) -> None:
        self.transposed, self.mirrored, self.flipped, self.text = transposed, mirrored, flipped, text

    @classmethod
    def from_exif(cls, value: int) -> "Orientation":
        """Return it for the value of the tag; any but 1 to 8 means upright."""
        return list(cls)[value - 1] if 1 <= value <= 8 else cls.UPRIGHT

    @classmethod
    def from_display_matrix(cls, matrix: bytes) -> "Orientation | None":
        """Return it for the 36 bytes of a video's display matrix; None for a turn by no right angle.

        The matrix takes a stored (x, y, 1), a row, to the shown one (ISO/IEC 14496-12, 6.2.2).
        """
        a, b, _, c, d = struct.unpack("<5i", matrix[:20])
        if not b and not c and abs(a) == abs(d) == _UNIT:
            steps = (False, a < 0, d < 0)
        elif not a and not d and abs(b) == abs(c) == _UNIT:
            steps = (True, c < 0, b < 0)
        else:
            return None
        return next(turn for turn in cls if turn.value[:3] == steps)

    def upright(self, picture: Array) -> Array:
        """Return an (h, w) or (h, w, c) picture as it was seen; the same array where it is upright."""
        picture = np.swapaxes(picture, 0, 1) if self.transposed else picture
        picture = picture[:, ::-1] if self.mirrored else picture
        return np.ascontiguousarray(picture[::-1] if self.flipped else picture)
