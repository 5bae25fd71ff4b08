"""The sewing pattern of a sweater: two flat panels, triangulated and sewn along sides and sleeves.

Pattern frame: metres, x to the wearer's left as seen from the front (right in the image), y up,
origin between the two neck points.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from vntoolkit.arrays import BoolArray, Faces, FloatArray, IntArray, Points2

FRONT, BACK = 0, 1
EDGE_LENGTH_M = 0.0125  # of the cage; two subdivisions make 3 mm of it
# the measures of an adult's loose sweater, metres
_NECK, _SHOULDER = np.array([0.085, 0.0]), np.array([0.215, -0.035])
_HALF_WIDTH, _LENGTH = 0.305, 0.72  # of the body part
_SLEEVE_LENGTH, _CUFF_WIDTH = 0.47, 0.150  # from shoulder to cuff; of the flat cuff
_SLEEVE_DROP_DEG = 25.0  # below the horizontal
_RIB_HEIGHT = 0.055  # of the ribbing at hem and cuffs
_RIB_GATHER = 0.78  # its rest length as a share of the cut; the cloth above it blouses


@dataclass(frozen=True, kw_only=True, eq=False)
class Garment:
    """A sewn garment at rest.

    flat: (n, 2) position in the pattern, metres; its metric gives every rest length.
    gather: (n,) factor on the rest lengths there, below 1 in the ribbing. panel: (n,) 0 on the front and on
    seams, 1 on the back. faces: (m, 3), counter-clockwise from outside.
    """

    flat: Points2
    gather: FloatArray
    panel: IntArray
    faces: Faces


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
    drop = np.deg2rad(_SLEEVE_DROP_DEG)
    outwards = np.abs(flat) @ [np.cos(drop), 0.0] - flat @ [0.0, np.sin(drop)]
    start = _SHOULDER @ [np.cos(drop), -np.sin(drop)]
    in_cuff = outwards - start > _SLEEVE_LENGTH - _RIB_HEIGHT
    return in_cuff | (flat[:, 1] < -_LENGTH + _RIB_HEIGHT)


def knit_coordinates(flat: Points2) -> Points2:
    """Return (n, 2) metres across and along the ribs: upright on the body, lengthwise on the sleeves."""
    drop = np.deg2rad(_SLEEVE_DROP_DEG)
    folded = np.stack([np.abs(flat[:, 0]), flat[:, 1]], axis=1) - _SHOULDER
    along = folded @ [np.cos(drop), -np.sin(drop)]
    across = folded @ [-np.sin(drop), -np.cos(drop)]
    on_sleeve = folded[:, 0] > 0.02 - 0.25 * folded[:, 1]  # beyond the armhole
    return np.where(on_sleeve[:, None], np.stack([across, along], axis=1), flat)


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
    drop = np.deg2rad(_SLEEVE_DROP_DEG)
    along, across = np.array([np.cos(drop), -np.sin(drop)]), np.array([-np.sin(drop), -np.cos(drop)])
    neck, shoulder = _NECK, _SHOULDER
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
