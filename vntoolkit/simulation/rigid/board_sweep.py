"""A board of coarse squares carried through the whole field: it tells how near lights change M over it.

The sample behind its hole is the paper of the `cylinder`, and the camera is the same. With another field,
board and path grow in proportion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.simulation.rigid.board import board_mesh
from vntoolkit.simulation.rigid.cylinder import FIELD_WIDTH_M, build_cylinder
from vntoolkit.simulation.rigid.motion import Sway
from vntoolkit.simulation.scene import Scene, SceneOptions, sample_weights
from vntoolkit.simulation.studio import studio_lights

FRAME_COUNT = 240
SWEPT_LAYOUT = BoardLayout(columns=7, rows=7, hole_squares=3, square_mm=36.0)


def build_board_sweep(options: SceneOptions) -> Scene:
    """The board, 25 cm wide, moved ±26 cm across and ±17 cm up and down while it tilts."""
    cylinder = build_cylinder(options)
    scale = (options.field_width_m or FIELD_WIDTH_M) / FIELD_WIDTH_M
    layout = replace(SWEPT_LAYOUT, square_mm=SWEPT_LAYOUT.square_mm * scale)
    generator = np.random.default_rng(options.seed)
    middle_m = np.array([layout.width_mm, layout.height_mm]) / 2000
    sway = Sway(
        turns_deg=(34.0, 36.0, 16.0),
        shifts_m=(0.26 * scale, 0.17 * scale, 0.08),
        periods_s=(0.53, 0.71, 1.9, 2.3, 1.37, 3.1),  # tilts quicker than it travels: all tilts everywhere
        phases=generator.uniform(0, 2 * np.pi, 6),
        rest=RigidTransform(translation=np.array([-middle_m[0], -middle_m[1], 0.0])),
    )
    sample = sample_weights(options, cylinder.surface.reference_weights)
    rest, surface = board_mesh(layout, scale, sample)
    return Scene(
        name="board_sweep",
        camera=cylinder.camera,
        lights=studio_lights(),
        surface=surface,
        vertices=lambda frame: sway.camera_from_object(frame).apply(rest),
        frame_count=FRAME_COUNT,
        exposure_level=0.8,
        camera_from_object=sway.camera_from_object,
        facts={
            "square_mm": layout.square_mm,
            "columns": layout.columns,
            "rows": layout.rows,
            "hole_squares": layout.hole_squares,
        },
    )
