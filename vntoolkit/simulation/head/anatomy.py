"""The head's mesh: skin slit at lips and lids, mouth cavity, lid rims, eyeballs, teeth and tongue."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from vntoolkit.arrays import Faces, FloatArray, IntArray, Points, read_only
from vntoolkit.geometry.mesh import vertex_normals
from vntoolkit.simulation.body.surface_nets import mesh_from_implicit
from vntoolkit.simulation.head import sculpture
from vntoolkit.simulation.head.hair import hair_share, hair_thickness
from vntoolkit.simulation.head.interior import extrude_slit, eyeball, teeth, tongue
from vntoolkit.simulation.head.slit import Slit, cut_slit

SKIN, CAVITY, LID_RIM, EYES, UPPER_TEETH, LOWER_TEETH, TONGUE = range(7)
_Piece = tuple[Points, Faces, IntArray, int]  # vertices, faces, owners, part
_CELL_CM = 0.16
_LEAST_LEVEL = 0.3  # of a cell: no vertex lies nearer to a slit, so no sliver arises


@dataclass(frozen=True, kw_only=True, eq=False)
class Head:
    """The neutral head, lids and lips closed, head frame, centimetres.

    part: (n,) one of SKIN … TONGUE. side: (n,) +1 above, -1 below the line of the lips, 0 at the
    mouth's corners. owner: (n,) the rim vertex that a cavity's or lid rim's vertex hangs on, its own
    number elsewhere. hair: (n,) from 0 skin to 1 hair. mouth, eyes: the slits; eyes[0] lies at x < 0.
    """

    vertices: Points
    faces: Faces
    part: IntArray
    side: IntArray
    owner: IntArray
    hair: FloatArray
    mouth: Slit
    eyes: tuple[Slit, Slit]

    def seams(self) -> dict[str, IntArray]:
        """Return the edges of lips and lids: closed loops of vertex numbers from the corner of least x."""
        slits = {"mouth": self.mouth, "eye_left_in_image": self.eyes[0], "eye_right_in_image": self.eyes[1]}
        return {name: slit.loop for name, slit in slits.items()}


def lip_line(x: FloatArray) -> FloatArray:
    """Return the height where the closed lips meet."""
    return sculpture.MOUTH_HEIGHT - 0.05 * (np.asarray(x) / sculpture.MOUTH_HALF_WIDTH) ** 2


def lid_line(x: FloatArray) -> FloatArray:
    """Return the height where the closed lids of the eye on the same side meet."""
    offset = (np.abs(x) - sculpture.EYE_CENTRE[0]) / 1.3
    return sculpture.EYE_CENTRE[1] - 0.42 + 0.30 * offset**2 + 0.05 * offset


@cache
def build_head() -> Head:
    """Sculpt, mesh, cut and fill the head; the same on every call, built once per process."""
    body = sculpture.sculpt_head()
    low, high = np.array([-9.6, sculpture.NECK_CUT, -11.5]), np.array([9.6, 12.2, 12.1])
    vertices, faces = mesh_from_implicit(body, low, high, _CELL_CM)
    side = np.sign(vertices[:, 1] - lip_line(vertices[:, 0])).astype(np.int8)
    vertices, faces, slits = _cut_all(vertices, faces)
    side = np.concatenate([side, np.zeros(len(vertices) - len(side), dtype=np.int8)])
    hair = hair_share(vertices)
    shape = vertices + (hair_thickness(vertices) * hair)[:, None] * vertex_normals(vertices, faces)
    for eye in slits[1:]:
        side[eye.upper], side[eye.lower] = 1, 1
    side[slits[0].upper[1:-1]], side[slits[0].lower[1:-1]] = 1, -1
    return _with_interior(shape, faces, side, hair, slits)


def _cut_all(vertices: Points, faces: Faces) -> tuple[Points, Faces, list[Slit]]:
    """Cut mouth, left eye, right eye."""
    slits = []
    half = sculpture.MOUTH_HALF_WIDTH
    for centre, width, line, front in (
        (0.0, half, lip_line, 6.5),
        (-sculpture.EYE_CENTRE[0], 1.22, lid_line, 6.3),
        (sculpture.EYE_CENTRE[0], 1.22, lid_line, 6.3),
    ):
        level = vertices[:, 1] - line(vertices[:, 0])
        inside = (np.abs(vertices[:, 0] - centre) < width) & (vertices[:, 2] > front) & (np.abs(level) < 1.0)
        small = inside & (np.abs(level) < _LEAST_LEVEL * _CELL_CM)
        wanted = np.where(level < 0, -1.0, 1.0) * _LEAST_LEVEL * _CELL_CM
        vertices = vertices.copy()
        vertices[small, 1] += (wanted - level)[small]
        level = np.where(small, wanted, level)
        vertices, faces, slit = cut_slit(vertices, faces, level, inside)
        slits.append(slit)
    return vertices, faces, slits


def _with_interior(shape: Points, faces: Faces, side: IntArray, hair: FloatArray, slits: list[Slit]) -> Head:
    """Append cavity, lid rims and the parts that move on their own."""
    pieces: list[_Piece] = [(shape, faces, np.arange(len(shape)), SKIN)]
    count = len(shape)
    for number, slit in enumerate(slits):
        eye = None if number == 0 else np.array(sculpture.EYE_CENTRE) * [(-1.0, 1.0)[number - 1], 1.0, 1.0]
        points, own, owner = extrude_slit(shape, slit, count, eye)
        pieces.append((points, own, owner, CAVITY if number == 0 else LID_RIM))
        count += len(points)
    for part, (points, own) in ((EYES, eyeball(-1.0)), (EYES, eyeball(1.0)), (UPPER_TEETH, teeth(upper=1.0)),
                                (LOWER_TEETH, teeth(upper=-1.0)), (TONGUE, tongue())):  # fmt: skip
        pieces.append((points, own + count, count + np.arange(len(points)), part))
        count += len(points)
    owner = np.concatenate([piece[2] for piece in pieces])
    skin = owner < len(shape)
    return Head(
        vertices=read_only(np.concatenate([piece[0] for piece in pieces])),
        faces=read_only(np.concatenate([piece[1] for piece in pieces]).astype(np.int32)),
        part=np.repeat([piece[3] for piece in pieces], [len(piece[0]) for piece in pieces]),
        side=_side_of_all(side, owner, pieces),
        owner=owner,
        hair=np.where(skin, hair[np.where(skin, owner, 0)], 0.0),
        mouth=slits[0],
        eyes=(slits[1], slits[2]),
    )


def _side_of_all(side: IntArray, owner: IntArray, pieces: list[_Piece]) -> IntArray:
    """Return the side of every vertex: what hangs on a rim has the rim's, what moves on its own none."""
    skin = owner < len(side)
    sides = np.where(skin, side[np.where(skin, owner, 0)], 0)
    # lids lie above the lips, whichever of the two they are
    lids = np.concatenate([np.full(len(piece[0]), piece[3] == LID_RIM) for piece in pieces])
    sides[lids] = 1
    return sides
