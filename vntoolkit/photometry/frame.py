"""A linear colour frame of a capture, and the labels of the lights that reach its pixels."""

from dataclasses import dataclass, field

import numpy as np

from vntoolkit.arrays import BoolArray, ByteArray, LinearImage, Mask, VisibilityLabels, read_only
from vntoolkit.checks import require_shape
from vntoolkit.display import Displayed, Facts, Picture, picture_of_light, share_of, size_of
from vntoolkit.errors import BadInput

ALL_LIT = 7
LABEL_LEGEND: dict[str, str] = {
    str(label): "no light" if label == 0 else "lit by " + " and ".join(
        f"light {light}" for light in range(3) if label >> light & 1
    )
    for label in range(8)
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LinearFrame(Displayed):
    """Light as the camera measured it, in three channels.

    rgb: (h, w, 3) float32, linear, black level removed, 1.0 = full scale (slightly negative where noise
    lies below black); may be given without its name. clipped: (h, w) bool, True where any channel reached
    the white level; by default where one reaches 1. number: the frame's number in its capture, counted
    from 0.
    """

    rgb: LinearImage = field(kw_only=False)
    clipped: Mask = None  # type: ignore[assignment]  # until __post_init__
    number: int = 0

    def __post_init__(self) -> None:
        given = np.asarray(self.rgb)
        if given.dtype.kind in "iu":
            raise BadInput(
                f"frame: expected linear light, full scale = 1, got {given.dtype}: divide by the largest "
                "value that it can hold, and undo the transfer curve"
            )
        rgb = given.astype(np.float32, copy=False)
        require_shape(rgb, (None, None, 3), "frame")
        if not np.isfinite(rgb.sum(dtype=np.float64)):
            raise BadInput(
                "frame: expected finite light, got NaN or infinity: mask those pixels, and store 0"
            )
        clipped = rgb.max(axis=2, initial=0.0) >= 1.0 if self.clipped is None else np.asarray(self.clipped)
        require_shape(clipped, rgb.shape[:2], "clipped mask")
        if clipped.dtype != np.bool_:
            raise BadInput(f"clipped mask: expected booleans, got {clipped.dtype}")
        object.__setattr__(self, "rgb", read_only(rgb))
        object.__setattr__(self, "clipped", read_only(clipped))

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        return self.rgb.shape[0], self.rgb.shape[1]

    def _facts(self) -> Facts:
        brightest = float(np.percentile(self.rgb, 99)) if self.rgb.size else 0.0
        return {
            "size": size_of(self.shape),
            "number": str(self.number),
            "brightest": f"{brightest:.2f}",
            "clipped": share_of(self.clipped),
        }

    def _picture(self) -> Picture:
        return picture_of_light(self.rgb)


def labels_from_lit(lit: BoolArray) -> VisibilityLabels:
    """Pack (..., 3) booleans, one per light, into (...) labels."""
    return (lit[..., 0] + 2 * lit[..., 1].astype(np.uint8) + 4 * lit[..., 2].astype(np.uint8)).astype(
        np.uint8
    )


def lit_from_labels(labels: VisibilityLabels) -> BoolArray:
    """Unpack (...) labels into (..., 3) booleans, one per light."""
    return (labels[..., None] >> np.arange(3, dtype=np.uint8)) & 1 == 1


def count_lit(labels: VisibilityLabels) -> ByteArray:
    """Number of lights, 0 to 3, that reach each pixel."""
    return np.array([0, 1, 1, 2, 1, 2, 2, 3], dtype=np.uint8)[labels]
