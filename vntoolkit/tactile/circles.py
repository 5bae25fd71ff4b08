"""Contact circles of presses, found in the change of colour alone, before any response is known.

A dent is symmetric about its middle, and a normal and the one opposite lean opposite ways. The change of
colour d is nearly linear in the normal, so that d(c + δ) ≈ −d(c − δ) about the middle c, whatever M is. The
autoconvolution Σ d(x) · d(2c − x) is then most negative at the middle: one Fourier transform finds it.
Inside the contact the tilt grows with the distance, beyond it the gel flattens out: the change is strongest
at the contact's rim.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import fft

from vntoolkit.arrays import FloatArray, LinearImage
from vntoolkit.checks import require_shape
from vntoolkit.tactile.dots import shrunk, step_of

_BLUR_PX = 1.0  # of the shrunk picture: what is left of dots and grain is no dent
_NOISE_FACTOR = 3.0  # changes below so many times the median are noise, and are shrunk to 0
_SMALLEST_RADIUS_PX = 3
_RAYS, _ROUNDS = 24, 8  # from the middle of a contact; of a robust fit
_RIM_SOUGHT, _RIM_BLUR = (0.5, 1.6), 0.06  # of the radius
_LEAST_SYMMETRY = 0.4  # 1 where all of the change is odd about the middle, 0 for one that is not at all


@dataclass(frozen=True, kw_only=True)
class Press:
    """One press, labelled or found: centre (u, v) and radius of the contact circle, pixels."""

    u_px: float
    v_px: float
    radius_px: float


def find_contact_circle(change: LinearImage) -> Press | None:
    """Find the dent of one ball in a change of colour (h, w, 3) without drift and dots; None without one."""
    require_shape(change, (None, None, 3), "change of colour")
    step, small = step_of(change.shape), shrunk(change)
    height, width = small.shape[:2]
    small = np.asarray(cv2.GaussianBlur(small, (0, 0), _BLUR_PX), dtype=np.float32)
    strength = np.linalg.norm(small, axis=2)
    noise = _NOISE_FACTOR * float(np.median(strength))
    small = small * (np.maximum(strength - noise, 0.0) / np.maximum(strength, 1e-12))[..., None]
    energy = float((small**2).sum())
    if not energy > 0:
        return None
    spectrum = fft.rfft2(small, (2 * height, 2 * width), axes=(0, 1))
    odd = -np.asarray(fft.irfft2((spectrum**2).sum(axis=2), (2 * height, 2 * width)))
    row, column = np.unravel_index(int(np.argmax(odd)), odd.shape)
    if odd[row, column] < _LEAST_SYMMETRY * energy:
        return None
    v = (row + _peak(odd[:, column], int(row))) / 2
    u = (column + _peak(odd[row], int(column))) / 2
    radius = _rim(strength, float(u), float(v))
    if radius is None:
        return None
    middle = (step - 1) / 2  # of a block of pixels
    return Press(u_px=u * step + middle, v_px=v * step + middle, radius_px=radius * step)


def aspect_of_contact(change: LinearImage, press: Press) -> float | None:
    """Return how many times as high as wide a contact is, from its rim in all directions; None if unseen.

    A ball's contact is a circle. The rim is where the odd part of the change is strongest along a ray.
    """
    angles = np.arange(_RAYS) * 2 * np.pi / _RAYS
    radii = press.radius_px * np.arange(*_RIM_SOUGHT, 0.5 / press.radius_px)
    u = (press.u_px + np.outer(np.cos(angles), radii)).astype(np.float32)
    v = (press.v_px + np.outer(np.sin(angles), radii)).astype(np.float32)
    smooth = cv2.GaussianBlur(change, (0, 0), max(_BLUR_PX, _RIM_BLUR * press.radius_px))
    along = cv2.remap(smooth, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    odd = np.linalg.norm(along - np.roll(along, _RAYS // 2, axis=0), axis=2)
    at = odd.argmax(axis=1)
    inside = ((u >= 0) & (u < change.shape[1] - 1) & (v >= 0) & (v < change.shape[0] - 1)).all(axis=1)
    seen = inside & np.roll(inside, _RAYS // 2) & (at > 0) & (at < len(radii) - 1)
    if 2 * seen.sum() < _RAYS:
        return None
    design = np.column_stack([np.ones(_RAYS), np.cos(2 * angles), np.sin(2 * angles)])[seen]
    logs, weight = np.log(radii[at][seen]), np.ones(int(seen.sum()))
    for _ in range(_ROUNDS):
        found = np.linalg.lstsq(design * weight[:, None], logs * weight, rcond=None)[0]
        left = np.abs(logs - design @ found)
        weight = 1.0 / np.sqrt(1.0 + (left / (2.0 * np.median(left) + 1e-6)) ** 2)
    return float(np.exp(-2.0 * found[1]))


def _peak(values: FloatArray, at: int) -> float:
    """Where between pixels a parabola through the largest value and its neighbours peaks, −1/2 to 1/2."""
    if not 0 < at < len(values) - 1:
        return 0.0
    before, here, after = (float(values[at + k]) for k in (-1, 0, 1))
    bend = before - 2 * here + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0


def _rim(strength: FloatArray, u: float, v: float) -> float | None:
    """Radius at which the change is strongest, in the median over the circle."""
    rows, columns = np.indices(strength.shape)
    distance = np.hypot(columns - u, rows - v)
    furthest = int(min(strength.shape) / 2)
    profile = np.array(
        [
            np.median(strength[(distance >= radius - 0.5) & (distance < radius + 0.5)])
            for radius in range(_SMALLEST_RADIUS_PX, furthest)
        ]
    )
    if len(profile) < 3:
        return None
    at = int(np.argmax(profile))
    return _SMALLEST_RADIUS_PX + at + _peak(profile, at)
