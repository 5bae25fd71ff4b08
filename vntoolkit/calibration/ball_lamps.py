"""A ball that each lamp lights alone: where the lamps stand, their colours, and the light of the room.

A lamp stands D radii from the centre of a ball, in the direction l. By Lambert's law and the square of the
distance it lights the point with the normal n as strongly as

    (x − t) / (1 − 2 t x + t²)^{3/2},  x = n · l,  t = 1 / D,

where a patch at the centre that faces the lamp is lit as strongly as 1. So the shading of a ball tells how
near a lamp stands. A far lamp has t = 0 and leaves n · l. Where a lamp does not reach the ball, the light of
the room is left.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from vntoolkit.arrays import Float32Array, FloatArray, Mask, Points, Vector3
from vntoolkit.calibration.lights import line_colour
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.spread import robust_deviation

_LIT_SHARE = 0.08  # of the brightest: less may be beyond the edge of the lamp's light
_BEHIND = 0.05  # cosine beyond that edge from which blur and a wrong direction no longer reach a pixel
_FEWEST_DARK = 50  # pixels that tell the light of the room
_MOST_PIXELS = 20_000  # that tell a lamp
_ROUNDS = 5  # of a robust fit: by then its scale has converged
# Closeness. A lamp three radii away would stand in the picture; of one a hundred away, gloss and an outline
# that is half a pixel off tell as much.
_NEAREST, _FARTHEST = 0.3, 0.01
NEAREST_USUAL = 0.15  # nearer ones are seldom meant: a wrong transfer curve looks like it
_PASSES = 2
_NAMES = ("red", "green", "blue")


@dataclass(frozen=True, kw_only=True, eq=False)
class BallLamp:
    """colour: (3,), what the ball returns of it at its centre, facing it. direction: (3,), unit, towards it.

    closeness: the ball's radius over its distance from the ball's centre, 0 for far away.
    """

    colour: Vector3
    direction: Vector3
    closeness: float

    def light_on(self, normals: Points) -> FloatArray:
        """How strongly it lights points of the ball, (..., 3) to (...), 0 where it does not reach."""
        return np.maximum(_light(np.asarray(normals) @ self.direction, self.closeness), 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class LitBall:
    """lamps: the red, the green and the blue one. room: (3,), what the ball returns of the room's light.

    is_room_known: False where no pixel shows it: it counts as 0 then.
    """

    lamps: tuple[BallLamp, BallLamp, BallLamp]
    room: Vector3
    is_room_known: bool

    def under_far_lamps(self, alone: Sequence[LinearFrame], normal_map: NormalMap) -> LinearFrame:
        """The ball under all lamps, each as strong and in the same direction everywhere, without the room."""
        rgb = np.zeros(alone[0].rgb.shape, np.float32)
        clipped = np.zeros(alone[0].shape, np.bool_)
        for lamp, frame in zip(self.lamps, alone, strict=True):
            cosines = normal_map.normals_in_camera @ lamp.direction
            near = lamp.light_on(normal_map.normals_in_camera)
            share = np.where(near > 0.0, np.maximum(cosines, 0.0) / np.maximum(near, 1e-9), 0.0)
            rgb += (frame.rgb - self.room.astype(np.float32)) * share[..., None].astype(np.float32)
            clipped |= frame.clipped
        return LinearFrame(rgb=rgb, clipped=clipped)


def fit_lamps_to_ball(
    alone: Sequence[LinearFrame], normal_map: NormalMap, dark: LinearFrame | None = None
) -> LitBall:
    """Fit the lamps to three photographs of a ball, each under one of them alone.

    dark: the ball under no lamp, None for none. Raises `BadCalibration` where a photograph is dark.
    """
    ball = normal_map.mask
    room: Vector3 = np.zeros(3)
    if dark is not None:
        room = np.median(dark.rgb[ball], axis=0).astype(np.float64)
    lamps, known = _fitted(alone, normal_map, room), dark is not None
    if not known:
        for _ in range(_PASSES):  # the room's light moves the lamps, and they where it is looked for
            found = _room_behind(alone, normal_map, lamps)
            if found is None:
                break
            room, known = found, True
            lamps = _fitted(alone, normal_map, room)
    return LitBall(lamps=lamps, room=room, is_room_known=known)


def _fitted(
    alone: Sequence[LinearFrame], normal_map: NormalMap, room: Vector3
) -> tuple[BallLamp, BallLamp, BallLamp]:
    first, second, third = (
        _fit_lamp(frame.rgb - room.astype(np.float32), normal_map.mask & ~frame.clipped, normal_map, name)
        for frame, name in zip(alone, _NAMES, strict=True)
    )
    return first, second, third


def _fit_lamp(rgb: Float32Array, seen: Mask, normal_map: NormalMap, name: str) -> BallLamp:
    pixels = rgb[seen].astype(np.float64)
    strengths = np.linalg.norm(pixels, axis=1)
    top = float(np.percentile(strengths, 99)) if len(strengths) else 0.0
    if not top > 0.0:
        raise BadCalibration(f"calibrate sphere: the ball is black or clipped under the {name} lamp")
    colour = line_colour(pixels[strengths > 0.3 * top])
    light, lit = pixels @ colour, pixels @ colour > _LIT_SHARE * top
    step = max(1, int(lit.sum()) // _MOST_PIXELS)
    light, normals = light[lit][::step], normal_map.normals_in_camera[seen][lit][::step].astype(np.float64)
    found = _fit_robustly(normals, light, np.append(np.linalg.lstsq(normals, light, rcond=None)[0], 0.0), 4)
    closeness = float(found[3])
    if closeness < _FARTHEST:  # negative where a surface shines more evenly than Lambert's
        closeness = 0.0
        found = _fit_robustly(normals, light, found, 3)
    strength = float(np.linalg.norm(found[:3]))
    return BallLamp(colour=strength * colour, direction=found[:3] / strength, closeness=closeness)


def _fit_robustly(normals: Points, light: FloatArray, start: FloatArray, count: int) -> FloatArray:
    """Fit a lamp, direction times strength and closeness (4,), to the light (n,); count: 3 for a far lamp.

    Gloss is a minority that departs far: the scale of what counts follows the median of the residuals.
    """

    def residuals(unknowns: FloatArray) -> FloatArray:
        strength = float(np.linalg.norm(unknowns[:3]))
        closeness = unknowns[3] if count == 4 else 0.0
        return np.asarray(strength * _light(normals @ unknowns[:3] / strength, closeness) - light)

    bound = np.append(np.full(3, np.inf), _NEAREST)[:count]
    found = start[:count]
    for _ in range(_ROUNDS):
        scale = max(robust_deviation(residuals(found)), 1e-6)
        found = least_squares(residuals, found, loss="cauchy", f_scale=scale, bounds=(-bound, bound)).x
    return np.append(found, np.zeros(4 - count))


def _light(cosines: FloatArray, closeness: float) -> FloatArray:
    squared = np.maximum(1.0 - 2.0 * closeness * cosines + closeness**2, 1e-6)
    return np.asarray((cosines - closeness) / (squared * np.sqrt(squared)))


def _room_behind(
    alone: Sequence[LinearFrame], normal_map: NormalMap, lamps: Sequence[BallLamp]
) -> Vector3 | None:
    """(3,), the median colour where a lamp does not reach the ball, None where too little of it is seen."""
    found = []
    for frame, lamp in zip(alone, lamps, strict=True):
        cosines = normal_map.normals_in_camera @ lamp.direction
        dark = normal_map.mask & ~frame.clipped & (cosines < lamp.closeness - _BEHIND)
        if np.count_nonzero(dark) >= _FEWEST_DARK:
            found.append(np.median(frame.rgb[dark], axis=0))
    # Light from a floor or a wall beside the ball reaches one side of it: the others outvote it.
    return np.median(found, axis=0).astype(np.float64) if found else None
