"""How a camera was held: what video and image files state about it, and the picture turned upright."""

import struct
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import Array

_UNIT = 1 << 16  # display matrices are 16.16 fixed point, their last column 2.30


@dataclass(frozen=True, kw_only=True)
class Orientation:
    """What turns a stored picture upright: first transposed, then flipped, as far as set."""

    transposed: bool = False
    left_right: bool = False
    up_down: bool = False

    @classmethod
    def from_exif(cls, value: int) -> "Orientation":
        """Return it for the value 1 to 8 of the EXIF and TIFF tag 274; any other value means upright."""
        return _BY_EXIF.get(value, UPRIGHT)

    @classmethod
    def from_display_matrix(cls, matrix: bytes) -> "Orientation | None":
        """Return it for the 36 bytes of a video's display matrix; None for a turn by no right angle.

        The matrix takes a stored (x, y, 1), a row, to the shown one (ISO/IEC 14496-12, 6.2.2).
        """
        a, b, _, c, d = struct.unpack("<5i", matrix[:20])
        if not b and not c and abs(a) == abs(d) == _UNIT:
            return cls(left_right=a < 0, up_down=d < 0)
        if not a and not d and abs(b) == abs(c) == _UNIT:
            return cls(transposed=True, left_right=c < 0, up_down=b < 0)
        return None

    def upright(self, picture: Array) -> Array:
        """Return an (h, w) or (h, w, c) picture as it was seen; the same array where it is upright."""
        if self.transposed:
            picture = np.swapaxes(picture, 0, 1)
        if self.left_right:
            picture = picture[:, ::-1]
        if self.up_down:
            picture = picture[::-1]
        return np.ascontiguousarray(picture)

    @property
    def text(self) -> str:
        """What is done, in words; empty for an upright picture."""
        turned = {(1, 0): "turned by 90°", (0, 1): "turned by 270°", (1, 1): "mirrored and turned by 90°"}
        flipped = {(1, 1): "turned by 180°", (1, 0): "mirrored", (0, 1): "flipped upside down"}
        key = (int(self.left_right), int(self.up_down))
        if self.transposed:
            return turned.get(key, "mirrored and turned by 270°")
        return flipped.get(key, "")


UPRIGHT = Orientation()
_BY_EXIF = {
    1: UPRIGHT,
    2: Orientation(left_right=True),
    3: Orientation(left_right=True, up_down=True),
    4: Orientation(up_down=True),
    5: Orientation(transposed=True),
    6: Orientation(transposed=True, left_right=True),
    7: Orientation(transposed=True, left_right=True, up_down=True),
    8: Orientation(transposed=True, up_down=True),
}
