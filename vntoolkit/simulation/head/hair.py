"""Where hair grows on the head, and how thick it lies."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray, Points

# azimuth from the front, degrees, and the height where the hair begins there, centimetres
_HAIRLINE_DEG = (0.0, 20.0, 40.0, 55.0, 66.0, 76.0, 84.0, 98.0, 118.0, 128.0, 145.0, 180.0)
_HAIRLINE_CM = (7.0, 7.1, 6.4, 4.6, 2.6, -1.0, 2.6, 3.3, 2.6, -2.0, -6.0, -7.0)
_EDGE_CM = 0.7
_THICKNESS_CM = 0.9


def azimuth_deg(points: Points) -> FloatArray:
    """Return (n,) the angle about the vertical from the front, positive towards +x."""
    return np.degrees(np.arctan2(points[:, 0], points[:, 2]))


def hair_share(points: Points) -> FloatArray:
    """Return (n,) from 0 on skin to 1 in the hair."""
    azimuth = np.abs(azimuth_deg(points))
    line = np.interp(azimuth, _HAIRLINE_DEG, _HAIRLINE_CM)
    ripple = 0.10 * np.sin(1.7 * azimuth) + 0.14 * np.sin(0.43 * azimuth + 2.0) + 0.08 * np.sin(1.1 * azimuth)
    share = np.clip((points[:, 1] - line - ripple) / _EDGE_CM, 0.0, 1.0)
    in_ear = (
        (np.abs(points[:, 0]) > 6.75) & (points[:, 1] < 2.9) & (points[:, 2] > -2.6) & (points[:, 2] < 1.4)
    )
    return np.where(in_ear, 0.0, share * share * (3.0 - 2.0 * share))


def hair_thickness(points: Points) -> FloatArray:
    """Return (n,) centimetres of hair, in soft locks, thinner towards hairline and neck."""
    azimuth = np.radians(azimuth_deg(points))
    line = np.interp(np.abs(np.degrees(azimuth)), _HAIRLINE_DEG, _HAIRLINE_CM)
    rise = np.clip((points[:, 1] - line) / 3.0, 0.0, 1.0)
    locks = np.sin(9.0 * azimuth + 0.35 * points[:, 1]) + 0.6 * np.sin(
        17.0 * azimuth - 0.6 * points[:, 1] + 1.0
    )
    crown = np.clip((10.0 - points[:, 1]) / 4.0, 0.0, 1.0)  # near the pole the azimuth means nothing
    return _THICKNESS_CM * rise * (1.0 + 0.10 * crown * locks)
