"""The scene `spandex`: two legs that step in front of each other and throw shadows (Figures 4, 5)."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.simulation.body.legs import LegPose, Legs
from vntoolkit.simulation.scene import Scene, SceneOptions, Surface
from vntoolkit.simulation.studio import studio_camera, studio_centre, studio_lights

_FRAMES = 240
_FIELD_WIDTH_M = 1.42
_MIDDLE_CM = np.array([0.0, -31.0, 0.0])
_FABRIC = np.array([0.70, 0.70, 0.72])
_STEP_HZ = 0.5


def build_spandex(options: SceneOptions) -> Scene:
    """Return four seconds of legs in matte spandex before a dark backdrop."""
    rng = np.random.default_rng(options.seed)
    legs, phase = Legs(), float(rng.uniform(0.0, 2.0 * np.pi))
    azimuth = np.arctan2(legs.rest[:, 0], legs.rest[:, 2]) / (2.0 * np.pi)
    uv = np.stack([4.0 * azimuth, legs.rest[:, 1] / 40.0], axis=1)[legs.faces]
    wrapped = uv[..., 0].max(axis=1) - uv[..., 0].min(axis=1) > 2.0
    uv[wrapped, :, 0] += np.where(uv[wrapped, :, 0] < 0.0, 4.0, 0.0)
    surface = Surface(
        faces=legs.faces,
        reference_weights=0.98 * _FABRIC,
        vertex_weights=np.tile(_FABRIC, (len(legs.rest), 1)),
        texture=_weave(rng),
        uv=uv,
    )

    def vertices(frame: int) -> Points:
        points = legs.vertices(step_at(frame / 60.0, phase))
        return 0.01 * (points - _MIDDLE_CM) * [1.0, -1.0, -1.0] + studio_centre()

    return Scene(
        name="spandex",
        camera=studio_camera(options.width, options.height, options.field_width_m or _FIELD_WIDTH_M),
        lights=studio_lights(),
        surface=surface,
        vertices=vertices,
        frame_count=_FRAMES,
        background_rgb=0.002,
    )


def step_at(time_s: float, phase: float) -> LegPose:
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


def _weave(rng: np.random.Generator, size: int = 256) -> FloatArray:
    """Return (size, size, 3) factors near 1: a fine mottle, no change of hue, tiling."""
    noise = gaussian_filter(rng.standard_normal((size, size)), 1.5, mode="wrap")
    factor = 0.98 + 0.02 * np.tanh(noise / noise.std())
    return np.repeat(factor[..., None], 3, axis=2).astype(np.float32)
