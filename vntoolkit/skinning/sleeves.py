"""Sleeves and trunk of a garment, found from its outline in the frame, whatever it is called or wears it.

The outline of a garment leaves its convex hull in bays. A bay with cloth above it and on its inner side lies
under an arm, and its deepest point is the armpit. The armhole runs from there straight up to the shoulder.
What lies beyond it is the sleeve; its axis is the middle of the cloth that is equally far from the armhole.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy import ndimage
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import ConvexHull

from vntoolkit.arrays import FloatArray, IntArray, Mask, Points, Points2, Vector3
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rigid import Similarity
from vntoolkit.native import njit

_CELLS = 224  # along the longer side of the outline: a sleeve is then some 30 cells wide
_LEAST_BAY = 0.06  # of the garment's larger extent: shallower ones are folds and a waist
_ASIDE = 0.12  # of the garment's width from its middle: nearer, a bay lies between two legs
_LEAST_SLEEVE = 0.5  # of the armhole's height: a shorter one is the edge of a vest
_LEAST_LEG = 0.35  # of the garment's height: trousers have longer legs, and a hem has shorter notches
_LEAST_HOLE = 0.05  # of it: the gap between thighs is as high, a gap in the mesh is less
_HEM_SHARE = 0.03  # of a leg's vertices: the lowest ones are its hem
_CORNERS = np.ones((3, 3), dtype=bool)  # cells that touch at a corner belong together
_STATIONS = 24  # along a sleeve's axis
_MIDDLE = 0.35  # of the radius: so far from the axis the cloth is at its nearest to the camera


@dataclass(frozen=True, kw_only=True, eq=False)
class Sleeve:
    """A sleeve, in the axes and lengths of the garment.

    side: −1 at smaller x, 1 at larger x. armpit: (3,). axis: (k, 3) from the armhole to the cuff. radii:
    (k,) about it. along: (n,) how far each vertex is from the armhole along the axis, NaN off the sleeve.
    """

    side: int
    armpit: Vector3
    axis: Points
    radii: FloatArray
    along: FloatArray

    @property
    def stations(self) -> FloatArray:
        """(k,) length of the axis up to each of its points."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.axis, axis=0), axis=1))])

    @property
    def length(self) -> float:
        """Length of the axis."""
        return float(self.stations[-1])

    def point_at(self, along: float) -> Vector3:
        """Return (3,): the point of the axis at a length from the armhole; beyond its ends, on their line."""
        stations, end = self.stations, len(self.axis) - 1
        if along < 0 or along > stations[-1]:
            first = 0 if along < 0 else max(end - 3, 0)
            last = min(3, end) if along < 0 else end
            way = self.axis[last] - self.axis[first]
            anchor, over = (self.axis[0], along) if along < 0 else (self.axis[-1], along - stations[-1])
            return anchor + over * way / max(float(np.linalg.norm(way)), 1e-300)
        return np.array([np.interp(along, stations, self.axis[:, i]) for i in range(3)])


@dataclass(frozen=True, kw_only=True, eq=False)
class GarmentRegions:
    """sleeves: none, one or two. trunk: (n,) below the armpits and between the flanks. hems: of trousers, the
    middle of the right and of the left leg's lower end, (2, 3), as seen from the front; else None.
    """

    sleeves: tuple[Sleeve, ...]
    trunk: Mask
    hems: Points | None = None

    def moved(self, similarity: Similarity) -> "GarmentRegions":
        """Return the regions of the garment after a similarity; sides stay those of the garment."""
        return replace(
            self,
            hems=None if self.hems is None else similarity.apply(self.hems),
            sleeves=tuple(
                replace(
                    sleeve,
                    armpit=similarity.apply(sleeve.armpit[None])[0],
                    axis=similarity.apply(sleeve.axis),
                    radii=similarity.scale * sleeve.radii,
                    along=similarity.scale * sleeve.along,
                )
                for sleeve in self.sleeves
            ),
        )


def regions_of_garment(garment: Mesh) -> GarmentRegions:
    """Find the sleeves of a garment seen from the front (x right, y down, z away), its trunk, or its legs.

    What has sleeves is not asked for legs: between the front and the back of a collar, too, lies a gap.
    """
    vertices = np.asarray(garment.vertices, dtype=np.float64)
    nothing = GarmentRegions(sleeves=(), trunk=np.zeros(len(vertices), dtype=bool))
    if len(garment.faces) < 2 or not np.ptp(vertices[:, :2], axis=0).min() > 0:
        return nothing
    outline = _outline_of(vertices, garment)
    found = [sleeve for armpit in _armpits(outline.mask) if (sleeve := _sleeve(outline, armpit)) is not None]
    if not found:
        crotch = _crotch(outline.mask)
        if crotch is None:
            return nothing
        return replace(nothing, hems=_hems(vertices, outline.cells(vertices)[:, 0] > crotch))
    cells = outline.cells(vertices)
    sleeves = tuple(_measured(outline, cells, *parts) for parts in found)
    trunk = np.ones(len(vertices), dtype=bool)
    for (column, row), _, _ in found:
        outer = max((abs(r - row), r) for (_, r), _, _ in found)[1]  # the other armpit, or the same
        other = next((c for (c, r), _, _ in found if r == outer and c != column), column)
        slope = (outer - row) / (other - column) if other != column else 0.0
        trunk &= cells[:, 1] > row + slope * (cells[:, 0] - column)
    for one in sleeves:
        trunk &= np.isnan(one.along)
    return GarmentRegions(sleeves=sleeves, trunk=trunk)


@dataclass(frozen=True, eq=False)
class _Outline:
    """mask, nearest: (h, w) which cells the garment covers, and its nearest z there. cell: length of one."""

    mask: Mask
    nearest: FloatArray
    origin: Points2
    cell: float

    def cells(self, points: Points) -> IntArray:
        """Return (n, 2): column and row of points."""
        return np.rint((np.asarray(points)[:, :2] - self.origin) / self.cell).astype(np.int64)


def _outline_of(vertices: Points, garment: Mesh) -> _Outline:
    used = vertices[np.unique(garment.faces)]
    low, high = used[:, :2].min(axis=0), used[:, :2].max(axis=0)
    cell = float((high - low).max()) / _CELLS
    origin = low - 2 * cell
    width, height = (np.ceil((high - low) / cell).astype(int) + 5).tolist()
    nearest = np.full((height, width), np.inf)
    placed = np.column_stack([(vertices[:, :2] - origin) / cell, vertices[:, 2]])
    _fill(np.ascontiguousarray(placed), garment.faces, nearest)
    mask = _largest(ndimage.binary_closing(np.isfinite(nearest)))
    return _Outline(mask=mask, nearest=nearest, origin=origin, cell=cell)


def _largest(mask: Mask) -> Mask:
    """Return the largest piece: scraps beside it are no sleeves."""
    pieces, _ = ndimage.label(mask, _CORNERS)
    return np.asarray(pieces == np.bincount(pieces[mask]).argmax())


@njit
def _fill(placed, faces, nearest):  # type: ignore[no-untyped-def]
    """Lower `nearest` to the z of every triangle, where it covers the centre of a cell."""
    for f in range(len(faces)):
        ax, ay, az = placed[faces[f, 0]]
        bx, by, bz = placed[faces[f, 1]]
        cx, cy, cz = placed[faces[f, 2]]
        for x, y, z in ((ax, ay, az), (bx, by, bz), (cx, cy, cz)):
            column, row = int(np.rint(x)), int(np.rint(y))
            nearest[row, column] = min(nearest[row, column], z)
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0.0:
            continue
        for row in range(int(np.ceil(min(ay, by, cy))), int(np.floor(max(ay, by, cy))) + 1):
            for column in range(int(np.ceil(min(ax, bx, cx))), int(np.floor(max(ax, bx, cx))) + 1):
                b = ((column - ax) * (cy - ay) - (cx - ax) * (row - ay)) / area
                c = ((bx - ax) * (row - ay) - (column - ax) * (by - ay)) / area
                if b >= 0.0 and c >= 0.0 and b + c <= 1.0:
                    z = az + b * (bz - az) + c * (cz - az)
                    nearest[row, column] = min(nearest[row, column], z)


def _bays(mask: Mask) -> Iterator[tuple[float, int, int]]:
    """Yield of each bay of the outline how deep it is, in cells; column and row of its deepest cell."""
    hull = _hull_of(mask)
    bays, count = ndimage.label(hull & ~mask)
    outside = ndimage.binary_dilation(~hull)
    for number, box in zip(range(1, count + 1), ndimage.find_objects(bays), strict=True):
        bay = bays == number
        lid = bay & outside
        if not lid.any():
            continue
        depths = np.where(bay, ndimage.distance_transform_edt(~lid), 0)[box]
        row, column = (int(i) for i in np.unravel_index(depths.argmax(), depths.shape))
        yield float(depths[row, column]), column + box[1].start, row + box[0].start


def _crotch(mask: Mask) -> int | None:
    """Return the column of the gap between two legs, None for a garment without legs.

    It lies near the middle, has cloth above and on either side, and reaches up a good part of the garment.
    Below it one leg may pass before the other.
    """
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    middle, found = (columns[0] + columns[-1]) / 2, []
    for depth, column, row in [*_bays(mask), *_holes(mask)]:
        lower = mask[(row + rows[-1]) // 2]  # half way down from there
        is_between = lower[:column].any() and lower[column + 1 :].any() and mask[:row, column].any()
        is_central = abs(column - middle) <= _ASIDE * np.ptp(columns)
        if is_between and is_central and rows[-1] - row > _LEAST_LEG * np.ptp(rows):
            found.append((depth, column))
    return max(found)[1] if found else None


def _holes(mask: Mask) -> Iterator[tuple[float, int, int]]:
    """Yield of each hole in the outline its height, in cells; column and row of its highest cell."""
    holes, _ = ndimage.label(ndimage.binary_fill_holes(mask) & ~mask)
    for number, box in enumerate(ndimage.find_objects(holes), start=1):
        height = box[0].stop - box[0].start
        if height > _LEAST_HOLE * np.ptp(np.flatnonzero(mask.any(axis=1))):
            first = int(np.median(np.flatnonzero(holes[box][0] == number)))
            yield float(height), first + box[1].start, box[0].start


def _hems(vertices: Points, is_left: Mask) -> Points:
    """Return (2, 3): the middle of the lowest cloth on either side."""
    hems = []
    for side in (~is_left, is_left):
        own = vertices[side]
        hems.append(own[own[:, 1] >= np.quantile(own[:, 1], 1 - _HEM_SHARE)].mean(axis=0))
    return np.stack(hems)


def _armpits(mask: Mask) -> Iterator[tuple[int, int]]:
    """Yield the column and row of the deepest point of the bay under each arm, at most one a side."""
    columns = np.flatnonzero(mask.any(axis=0))
    middle, size = (
        (columns[0] + columns[-1]) / 2,
        max(np.ptp(columns), np.ptp(np.flatnonzero(mask.any(axis=1)))),
    )
    deepest: dict[bool, tuple[float, int, int]] = {}
    for depth, column, row in _bays(mask):
        right = column > middle
        inward = mask[row, :column] if right else mask[row, column + 1 :]
        under_cloth = mask[:row, column].any() and inward.any()
        is_aside = abs(column - middle) > _ASIDE * np.ptp(columns)
        if under_cloth and is_aside and depth > max(_LEAST_BAY * size, deepest.get(right, (0.0,))[0]):
            deepest[right] = (depth, column, row)
    for _, column, row in deepest.values():
        yield column, row


def _hull_of(mask: Mask) -> Mask:
    sides = ConvexHull(np.argwhere(mask)).equations  # outward normals and offsets
    places = np.moveaxis(np.indices(mask.shape), 0, -1)
    return np.asarray((places @ sides[:, :2].T + sides[:, 2] < 1e-6).all(axis=2))


_Parts = tuple[tuple[int, int], Mask, FloatArray]


def _sleeve(outline: _Outline, armpit: tuple[int, int]) -> _Parts | None:
    """Return the armpit, the cells of its sleeve, and their distance from the armhole in cells; or None."""
    column, row = armpit
    columns = np.flatnonzero(outline.mask.any(axis=0))
    outward = 1 if column > (columns[0] + columns[-1]) / 2 else -1
    above = np.flatnonzero(outline.mask[:row, column])
    top = row - 1
    while top > 0 and not outline.mask[top, column]:
        top -= 1
    bottom = top
    while top > 0 and outline.mask[top - 1, column]:
        top -= 1
    if not len(above) or bottom - top < 2:
        return None
    open_mask = outline.mask.copy()
    open_mask[: bottom + 1, column] = False
    labels, _ = ndimage.label(open_mask, _CORNERS)
    beyond, within = labels[top : bottom + 1, column + outward], labels[top : bottom + 1, column - outward]
    if not beyond.any() or not within.any():
        return None
    label = np.bincount(beyond[beyond > 0]).argmax()
    if label == np.bincount(within[within > 0]).argmax():
        return None  # the sleeve touches the flank below
    cells = labels == label
    start = np.zeros_like(cells)
    start[top : bottom + 1, column + outward] = cells[top : bottom + 1, column + outward]
    distances = _distances_within(cells, start)
    long = np.quantile(distances[np.isfinite(distances)], 0.98) > _LEAST_SLEEVE * (bottom - top)
    return (armpit, cells, distances) if long else None


def _distances_within(cells: Mask, start: Mask) -> FloatArray:
    """Return (h, w): how far each cell is from the start, on a way within the cells; inf elsewhere."""
    index = np.full(cells.shape, -1)
    index[cells] = np.arange(cells.sum())
    pairs, lengths = [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1)):
        here = index[: cells.shape[0] - dy, max(0, -dx) : cells.shape[1] - max(0, dx)]
        there = index[dy:, max(0, dx) : cells.shape[1] - max(0, -dx)]
        both = (here >= 0) & (there >= 0)
        pairs.append(np.column_stack([here[both], there[both]]))
        lengths.append(np.full(both.sum(), np.hypot(dx, dy)))
    (a, b), far = np.concatenate(pairs).T, np.concatenate(lengths)
    graph = sp.csr_array((far, (a, b)), shape=(cells.sum(), cells.sum()))
    least = dijkstra(graph, directed=False, indices=index[start], min_only=True)
    distances = np.full(cells.shape, np.inf)
    distances[cells] = least
    return distances


def _measured(
    outline: _Outline, cells: IntArray, armpit: tuple[int, int], sleeve: Mask, distances: FloatArray
) -> Sleeve:
    """Lay the axis, and tell how far along it each vertex is."""
    reached = np.isfinite(distances)
    rows, columns = np.nonzero(reached)
    far = distances[reached]
    length = float(np.quantile(far, 0.98))
    step = length / _STATIONS
    axis, radii, places = [], [], []
    for place in (np.arange(_STATIONS) + 0.5) * step:
        band = np.abs(far - place) <= step / 2
        if not band.any():
            continue
        centre, radius = np.array([columns[band].mean(), rows[band].mean()]), band.sum() / step / 2
        off = np.hypot(columns[band] - centre[0], rows[band] - centre[1])
        z = outline.nearest[rows[band], columns[band]]
        near = z[(off <= max(_MIDDLE * radius, 1.0)) & np.isfinite(z)]
        if not len(near):
            continue
        radii.append(radius * outline.cell)
        axis.append([*(outline.origin + outline.cell * centre), float(np.median(near)) + radii[-1]])
        places.append(place)
    line, sizes = _smoothed(np.array(axis)), np.array(radii)
    stations = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    side = 1 if columns.mean() > armpit[0] else -1
    nearest = ndimage.distance_transform_edt(~outline.mask, return_distances=False, return_indices=True)
    row, column = (
        n[cells[:, 1].clip(0, sleeve.shape[0] - 1), cells[:, 0].clip(0, sleeve.shape[1] - 1)] for n in nearest
    )
    own = distances[row, column]
    along = np.where(np.isfinite(own), np.interp(own, places, stations), np.nan)
    tip = np.array([*(outline.origin + outline.cell * np.array(armpit)), line[0, 2]])
    return Sleeve(side=side, armpit=tip, axis=line, radii=sizes, along=along)


def _smoothed(axis: Points) -> Points:
    """Even out the steps of cells; the ends stay on their line."""
    return ndimage.gaussian_filter1d(axis, 1.5, axis=0, mode="nearest") if len(axis) > 4 else axis
