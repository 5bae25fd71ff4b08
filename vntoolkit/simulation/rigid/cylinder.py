"""A cylinder wrapped in paper, moved through all six degrees of freedom (Figure 7)."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import Faces, FloatArray, Points
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.simulation.grids import closed_columns, grid_faces, grid_uv
from vntoolkit.simulation.relief import paper_fibres, tiling_noise
from vntoolkit.simulation.rigid.motion import Sway
from vntoolkit.simulation.scene import Detail, Scene, SceneOptions, SceneSurface
from vntoolkit.simulation.studio import studio_camera, studio_lights

RADIUS_M, LENGTH_M = 0.12, 0.42
FIELD_WIDTH_M = 0.9
FRAME_COUNT = 180  # 3 s
_ROWS, _COLUMNS = 150, 720
_PAPER = np.array([0.80, 0.785, 0.75])
_FIBRE_HEIGHT_M = 6e-5


def build_cylinder(options: SceneOptions) -> Scene:
    """A paper tube of 42 cm by 24 cm with end caps; its axis is the object's y axis."""
    generator = np.random.default_rng(options.seed)
    rest, faces, uv = cylinder_mesh()
    fibres = paper_fibres(1024, 9000, 40.0, generator)
    sway = Sway(
        turns_deg=(24.0, 70.0, 38.0),
        shifts_m=(0.10, 0.06, 0.12),
        periods_s=(2.1, 3.7, 3.1, 1.7, 2.3, 2.9),
        phases=generator.uniform(0, 2 * np.pi, 6),
        rest=RigidTransform.from_rotation_vector((0.0, 0.0, 0.5)),
    )
    return Scene(
        name="cylinder",
        camera=studio_camera(
            options.width, options.height, field_width_m=options.field_width_m or FIELD_WIDTH_M
        ),
        lights=studio_lights(),
        surface=SceneSurface(
            faces=faces,
            reference_weights=_PAPER,
            texture=_paper_texture(fibres, generator),
            uv=uv,
            detail=Detail(height_m=_FIBRE_HEIGHT_M * fibres, repeats=(3.0, 2.0)),
        ),
        vertices=lambda frame: sway.camera_from_object(frame).apply(rest),
        frame_count=FRAME_COUNT,
        camera_from_object=sway.camera_from_object,
        facts={"radius_m": RADIUS_M, "length_m": LENGTH_M},
    )


def cylinder_mesh() -> tuple[Points, Faces, FloatArray]:
    """Return vertices (n, 3) about the origin, axis y; faces; uv per corner (u once round, v along)."""
    around = np.linspace(0.0, 2 * np.pi, _COLUMNS, endpoint=False)
    ring = np.stack([np.sin(around), np.zeros(_COLUMNS), -np.cos(around)], axis=1) * RADIUS_M
    heights = np.linspace(-LENGTH_M / 2, LENGTH_M / 2, _ROWS)
    side = ring[None] + heights[:, None, None] * np.array([0.0, 1.0, 0.0])
    vertices, faces = [side.reshape(-1, 3)], [grid_faces(closed_columns(_ROWS, _COLUMNS))]
    uv = [grid_uv(_ROWS, _COLUMNS + 1)]
    for end in (-1, 1):
        cap, triangles = _cap(ring, end)
        faces.append(triangles + sum(len(part) for part in vertices))
        vertices.append(cap)
        # The paper's scale on the caps too: metres over circumference and length.
        flat = cap[:, [0, 2]] / np.array([2 * np.pi * RADIUS_M, LENGTH_M]) + 0.5
        uv.append(flat[triangles])
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32), np.concatenate(uv)


def _cap(ring: Points, end: int) -> tuple[Points, Faces]:
    """Return a disc at the top (−1) or the bottom (1); own vertices, since its edge is sharp."""
    lift = np.array([0.0, end * LENGTH_M / 2, 0.0])
    vertices = np.concatenate([ring + lift, ring * 0.5 + lift, lift[None]])
    index = np.arange(_COLUMNS)
    after, middle = np.roll(index, -1), np.full(_COLUMNS, 2 * _COLUMNS)
    inner, inner_after = index + _COLUMNS, after + _COLUMNS
    triangles = np.concatenate(
        [
            np.stack([index, after, inner], 1),
            np.stack([after, inner_after, inner], 1),
            np.stack([inner, inner_after, middle], 1),
        ]
    )
    return vertices, (triangles if end < 0 else triangles[:, ::-1]).astype(np.int32)


def _paper_texture(fibres: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Nearly white, faintly mottled and fibrous, with the line of the overlapping edge at u = 0."""
    size = len(fibres)
    cloudy = 0.008 * tiling_noise(size, 60.0, generator) + 0.012 * (fibres - fibres.mean())
    column = np.minimum(np.arange(size), size - 1 - np.arange(size))
    edge = 1.0 - 0.12 * np.exp(-np.square(column / 1.5))
    return (1.0 + cloudy)[..., None] * edge[None, :, None] * _PAPER
