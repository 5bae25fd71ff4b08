"""Calibration of a tactile sensor: a ball of known radius pressed into its gel, again and again.

The camera looks at the gel from behind, so the dent bulges towards it and inside the contact circle it is the
ball's own surface (Johnson and Adelson, Retrographic sensing for the measurement of surface texture and
shape, 2009, johnson2009). Each frame has the untouched gel's photograph subtracted, which takes most of the
light's unevenness away; r + mean background = M n is then the model, and the rig carries the mean background
as a negative ambient term, so that later footage is reconstructed with the same subtraction. One M serves the
whole gel: a map of M over the gel would take the same samples with their positions.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from vntoolkit.arrays import IntArray, LinearImage, Mask, Points, Vector3
from vntoolkit.calibration.fit import FitOptions, ResponseFit, fit_response
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.photometry.frame import LinearFrame

_FLAT_NORMAL = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, kw_only=True)
class PressOptions:
    """How presses calibrate.

    ball_radius_mm: of the ball. pixel_mm: side of a pixel on the gel. contact_share: share of the labelled
    contact radius inside which the gel follows the ball. flat_share: how many contact radii from the centre
    the gel counts as flat. samples: pixels drawn from a frame, one half of them from the flat gel. fit: how M
    is fitted.
    """

    ball_radius_mm: float
    pixel_mm: float
    contact_share: float = 0.8
    flat_share: float = 4.0
    samples: int = 400
    fit: FitOptions = field(default_factory=FitOptions)

    def __post_init__(self) -> None:
        if not (self.ball_radius_mm > 0 and self.pixel_mm > 0):
            raise BadInput("presses: expected a positive ball radius and pixel size in mm")
        if not (0 < self.contact_share <= 1 < self.flat_share):
            raise BadInput("presses: expected 0 < contact share <= 1 < flat share")
        if self.samples < 4:
            raise BadInput(f"presses: expected at least 4 samples a press, got {self.samples}")


@dataclass(frozen=True, kw_only=True)
class Press:
    """One press as labelled: centre (u, v) and radius of the contact circle, pixels."""

    u_px: float
    v_px: float
    radius_px: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PressSamples:
    """normals (n, 3), rgb (n, 3) with the background subtracted, positions_px (n, 2), touched (n,) bool."""

    normals: Points
    rgb: Points
    positions_px: Points
    touched: Mask


def normals_of_press(press: Press, options: PressOptions, shape: tuple[int, int]) -> tuple[Points, Mask]:
    """Normals (h, w, 3), camera frame, and the mask of the contact. Raises where the contact is too wide."""
    v, u = np.indices(shape)
    offset_mm = np.stack([u - press.u_px, v - press.v_px], axis=-1) * options.pixel_mm
    distance = np.linalg.norm(offset_mm, axis=-1)
    contact_mm = press.radius_px * options.pixel_mm
    if contact_mm >= options.ball_radius_mm:
        raise BadCalibration(
            f"calibrate presses: a contact circle of {contact_mm:.2f} mm is not narrower than the ball of "
            f"{options.ball_radius_mm:g} mm radius; check --ball-radius-mm and --pixel-mm"
        )
    inside = distance < options.contact_share * contact_mm
    height = np.sqrt(np.maximum(options.ball_radius_mm**2 - distance**2, 0))
    normals = np.concatenate([offset_mm, -height[..., None]], axis=-1) / options.ball_radius_mm
    return normals, inside


def samples_from_press(
    frame: LinearFrame,
    press: Press,
    background: LinearImage,
    options: PressOptions,
    rng: np.random.Generator,
) -> PressSamples:
    """Draw pixels of the contact and of the flat gel around it. background: (h, w, 3), the untouched gel."""
    require_shape(background, (*frame.shape, 3), "background")
    normals, touched = normals_of_press(press, options, frame.shape)
    v, u = np.indices(frame.shape)
    flat = np.hypot(u - press.u_px, v - press.v_px) > options.flat_share * press.radius_px
    touched, flat = touched & ~frame.clipped, flat & ~frame.clipped
    contact = _draw(np.flatnonzero(touched), options.samples - options.samples // 2, rng)
    around = _draw(np.flatnonzero(flat), options.samples // 2, rng)
    chosen = np.concatenate([contact, around])
    known = normals.reshape(-1, 3)[chosen]
    known[len(contact) :] = _FLAT_NORMAL
    return PressSamples(
        normals=known,
        rgb=(frame.rgb - background).reshape(-1, 3)[chosen].astype(np.float64),
        positions_px=np.column_stack([u.ravel()[chosen], v.ravel()[chosen]]).astype(np.float64),
        touched=np.arange(len(chosen)) < len(contact),
    )


def fit_response_to_presses(
    samples: Iterable[PressSamples], level: Vector3, options: PressOptions, rng: np.random.Generator
) -> ResponseFit:
    """Fit one M for the whole gel, for frames with the background subtracted.

    level: (3,) mean colour of the untouched gel; what is subtracted from every light alike is added back for
    the fit, so that shadow can be told from a negative difference. The quality counts touched pixels only.
    """
    parts = list(samples)
    if not parts or not any(part.touched.any() for part in parts):
        raise BadCalibration(
            "calibrate presses: no press with a label, or every contact lies outside the gel"
        )
    normals = np.concatenate([part.normals for part in parts])
    rgb = np.concatenate([part.rgb for part in parts])
    fit = fit_response(normals, rgb + level, options.fit, verb="presses", rng=rng)
    response = replace(fit.response, ambient=fit.response.ambient - level)
    return replace(fit, response=response)


def _draw(indices: IntArray, count: int, rng: np.random.Generator) -> IntArray:
    return indices if len(indices) <= count else rng.choice(indices, count, replace=False)
