"""The scene `sphere`: a matte ball that drifts and turns a little."""

import numpy as np

from vntoolkit.arrays import Faces, Points
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.simulation.grids import closed_columns, grid_faces
from vntoolkit.simulation.lights import studio_camera, studio_centre
from vntoolkit.simulation.scene import Scene, SceneSurface

RADIUS_M = 0.3
_RINGS, _SEGMENTS = 240, 480
PAINT = (0.62, 0.60, 0.58)  # a nearly neutral matte grey


def build_sphere(options: SceneOptions) -> Scene:
    """A ball of 0.6 m, evenly painted; it drifts a little, so that it can be tracked."""
    ball, faces = ball_mesh(RADIUS_M, _RINGS, _SEGMENTS)

    def pose(frame: int) -> RigidTransform:
        angle = 2 * np.pi * frame / 60.0
        drift = np.array([0.03 * np.sin(angle), 0.02 * np.sin(2 * angle), 0.0])
        return RigidTransform.from_rotation_vector((0.0, 0.3 * np.sin(angle), 0.0), studio_centre() + drift)

    return Scene(
        name="sphere",
        camera=studio_camera(options, field_width_m=1.0),
        surface=SceneSurface(faces=faces, reference_weights=np.array(PAINT)),
        vertices=lambda frame: pose(frame).apply(ball),
        frame_count=60,
        camera_from_object=pose,
    )


def ball_mesh(radius_m: float, rings: int, segments: int) -> tuple[Points, Faces]:
    """Return vertices (n, 3) and faces of a ball about the origin, its poles at ±y."""
    polar = np.linspace(0.0, np.pi, rings + 1)[1:-1]
    around = np.linspace(0.0, 2 * np.pi, segments, endpoint=False)
    y = -np.cos(polar)[:, None] * np.ones(segments)
    x = np.sin(polar)[:, None] * np.sin(around)
    z = -np.sin(polar)[:, None] * np.cos(around)
    poles = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    vertices = radius_m * np.concatenate([np.stack([x, y, z], axis=-1).reshape(-1, 3), poles])
    ring = np.arange(segments)
    after, top, bottom = np.roll(ring, -1), len(vertices) - 2, len(vertices) - 1
    last = (rings - 2) * segments
    caps = [
        np.stack([np.full(segments, top), ring, after], axis=1),
        np.stack([last + after, last + ring, np.full(segments, bottom)], axis=1),
    ]
    faces = np.concatenate([grid_faces(closed_columns(rings - 1, segments)), *caps])
    return vertices, faces.astype(np.int32)
