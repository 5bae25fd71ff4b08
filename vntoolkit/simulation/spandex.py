"""The scene `spandex`: two legs that step in front of each other and cast shadows (Figures 4, 5)."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.simulation.lights import FRAME_RATE_HZ, studio_camera, studio_centre
from vntoolkit.simulation.scene import Scene, SceneSurface
from vntoolkit.simulation.shapes import read_shape, smooth_step

_FRAMES = 240
_FIELD_WIDTH_M = 1.42
_MIDDLE_CM = np.array([0.0, -31.0, 0.0])
_FABRIC = np.array([0.70, 0.70, 0.72])
_STEP_HZ = 0.5
_HIP, _KNEE = np.array([8.6, 0.0, 0.0]), np.array([9.2, -43.0, 1.2])


def build_spandex(options: SceneOptions) -> Scene:
    """Return four seconds of legs in matte spandex before a dark backdrop."""
    rng = np.random.default_rng(options.seed)
    legs, phase = Legs(), float(rng.uniform(0.0, 2.0 * np.pi))
    azimuth = np.arctan2(legs.rest[:, 0], legs.rest[:, 2]) / (2.0 * np.pi)
    uv = np.stack([4.0 * azimuth, legs.rest[:, 1] / 40.0], axis=1)[legs.faces]
    wrapped = uv[..., 0].max(axis=1) - uv[..., 0].min(axis=1) > 2.0
    uv[wrapped, :, 0] += np.where(uv[wrapped, :, 0] < 0.0, 4.0, 0.0)
    surface = SceneSurface(
        faces=legs.faces,
        reference_weights=0.98 * _FABRIC,
        vertex_weights=np.tile(_FABRIC, (len(legs.rest), 1)),
        texture=_weave(rng),
        uv=uv,
    )

    def vertices(frame: int) -> Points:
        points = legs.vertices(step_at(frame / FRAME_RATE_HZ, phase))
        return 0.01 * (points - _MIDDLE_CM) * [1.0, -1.0, -1.0] + studio_centre()

    return Scene(
        name="spandex",
        camera=studio_camera(options, _FIELD_WIDTH_M),
        surface=surface,
        vertices=vertices,
        frame_count=_FRAMES,
        background_rgb=0.002,
    )


def step_at(time_s: float, phase: float) -> "LegPose":
    """Return the pose of a slow dance step: each knee in turn is raised across the other leg."""
    beat = 2.0 * np.pi * _STEP_HZ * time_s + phase
    left, right = (0.5 + 0.5 * np.sin(beat), 0.5 - 0.5 * np.sin(beat))
    lift = (left**2, right**2)
    return LegPose(
        raise_deg=(6.0 + 38.0 * lift[0], 6.0 + 38.0 * lift[1]),
        inward_deg=(1.0 + 13.0 * lift[0], 1.0 + 13.0 * lift[1]),
        knee_deg=(10.0 + 42.0 * lift[0], 10.0 + 42.0 * lift[1]),
        sway_cm=(float(2.5 * np.sin(beat)), float(0.8 * np.sin(2.0 * beat))),
        turn_deg=float(8.0 * np.sin(0.5 * beat + 0.4)),
    )


def _weave(rng: np.random.Generator) -> FloatArray:
    """Return (256, 256, 3) factors near 1: a fine mottle, no change of hue, tiling."""
    noise = gaussian_filter(rng.standard_normal((256, 256)), 1.5, mode="wrap")
    factor = 0.98 + 0.02 * np.tanh(noise / noise.std())
    return np.repeat(factor[..., None], 3, axis=2).astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class LegPose:
    """Angles in degrees, each for the leg (left in the image, right in the image), and the hips' shift.

    raise_deg: thigh forwards. inward_deg: thigh across the other leg. knee_deg: shin backwards.
    sway_cm: of the hips (x, y). turn_deg: of the whole about the vertical.
    """

    raise_deg: tuple[float, float] = (0.0, 0.0)
    inward_deg: tuple[float, float] = (0.0, 0.0)
    knee_deg: tuple[float, float] = (0.0, 0.0)
    sway_cm: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0


class Legs:
    """The skin of two legs and how its vertices follow a pose; open at waist and ankles."""

    def __init__(self) -> None:
        shape = read_shape("legs")
        self.faces, rest = shape["faces"], shape["vertices"].astype(np.float64)
        self.rest: Points = rest
        self._on_side = [smooth_step(0.5 + sign * rest[:, 0] / 4.0) for sign in (-1.0, 1.0)]
        self._thigh = smooth_step((6.0 + 0.55 * (np.abs(rest[:, 0]) - 8.0) - rest[:, 1]) / 17.0)
        self._shin = smooth_step((_KNEE[1] + 7.0 - rest[:, 1]) / 14.0)

    def vertices(self, pose: LegPose) -> Points:
        """Return (n, 3) the vertices in that pose, centimetres."""
        points = self.rest.copy()
        for leg, sign in enumerate((-1.0, 1.0)):
            mirror = np.array([sign, 1.0, 1.0])
            rows = np.flatnonzero(self._on_side[leg] > 0.0)
            share = self._on_side[leg][rows]
            knee = np.radians(pose.knee_deg[leg]) * np.array([1.0, 0.0, 0.0])
            bent = _turned(points[rows], _KNEE * mirror, knee, self._shin[rows] * share)
            lift = Rotation.from_euler("x", -pose.raise_deg[leg], degrees=True)
            inward = Rotation.from_euler("z", -sign * pose.inward_deg[leg], degrees=True)
            thigh = (lift * inward).as_rotvec()
            points[rows] = _turned(bent, _HIP * mirror, thigh, self._thigh[rows] * share)
        points = Rotation.from_euler("y", pose.turn_deg, degrees=True).apply(points)
        return points + np.array([*pose.sway_cm, 0.0])


# The legs: one skin at rest, bent at hips and knees.


def _turned(points: Points, centre: FloatArray, rotation: FloatArray, share: FloatArray) -> Points:
    """Rotate each point about `centre` by its share of a rotation vector."""
    return Rotation.from_rotvec(share[:, None] * rotation).apply(points - centre) + centre
