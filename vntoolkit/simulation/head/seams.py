"""Where lips and lids part, in a frame's image: the truth behind a tracker's file of seams."""

from __future__ import annotations

from vntoolkit.arrays import Points2
from vntoolkit.errors import BadInput
from vntoolkit.simulation.head.anatomy import build_head
from vntoolkit.simulation.scene import SCENES, Scene


def seam_loops_px(scene: Scene, frame: int) -> dict[str, Points2]:
    """Return the closed loops (k, 2) in pixels of "mouth", "eye_left_in_image", "eye_right_in_image".

    Each starts at its corner of least x at rest, runs along the upper edge and back along the lower; the rows
    are those of `Head.seams()`. Hidden parts are not left out. Raises `BadInput` for a scene without a head.
    """
    head, vertices = build_head(), scene.vertices(frame)
    if len(vertices) != len(head.vertices):
        raise BadInput(f"scene {scene.name}: expected a scene of the head (head_turn, face, face_makeup)")
    return {name: scene.camera.project(vertices[loop]) for name, loop in head.seams().items()}


def seam_lines_px(scene: Scene, frame: int) -> tuple[Points2, ...]:
    """Return the upper and the lower edge of every loop, each (k, 2) in pixels; none without a head.

    As two lines, since shut lips and lids have both edges in one place, and are cut all the same.
    """
    if not SCENES.get(scene.name, "").startswith("vntoolkit.simulation.head."):
        return ()
    head, vertices = build_head(), scene.vertices(frame)
    slits = (head.mouth, *head.eyes)
    return tuple(scene.camera.project(vertices[edge]) for slit in slits for edge in (slit.upper, slit.lower))
