"""Normal maps and depth maps: one normal or one depth per pixel."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from vntoolkit import display
from vntoolkit.arrays import Depth, FloatArray, Mask, Normals, Weight, read_only
from vntoolkit.checks import require_mask, require_shape
from vntoolkit.errors import BadInput

HALF_WEIGHT_DEG = 12.0  # error of a normal that weighs half
_LOOKED_AT_PX = 16  # rows and columns that tell axes and length, in a hundredth of a frame's time
_MOST_BACKWARD = 0.75  # of the pixels: noise turns fewer, other axes turn nearly all
_LENGTH_OFF = 0.1  # from 1; rounding to 8 bits stays below 0.02
NOISE_CELL_PX = 16  # side of the squares that noise is told by


class LengthUnit(Enum):
    """What a length of 1 means."""

    PIXEL = "px"
    METRE = "m"
    FREE = "free"  # perspective depth from normals alone: the scale is not observable


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class NormalMap(display.Displayed):
    """Surface normals seen by a camera.

    normals_in_camera: (h, w, 3) float32, unit length, n_z < 0 towards the viewer, 0 where invalid.
    mask: (h, w) bool. weight: (h, w) float32 confidence from 0 to 1, or None for 1 everywhere in the mask.
    error_deg: (h, w) float32, angle in degrees that nine of ten normals stay within, or None if not known.
    noise_deg: (⌈h/16⌉, ⌈w/16⌉), the part of it that noise makes and neighbours do not share, by cells of
    16×16 pixels; not kept in files. mirror_probability: (h, w), where two lights arrive how likely the true
    normal is the mirror image of this one in their plane; None if not known; not kept in files.
    """

    normals_in_camera: Normals
    mask: Mask
    weight: Weight | None = None
    error_deg: FloatArray | None = None
    noise_deg: FloatArray | None = None
    mirror_probability: FloatArray | None = None

    def __post_init__(self) -> None:
        normals = np.asarray(self.normals_in_camera, dtype=np.float32)
        require_shape(normals, (None, None, 3), "normals")
        require_mask(self.mask, normals.shape[:2])
        _require_seen(normals, np.asarray(self.mask))
        object.__setattr__(self, "normals_in_camera", read_only(normals))
        object.__setattr__(self, "mask", read_only(np.asarray(self.mask)))
        height, width = normals.shape[:2]
        cells = (-(-height // NOISE_CELL_PX), -(-width // NOISE_CELL_PX))
        for name, shape in (
            ("weight", (height, width)),
            ("error_deg", (height, width)),
            ("noise_deg", cells),
            ("mirror_probability", (height, width)),
        ):
            if getattr(self, name) is not None:
                values = np.asarray(getattr(self, name), dtype=np.float32)
                require_shape(values, shape, name)
                object.__setattr__(self, name, read_only(values))

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        return self.normals_in_camera.shape[0], self.normals_in_camera.shape[1]

    def _facts(self) -> display.Facts:
        facts = {"size": display.size_of(self.shape), "valid": display.share_of(self.mask)}
        if self.mask.any():
            cosines = np.clip(-self.normals_in_camera[..., 2][self.mask], 0, 1)
            facts["median slant"] = f"{np.degrees(np.arccos(np.median(cosines))):.0f}°"
            if self.weight is not None:
                facts["mean weight"] = f"{self.weight[self.mask].mean():.2f}"
            if self.error_deg is not None:
                facts["expected error"] = f"{np.median(self.error_deg[self.mask]):.1f}°"
        return facts

    def _picture(self) -> display.Picture:
        return display.picture_of_normals(self.normals_in_camera, self.mask)


def _require_seen(normals: Normals, mask: Mask) -> None:
    """Raise `BadInput` for normals of other axes or of no unit length, as files and arrays elsewhere hold.

    A part of the pixels tells: a map of the wrong axes is wrong nearly everywhere.
    """
    step = max(1, min(mask.shape) // _LOOKED_AT_PX)
    some = normals[::step, ::step][mask[::step, ::step]]
    some = some[np.isfinite(some).all(axis=1)]  # who works on the map refuses what is no number
    if not len(some):
        return
    if np.mean(some[:, 2] > 0) > _MOST_BACKWARD:
        raise BadInput(
            "normals: expected the camera's axes (x right, y down, z away from the viewer), where a visible "
            f"normal has n_z < 0, got n_z > 0 in {np.mean(some[:, 2] > 0):.0%} of the pixels: multiply by "
            "[1, -1, -1]"
        )
    lengths = np.linalg.norm(some, axis=1)
    if not abs(np.median(lengths) - 1.0) < _LENGTH_OFF:
        raise BadInput(
            f"normals: expected unit length, got {np.median(lengths):g} (median); divide each by its length"
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DepthMap(display.Displayed):
    """Depth along the optical axis, growing away from the camera.

    depth: (h, w) float32 or float64, 0 where invalid. mask: (h, w) bool. unit: what a length of 1 means.
    error_percent: (h, w) float32, error in % of the depth's range that nine of ten pixels stay within, or
    None.
    """

    depth: Depth
    mask: Mask
    unit: LengthUnit = LengthUnit.PIXEL
    error_percent: FloatArray | None = None

    def __post_init__(self) -> None:
        depth = np.asarray(self.depth)
        if not np.issubdtype(depth.dtype, np.floating):
            raise BadInput(f"depth: expected floating point, got {depth.dtype}")
        require_shape(depth, (None, None), "depth")
        require_mask(self.mask, depth.shape)
        if self.error_percent is not None:
            error = np.asarray(self.error_percent, dtype=np.float32)
            require_shape(error, depth.shape, "error of the depth")
            object.__setattr__(self, "error_percent", read_only(error))
        object.__setattr__(self, "depth", read_only(depth))
        object.__setattr__(self, "mask", read_only(np.asarray(self.mask)))

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        return self.depth.shape[0], self.depth.shape[1]

    def _facts(self) -> display.Facts:
        facts = {
            "size": display.size_of(self.shape),
            "valid": display.share_of(self.mask),
            "unit": self.unit.value,
        }
        if self.mask.any():
            near, far = self.depth[self.mask].min(), self.depth[self.mask].max()
            facts["from"], facts["to"] = f"{near:.4g}", f"{far:.4g}"
        return facts

    def _picture(self) -> display.Picture:
        return display.picture_of_depth(self.depth, self.mask)
