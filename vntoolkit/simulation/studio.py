"""Camera and lamps of every scene: one camera and three lamps, all about 5 m from the subject."""

from __future__ import annotations

import numpy as np

from vntoolkit.geometry.camera import Camera
from vntoolkit.simulation.lights import Lights
from vntoolkit.simulation.spectra import coloured_lamps, room_glow

CAMERA_DISTANCE_M = 5.0
_LIGHT_DISTANCES_M = (5.2, 4.8, 5.4)
_LIGHT_AZIMUTHS_DEG = (155.0, 35.0, 270.0)  # about the optical axis, 0 = right, 90 = down, seen by the camera
_LIGHT_OFF_AXIS_DEG = 18.0  # on a cone of 18° the lights are 30° to 32° apart, and not in one plane
_AMBIENT_LEVEL = 0.02


def studio_camera(width: int, height: int, field_width_m: float) -> Camera:
    """Return a pinhole camera that sees `field_width_m` across at the subject, 5 m away.

    Where the image is flatter than 4:3 the field's height is kept at 3/4 of `field_width_m`, so that the
    subject stays whole.
    """
    pixels_per_metre = min(width / field_width_m, height / (0.75 * field_width_m))
    return Camera.pinhole(width=width, height=height, focal_px=pixels_per_metre * CAMERA_DISTANCE_M)


def studio_centre() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return (3,) the place of the subject in the camera frame, metres."""
    return np.array([0.0, 0.0, CAMERA_DISTANCE_M])


def studio_lights() -> Lights:
    """Return the red, green and blue lamp round the camera, about 30° apart seen from the subject."""
    off_axis = np.deg2rad(_LIGHT_OFF_AXIS_DEG)
    azimuth = np.deg2rad(_LIGHT_AZIMUTHS_DEG)
    towards = np.stack(
        [
            np.sin(off_axis) * np.cos(azimuth),
            np.sin(off_axis) * np.sin(azimuth),
            np.full(3, -np.cos(off_axis)),
        ],
        axis=1,
    )
    positions = studio_centre() + np.array(_LIGHT_DISTANCES_M)[:, None] * towards
    return Lights(positions=positions, spectra=coloured_lamps(), ambient_spectrum=room_glow(_AMBIENT_LEVEL))
