"""The head as an implicit body: skull, face, nose, lips, ears, neck, hair.

Head frame: centimetres, x to the right in the image (the person's left), y up, z towards the viewer,
origin between the ears at the height of the pupils.
"""

from itertools import pairwise

import numpy as np

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.simulation.body.implicit import ImplicitBody, Part, both_sides, capsule, ellipsoid

EYE_CENTRE = (3.15, 0.0, 6.75)
EYE_RADIUS = 1.22
LID_THICKNESS = 0.14
MOUTH_HALF_WIDTH = 2.55
MOUTH_HEIGHT = -6.75
NECK_CUT = -20.0
# azimuth from the front, degrees, and the height where the hair begins there, centimetres
_HAIRLINE_DEG = (0.0, 20.0, 40.0, 55.0, 66.0, 76.0, 84.0, 98.0, 118.0, 128.0, 145.0, 180.0)
_HAIRLINE_CM = (7.0, 7.1, 6.4, 4.6, 2.6, -1.0, 2.6, 3.3, 2.6, -2.0, -6.0, -7.0)
_EDGE_CM = 0.7
_THICKNESS_CM = 0.9


def sculpt_head() -> ImplicitBody:
    """Return the neutral head with closed lids and closed mouth."""
    parts = [*_skull(), *_jaw(), *_neck(), *_eyes(), *_nose(), *_lips(), *_ears()]
    return ImplicitBody.from_parts(parts)


def _skull() -> list[Part]:
    return [
        ellipsoid((0.0, 3.3, -1.2), (7.5, 8.0, 9.5), 0.0),
        ellipsoid((0.0, 4.0, 3.0), (6.6, 6.0, 6.1), 2.0),
        ellipsoid((0.0, -3.6, 2.6), (5.3, 7.2, 6.2), 2.5),
        *both_sides(
            ellipsoid((4.6, -2.6, 5.2), (1.9, 1.5, 2.1), 2.0),
            ellipsoid((3.3, -4.6, 5.9), (2.2, 2.4, 2.0), 2.0),
        ),
    ]


def _jaw() -> list[Part]:
    return [
        *both_sides(capsule((4.9, -5.6, 0.6), (1.2, -10.0, 6.9), (1.1, 1.2), 1.8)),
        ellipsoid((0.0, -6.4, 5.4), (3.5, 3.2, 3.6), 1.8),
        ellipsoid((0.0, -10.0, 7.5), (1.75, 1.35, 1.5), 1.4),
    ]


def _neck() -> list[Part]:
    return [
        capsule((0.0, -7.0, -2.3), (0.0, -20.0, -3.6), (4.7, 5.4), 2.6),
        *both_sides(capsule((4.5, -4.0, -2.6), (1.8, -17.5, 1.0), (0.9, 0.9), 1.8)),
    ]


def _eyes() -> list[Part]:
    x, y, z = EYE_CENTRE
    shell = EYE_RADIUS + LID_THICKNESS
    return [
        *both_sides(
            ellipsoid((x - 0.1, y - 0.15, z + 2.0), (2.1, 1.35, 1.6), -1.5),
            ellipsoid((1.55, 0.4, 9.3), (0.9, 1.1, 1.1), -1.2),
        ),
        *both_sides(
            capsule((0.9, 1.95, 7.9), (3.6, 2.35, 7.2), (0.85, 0.75), 1.2),
            capsule((3.6, 2.35, 7.2), (5.2, 1.5, 5.2), (0.75, 0.5), 1.8),
        ),
        *both_sides(
            ellipsoid((x, y, z), (shell, shell, shell), 0.55),
            capsule((x - 1.1, y - 1.55, z + 0.65), (x + 1.3, y - 1.45, z + 0.2), (0.35, 0.35), 1.0),
        ),
    ]


def _nose() -> list[Part]:
    return [
        capsule((0.0, 1.2, 7.9), (0.0, -1.6, 9.3), (0.75, 0.62), 1.3),
        capsule((0.0, -1.4, 9.3), (0.0, -3.4, 10.35), (0.62, 0.70), 1.0),
        ellipsoid((0.0, -3.5, 10.2), (0.85, 0.78, 0.85), 0.9),
        *both_sides(ellipsoid((1.15, -3.65, 9.0), (0.66, 0.70, 1.05), 0.9, (0.25, 0.35, 0.0))),
        capsule((0.0, -4.1, 10.2), (0.0, -4.45, 9.1), (0.34, 0.45), 0.4),
        *both_sides(ellipsoid((0.62, -4.45, 9.55), (0.30, 0.45, 0.62), -0.22, (0.3, 0.35, 0.0))),
        *both_sides(capsule((1.95, -3.7, 9.0), (3.3, -6.2, 8.1), (0.08, 0.08), -0.9)),
    ]


def _lips() -> list[Part]:
    y = MOUTH_HEIGHT
    return [
        capsule((0.0, -5.0, 9.5), (0.0, y + 0.85, 9.45), (0.16, 0.20), -0.5),
        *both_sides(
            capsule((0.0, y + 0.36, 8.85), (1.2, y + 0.36, 8.62), (0.55, 0.52), 0.5),
            capsule((1.2, y + 0.36, 8.62), (2.5, y + 0.04, 7.75), (0.52, 0.24), 0.5),
        ),
        *both_sides(
            capsule((0.0, y - 0.52, 8.80), (1.1, y - 0.48, 8.60), (0.66, 0.60), 0.4),
            capsule((1.1, y - 0.48, 8.60), (2.4, y - 0.10, 7.80), (0.60, 0.24), 0.4),
        ),
        capsule((-1.2, y - 1.60, 9.0), (1.2, y - 1.60, 9.0), (0.35, 0.35), -0.9),
        *both_sides(
            capsule((0.0, y, 9.62), (1.3, y - 0.01, 9.36), (0.05, 0.05), -0.30),
            capsule((1.3, y - 0.01, 9.36), (2.7, y - 0.05, 8.25), (0.05, 0.12), -0.35),
        ),
    ]


def _ears() -> list[Part]:
    rim = [(7.0, -2.1, 0.1), (7.3, -1.0, -0.9), (7.75, 0.5, -1.7), (7.8, 1.8, -1.5), (7.5, 2.3, -0.5),
           (7.1, 1.9, 0.4), (6.9, 1.1, 0.6)]  # fmt: skip
    helix = [capsule(a, b, (0.24, 0.24), 0.4) for a, b in pairwise(rim)]
    return [
        *both_sides(ellipsoid((7.1, 0.3, -0.5), (0.40, 2.3, 1.35), 0.6, (0.0, -0.5, 0.0))),
        *both_sides(*helix),
        *both_sides(
            ellipsoid((7.0, -2.2, 0.15), (0.32, 0.65, 0.5), 0.5),
            ellipsoid((7.4, 0.0, -0.1), (0.45, 0.9, 0.55), -0.4, (0.0, -0.3, 0.0)),
            ellipsoid((7.0, -0.2, 0.6), (0.25, 0.45, 0.3), 0.3),
        ),
    ]


# Hair: where it grows and how thick it is.


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
