"""Distances between meshes or point clouds, their alignment, and the quality of a mesh."""

from dataclasses import dataclass, replace
from typing import TypeAlias, TypeVar

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from vntoolkit import progress
from vntoolkit.arrays import FloatArray, Points
from vntoolkit.errors import BadMesh, SolverFailed
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.geometry.point_cloud import PointCloud
from vntoolkit.geometry.rays import RayScene
from vntoolkit.geometry.rigid import RigidTransform, Similarity
from vntoolkit.libraries import import_pymeshlab
from vntoolkit.options.evaluation import Alignment, MeasuredBy

_FARTHEST = 1000.0  # times the smaller mesh's size: pymeshlab searches in steps of that, beyond for minutes
_OTHER_SCALE = 10.0  # ratio of sizes from which two surfaces are hardly in one unit
_POINTS_A_STEP = 1 << 14  # between two reports of progress
_FEWEST_VERTICES = 20
_PAIRED = 20_000  # vertices that are paired
_KEPT_SHARE = 0.95  # of the nearest pairs; the others have no counterpart
_MOST_ROUNDS = 60  # of the alignment
Compared: TypeAlias = Mesh | PointCloud
S = TypeVar("S", Mesh, PointCloud)


@dataclass(frozen=True, kw_only=True)
class OneWayDistance:
    """Distances from the vertices of one surface to the nearest point of another, in its length unit."""

    mean: float
    root_mean_square: float
    largest: float
    samples: int


@dataclass(frozen=True, kw_only=True)
class MeshDistance:
    """Distances both ways.

    diagonal: of the reference's bounding box. mean: the larger of the two mean distances, the value to
    quote. hausdorff: the larger of the two largest distances. *_percent: of the diagonal.
    """

    to_reference: OneWayDistance
    from_reference: OneWayDistance
    diagonal: float

    @classmethod
    def from_vertices(cls, to: FloatArray, back: FloatArray, diagonal: float) -> "MeshDistance":
        """Summarise the distances of all vertices to the reference, (n,), and of all its own back, (m,)."""
        ways = (
            OneWayDistance(
                mean=float(way.mean()),
                root_mean_square=float(np.sqrt(np.mean(way**2))),
                largest=float(way.max()),
                samples=len(way),
            )
            for way in (to, back)
        )
        return cls(to_reference=next(ways), from_reference=next(ways), diagonal=diagonal)

    @property
    def mean(self) -> float:
        """The larger mean of the two ways."""
        return max(self.to_reference.mean, self.from_reference.mean)

    @property
    def hausdorff(self) -> float:
        """The larger maximum of the two ways."""
        return max(self.to_reference.largest, self.from_reference.largest)

    @property
    def mean_percent(self) -> float:
        """`mean` in percent of the reference's diagonal."""
        return 100.0 * self.mean / self.diagonal

    @property
    def hausdorff_percent(self) -> float:
        """`hausdorff` in percent of the reference's diagonal."""
        return 100.0 * self.hausdorff / self.diagonal


def mesh_distance(mesh: Compared, reference: Compared) -> MeshDistance:
    """Measure two surfaces in one frame; raises as `vertex_distances`."""
    to_reference, from_reference = vertex_distances(mesh, reference), vertex_distances(reference, mesh)
    return MeshDistance.from_vertices(to_reference, from_reference, reference.diagonal)


def vertex_distances(mesh: Compared, reference: Compared, by: MeasuredBy = MeasuredBy.EMBREE) -> FloatArray:
    """Return (n,) float64, from every vertex to the nearest point of the reference's faces, or of its points.

    The largest both ways is the Hausdorff distance. Raises `BadMesh` where one is empty or the reference has
    no size, and what pymeshlab would search for minutes.
    """
    for name, each in (("mesh", mesh), ("reference mesh", reference)):
        if not len(positions(each)) or (isinstance(each, Mesh) and not len(each.faces)):
            raise BadMesh(f"{name}: no triangle, so there is no surface to measure the distance to")
    if not reference.diagonal > 0:
        raise BadMesh("reference mesh: all its vertices lie in one point")
    points = np.asarray(positions(mesh), dtype=np.float64)
    if by is MeasuredBy.PYMESHLAB:
        return _distances_by_pymeshlab(mesh, reference)
    # float32, which Embree takes, has the most digits about the reference's centre
    centre = np.asarray(positions(reference), dtype=np.float64).mean(axis=0)
    if isinstance(reference, Mesh):
        scene = RayScene((reference.vertices - centre, reference.faces))
    else:
        tree = cKDTree(reference.points)
    progress.begin("vertices", len(points))
    distances = np.empty(len(points))
    for start in range(0, len(points), _POINTS_A_STEP):
        some = points[start : start + _POINTS_A_STEP]
        found = scene.distances(some - centre) if isinstance(reference, Mesh) else tree.query(some)[0]
        distances[start : start + len(some)] = found
        progress.step(len(some))
    return distances


def _distances_by_pymeshlab(mesh: Compared, reference: Compared) -> FloatArray:
    if isinstance(reference, PointCloud):
        raise BadMesh("pymeshlab measures distances to faces, and the reference has none: measure by embree")
    corners = np.stack([pick(positions(m), axis=0) for m in (mesh, reference) for pick in (np.min, np.max)])
    reach = float(np.linalg.norm(np.ptp(corners, axis=0)))
    if reach > _FARTHEST * min(mesh.diagonal, reference.diagonal):
        raise BadMesh(f"{mismatch(mesh, reference)}: pymeshlab would search for minutes; measure by embree")
    pymeshlab = import_pymeshlab()
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(mesh.to_pymeshlab())
    meshes.add_mesh(reference.to_pymeshlab())
    meshes.compute_scalar_by_distance_from_another_mesh_per_vertex(
        measuremesh=0, refmesh=1, signeddist=False, maxdist=pymeshlab.PureValue(float("inf"))
    )
    return np.abs(np.array(meshes.mesh(0).vertex_scalar_array()))


def positions(surface: Compared) -> Points:
    """Return the (n, 3) vertices of a mesh or points of a cloud."""
    return surface.vertices if isinstance(surface, Mesh) else surface.points


def mismatch(mesh: Compared, reference: Compared) -> str:
    """Return why two surfaces seem to differ in frame or unit; empty if they do not."""
    sizes = (mesh.diagonal, reference.diagonal)
    low, high = (
        np.stack([pick(positions(m), axis=0) for m in (mesh, reference)]) for pick in (np.min, np.max)
    )
    gap = float(np.linalg.norm(np.maximum(low.max(axis=0) - high.min(axis=0), 0.0)))
    if max(sizes) <= _OTHER_SCALE * min(sizes) and gap <= max(sizes):
        return ""
    return (
        f"one is {sizes[0]:.3g} across, the reference {sizes[1]:.3g}, and {gap:.3g} lies between them: "
        "are they in one frame and one unit?"
    )


def align_mesh(
    mesh: S, reference: Compared, rng: np.random.Generator, align: Alignment
) -> tuple[S, Similarity]:
    """Align a surface to the reference by iterated closest points; they must lie near each other.

    Raises `BadMesh` for too few vertices, for a reference without normals, and where the two are far apart or
    of other sizes; `SolverFailed` where the surfaces leave the motion undetermined.
    """
    motion = Similarity(scale=1.0, rigid=RigidTransform())
    if align is Alignment.NONE:
        return mesh, motion
    for name, each in (("mesh", mesh), ("reference mesh", reference)):
        if len(positions(each)) < _FEWEST_VERTICES:
            raise BadMesh(f"{name}: {len(positions(each))} vertices are too few to align by")
    targets = np.asarray(positions(reference), dtype=np.float64)
    vertices = np.asarray(positions(mesh), dtype=np.float64)
    faces = reference.faces if isinstance(reference, Mesh) else np.zeros((0, 3), np.int32)
    normals = vertex_normals(targets, faces) if len(faces) else reference.normals
    if normals is None:
        raise BadMesh("reference mesh: has neither faces nor normals, so there is no surface to align to")
    if np.ptp(vertices, axis=0).any() and (why := mismatch(mesh, reference)):
        raise BadMesh(f"align: {why}")
    tree = cKDTree(targets)
    sampled = vertices[rng.permutation(len(vertices))[:_PAIRED]]
    last = np.inf
    for _ in range(_MOST_ROUNDS):
        moved = motion.apply(sampled)
        distances, nearest = tree.query(moved)
        kept = distances <= np.quantile(distances, _KEPT_SHARE)
        step = _step(moved[kept], targets[nearest[kept]], normals[nearest[kept]], align)
        rigid = RigidTransform(
            rotation=step.rigid.rotation @ motion.rigid.rotation,
            translation=step.apply(motion.rigid.translation),
        )
        motion = Similarity(scale=step.scale * motion.scale, rigid=rigid)
        cost = float(distances[kept].mean())
        if abs(last - cost) <= 1e-7 * cost:
            break
        last = cost
    moved = motion.apply(vertices)
    if isinstance(mesh, Mesh):
        return mesh.with_vertices(moved), motion
    turned = None if mesh.normals is None else motion.rigid.rotate(mesh.normals)
    return replace(mesh, points=moved, normals=turned), motion


def _step(points: Points, targets: Points, normals: Points, free: Alignment) -> Similarity:
    """Small motion about the points' centre that takes them to the tangent planes of their targets."""
    centre = points.mean(axis=0)
    from_centre = points - centre
    size = float(np.sqrt((from_centre**2).sum(axis=1).mean()))
    if not size > 0:
        raise SolverFailed("align: all vertices of the mesh lie in one point")
    rows = np.column_stack([np.cross(from_centre / size, normals), normals])
    if free is Alignment.SIMILARITY:
        rows = np.column_stack([rows, ((from_centre / size) * normals).sum(axis=1)])
    values = ((targets - points) * normals).sum(axis=1)
    solution, _, rank, _ = np.linalg.lstsq(rows, values, rcond=1e-9)
    if rank < rows.shape[1] or not np.isfinite(solution).all():
        raise SolverFailed("align: the surfaces slide on each other (flat, or surfaces of revolution)")
    rotation = Rotation.from_rotvec(solution[:3] / size).as_matrix()
    scale = 1.0 + (float(solution[6]) / size if free is Alignment.SIMILARITY else 0.0)
    translation = centre + solution[3:6] - scale * rotation @ centre
    return Similarity(scale=scale, rigid=RigidTransform(rotation=rotation, translation=translation))


@dataclass(frozen=True, kw_only=True)
class MeshQuality:
    """Quality of a mesh: counts of faults, and shapes of triangles.

    median_aspect, worst_aspect: longest edge over twice √3 times the inscribed circle's radius: 1 for an
    equilateral triangle, infinite for a degenerate one. pieces: connected components. holes: boundary loops,
    None where edges of more than two triangles leave them undefined.
    """

    vertices: int
    faces: int
    pieces: int
    holes: int | None
    boundary_edges: int
    non_manifold_edges: int
    non_manifold_vertices: int
    isolated_vertices: int
    self_intersecting_faces: int
    median_aspect: float
    worst_aspect: float


def mesh_quality(mesh: Mesh) -> MeshQuality:
    """Measure a mesh; raises `BadMesh` where it has no triangle."""
    if not len(mesh.faces):
        raise BadMesh("mesh: no triangle to judge")
    meshes = import_pymeshlab().MeshSet(verbose=False)
    meshes.add_mesh(mesh.to_pymeshlab())
    topology = meshes.get_topological_measures()
    meshes.compute_selection_by_self_intersections_per_face()
    aspect = triangle_aspects(mesh)
    return MeshQuality(
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        pieces=topology["connected_components_number"],
        holes=None if topology["non_two_manifold_edges"] else topology["number_holes"],
        boundary_edges=topology["boundary_edges"],
        non_manifold_edges=topology["non_two_manifold_edges"],
        non_manifold_vertices=topology["non_two_manifold_vertices"],
        isolated_vertices=topology["unreferenced_vertices"],
        self_intersecting_faces=meshes.current_mesh().selected_face_number(),
        median_aspect=float(np.median(aspect)),
        worst_aspect=float(aspect.max()),
    )


def triangle_aspects(mesh: Mesh) -> FloatArray:
    """Return (m,) longest edge / (2√3 · inradius) of each triangle."""
    corners = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]
    edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    double_area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    perimeter, longest = edges.sum(axis=1), edges.max(axis=1)
    infinite = np.full(len(edges), np.inf)
    return np.divide(
        longest * perimeter, 2.0 * np.sqrt(3.0) * double_area, out=infinite, where=double_area > 0
    )
