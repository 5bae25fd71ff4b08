"""A cotton jacket that stands still (Figure 6): folds, pockets, buttons, seams, ribbed hem and cuffs."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.simulation.relief import twill_weave
from vntoolkit.simulation.rigid.jacket_parts import Part, collar, sleeve, torso
from vntoolkit.simulation.scene import Detail, Scene, SceneOptions, Surface
from vntoolkit.simulation.studio import studio_camera, studio_centre, studio_lights

_COTTON = np.array([0.47, 0.43, 0.35])
_THREADS = 16  # in a tile of the weave
_THREAD_M = 0.0011
_WEAVE_HEIGHT_M = 1.2e-4
_TURN_DEG = 14.0  # a little from the front, so that one side falls away


def build_jacket(options: SceneOptions) -> Scene:
    """A jacket of 65 cm on an invisible form, turned a little to one side."""
    generator = np.random.default_rng(options.seed)
    parts = [torso(generator), sleeve(-1, generator), sleeve(1, generator), collar(generator)]
    vertices, surface = _joined(parts)
    pose = RigidTransform.from_rotation_vector(
        (0.0, np.deg2rad(_TURN_DEG), 0.0), studio_centre() + np.array([0.0, 0.02, 0.0])
    )
    standing = pose.apply(vertices)
    return Scene(
        name="jacket",
        camera=studio_camera(options.width, options.height, field_width_m=options.field_width_m or 1.05),
        lights=studio_lights(),
        surface=surface,
        vertices=lambda _frame: standing,
        frame_count=1,
        camera_from_object=lambda _frame: pose,
    )


def _joined(parts: list[Part]) -> tuple[Points, Surface]:
    """Return all vertices and one surface; the parts' texture coordinates become tiles of the weave."""
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False)]
    tile_m = _THREADS * _THREAD_M
    uv = [_whole_tiles(part, tile_m) for part in parts]
    weights = np.concatenate([part.shade for part in parts])[:, None] * _COTTON
    surface = Surface(
        faces=np.concatenate(faces),
        reference_weights=_COTTON,
        vertex_weights=weights,
        uv=np.concatenate(uv),
        detail=Detail(
            height_m=_WEAVE_HEIGHT_M * twill_weave(_THREADS, 8),
            strength=np.concatenate([part.weave for part in parts]),
        ),
    )
    return np.concatenate([part.vertices for part in parts]), surface


def _whole_tiles(part: Part, tile_m: float) -> FloatArray:
    """Scale uv so that 1 is a tile of the weave and a whole number of them goes round."""
    return part.uv * np.array([round(part.girth / tile_m), part.length / tile_m])
