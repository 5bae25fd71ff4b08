"""The head's mesh: skin slit at lips and lids, mouth cavity, lid rims, eyeballs, teeth and tongue."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from vntoolkit.arrays import BoolArray, Faces, FloatArray, IntArray, Points, read_only
from vntoolkit.geometry.mesh import vertex_normals
from vntoolkit.simulation.body.implicit import mesh_from_implicit
from vntoolkit.simulation.head import sculpture

SKIN, CAVITY, LID_RIM, EYES, UPPER_TEETH, LOWER_TEETH, TONGUE = range(7)
_Piece = tuple[Points, Faces, IntArray, int]  # vertices, faces, owners, part
_CELL_CM = 0.16
_LEAST_LEVEL = 0.3  # of a cell: no vertex lies nearer to a slit, so no sliver arises
IRIS_RADIUS, PUPIL_RADIUS = 0.54, 0.20


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
    mouth: "Slit"
    eyes: "tuple[Slit, Slit]"


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
    hair = sculpture.hair_share(vertices)
    shape = vertices + (sculpture.hair_thickness(vertices) * hair)[:, None] * vertex_normals(vertices, faces)
    for eye in slits[1:]:
        side[eye.upper], side[eye.lower] = 1, 1
    side[slits[0].upper[1:-1]], side[slits[0].lower[1:-1]] = 1, -1
    return _with_interior(shape, faces, side, hair, slits)


def _cut_all(vertices: Points, faces: Faces) -> "tuple[Points, Faces, list[Slit]]":
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


def _with_interior(
    shape: Points, faces: Faces, side: IntArray, hair: FloatArray, slits: "list[Slit]"
) -> Head:
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Slit:
    """The two sides of a cut, vertex numbers from its smallest to its largest x.

    upper and lower have the same length and share their first and last vertex, the corners.
    """

    upper: IntArray
    lower: IntArray

    @property
    def loop(self) -> IntArray:
        """Vertex numbers once round, from the corner of least x: along the upper side, back by the lower."""
        return np.concatenate([self.upper, self.lower[-2:0:-1]])


# Slits: the mesh cut open along a curve, for mouth and eyes.


def cut_slit(
    vertices: Points, faces: Faces, level: FloatArray, inside: BoolArray
) -> tuple[Points, Faces, Slit]:
    """Cut the mesh where `level` (n,) changes sign, on faces whose three corners are all `inside` (n,).

    New vertices are appended; those between the two ends are doubled, so that the sides above (level > 0)
    and below can part. The curve must run monotonically in x.
    """
    positive = level > 0
    mixed = positive[faces].any(axis=1) & ~positive[faces].all(axis=1)
    cut = np.flatnonzero(mixed & inside[faces].all(axis=1))
    alone = _turned_to_lone_corner(faces[cut], positive)
    a, b, c = alone.T
    keys, number = np.unique(
        np.sort(np.concatenate([np.stack([a, b], 1), np.stack([a, c], 1)]), axis=1),
        axis=0,
        return_inverse=True,
    )
    share = level[keys[:, 0]] / (level[keys[:, 0]] - level[keys[:, 1]])
    points = vertices[keys[:, 0]] + share[:, None] * (vertices[keys[:, 1]] - vertices[keys[:, 0]])
    order = np.argsort(points[:, 0])
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    number = rank[number.ravel()]
    keys, points = keys[order], points[order]
    upper = len(vertices) + np.arange(len(points))
    lower = np.concatenate([upper[:1], len(vertices) + len(points) + np.arange(len(points) - 2), upper[-1:]])
    new = _split_faces(alone, number.reshape(2, -1), positive, upper, lower)
    kept = np.ones(len(faces), dtype=bool)
    kept[cut] = False
    halved, halves = _halve_at_ends(faces, kept, keys[[0, -1]], upper[[0, -1]])
    kept[halved] = False
    all_vertices = np.concatenate([vertices, points, points[1:-1]])
    all_faces = np.concatenate([faces[kept], new, halves]).astype(np.int32)
    return all_vertices, all_faces, Slit(upper=upper, lower=lower)


def _split_faces(
    alone: IntArray, number: IntArray, positive: BoolArray, upper: IntArray, lower: IntArray
) -> IntArray:
    """Return three faces for each cut one. alone: (k, 3), lone corner first; number: (2, k) new points."""
    a, b, c = alone.T
    above = positive[a][:, None]
    on_upper, on_lower = upper[number].T, lower[number].T
    lone, pair = np.where(above, on_upper, on_lower), np.where(above, on_lower, on_upper)
    return np.concatenate(
        [
            np.stack([a, lone[:, 0], lone[:, 1]], axis=1),
            np.stack([pair[:, 0], b, c], axis=1),
            np.stack([pair[:, 0], c, pair[:, 1]], axis=1),
        ]
    )


def _turned_to_lone_corner(faces: Faces, positive: BoolArray) -> IntArray:
    """Turn each face so that its first corner is alone on its side of the level."""
    signs = positive[faces]
    lone = np.where(signs.sum(axis=1) == 1, signs.argmax(axis=1), (~signs).argmax(axis=1))
    columns = (lone[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces.astype(np.int64), columns, axis=1)


def _halve_at_ends(
    faces: Faces, kept: BoolArray, edges: IntArray, tips: IntArray
) -> tuple[IntArray, IntArray]:
    """Split the uncut face beyond each end of the slit, so that no vertex lies on another face's edge."""
    halved, halves = [], []
    for (low, high), tip in zip(edges, tips, strict=True):
        holds = kept & (faces == low).any(axis=1) & (faces == high).any(axis=1)
        for f in np.flatnonzero(holds):
            face = faces[f]
            halved.append(f)
            halves += [np.where(face == low, tip, face), np.where(face == high, tip, face)]
    return np.array(halved, dtype=np.int64), np.array(halves, dtype=np.int64).reshape(-1, 3)


# Interior: mouth cavity, lid rims, eyeballs, teeth, tongue; centimetres.


# how far each ring of the pocket opens up and down, and how far it goes in
_POCKET_RINGS = ((0.02, -0.12), (0.06, -0.45), (0.85, -1.05), (1.05, -4.6))
_LID_RINGS = (1.02, 0.90)  # in eyeball radii


def extrude_slit(
    shape: Points, slit: Slit, first: int, eye: FloatArray | None
) -> tuple[Points, Faces, IntArray]:
    """Return rings behind a slit: a closed pocket for the mouth, two rings towards the eyeball for an eye.

    first: the number of the first new vertex. Also returns the rim vertex that each new one hangs on.
    """
    loop = slit.loop
    rim, size, half = shape[loop], len(loop), len(slit.upper)
    rings = []
    if eye is None:
        almond = np.sqrt(np.clip(1.0 - (rim[:, 0] / sculpture.MOUTH_HALF_WIDTH) ** 2, 0.0, 1.0))
        up = np.where(np.arange(size) < half, 1.0, -1.0) * almond
        for opening, depth in _POCKET_RINGS:
            rings.append(rim + np.stack([0 * up, opening * up, depth * (0.25 + 0.75 * almond)], axis=1))
    else:
        outward = (rim - eye) / np.linalg.norm(rim - eye, axis=1, keepdims=True)
        rings = [eye + radius * sculpture.EYE_RADIUS * outward for radius in _LID_RINGS]
    here = np.arange(size)
    following = (here + 1) % size
    faces = []
    for ring in range(len(rings)):
        outer = loop if ring == 0 else first + (ring - 1) * size + here
        inner = first + ring * size + here
        faces.append(np.stack([outer[following], outer, inner], axis=1))
        faces.append(np.stack([outer[following], inner, inner[following]], axis=1))
    if eye is None:
        faces.append(_back_wall(first + (len(rings) - 1) * size, half, size))
    return np.concatenate(rings), np.concatenate(faces), np.tile(loop, len(rings))


def _back_wall(start: int, half: int, size: int) -> Faces:
    """Return the faces that join the upper half of the last ring with the lower."""
    upper = start + np.arange(half)
    lower = start + np.concatenate([[0], size - np.arange(1, half - 1), [half - 1]])
    wall = np.concatenate(
        [np.stack([lower[:-1], lower[1:], upper[1:]], 1), np.stack([lower[:-1], upper[1:], upper[:-1]], 1)]
    )
    return wall[(wall[:, 0] != wall[:, 1]) & (wall[:, 1] != wall[:, 2]) & (wall[:, 2] != wall[:, 0])]


def eyeball(side: float) -> tuple[Points, Faces]:
    """Return the eyeball at x < 0 (side -1) or x > 0 (+1), its pole to the front, with a slight cornea."""
    tilt = np.linspace(0.0, 1.0, 49)[1:] ** 1.35 * 0.75 * np.pi
    turn = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    angle, about = np.meshgrid(tilt, turn, indexing="ij")
    bulge = 1.0 + 0.045 * np.clip(1.0 - (angle / 0.50) ** 2, 0.0, 1.0)
    ball = np.stack([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)], axis=-1)
    points = (
        np.concatenate([[[0.0, 0.0, 1.045]], (bulge[..., None] * ball).reshape(-1, 3)]) * sculpture.EYE_RADIUS
    )
    faces = 1 + _sheet_faces(len(tilt), len(turn), around=True)
    tip = np.stack([np.zeros(64, dtype=int), 1 + np.arange(64), 1 + (np.arange(64) + 1) % 64], axis=1)
    return points + np.array(sculpture.EYE_CENTRE) * [side, 1.0, 1.0], np.concatenate([tip, faces])


def teeth(upper: float) -> tuple[Points, Faces]:
    """Return a row of teeth: upper for +1, lower for -1."""
    arc = np.radians(np.linspace(-72.0, 72.0, 145))
    height = np.linspace(0.0, 1.0, 14)
    gap = np.abs(np.sin(arc * 6.0)) ** 0.35
    edge = np.clip((height - 0.8) / 0.2, 0.0, 1.0)
    radius = (0.93 + 0.07 * gap)[None, :] * (1.0 - 0.08 * edge**2)[:, None]
    size = (2.55, 3.25) if upper > 0 else (2.40, 2.95)
    root = sculpture.MOUTH_HEIGHT + (1.1 if upper > 0 else -1.35)
    tip = sculpture.MOUTH_HEIGHT + (-0.38 if upper > 0 else -0.42)
    y = root + (tip - root) * height[:, None] * (0.88 + 0.12 * gap)[None, :]
    x, z = size[0] * radius * np.sin(arc), 4.95 + size[1] * radius * np.cos(arc)
    faces = _sheet_faces(len(height), len(arc), around=False)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), faces if upper > 0 else faces[:, ::-1]


def tongue() -> tuple[Points, Faces]:
    """Return the tongue, lying behind the lower teeth."""
    tilt, turn = np.linspace(0.02, np.pi - 0.02, 24), np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    angle, about = np.meshgrid(tilt, turn, indexing="ij")
    ball = np.stack([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)], axis=-1)
    points = ball.reshape(-1, 3) * [1.7, 0.55, 2.1] + [0.0, sculpture.MOUTH_HEIGHT - 0.85, 5.5]
    return points, _sheet_faces(len(tilt), len(turn), around=True)


def _sheet_faces(rows: int, columns: int, around: bool) -> Faces:
    """Return the triangles of a grid of vertices; rows × columns, closed along its columns or not."""
    row, column = np.meshgrid(
        np.arange(rows - 1), np.arange(columns if around else columns - 1), indexing="ij"
    )
    a = (row * columns + column).ravel()
    b = (row * columns + (column + 1) % columns).ravel()
    lower, upper = np.stack([a, a + columns, b + columns], 1), np.stack([a, b + columns, b], 1)
    return np.concatenate([lower, upper])
