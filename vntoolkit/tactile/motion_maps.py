"""Motion of a gel's material over a whole picture: in millimetres, with shear, twist, divergence and curl."""

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import Float32Array, FloatArray, Mask
from vntoolkit.tactile.motion import Membrane, MembraneMotion, enlarged

_FEWEST_TWISTED = 3  # cells in contact that tell a twist


@dataclass(frozen=True, kw_only=True, eq=False)
class GelMotion:
    """How the material has moved since the gel was untouched; maps are of the frame's rectified picture.

    displacement_mm: (h, w, 2), x right and y down, in the plane of the picture. divergence: (h, w), growth of
    area as a share, below 0 where the gel is pushed together. curl_deg: (h, w), turn, from x to y. seen:
    (h, w), False where the nearest point of the material is lost. error_mm: (h, w), what nine of ten
    displacements stay within, infinite where not seen. shear_mm: (2,), mean displacement of what touches;
    twist_deg: its turn as a whole; both None where nothing is seen to touch.
    """

    displacement_mm: Float32Array
    divergence: Float32Array
    curl_deg: Float32Array
    seen: Mask
    error_mm: Float32Array
    shear_mm: tuple[float, float] | None
    twist_deg: float | None


def motion_over_picture(
    membrane: Membrane, motion: MembraneMotion, contact: Mask, pixel_mm: float
) -> GelMotion:
    """Spread the motion of a membrane's points over the picture. contact: (h, w)."""
    places, field = membrane.cells.middles_px, membrane.field_in_frame(motion)
    found, error = (
        values[field.nearest].astype(np.float64) if len(values) else np.zeros(len(places))
        for values in (motion.found, motion.error_px)
    )
    # In the frame u(y) = y − X(y): of X by y, the inverse of y by X, which turns the other way
    xx, xy, yx, yy = (np.eye(2) - field.gradient).reshape(-1, 4).T
    stretch = 1.0 / (xx * yy - xy * yx) - 1.0
    turned = np.degrees(np.arctan2(xy - yx, xx + yy))
    values = np.column_stack([pixel_mm * field.displacement_px, stretch, turned, pixel_mm * error, found])
    maps = enlarged(values, membrane.cells, contact.shape)
    seen = maps[..., 5] > 0.5
    touched = (found > 0) & contact[np.round(places[:, 1]).astype(int), np.round(places[:, 0]).astype(int)]
    shear, twist = None, None
    if np.count_nonzero(touched) >= _FEWEST_TWISTED:
        moved = values[touched, :2]
        shear = (float(moved[:, 0].mean()), float(moved[:, 1].mean()))
        twist = _turn_deg(pixel_mm * places[touched] - moved, pixel_mm * places[touched])
    return GelMotion(
        displacement_mm=maps[..., :2],
        divergence=maps[..., 2],
        curl_deg=maps[..., 3],
        seen=seen,
        error_mm=np.where(seen, maps[..., 4], np.float32(np.inf)),
        shear_mm=shear,
        twist_deg=twist,
    )


def _turn_deg(before: FloatArray, after: FloatArray) -> float:
    """The turn, from x to y, that carries points (n, 2) to others best."""
    (x, y), (p, q) = (before - before.mean(axis=0)).T, (after - after.mean(axis=0)).T
    return float(np.degrees(np.arctan2((x * q - y * p).sum(), (x * p + y * q).sum())))
