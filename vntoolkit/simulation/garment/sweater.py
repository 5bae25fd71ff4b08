"""The scene `sweater`: a knitted sweater on a dancer, folds that open and close (Figures 9, 10)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vntoolkit.arrays import Faces, FloatArray, Points
from vntoolkit.simulation.garment.dance import DancingGarment
from vntoolkit.simulation.garment.knit import STITCH_M, heather_texture, knit_relief, stitch_tile
from vntoolkit.simulation.garment.pattern import SweaterOptions, knit_coordinates
from vntoolkit.simulation.garment.refinement import loop_subdivision, raise_along_normals
from vntoolkit.simulation.scene import Detail, Scene, SceneOptions, Surface
from vntoolkit.simulation.studio import studio_camera, studio_centre, studio_lights

_FRAMES = 1000
_FIELD_WIDTH_M = 1.42
_MIDDLE_M = np.array([0.0, -0.36, 0.0])  # of the sweater, below the throat: what the camera looks at
_LEVELS = 2
_WOOL = np.array([0.66, 0.63, 0.58])


def build_sweater(options: SceneOptions) -> Scene:
    """Return 1000 frames of the dancing sweater; frames are simulated as they are asked for."""
    rng = np.random.default_rng(options.seed + 1)
    sweater = SweaterOptions()
    garment = DancingGarment(options.seed, sweater)
    sewn = garment.garment
    faces, flat, gather = sewn.faces, sewn.flat, sewn.gather
    refine = None
    for _ in range(_LEVELS):
        smooth, halve, faces = loop_subdivision(faces, len(flat))
        flat, gather = halve @ flat, halve @ gather
        refine = smooth if refine is None else smooth @ refine
    relief = knit_relief(knit_coordinates(flat, sweater), gather)
    uv = flat[faces]
    stitches = 1.0 / np.array(STITCH_M)
    surface = Surface(
        faces=faces,
        reference_weights=0.95 * _WOOL,
        vertex_weights=np.tile(_WOOL, (len(flat), 1)),
        texture=heather_texture(rng),
        uv=4.0 * uv,
        detail=Detail(height_m=stitch_tile(), repeats=(stitches[0] / 4.0, stitches[1] / 4.0)),
    )
    return Scene(
        name="sweater",
        camera=studio_camera(options.width, options.height, options.field_width_m or _FIELD_WIDTH_M),
        lights=studio_lights(),
        surface=surface,
        vertices=_refined(garment, refine, faces, relief),
        frame_count=_FRAMES,
    )


def _refined(
    garment: DancingGarment, refine: object, faces: Faces, relief: FloatArray
) -> Callable[[int], Points]:
    """Return the function from frame to dense vertices in the camera frame."""

    def vertices(frame: int) -> Points:
        fine = refine @ garment.cage(frame)  # type: ignore[operator]
        raise_along_normals(fine, faces, relief)
        return (fine - _MIDDLE_M) * [1.0, -1.0, -1.0] + studio_centre()

    return vertices
