"""Calibration of a tactile sensor: a ball of known radius pressed into its gel, again and again.

The camera looks at the gel from behind, so the dent bulges towards it and inside the contact circle it is
the ball's own surface (Johnson and Adelson, Retrographic sensing for the measurement of surface texture
and shape, 2009, johnson2009). Each frame has the untouched gel's photograph subtracted, which takes most
of the light's unevenness away and leaves r = M (n − n0), n0 = the flat gel's normal. M n0 is known, the
colour of the untouched gel, so only the columns of n_x and n_y are fitted, and the untouched gel comes
out flat. (Fitting all nine follows the ball more closely, but tilts the flat gel by ten degrees or turns
lights behind the gel: near lights and errors of the labels bend the third column.) One M serves the whole
gel; a map of M would take the same samples with their positions.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import LinearImage, Mask, Points, Points2, Vector3
from vntoolkit.calibration.fit import ResponseFit, response_from_unknowns
from vntoolkit.calibration.quality import fit_quality, warn_of_weak_fit
from vntoolkit.calibration.robust import Design, fit_by_trimming
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.photometry.frame import LinearFrame

_ROUNDS = 30


@dataclass(frozen=True, kw_only=True)
class PressOptions:
    """How presses calibrate.

    ball_radius_mm: of the ball. pixel_mm: side of a pixel on the gel. contact_share: share of the labelled
    contact radius inside which the gel follows the ball. samples: pixels drawn from a press. outlier_sigmas:
    pixels whose colour residual exceeds this many robust standard deviations (dots, creases) are left out.
    """

    ball_radius_mm: float
    pixel_mm: float
    contact_share: float = 0.8
    samples: int = 400
    outlier_sigmas: float = 4.0

    def __post_init__(self) -> None:
        if not (self.ball_radius_mm > 0 and self.pixel_mm > 0):
            raise BadInput("presses: expected a positive ball radius and pixel size in mm")
        if not 0 < self.contact_share <= 1:
            raise BadInput(f"presses: expected a contact share from 0 to 1, got {self.contact_share:g}")
        if self.samples < 4 or not self.outlier_sigmas > 0:
            raise BadInput("presses: expected at least 4 samples a press and positive outlier sigmas")


@dataclass(frozen=True, kw_only=True)
class Press:
    """One press as labelled: centre (u, v) and radius of the contact circle, pixels."""

    u_px: float
    v_px: float
    radius_px: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PressSamples:
    """normals (n, 3), rgb (n, 3) with the background subtracted, positions_px (n, 2)."""

    normals: Points
    rgb: Points
    positions_px: Points2


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
    """Draw pixels of the contact. background: (h, w, 3), the untouched gel."""
    require_shape(background, (*frame.shape, 3), "background")
    normals, touched = normals_of_press(press, options, frame.shape)
    chosen = np.flatnonzero(touched & ~frame.clipped)
    if len(chosen) > options.samples:
        chosen = rng.choice(chosen, options.samples, replace=False)
    v, u = np.divmod(chosen, frame.shape[1])
    return PressSamples(
        normals=normals[v, u],
        rgb=(frame.rgb[v, u] - background[v, u]).astype(np.float64),
        positions_px=np.column_stack([u, v]).astype(np.float64),
    )


def fit_response_to_presses(
    samples: Iterable[PressSamples], level: Vector3, options: PressOptions
) -> ResponseFit:
    """Fit one M for the whole gel, for frames with the background subtracted.

    level: (3,) mean colour of the untouched gel.
    """
    parts = [part for part in samples if len(part.rgb)]
    if not parts:
        raise BadCalibration(
            "calibrate presses: no press with a label, or every contact lies outside the gel"
        )
    normals = np.concatenate([part.normals for part in parts])
    rgb = np.concatenate([part.rgb for part in parts])
    design = Design(rows=normals[:, :2], colours=rgb + (1.0 + normals[:, 2:]) * level)
    everything = np.ones(len(rgb), np.bool_)
    unknowns, inliers = fit_by_trimming(design, everything, 0.0, options.outlier_sigmas, _ROUNDS)
    response = response_from_unknowns(np.vstack([unknowns, -level, -level]))
    quality = fit_quality(normals[inliers], rgb[inliers], response, "presses")
    warn_of_weak_fit(quality)
    return ResponseFit(response=response, quality=quality, inliers=inliers)
