"""The scenes `head_turn`, `face` and `face_makeup` (Figures 2, 3, 8)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vntoolkit.arrays import Points
from vntoolkit.simulation.head import anatomy, paint
from vntoolkit.simulation.head.anatomy import Head, build_head
from vntoolkit.simulation.head.paint import Makeup
from vntoolkit.simulation.head.rig import (
    Expression,
    HeadRig,
    performance_at,
    performance_pose,
    turning_pose,
)
from vntoolkit.simulation.scene import Detail, Scene, SceneOptions, SceneSurface
from vntoolkit.simulation.studio import studio_camera, studio_centre, studio_lights

_TURN_FRAMES, _WIDEST_TURN_DEG = 90, 68.0
_FACE_FRAMES = 1000
_FIELD_WIDTH_M = 0.40
_FACE_FIELD_WIDTH_M = 0.355
_MIDDLE_CM = np.array([0.0, -0.6, 0.0])
_FACE_MIDDLE_CM = np.array([0.0, -0.3, 0.0])
_SKIN_GLOSS, _EYE_GLOSS = 0.010, 0.015


def build_head_turn(options: SceneOptions) -> Scene:
    """Return a freckled head that turns from 68° left to 68° right with a fixed expression."""
    rig = HeadRig(build_head())

    def vertices(frame: int) -> Points:
        pose = turning_pose(frame / (_TURN_FRAMES - 1), _WIDEST_TURN_DEG)
        return rig.vertices(Expression(), pose)

    return _scene("head_turn", options, Makeup.NONE, vertices, _TURN_FRAMES, _FIELD_WIDTH_M, _MIDDLE_CM)


def build_face(options: SceneOptions) -> Scene:
    """Return the bare face: it smiles, grimaces, speaks and blinks."""
    return _performing("face", options, Makeup.NONE)


def build_face_makeup(options: SceneOptions) -> Scene:
    """Return the same performance in makeup of one colour."""
    return _performing("face_makeup", options, Makeup.UNIFORM)


def _performing(name: str, options: SceneOptions, makeup: Makeup) -> Scene:
    rig = HeadRig(build_head())
    phases = np.random.default_rng(options.seed).uniform(0.0, 2.0 * np.pi, 8)

    def vertices(frame: int) -> Points:
        time_s = frame / 60.0
        return rig.vertices(performance_at(time_s, phases), performance_pose(time_s, phases))

    return _scene(name, options, makeup, vertices, _FACE_FRAMES, _FACE_FIELD_WIDTH_M, _FACE_MIDDLE_CM)


def _scene(
    name: str,
    options: SceneOptions,
    makeup: Makeup,
    vertices_cm: Callable[[int], Points],
    frame_count: int,
    field_width_m: float,
    middle_cm: Points,
) -> Scene:
    head = build_head()
    rng = np.random.default_rng(options.seed + 1)
    soft = np.isin(head.part, (anatomy.SKIN, anatomy.CAVITY, anatomy.LID_RIM))
    surface = SceneSurface(
        faces=head.faces,
        reference_weights=paint.skin_reflectance(makeup),
        vertex_weights=paint.vertex_colours(head, makeup),
        texture=paint.skin_texture(rng, makeup),
        uv=paint.corner_uv(head),
        detail=Detail(height_m=paint.skin_relief(rng), strength=soft.astype(np.float64)),
        gloss=_gloss(head, makeup),
        gloss_exponent=30.0,
    )
    return Scene(
        name=name,
        camera=studio_camera(options.width, options.height, options.field_width_m or field_width_m),
        lights=studio_lights(),
        surface=surface,
        vertices=lambda frame: 0.01 * (vertices_cm(frame) - middle_cm) * [1.0, -1.0, -1.0] + studio_centre(),
        frame_count=frame_count,
    )


def _gloss(head: Head, makeup: Makeup) -> Points:
    """Return (n,) the strength of the specular lobe: a trace on bare skin, none on matte makeup."""
    gloss = np.full(len(head.vertices), _SKIN_GLOSS if makeup is Makeup.NONE else 0.0)
    gloss[np.isin(head.part, (anatomy.EYES, anatomy.UPPER_TEETH, anatomy.LOWER_TEETH))] = _EYE_GLOSS
    return gloss
