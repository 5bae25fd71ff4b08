"""The shapes of the scenes that no seed changes, made anew: `data/shapes/*.npz`.

    python recipes/scene_shapes.py --out data/shapes        # 20 s

head.npz: a head sculpted from ellipsoids and capsules, cut open at lips and lids, with a mouth's cavity,
eyes, teeth and tongue; its colours; and how far jaw, lids and muscles move each vertex. legs.npz: two legs,
sculpted alike. sweater.npz: a sewing pattern of two panels, triangulated and sewn along sides and sleeves.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay, cKDTree
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import Array, BoolArray, Colours, Faces, FloatArray, IntArray, Points, Points2
from vntoolkit.geometry.mesh import isosurface, vertex_normals
from vntoolkit.simulation.garment.solver import BACK, FRONT, Garment
from vntoolkit.simulation.garment.sweater import SHOULDER_M, SLEEVE_DROP_DEG
from vntoolkit.simulation.head import rig
from vntoolkit.simulation.head.rig import EYE_CENTRE, Makeup, Muscle, Slit
from vntoolkit.simulation.head.scenes import (
    HAIRLINE_CM,
    HAIRLINE_DEG,
    azimuth_deg,
    hair_share,
    skin_reflectance,
)
from vntoolkit.simulation.shapes import smooth_step

_Vector = tuple[float, float, float]


def main(out: Path) -> None:
    """Write the three files into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    write_shape(out / "head.npz", head_arrays())
    write_shape(out / "legs.npz", legs_arrays())
    write_shape(out / "sweater.npz", sweater_arrays())


def write_shape(path: Path, arrays: dict[str, Array]) -> None:
    """Write arrays as `read_shape` reads them: column by column, which packs better, and faces as steps."""
    stored = {name: np.asfortranarray(array) for name, array in arrays.items() if name != "faces"}
    steps = np.diff(arrays["faces"].ravel(), prepend=0).astype(np.int32)
    np.savez_compressed(path, allow_pickle=False, face_steps=steps, **stored)


# Implicit bodies: ellipsoids and tapered capsules, blended one after another. Each part is added to, or
# carved from, what came before with a polynomial smooth minimum (quilez2013). Distances are approximate away
# from the surface and exact in sign.


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid, turned by a rotation vector in radians.

    blend: how far it melts into the rest; negative carves it out.
    """

    centre: _Vector
    radii: _Vector
    blend: float
    turn: _Vector = (0.0, 0.0, 0.0)

    def distance(self, points: Points) -> FloatArray:
        """Return (n,) about the distance to its surface, negative inside."""
        scaled = Rotation.from_rotvec(self.turn).inv().apply(points - self.centre) / self.radii
        length = np.linalg.norm(scaled, axis=1)
        return length * (length - 1.0) / np.maximum(np.linalg.norm(scaled / self.radii, axis=1), 1e-9)

    def mirrored(self) -> "Ellipsoid":
        """Return it on the other side of the plane x = 0."""
        (x, y, z), (a, b, c) = self.centre, self.turn
        return Ellipsoid((-x, y, z), self.radii, self.blend, (a, -b, -c))


@dataclass(frozen=True)
class Capsule:
    """A sphere swept from `start` to `end` while its radius changes linearly; blend as of an ellipsoid."""

    start: _Vector
    end: _Vector
    radii: tuple[float, float]
    blend: float

    def distance(self, points: Points) -> FloatArray:
        """Return (n,) the distance to its surface, negative inside."""
        axis = np.subtract(self.end, self.start)
        along = np.clip((points - self.start) @ axis / (axis @ axis), 0.0, 1.0)
        away = np.linalg.norm(points - self.start - along[:, None] * axis, axis=1)
        return away - (self.radii[0] + along * (self.radii[1] - self.radii[0]))

    def mirrored(self) -> "Capsule":
        """Return it on the other side of the plane x = 0."""
        (x, y, z), (a, b, c) = self.start, self.end
        return Capsule((-x, y, z), (-a, b, c), self.radii, self.blend)


Part = Ellipsoid | Capsule
Body = Sequence[Part]


def both_sides(*parts: Part) -> list[Part]:
    """Return the parts and their mirror images, pair by pair."""
    return [side for part in parts for side in (part, part.mirrored())]


def signed_distance(body: Body, points: Points) -> FloatArray:
    """Return (n,) about the distance to the body's surface, negative inside."""
    total = np.full(len(points), 1e9)
    for part in body:
        distance = part.distance(points)
        if part.blend < 0.0:  # carve: a smooth maximum with the part's outside
            total = -_smooth_minimum(-total, distance, -part.blend)
        else:
            total = _smooth_minimum(total, distance, part.blend)
    return total


def _smooth_minimum(a: FloatArray, b: FloatArray, width: float) -> FloatArray:
    h = np.maximum(width - np.abs(a - b), 0.0) / max(width, 1e-9)
    return np.minimum(a, b) - 0.25 * width * h * h


def gradient(body: Body, points: Points, step: float) -> Points:
    """Return (n, 3) the outward gradient by differences over the corners of a tetrahedron."""
    corners = np.array([[1.0, -1.0, -1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, 1.0, 1.0]])
    values = np.stack([signed_distance(body, points + step * corner) for corner in corners], axis=1)
    return values @ corners / (4.0 * step)


# A triangle mesh of a body: an isosurface, smoothed and pulled onto the surface in turns.


_ROUNDS = 3  # of smoothing and pulling back
_COARSE = 4  # cells of the search grid per side, in cells of the mesh


def mesh_from_implicit(body: Body, low: FloatArray, high: FloatArray, cell: float) -> tuple[Points, Faces]:
    """Return vertices (n, 3) and outward faces (m, 3) of the surface inside the box, cells of size `cell`."""
    counts = _COARSE * np.ceil((np.asarray(high) - low) / (_COARSE * cell)).astype(int) + 1
    values = _values_near_surface(body, np.asarray(low, dtype=np.float64), counts, cell)
    vertices, faces = isosurface(-values)
    vertices = low + cell * vertices
    for _ in range(_ROUNDS):
        vertices = _pull_onto_surface(body, _relaxed(vertices, faces), cell)
    return _pull_onto_surface(body, vertices, cell), faces


def _relaxed(vertices: Points, faces: Faces) -> Points:
    """Return every vertex moved half-way to the mean of its neighbours; a rim stays where it is."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = np.sort(edges, axis=1).astype(np.int64) @ [len(vertices), 1]
    _, place, times = np.unique(key, return_inverse=True, return_counts=True)
    count = np.bincount(edges[:, 0], minlength=len(vertices))
    mean = (
        np.stack(
            [np.bincount(edges[:, 0], vertices[edges[:, 1], a], minlength=len(vertices)) for a in range(3)],
            axis=1,
        )
        / np.maximum(count, 1)[:, None]
    )
    on_rim = np.zeros(len(vertices), dtype=bool)
    on_rim[edges[times[place] == 1]] = True
    return np.where(on_rim[:, None], vertices, 0.5 * (vertices + mean))


def _pull_onto_surface(body: Body, vertices: Points, cell: float) -> Points:
    """Return the vertices after one Newton step along the gradient."""
    slope = gradient(body, vertices, 0.25 * cell)
    step = signed_distance(body, vertices) / np.maximum(np.sum(slope**2, axis=1), 0.1)
    return vertices - np.clip(step, -cell, cell)[:, None] * slope


def _values_near_surface(body: Body, low: FloatArray, counts: IntArray, cell: float) -> FloatArray:
    """Return the grid of signed distances, in cells; exact only in blocks that the surface can cross."""
    blocks = (counts - 1) // _COARSE
    centres = _grid(blocks) * (_COARSE * cell) + low + 0.5 * _COARSE * cell
    distance = signed_distance(body, centres) / cell
    values = np.empty(tuple(counts))
    near = np.flatnonzero(np.abs(distance) < 1.3 * _COARSE)
    coarse = np.kron(distance.reshape(blocks), np.ones((_COARSE,) * 3))
    values[:-1, :-1, :-1] = coarse
    values[-1], values[:, -1], values[:, :, -1] = values[-2], values[:, -2], values[:, :, -2]
    corner = np.stack(np.unravel_index(near, blocks), axis=1) * _COARSE
    nodes = (corner[:, None] + _grid(np.full(3, _COARSE + 1)).astype(int)).reshape(-1, 3)
    flat = np.unique(np.ravel_multi_index(tuple(nodes.T), tuple(counts)))
    places = np.stack(np.unravel_index(flat, tuple(counts)), axis=1)
    values.ravel()[flat] = signed_distance(body, low + cell * places) / cell
    return values


def _grid(counts: IntArray) -> Points:
    return np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), -1).reshape(-1, 3) * 1.0


# The head: skull, face, nose, lips, ears, neck; head frame, centimetres (`vntoolkit/simulation/head/rig.py`).


EYE_RADIUS = 1.22
LID_THICKNESS = 0.14
MOUTH_HALF_WIDTH = 2.55
MOUTH_HEIGHT = -6.75
NECK_CUT = -20.0
_HEAD_CELL_CM = 0.16
_LEAST_LEVEL = 0.3  # of a cell: no vertex lies nearer to a slit, so no sliver arises
_HAIR_CM = 0.9


def sculpt_head() -> Body:
    """Return the neutral head with closed lids and closed mouth."""
    return [*_skull(), *_jaw(), *_neck(), *_eyes(), *_nose(), *_lips(), *_ears()]


def _skull() -> list[Part]:
    return [
        Ellipsoid((0.0, 3.3, -1.2), (7.5, 8.0, 9.5), 0.0),
        Ellipsoid((0.0, 4.0, 3.0), (6.6, 6.0, 6.1), 2.0),
        Ellipsoid((0.0, -3.6, 2.6), (5.3, 7.2, 6.2), 2.5),
        *both_sides(
            Ellipsoid((4.6, -2.6, 5.2), (1.9, 1.5, 2.1), 2.0),
            Ellipsoid((3.3, -4.6, 5.9), (2.2, 2.4, 2.0), 2.0),
        ),
    ]


def _jaw() -> list[Part]:
    return [
        *both_sides(Capsule((4.9, -5.6, 0.6), (1.2, -10.0, 6.9), (1.1, 1.2), 1.8)),
        Ellipsoid((0.0, -6.4, 5.4), (3.5, 3.2, 3.6), 1.8),
        Ellipsoid((0.0, -10.0, 7.5), (1.75, 1.35, 1.5), 1.4),
    ]


def _neck() -> list[Part]:
    return [
        Capsule((0.0, -7.0, -2.3), (0.0, -20.0, -3.6), (4.7, 5.4), 2.6),
        *both_sides(Capsule((4.5, -4.0, -2.6), (1.8, -17.5, 1.0), (0.9, 0.9), 1.8)),
    ]


def _eyes() -> list[Part]:
    x, y, z = EYE_CENTRE
    shell = EYE_RADIUS + LID_THICKNESS
    return [
        *both_sides(
            Ellipsoid((x - 0.1, y - 0.15, z + 2.0), (2.1, 1.35, 1.6), -1.5),
            Ellipsoid((1.55, 0.4, 9.3), (0.9, 1.1, 1.1), -1.2),
        ),
        *both_sides(
            Capsule((0.9, 1.95, 7.9), (3.6, 2.35, 7.2), (0.85, 0.75), 1.2),
            Capsule((3.6, 2.35, 7.2), (5.2, 1.5, 5.2), (0.75, 0.5), 1.8),
        ),
        *both_sides(
            Ellipsoid((x, y, z), (shell, shell, shell), 0.55),
            Capsule((x - 1.1, y - 1.55, z + 0.65), (x + 1.3, y - 1.45, z + 0.2), (0.35, 0.35), 1.0),
        ),
    ]


def _nose() -> list[Part]:
    return [
        Capsule((0.0, 1.2, 7.9), (0.0, -1.6, 9.3), (0.75, 0.62), 1.3),
        Capsule((0.0, -1.4, 9.3), (0.0, -3.4, 10.35), (0.62, 0.70), 1.0),
        Ellipsoid((0.0, -3.5, 10.2), (0.85, 0.78, 0.85), 0.9),
        *both_sides(Ellipsoid((1.15, -3.65, 9.0), (0.66, 0.70, 1.05), 0.9, (0.25, 0.35, 0.0))),
        Capsule((0.0, -4.1, 10.2), (0.0, -4.45, 9.1), (0.34, 0.45), 0.4),
        *both_sides(Ellipsoid((0.62, -4.45, 9.55), (0.30, 0.45, 0.62), -0.22, (0.3, 0.35, 0.0))),
        *both_sides(Capsule((1.95, -3.7, 9.0), (3.3, -6.2, 8.1), (0.08, 0.08), -0.9)),
    ]


def _lips() -> list[Part]:
    y = MOUTH_HEIGHT
    return [
        Capsule((0.0, -5.0, 9.5), (0.0, y + 0.85, 9.45), (0.16, 0.20), -0.5),
        *both_sides(
            Capsule((0.0, y + 0.36, 8.85), (1.2, y + 0.36, 8.62), (0.55, 0.52), 0.5),
            Capsule((1.2, y + 0.36, 8.62), (2.5, y + 0.04, 7.75), (0.52, 0.24), 0.5),
        ),
        *both_sides(
            Capsule((0.0, y - 0.52, 8.80), (1.1, y - 0.48, 8.60), (0.66, 0.60), 0.4),
            Capsule((1.1, y - 0.48, 8.60), (2.4, y - 0.10, 7.80), (0.60, 0.24), 0.4),
        ),
        Capsule((-1.2, y - 1.60, 9.0), (1.2, y - 1.60, 9.0), (0.35, 0.35), -0.9),
        *both_sides(
            Capsule((0.0, y, 9.62), (1.3, y - 0.01, 9.36), (0.05, 0.05), -0.30),
            Capsule((1.3, y - 0.01, 9.36), (2.7, y - 0.05, 8.25), (0.05, 0.12), -0.35),
        ),
    ]


def _ears() -> list[Part]:
    rim = [(7.0, -2.1, 0.1), (7.3, -1.0, -0.9), (7.75, 0.5, -1.7), (7.8, 1.8, -1.5), (7.5, 2.3, -0.5),
           (7.1, 1.9, 0.4), (6.9, 1.1, 0.6)]  # fmt: skip
    helix = [Capsule(a, b, (0.24, 0.24), 0.4) for a, b in pairwise(rim)]
    return [
        *both_sides(Ellipsoid((7.1, 0.3, -0.5), (0.40, 2.3, 1.35), 0.6, (0.0, -0.5, 0.0))),
        *both_sides(*helix),
        *both_sides(
            Ellipsoid((7.0, -2.2, 0.15), (0.32, 0.65, 0.5), 0.5),
            Ellipsoid((7.4, 0.0, -0.1), (0.45, 0.9, 0.55), -0.4, (0.0, -0.3, 0.0)),
            Ellipsoid((7.0, -0.2, 0.6), (0.25, 0.45, 0.3), 0.3),
        ),
    ]


def hair_thickness(points: Points) -> FloatArray:
    """Return (n,) centimetres of hair, in soft locks, thinner towards hairline and neck."""
    azimuth = np.radians(azimuth_deg(points))
    line = np.interp(np.abs(np.degrees(azimuth)), HAIRLINE_DEG, HAIRLINE_CM)
    rise = np.clip((points[:, 1] - line) / 3.0, 0.0, 1.0)
    locks = np.sin(9.0 * azimuth + 0.35 * points[:, 1]) + 0.6 * np.sin(
        17.0 * azimuth - 0.6 * points[:, 1] + 1.0
    )
    crown = np.clip((10.0 - points[:, 1]) / 4.0, 0.0, 1.0)  # near the pole the azimuth means nothing
    return _HAIR_CM * rise * (1.0 + 0.10 * crown * locks)


_Piece = tuple[Points, Faces, IntArray, int]  # vertices, faces, owners, part


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """The neutral head, lids and lips closed.

    part, hair, mouth, eyes: as of `Head`. side: (n,) +1 above, -1 below the line of the lips, 0 at the
    mouth's corners. owner: (n,) the rim vertex that a cavity's or lid rim's vertex hangs on, its own number
    elsewhere.
    """

    vertices: Points
    faces: Faces
    part: IntArray
    side: IntArray
    owner: IntArray
    hair: FloatArray
    mouth: Slit
    eyes: tuple[Slit, Slit]


def head_arrays() -> dict[str, Array]:
    """Return the arrays of head.npz, as `read_head` takes them."""
    head = build_head()
    on_rim = head.vertices[head.owner]  # what hangs on a rim moves with it
    arrays: dict[str, Array] = {
        "vertices": head.vertices.astype(np.float32),
        "faces": head.faces,
        "part": head.part.astype(np.int8),
        "hair": head.hair.astype(np.float32),
        "jaw": _jaw_share(head, on_rim).astype(np.float32),
        "lids": (_lid_angles(head, on_rim, -1.0) + _lid_angles(head, on_rim, 1.0)).astype(np.float32),
    }
    for name, slit in zip(("mouth", "left_eye", "right_eye"), (head.mouth, *head.eyes), strict=True):
        arrays |= {f"{name}_upper": slit.upper, f"{name}_lower": slit.lower}
    for muscle in Muscle:
        arrays[muscle.value] = muscle_shift(muscle, head, on_rim).astype(np.float32)
    for makeup in Makeup:
        levels = np.rint(vertex_colours(head, makeup) * np.iinfo(np.uint16).max)
        arrays[f"colours_{makeup.value}"] = levels.astype(np.uint16)
    return arrays


def lip_line(x: FloatArray) -> FloatArray:
    """Return the height where the closed lips meet."""
    return MOUTH_HEIGHT - 0.05 * (np.asarray(x) / MOUTH_HALF_WIDTH) ** 2


def lid_line(x: FloatArray) -> FloatArray:
    """Return the height where the closed lids of the eye on the same side meet."""
    offset = (np.abs(x) - EYE_CENTRE[0]) / 1.3
    return EYE_CENTRE[1] - 0.42 + 0.30 * offset**2 + 0.05 * offset


def build_head() -> "Shape":
    """Sculpt, mesh, cut and fill the head."""
    low, high = np.array([-9.6, NECK_CUT, -11.5]), np.array([9.6, 12.2, 12.1])
    vertices, faces = mesh_from_implicit(sculpt_head(), low, high, _HEAD_CELL_CM)
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
    half = MOUTH_HALF_WIDTH
    for centre, width, line, front in (
        (0.0, half, lip_line, 6.5),
        (-EYE_CENTRE[0], 1.22, lid_line, 6.3),
        (EYE_CENTRE[0], 1.22, lid_line, 6.3),
    ):
        level = vertices[:, 1] - line(vertices[:, 0])
        inside = (np.abs(vertices[:, 0] - centre) < width) & (vertices[:, 2] > front) & (np.abs(level) < 1.0)
        small = inside & (np.abs(level) < _LEAST_LEVEL * _HEAD_CELL_CM)
        wanted = np.where(level < 0, -1.0, 1.0) * _LEAST_LEVEL * _HEAD_CELL_CM
        vertices = vertices.copy()
        vertices[small, 1] += (wanted - level)[small]
        level = np.where(small, wanted, level)
        vertices, faces, slit = cut_slit(vertices, faces, level, inside)
        slits.append(slit)
    return vertices, faces, slits


def _with_interior(
    shape: Points, faces: Faces, side: IntArray, hair: FloatArray, slits: list[Slit]
) -> "Shape":
    """Append cavity, lid rims and the parts that move on their own."""
    pieces: list[_Piece] = [(shape, faces, np.arange(len(shape)), rig.SKIN)]
    count = len(shape)
    for number, slit in enumerate(slits):
        eye = None if number == 0 else np.array(EYE_CENTRE) * [(-1.0, 1.0)[number - 1], 1.0, 1.0]
        points, own, owner = extrude_slit(shape, slit, count, eye)
        pieces.append((points, own, owner, rig.CAVITY if number == 0 else rig.LID_RIM))
        count += len(points)
    moving = (
        (rig.EYES, eyeball(-1.0)),
        (rig.EYES, eyeball(1.0)),
        (rig.UPPER_TEETH, teeth(upper=1.0)),
        (rig.LOWER_TEETH, teeth(upper=-1.0)),
        (rig.TONGUE, tongue()),
    )
    for part, (points, own) in moving:
        pieces.append((points, own + count, count + np.arange(len(points)), part))
        count += len(points)
    owner = np.concatenate([piece[2] for piece in pieces])
    skin = owner < len(shape)
    return Shape(
        vertices=np.concatenate([piece[0] for piece in pieces]),
        faces=np.concatenate([piece[1] for piece in pieces]).astype(np.int32),
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
    lids = np.concatenate([np.full(len(piece[0]), piece[3] == rig.LID_RIM) for piece in pieces])
    sides[lids] = 1
    return sides


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
        almond = np.sqrt(np.clip(1.0 - (rim[:, 0] / MOUTH_HALF_WIDTH) ** 2, 0.0, 1.0))
        up = np.where(np.arange(size) < half, 1.0, -1.0) * almond
        for opening, depth in _POCKET_RINGS:
            rings.append(rim + np.stack([0 * up, opening * up, depth * (0.25 + 0.75 * almond)], axis=1))
    else:
        outward = (rim - eye) / np.linalg.norm(rim - eye, axis=1, keepdims=True)
        rings = [eye + radius * EYE_RADIUS * outward for radius in _LID_RINGS]
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
    points = np.concatenate([[[0.0, 0.0, 1.045]], (bulge[..., None] * ball).reshape(-1, 3)]) * EYE_RADIUS
    faces = 1 + _sheet_faces(len(tilt), len(turn), around=True)
    tip = np.stack([np.zeros(64, dtype=int), 1 + np.arange(64), 1 + (np.arange(64) + 1) % 64], axis=1)
    return points + np.array(EYE_CENTRE) * [side, 1.0, 1.0], np.concatenate([tip, faces])


def teeth(upper: float) -> tuple[Points, Faces]:
    """Return a row of teeth: upper for +1, lower for -1."""
    arc = np.radians(np.linspace(-72.0, 72.0, 145))
    height = np.linspace(0.0, 1.0, 14)
    gap = np.abs(np.sin(arc * 6.0)) ** 0.35
    edge = np.clip((height - 0.8) / 0.2, 0.0, 1.0)
    radius = (0.93 + 0.07 * gap)[None, :] * (1.0 - 0.08 * edge**2)[:, None]
    size = (2.55, 3.25) if upper > 0 else (2.40, 2.95)
    root = MOUTH_HEIGHT + (1.1 if upper > 0 else -1.35)
    tip = MOUTH_HEIGHT + (-0.38 if upper > 0 else -0.42)
    y = root + (tip - root) * height[:, None] * (0.88 + 0.12 * gap)[None, :]
    x, z = size[0] * radius * np.sin(arc), 4.95 + size[1] * radius * np.cos(arc)
    faces = _sheet_faces(len(height), len(arc), around=False)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), faces if upper > 0 else faces[:, ::-1]


def tongue() -> tuple[Points, Faces]:
    """Return the tongue, lying behind the lower teeth."""
    tilt, turn = np.linspace(0.02, np.pi - 0.02, 24), np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    angle, about = np.meshgrid(tilt, turn, indexing="ij")
    ball = np.stack([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)], axis=-1)
    points = ball.reshape(-1, 3) * [1.7, 0.55, 2.1] + [0.0, MOUTH_HEIGHT - 0.85, 5.5]
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


# How jaw and lids follow.


_UPPER_LID_DEG, _LOWER_LID_DEG = 34.0, 11.0
_LID_HALF_WIDTH = 1.25


def _jaw_share(head: Shape, points: Points) -> FloatArray:
    """Return (n,) how far each vertex follows the jaw: 1 chin and lower lip, 0 skull, less in the cheeks."""
    x, y, z = points.T
    level = y - lip_line(x)
    almond = np.sqrt(np.clip(1.0 - (x / MOUTH_HALF_WIDTH) ** 2, 0.0, 1.0))
    reach = 0.5 + 0.9 * np.clip(np.abs(x) - 1.6, 0.0, None)
    away = np.maximum(almond, smooth_step(np.abs(level) / reach))
    share = 0.5 - 0.5 * np.where(head.side == 0, 0.0, head.side) * away
    share = np.where(z > 1.5, share, 0.5 - 0.5 * np.sign(level) * smooth_step(np.abs(level) / reach))
    behind = smooth_step((z + 0.5) / 4.0)  # the jaw's angle hardly moves
    throat = smooth_step((y + 13.2 + 0.25 * np.clip(z, 0.0, 8.0)) / 2.2)
    share = np.clip(share, 0.0, 1.0) * behind * throat
    share = np.where((head.part == rig.LOWER_TEETH) | (head.part == rig.TONGUE), 1.0, share)
    return np.where((head.part == rig.UPPER_TEETH) | (head.part == rig.EYES), 0.0, share)


def _lid_angles(head: Shape, points: Points, sign: float) -> FloatArray:
    """Return (n,) the angle that opens one eye's lids, radians, negative upwards, 0 away from them."""
    centre = np.array(EYE_CENTRE) * [sign, 1.0, 1.0]
    offset = points - centre
    distance = np.linalg.norm(offset, axis=1)
    near = (distance < 2.9) & (offset[:, 2] > -0.2) & (head.part != rig.EYES)
    rows = np.flatnonzero(near)
    o = offset[rows]
    radius = np.maximum(np.hypot(o[:, 1], o[:, 2]), 1e-6)
    elevation = np.degrees(np.arctan2(o[:, 1], o[:, 2]))
    seam = np.degrees(np.arcsin(np.clip((lid_line(points[rows, 0]) - centre[1]) / radius, -0.95, 0.95)))
    slit = head.eyes[0 if sign < 0 else 1]
    owner = head.owner[rows]
    above = np.where(
        np.isin(owner, slit.upper), True, np.where(np.isin(owner, slit.lower), False, elevation > seam)
    )
    almond = np.clip(1.0 - (o[:, 0] / _LID_HALF_WIDTH) ** 2, 0.0, 1.0) ** 0.65
    fade = 1.0 - smooth_step((distance[rows] - 1.45 * EYE_RADIUS / 1.22) / 1.3)
    upper = 1.0 - smooth_step((elevation - seam) / 75.0)
    lower = 1.0 - smooth_step((seam - elevation) / 50.0)
    angle = np.where(above, -_UPPER_LID_DEG * np.clip(upper, 0, 1), _LOWER_LID_DEG * np.clip(lower, 0, 1))
    opening = np.zeros(len(points))
    opening[rows] = np.radians(angle) * almond * fade
    return opening


# Muscles: each moves the skin around a few places smoothly, and separates the lips.


# (place, radius, shift) on the side x > 0, mirrored to the other; side +1 or -1 moves that lip alone
_Pull = tuple[_Vector, float, _Vector, int]
_CORNER = (2.55, -6.8, 8.0)
_PULLS: dict[Muscle, tuple[_Pull, ...]] = {
    Muscle.SMILE: (
        (_CORNER, 1.5, (0.62, 0.62, -0.45), 0),
        ((4.0, -3.9, 7.0), 1.7, (0.05, 0.38, 0.42), 0),
        ((3.2, -1.4, 7.8), 1.0, (0.0, 0.16, 0.10), 0),
        ((1.0, -6.3, 9.4), 1.0, (0.10, 0.06, -0.16), 0),
    ),
    Muscle.GRIMACE: (
        (_CORNER, 1.5, (0.45, -0.45, -0.25), 0),
        ((1.3, -3.7, 9.2), 0.9, (0.10, 0.30, 0.05), 0),
        ((1.0, -6.2, 9.4), 1.0, (0.0, 0.38, 0.05), 1),
        ((0.9, -7.3, 9.4), 1.1, (0.05, -0.42, 0.0), -1),
        ((2.0, -2.0, 8.4), 1.2, (0.0, 0.25, 0.18), 0),
        ((0.0, -10.0, 8.9), 1.2, (0.0, 0.25, 0.10), 0),
    ),
    Muscle.PUCKER: (
        (_CORNER, 1.3, (-0.85, 0.0, 0.45), 0),
        ((0.0, -6.4, 9.5), 1.2, (0.0, 0.06, 0.38), 1),
        ((0.0, -7.3, 9.4), 1.2, (0.0, -0.06, 0.42), -1),
        ((3.9, -6.2, 7.2), 1.5, (-0.20, 0.0, -0.15), 0),
    ),
    Muscle.LIPS_APART: (
        ((0.0, -6.3, 9.5), 1.5, (0.0, 0.26, 0.04), 1),
        ((0.0, -7.2, 9.4), 1.5, (0.0, -0.34, 0.04), -1),
    ),
    Muscle.BROWS_UP: (
        ((1.6, 2.4, 8.6), 1.4, (0.0, 0.50, 0.05), 0),
        ((3.8, 2.6, 7.4), 1.5, (0.0, 0.55, 0.03), 0),
        ((2.0, 5.0, 8.4), 1.8, (0.0, 0.22, 0.0), 0),
    ),
    Muscle.BROWS_KNIT: (
        ((1.5, 2.0, 8.7), 1.2, (-0.30, -0.42, 0.16), 0),
        ((3.4, 2.4, 7.7), 1.3, (-0.12, -0.22, 0.05), 0),
    ),
}


_LEAST_SHIFT_CM = 1e-3


def muscle_shift(muscle: Muscle, head: Shape, points: Points) -> Points:
    """Return (n, 3) centimetres by which a muscle shifts each vertex at full strength."""
    soft = np.isin(head.part, (rig.SKIN, rig.CAVITY, rig.LID_RIM))
    almond = np.sqrt(np.clip(1.0 - (points[:, 0] / MOUTH_HALF_WIDTH) ** 2, 0.0, 1.0))
    shift = np.zeros_like(points)
    for place, radius, pull, lip in _PULLS[muscle]:
        for mirror in (1.0, -1.0) if place[0] else (1.0,):
            flip = np.array([mirror, 1.0, 1.0])
            squared = np.sum((points - flip * place) ** 2, axis=1)
            share = np.exp(-0.5 * squared / (0.7 * radius) ** 2)
            if lip:
                share = share * _one_lip(head.side, points, almond, lip)
            shift += share[:, None] * (flip * pull)
    moved = soft & (np.linalg.norm(shift, axis=1) > _LEAST_SHIFT_CM)
    return np.where(moved[:, None], shift, 0.0)


def _one_lip(side: IntArray, points: Points, almond: FloatArray, lip: int) -> FloatArray:
    """Return 1 on that lip, 0 on the other, fading towards the corners where the two are one."""
    away = np.abs(points[:, 1] - lip_line(points[:, 0]))
    return np.where(side == lip, np.maximum(almond, np.clip(away / 0.8, 0.0, 1.0)), 0.0)


# Colours that change slowly over the head: lips, warm cheeks, hair, eyes; or makeup.


_IRIS_RADIUS, _PUPIL_RADIUS = 0.54, 0.20
_LIPS, _HAIR = np.array([0.47, 0.20, 0.185]), np.array([0.115, 0.075, 0.050])
_IRIS, _SCLERA = np.array([0.16, 0.24, 0.27]), np.array([0.72, 0.70, 0.68])
_FLESH, _TOOTH = np.array([0.30, 0.075, 0.07]), np.array([0.74, 0.70, 0.60])
_RIM = np.array([0.24, 0.13, 0.10])


def vertex_colours(head: Shape, makeup: Makeup) -> Colours:
    """Return (n, 3) the weights of the RGB pigments that change slowly over the head."""
    x, y, z = head.vertices.T
    skin = np.tile(skin_reflectance(makeup), (len(x), 1))
    if makeup is Makeup.NONE:
        half = np.clip(1.0 - (x / (MOUTH_HALF_WIDTH + 0.1)) ** 2, 0.0, 1.0) ** 0.6
        level = y - lip_line(x)
        reach = np.where(level > 0, 0.80, 1.05) * half + 1e-6
        lips = smooth_step((1.12 - np.abs(level) / reach) / 0.24) * (z > 6.5) * (half > 0)
        warm = np.exp(-0.5 * (((np.abs(x) - 4.3) / 1.5) ** 2 + ((y + 3.3) / 1.5) ** 2))
        warm += 0.8 * np.exp(-0.5 * ((x / 0.9) ** 2 + ((y + 3.5) / 0.9) ** 2))
        skin *= 1.0 - 0.22 * (warm * (z > 4.0))[:, None] * np.array([0.1, 1.0, 0.9])
        skin += lips[:, None] * (_LIPS - skin)
    colours = skin + head.hair[:, None] * (_HAIR - skin)
    for part, colour in ((rig.CAVITY, _FLESH), (rig.TONGUE, 1.3 * _FLESH), (rig.LID_RIM, _RIM),
                         (rig.UPPER_TEETH, _TOOTH), (rig.LOWER_TEETH, _TOOTH)):  # fmt: skip
        colours[head.part == part] = colour
    eyes = head.part == rig.EYES
    colours[eyes] = _eye_colours(np.hypot(np.abs(x[eyes]) - EYE_CENTRE[0], y[eyes]), z[eyes] > EYE_CENTRE[2])
    return colours.astype(np.float32)


def _eye_colours(off_axis: FloatArray, in_front: FloatArray) -> Colours:
    iris = smooth_step((_IRIS_RADIUS + 0.03 - off_axis) / 0.06) * in_front
    rim = np.exp(-0.5 * ((off_axis - _IRIS_RADIUS + 0.05) / 0.06) ** 2) * in_front
    pupil = smooth_step((_PUPIL_RADIUS + 0.03 - off_axis) / 0.06) * in_front
    colours = _SCLERA + iris[:, None] * (_IRIS - _SCLERA)
    return np.asarray(colours * (1.0 - 0.6 * rim[:, None]) * (1.0 - 0.95 * pupil[:, None]), dtype=np.float32)


# The legs, centimetres: open at waist and ankles.


_LEGS_CELL_CM = 0.40
_WAIST_CUT, _ANKLE_CUT = 17.0, -80.0
_GAP_DEPTHS = (-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0)  # what is carved out between the thighs


def legs_arrays() -> dict[str, Array]:
    """Return the arrays of legs.npz."""
    low, high = np.array([-21.0, _ANKLE_CUT, -19.0]), np.array([21.0, _WAIST_CUT, 17.0])
    vertices, faces = mesh_from_implicit(sculpt_legs(), low, high, _LEGS_CELL_CM)
    return {"vertices": vertices.astype(np.float32), "faces": faces}


def sculpt_legs() -> Body:
    """Return two legs and the hips."""
    return [
        Ellipsoid((0.0, 12.0, -0.5), (14.0, 17.0, 9.5), 0.0),
        Ellipsoid((0.0, 26.0, 0.0), (12.5, 16.0, 8.5), 6.0),
        *both_sides(
            Capsule((8.8, 0.0, -0.2), (9.2, -42.0, 1.0), (8.2, 5.2), 5.0),
            Ellipsoid((7.2, 1.0, -6.0), (7.2, 8.5, 6.5), 5.0),
            Ellipsoid((8.6, -18.0, 2.2), (6.4, 19.0, 5.8), 5.0),
            Ellipsoid((9.2, -43.0, 1.9), (2.6, 6.0, 2.6), 5.0),
            Capsule((9.2, -42.0, 0.8), (9.2, -84.0, -1.6), (4.2, 3.4), 3.0),
            Ellipsoid((9.6, -56.0, -2.4), (4.7, 12.5, 4.9), 4.0),
        ),
        *(Capsule((0.0, -8.5, z), (0.0, -95.0, z), (1.5, 1.5), -3.0) for z in _GAP_DEPTHS),
    ]


# The sweater's pattern: metres, x to the wearer's left as seen from the front (right in the image), y up,
# origin between the two neck points.


EDGE_LENGTH_M = 0.0125  # of the cage; two subdivisions make 3 mm of it
# the measures of an adult's loose sweater, metres
_NECK = np.array([0.085, 0.0])
_HALF_WIDTH, _LENGTH = 0.305, 0.72  # of the body part
_SLEEVE_LENGTH, _CUFF_WIDTH = 0.47, 0.150  # from shoulder to cuff; of the flat cuff
_RIB_HEIGHT = 0.055  # of the ribbing at hem and cuffs
_RIB_GATHER = 0.78  # its rest length as a share of the cut; the cloth above it blouses


def sweater_arrays() -> dict[str, Array]:
    """Return the arrays of sweater.npz."""
    sewn = sew_sweater()
    return {
        "flat": sewn.flat,
        "gather": sewn.gather,
        "panel": sewn.panel.astype(np.int8),
        "faces": sewn.faces,
    }


def sew_sweater(edge_length: float = EDGE_LENGTH_M) -> Garment:
    """Cut, triangulate and sew the two panels, edges about so long; openings stay at neck, cuffs and hem."""
    front, front_faces, front_seam = _panel(edge_length, neck_depth=0.085)
    back, back_faces, back_seam = _panel(edge_length, neck_depth=0.025)
    seam_tree = cKDTree(front[front_seam])
    distance, nearest = seam_tree.query(back)
    sewn = back_seam & (distance < 1e-9)
    index = np.empty(len(back), dtype=np.int64)
    index[sewn] = np.flatnonzero(front_seam)[nearest[sewn]]
    index[~sewn] = len(front) + np.arange(np.count_nonzero(~sewn))
    flat = np.concatenate([front, back[~sewn]])
    return Garment(
        flat=flat,
        gather=np.where(_in_ribbing(flat), _RIB_GATHER, 1.0),
        panel=np.where(np.arange(len(flat)) < len(front), FRONT, BACK),
        faces=np.concatenate([front_faces, index[back_faces][:, ::-1]]).astype(np.int32),
    )


def _in_ribbing(flat: Points2) -> BoolArray:
    """Return which points lie in the bands at hem and cuffs."""
    drop = np.deg2rad(SLEEVE_DROP_DEG)
    outwards = np.abs(flat) @ [np.cos(drop), 0.0] - flat @ [0.0, np.sin(drop)]
    start = SHOULDER_M @ [np.cos(drop), -np.sin(drop)]
    in_cuff = outwards - start > _SLEEVE_LENGTH - _RIB_HEIGHT
    return in_cuff | (flat[:, 1] < -_LENGTH + _RIB_HEIGHT)


def _panel(step: float, neck_depth: float) -> tuple[Points2, Faces, BoolArray]:
    """Return points, counter-clockwise triangles and which points lie on a seam."""
    outline, on_seam = _outline(step, neck_depth)
    tree = cKDTree(outline)
    low, high = outline.min(axis=0), outline.max(axis=0)
    rows = np.arange(low[1], high[1], step * np.sqrt(0.75))
    columns = np.arange(low[0] - step, high[0] + step, step)
    v, u = np.meshgrid(np.arange(len(rows)), columns, indexing="ij")
    lattice = np.stack([u + 0.5 * step * (v % 2), rows[v]], axis=-1).reshape(-1, 2)
    keep = _inside(outline, lattice) & (tree.query(lattice)[0] > 0.6 * step)
    points = np.concatenate([outline, lattice[keep]])
    faces = Delaunay(points).simplices.astype(np.int32)
    faces = faces[_inside(outline, points[faces].mean(axis=1))]
    a, b, c = (points[faces[:, i]] for i in range(3))
    doubled_area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces = faces[np.abs(doubled_area) > 1e-3 * step**2]
    flip = doubled_area[np.abs(doubled_area) > 1e-3 * step**2] < 0
    faces[flip] = faces[flip][:, ::-1]
    return points, faces, np.concatenate([on_seam, np.zeros(np.count_nonzero(keep), dtype=bool)])


def _outline(step: float, neck_depth: float) -> tuple[Points2, BoolArray]:
    """Return the closed outline, resampled at about `step`, and which points are sewn."""
    drop = np.deg2rad(SLEEVE_DROP_DEG)
    along, across = np.array([np.cos(drop), -np.sin(drop)]), np.array([-np.sin(drop), -np.cos(drop)])
    neck, shoulder = _NECK, SHOULDER_M
    cuff_top = shoulder + _SLEEVE_LENGTH * along
    cuff_low = cuff_top + _CUFF_WIDTH * across
    armpit, hem = np.array([_HALF_WIDTH, -0.30]), np.array([_HALF_WIDTH, -_LENGTH])
    turn = np.linspace(0.0, np.pi / 2, 20)[:, None]
    neckline = np.hstack([neck[0] * np.sin(turn), -neck_depth * np.cos(turn)])
    under = _curve(cuff_low, armpit + 0.035 * np.array([1.0, 0.55]), armpit - np.array([0.0, 0.03]))
    pieces = [
        (neckline, False),
        (np.stack([neck, shoulder, cuff_top]), True),
        (np.stack([cuff_top, cuff_low]), False),
        (np.concatenate([under, hem[None]]), True),
        (np.stack([hem, np.array([0.0, hem[1]])]), False),
    ]
    half, sewn = _resample(pieces, step)
    inner = slice(1, -1)  # the two points on the mirror line belong to both halves
    mirrored = (half * [-1.0, 1.0])[inner][::-1]
    return np.concatenate([half, mirrored]), np.concatenate([sewn, sewn[inner][::-1]])


def _curve(start: FloatArray, corner: FloatArray, end: FloatArray) -> Points2:
    """Return a line that rounds the armpit: straight to 70 %, then a quadratic Bézier."""
    first = start + 0.7 * (corner - start)
    t = np.linspace(0.0, 1.0, 24)[:, None]
    bend = (1 - t) ** 2 * first + 2 * t * (1 - t) * corner + t**2 * end
    return np.concatenate([start[None], bend])


def _resample(pieces: list[tuple[Points2, bool]], step: float) -> tuple[Points2, BoolArray]:
    """Sample each piece at nearly `step`; where two meet the sewn one owns the point."""
    points, sewn = [pieces[0][0][:1]], [np.zeros(1, dtype=bool)]
    for line, is_sewn in pieces:
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        count = max(2, round(float(arc[-1]) / step))
        at = np.linspace(0.0, arc[-1], count + 1)[1:]
        points.append(np.stack([np.interp(at, arc, line[:, 0]), np.interp(at, arc, line[:, 1])], axis=1))
        if is_sewn:
            sewn[-1][-1] = True
        sewn.append(np.full(count, is_sewn))
    return np.concatenate(points), np.concatenate(sewn)


def _inside(outline: Points2, points: Points2) -> BoolArray:
    """Return which points lie inside the closed outline (crossing number)."""
    a, b = outline, np.roll(outline, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    rise = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
    right = x < a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
    return np.count_nonzero(crosses & right, axis=1) % 2 == 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("data/shapes"), help="folder to write")
    main(parser.parse_args().out)
