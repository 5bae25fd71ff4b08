"""The scene `gel`: a tactile gel under near lamps, seen from behind. A ball is pressed in, then rolled.

Frame 0 is the untouched gel, frames 1 to 36 are single presses, the others one rolling touch. Under the ball
the gel is the ball's surface. Around it, it comes to rest as the half-space of Hertz's contact does
(hertz1882), sooner, since a gel is a layer.
"""

import numpy as np

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.geometry.camera import Camera
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.simulation.grids import grid_faces, grid_uv
from vntoolkit.simulation.lights import Lights, coloured_lamps, room_glow
from vntoolkit.simulation.rigid.sphere import PAINT
from vntoolkit.simulation.scene import Scene, SceneSurface

BALL_RADIUS_M = 2.4e-3
_PRESSES, _ROLLED = 36, 24  # frames
_FIELD_WIDTH_M = 16e-3
_CAMERA_DISTANCE_M = 0.04
_LAMPS_M = 0.018  # of each from the axis, and as far towards the camera: near, at 45 degrees
_AZIMUTHS_DEG = (180.0, 60.0, 300.0)
_EXPOSURE = 0.5  # near the lamps the gel is brighter than in the middle, and must not clip
_CELLS = 260  # across the gel: of 0.08 mm
_MARGIN = 1.3  # of the gel over the field
_CONTACTS = (0.45, 0.65)  # radius of the contact over the ball's
_DOTS_APART_M, _DOT_M = 1.6e-3, 0.36e-3
_DOT_REFLECTS = 0.3  # of what the gel does
_DOT_TEXELS = 32


def build_gel(options: SceneOptions) -> Scene:
    """Build a gel of 21 × 16 mm, printed with dots, into which a ball of 2.4 mm radius is pressed."""
    width_m = options.field_width_m or _FIELD_WIDTH_M
    pixels_per_metre = min(options.width / width_m, options.height / (0.75 * width_m))
    size_m = _MARGIN * np.array([options.width, options.height]) / pixels_per_metre
    columns, rows = (round(_CELLS * side) for side in size_m / size_m[0])
    x, y = (size_m[0] / _CELLS * (np.arange(count) - (count - 1) / 2) for count in (columns, rows))
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    presses = _presses(np.random.default_rng(options.seed), width_m)

    def vertices(frame: int) -> Points:
        gel = np.concatenate([grid, np.full((rows, columns, 1), _CAMERA_DISTANCE_M)], axis=-1)
        if frame:
            u, v, contact_m = presses[frame - 1]
            # the dent comes towards the camera, which looks at the gel from behind
            gel[..., 2] -= dent(np.linalg.norm(grid - (u, v), axis=-1), contact_m)
        return gel.reshape(-1, 3)

    count = rows * columns
    return Scene(
        name="gel",
        camera=Camera.pinhole(
            width=options.width, height=options.height, focal_px=pixels_per_metre * _CAMERA_DISTANCE_M
        ),
        lights=_lamps(),
        surface=SceneSurface(
            faces=grid_faces(np.arange(count).reshape(rows, columns)),
            reference_weights=np.array(PAINT),
            texture=_dot()[..., None] * np.array(PAINT),
            uv=grid_uv(rows, columns) * size_m / _DOTS_APART_M,
        ),
        vertices=vertices,
        frame_count=1 + len(presses),
        centre=np.array([0.0, 0.0, _CAMERA_DISTANCE_M]),
        exposure_level=_EXPOSURE,
        facts={"ball_radius_mm": 1000 * BALL_RADIUS_M, "pixel_mm": 1000 / pixels_per_metre},
    )


def dent(distance_m: FloatArray, contact_m: float) -> FloatArray:
    """Depth of the gel in metres at a distance from the middle of a contact of this radius."""
    radius_m = BALL_RADIUS_M
    deepest = contact_m**2 / radius_m  # by Hertz
    cap = deepest - radius_m + np.sqrt(radius_m**2 - np.minimum(distance_m, contact_m) ** 2)
    share = contact_m / np.maximum(distance_m, contact_m)
    fall = (2 - share**-2) * np.arcsin(share) + np.sqrt(1 - share**2) / share  # π / 2 at the rim
    rest = np.exp(-((np.maximum(distance_m - contact_m, 0.0) / contact_m) ** 2))
    return np.asarray(cap * fall / (np.pi / 2) * rest)


def _presses(rng: np.random.Generator, width_m: float) -> FloatArray:
    """Return (n, 3): place of the ball and radius of its contact, metres, frame by frame."""
    room = np.array([width_m, 0.75 * width_m]) / 2 - 1.1 * BALL_RADIUS_M
    places = rng.uniform(-room, room, (_PRESSES, 2))
    contacts = rng.uniform(*_CONTACTS, _PRESSES)
    turn = 2 * np.pi * np.arange(_ROLLED) / _ROLLED
    rolled = room * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    pressed = np.mean(_CONTACTS) + 0.5 * np.ptp(_CONTACTS) * np.sin(2 * turn)
    return np.column_stack(
        [np.concatenate([places, rolled]), BALL_RADIUS_M * np.concatenate([contacts, pressed])]
    )


def _lamps() -> Lights:
    around = np.deg2rad(_AZIMUTHS_DEG)
    across = _LAMPS_M * np.stack([np.cos(around), np.sin(around)], axis=-1)
    positions = np.column_stack([across, np.full(3, _CAMERA_DISTANCE_M - _LAMPS_M)])
    return Lights(positions=positions, spectra=coloured_lamps(), ambient_spectrum=room_glow())


def _dot() -> FloatArray:
    """One printed dot on its tile, (n, n): the share of light that the gel or the ink reflects."""
    place = (np.arange(_DOT_TEXELS) + 0.5) / _DOT_TEXELS - 0.5
    away = np.hypot(*np.meshgrid(place, place)) * _DOTS_APART_M
    return np.where(away < _DOT_M / 2, _DOT_REFLECTS, 1.0)
