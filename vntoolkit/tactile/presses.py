"""Presses of a ball into a gel: samples of normal and colour.

Inside the contact circle the gel is the ball's own surface; far from it the gel lies flat. In the crease
between, its shape is not known, and no sample is taken.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import Array, BoolArray, FloatArray, Int64Array, LinearImage, Mask, Points, Points2
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadCalibration
from vntoolkit.options.calibration import PressOptions
from vntoolkit.tactile.circles import Press

_SAMPLES = 400  # pixels drawn from a press's contact
_UNTOUCHED_RADII = 3.3  # of the labelled contact: beyond it the gel lies flat, by half a radius to spare
_FLAT_RADII = 2.8  # of the contact where it really is, which may be half a radius from its label
CONTACT_SHARE = 0.8  # of the labelled contact radius, inside which the gel follows the ball
_FLAT_SHARE = 0.67  # of the contact's pixels are drawn where the gel is flat; more make the ball less round
_DRAWN_RADII = 1.25  # of the labelled contact: room for labels that lie beside the dent


@dataclass(frozen=True, kw_only=True, eq=False)
class PressSamples:
    """Pixels of one frame, at and around the contact and, far away, on the flat gel.

    rgb: (n, 3) change of colour against the untouched gel. untouched: (n, 3), the gel's own colour there.
    positions_px: (n, 2). press: as labelled. ball_radius_mm: of the ball that was pressed.
    """

    rgb: Points
    untouched: Points
    positions_px: Points2
    press: Press
    ball_radius_mm: float

    def offsets_px(self, label_offset_px: FloatArray) -> Points2:
        """From the centre of the ball, (n, 2), where the label is off by `label_offset_px`, (2,)."""
        return self.positions_px - (self.press.u_px, self.press.v_px) - label_offset_px


@dataclass(frozen=True, kw_only=True, eq=False)
class PressPairs:
    """Pairs of normal and change of colour: normals, rgb (n, 3), positions_px (n, 2), touched (n,) bool.

    presses: (n,) number of the press that a pair is of.
    """

    normals: Points
    rgb: Points
    positions_px: Points2
    touched: BoolArray
    presses: Int64Array

    def thinned(self, count: int) -> "PressPairs":
        """Every k-th pair, so that about `count` are left."""
        step = max(1, -(-len(self.rgb) // count))
        return PressPairs(**{name: values[::step] for name, values in vars(self).items()})


def samples_from_press(
    change: LinearImage,
    background: LinearImage,
    usable: Mask,
    press: Press,
    options: PressOptions,
    rng: np.random.Generator,
) -> PressSamples:
    """Draw pixels of the contact and of the flat gel around it.

    change: (h, w, 3), the frame less the untouched gel, its drift removed. background: (h, w, 3), the
    untouched gel. usable: (h, w), pixels that count.
    """
    shape = usable.shape
    require_shape(change, (*shape, 3), "change of colour")
    require_shape(background, (*shape, 3), "background")
    contact_mm = press.radius_px * options.side_mm
    if contact_mm >= options.ball_radius_mm:
        raise BadCalibration(
            f"calibrate presses: a contact circle of {contact_mm:.2f} mm is not narrower than the ball of "
            f"{options.ball_radius_mm:g} mm radius; check --ball-radius-mm and --pixel-mm"
        )
    v, u = np.indices(shape)
    distance = np.hypot(u - press.u_px, v - press.v_px)
    contact = _draw((distance < _DRAWN_RADII * press.radius_px) & usable, 2 * _SAMPLES, rng)
    flat = (distance > _UNTOUCHED_RADII * press.radius_px) & usable
    chosen = np.concatenate([contact, _draw(flat, round(_FLAT_SHARE * _SAMPLES), rng)])
    rows, columns = np.divmod(chosen, shape[1])
    return PressSamples(
        rgb=change[rows, columns].astype(np.float64),
        untouched=background[rows, columns].astype(np.float64),
        positions_px=np.column_stack([columns, rows]).astype(np.float64),
        press=press,
        ball_radius_mm=options.ball_radius_mm,
    )


def _draw(mask: Mask, count: int, rng: np.random.Generator) -> Int64Array:
    chosen = np.flatnonzero(mask)
    return rng.choice(chosen, count, replace=False) if len(chosen) > count else chosen


def pairs_from_samples(
    samples: Iterable[PressSamples], label_offset_px: FloatArray, options: PressOptions
) -> PressPairs:
    """Give every sample its normal; those in the crease around the contact are left out.

    label_offset_px: from label to dent, (2,) of all presses or (presses, 2) of each.
    """
    samples = list(samples)
    own = np.broadcast_to(label_offset_px, (len(samples), 2))
    parts: list[tuple[Array, ...]] = []
    for number, part in enumerate(samples):
        offsets = part.offsets_px(own[number])
        distance = np.linalg.norm(offsets, axis=1)
        touched = distance < CONTACT_SHARE * part.press.radius_px
        xy = np.where(touched[:, None], offsets * options.side_mm / part.ball_radius_mm, 0.0)
        normals = np.column_stack([xy, -np.sqrt(np.maximum(1.0 - (xy**2).sum(axis=1), 0.0))])
        used = touched | (distance > _FLAT_RADII * part.press.radius_px)
        presses = np.full(int(used.sum()), number, dtype=np.int64)
        parts.append((normals[used], part.rgb[used], part.positions_px[used], touched[used], presses))
    if not any(touched.any() for *_, touched, _ in parts):
        raise BadCalibration(
            "calibrate presses: no press with a label, or every contact lies outside the gel"
        )
    normals, rgb, positions_px, touched, presses = (
        np.concatenate(group) for group in zip(*parts, strict=True)
    )
    return PressPairs(normals=normals, rgb=rgb, positions_px=positions_px, touched=touched, presses=presses)
