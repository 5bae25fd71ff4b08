"""A board of coarse squares carried through the whole field: it tells how near lights change M over it.

The sample behind its hole is the paper of the `cylinder`, and the camera is the same.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.simulation.rigid.board import board_mesh
from vntoolkit.simulation.rigid.cylinder import build_cylinder
from vntoolkit.simulation.rigid.motion import Sway
from vntoolkit.simulation.scene import Scene, SceneOptions
from vntoolkit.simulation.studio import studio_lights

FRAME_COUNT = 240
SWEPT_LAYOUT = BoardLayout(columns=7, rows=7, hole_squares=3, square_mm=36.0)


def build_board_sweep(options: SceneOptions) -> Scene:
    """The board, 25 cm wide, moved ±26 cm across and ±17 cm up and down while it tilts."""
    layout, cylinder = SWEPT_LAYOUT, build_cylinder(options)
    paper = cylinder.surface.reference_weights
    generator = np.random.default_rng(options.seed)
    middle_m = np.array([layout.width_mm, layout.height_mm]) / 2000
    sway = Sway(
        turns_deg=(34.0, 36.0, 16.0),
        shifts_m=(0.26, 0.17, 0.08),
        periods_s=(0.53, 0.71, 1.9, 2.3, 1.37, 3.1),  # tilts quicker than it travels: all tilts everywhere
        phases=generator.uniform(0, 2 * np.pi, 6),
        rest=RigidTransform(translation=np.array([-middle_m[0], -middle_m[1], 0.0])),
    )
    rest, surface = board_mesh(layout)
    assert surface.vertex_weights is not None
    sample = np.all(surface.vertex_weights == surface.reference_weights, axis=1)
    weights = np.where(sample[:, None], paper, surface.vertex_weights)
    return Scene(
        name="board_sweep",
        camera=cylinder.camera,
        lights=studio_lights(),
        surface=replace(surface, vertex_weights=weights, reference_weights=paper),
        vertices=lambda frame: sway.camera_from_object(frame).apply(rest),
        frame_count=FRAME_COUNT,
        exposure_level=0.8,
        camera_from_object=sway.camera_from_object,
        facts={"square_mm": layout.square_mm, "columns": layout.columns, "rows": layout.rows},
    )
