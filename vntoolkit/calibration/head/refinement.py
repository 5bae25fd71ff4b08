"""The head's shape refined by its own normals, and M fitted again (nehab2005; brostow2011, Section IV).

Stereo knows where the skin is, but not its relief: its windows blur it, and noise ripples it.
Normals know the relief but not the place: their errors add up with distance. Silhouettes know the place,
where the surface turns away from a viewer. The positions sought agree with all three, each as far as its own
error allows. A vertex moves along its normal, by d. Every edge should be at right angles to its mean normal,
and d should be small, or what a contour tells: linear in d.

An error of M, the same in all frames, bends the shape in patterns that are known. M is corrected until the
frames agree on every normal and the normals, integrated, agree with the positions of stereo.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.linalg import null_space
from scipy.sparse.linalg import cg, splu
from scipy.spatial import cKDTree

from vntoolkit.arrays import Array, Faces, FloatArray, IntArray, Points
from vntoolkit.calibration.head import skin as skins
from vntoolkit.calibration.head.light import HeadLight, light_of_response
from vntoolkit.calibration.head.rims import RimTargets, rim_targets
from vntoolkit.calibration.head.samples import HeadSamples, LightFrame
from vntoolkit.calibration.head.shape import FusedShape
from vntoolkit.errors import SolverFailed
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh, edge_cotangents, face_normals, vertex_normals
from vntoolkit.geometry.rays import RayScene
from vntoolkit.options.head import LightOptions
from vntoolkit.photometry.response import LightResponse

_ROUNDS, _PASSES = 6, 2  # colours are taken anew in so many: later, vertices hardly move
_ROBUST_ROUNDS = 6
_FREE = null_space(
    np.append(np.eye(3), np.zeros(3)).reshape(1, -1)
)  # M's scale is open, and is left as it is
_FIRST_ERROR = 0.05  # standard deviation of an entry of E for the first M
_NEARNESS = 0.2  # of lamps that are five of the head's diagonals away
_REGION = 1 / 6  # of the diagonal: stereo errs alike within such cubes
_SETTLED = 0.002  # change of M, as a share, that ends the rounds
_EDGE_PX = 1.6  # mean length of an edge, about: two samples of a relief of a few pixels
_COARSE = 4.0  # edges while M is sought: a relief too fine for them says nothing of M
_MOST_VERTICES = 300_000
# Normals that are off by 1 degree, as a good M leaves them, bend positions by half a pixel over half of
# this wavelength. Stereo's ripples are of a pixel and more, and up to a dozen windows long.
_CROSSOVER_PX, _CROSSOVER_NOISE = 200.0, 0.02
_LARGEST_CROSSOVER = 1.0 / 3.0  # of the mesh's diagonal: M is fitted to what longer waves say
_LOOSE = 2.0  # of the diagonal: where normals are to show their errors, stereo holds only the mesh's place
_PATCH_PX = 16.0  # side: larger than the windows of stereo blur, smaller than a nose
_REGION_PX = 96.0  # side: so large that stereo's ripples average out, smaller than a cheek
_DRAWS, _PATTERNS = 8, 9
_SPACING_PX = 2.0  # of the points of stereo, about
_STRAY = 0.5  # of the way to the next point: so far off may be what is filled in between points
_FLATTENED = 2.0  # slopes of relief as fine as stereo's windows, over what stereo leaves of them
_TINY, _SMALLEST_SINE = 1e-30, 1e-9
_STEPS = 2  # of the positions: more change nothing
_TOLERANCE, _MOST_ITERATIONS = 1e-4, 2000
_LEAST_COTANGENT, _MOST_COTANGENT = 0.05, 5.0
_LEAST_SEEN = 0.5  # of a patch's area, in a frame
_LEAST_PATCH = 0.1  # of its side squared: less is a sliver
_LEAST_NOISE = 0.01  # rad, of a normal: what registration and the mesh's resolution leave
_SHARED_NOISE = 0.03  # rad, of all normals: what errors of M and of poses left on a scanned head
_UNKNOWN_NOISE = 0.2  # rad: of the mesh's own normals, where no light shows the skin's
_LEAST_AGREEMENT = 0.3  # cosine between a measured normal and the surface's: a wrong visibility below it
_MEDIAN_OF_ONE, _MEDIAN_OF_TWO = 0.455, 0.693  # of χ² with so many components, over its mean
_NINE_OF_TEN = 2.146  # standard deviations of a component that hold nine of ten directions


@dataclass(frozen=True, kw_only=True, eq=False)
class RefinedHead:
    """A head whose shape agrees with its normals. mesh: head frame, with normals, colours and `error_deg`.

    light, samples: M fitted to this mesh, and its samples, patches of skin instead of points. changes:
    relative change of M in every round. error_percent: (n,) standard deviation of the positions, % of the
    diagonal.
    """

    mesh: Mesh
    light: HeadLight
    samples: HeadSamples
    changes: tuple[float, ...]
    error_percent: FloatArray


def refine_head(
    shape: FusedShape,
    camera: Camera,
    frames: Callable[[], Iterable[LightFrame]],
    light: HeadLight,
    options: LightOptions,
    rng: np.random.Generator,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> RefinedHead:
    """Alternate normals from colours, positions from normals and stereo, and M; then refine a finer mesh.

    shape: of stereo. frames: reads the frames that normals are taken from, in passes. light: M and what the
    first fit made of the samples.
    """
    depth = float(np.median(next(iter(frames())).camera_from_head.apply(shape.mesh.vertices)[:, 2]))
    pixel = depth / float(camera.matrix[0, 0])
    coarse = _COARSE * _EDGE_PX * pixel
    stereo = thinned(divided(shape.mesh, coarse), coarse)
    crossover = min(_CROSSOVER_PX * pixel, _LARGEST_CROSSOVER * stereo.diagonal)
    lit, surface, seen = skins.SkinLight(response=light.response), stereo, None
    changes: list[float] = []
    for number in range(_ROUNDS):
        if number < _PASSES or seen is None:
            seen = skins.skin_colours(surface, camera, frames())
        colours = skins.without_shadow(seen, surface, lit.response)
        skin = skins.skin_normals(colours, lit)
        before = lit.response
        lit = _corrected(lit, light.response, colours, skin, stereo, _PATCH_PX * pixel)
        solver = PositionSolver(stereo.vertices, stereo.faces, skin, crossover)
        surface = stereo.with_vertices(solver.positions())
        changes.append(_relative_change(before, lit.response))
        on_progress(number + 1, _ROUNDS + 1)
        if changes[-1] < _SETTLED:
            break
    levels = measured_noise(surface, stereo.vertices, skin, pixel)
    spread = solver.spread(surface, levels, rng)
    fine, colours, skin = _refined_finely(shape, surface, camera, frames, lit, levels, crossover, pixel)
    on_progress(_ROUNDS + 1, _ROUNDS + 1)
    samples = patch_samples(fine, camera, colours, skin, _PATCH_PX * pixel)
    return RefinedHead(
        mesh=replace(fine, colours=_skin_colour(skin, lit.response), error_deg=_expected_error_deg(skin)),
        light=light_of_response(samples, lit.response, options),
        samples=samples,
        changes=tuple(changes),
        error_percent=100.0 * spread[cKDTree(surface.vertices).query(fine.vertices)[1]] / fine.diagonal,
    )


def _refined_finely(
    shape: FusedShape,
    surface: Mesh,
    camera: Camera,
    frames: Callable[[], Iterable[LightFrame]],
    lit: skins.SkinLight,
    levels: "NoiseLevels",
    crossover: float,
    pixel: float,
) -> tuple[Mesh, skins.SkinColours, skins.SkinNormals]:
    """Solve a mesh of two edges a pixel and a half, with contours; return it, its colours and normals."""
    stereo = divided(shape.mesh, _EDGE_PX * pixel)
    nearest = RayScene((surface.vertices, surface.faces)).closest(stereo.vertices)
    placed = stereo.with_vertices(nearest)  # stereo's ripples would mix the colours of what lies around
    colours = skins.without_shadow(skins.skin_colours(placed, camera, frames()), placed, lit.response)
    skin = skins.skin_normals(colours, lit)
    solver = PositionSolver(
        stereo.vertices,
        stereo.faces,
        followed_normals(stereo, skin, pixel),
        crossover * _CROSSOVER_NOISE / _LEAST_NOISE,  # errors as they are measured make it shorter
        shared_errors(stereo, skin, pixel),
        stereo_support(stereo.vertices, shape.points, levels, pixel),
    )
    solver.hold(rim_targets(placed, camera, frames(), lit.response), levels.stereo)
    return stereo.with_vertices(solver.positions()), colours, skin


def _corrected(
    light: skins.SkinLight,
    first: LightResponse,
    colours: skins.SkinColours,
    skin: skins.SkinNormals,
    stereo: Mesh,
    side: float,
) -> skins.SkinLight:
    """Return the light whose normals agree best between the frames, and with the positions of stereo.

    An error of M that all frames follow shows only in the shape: wrong normals move positions off stereo's by
    more than its noise, in patterns that are known. Both are linear in the errors; patches of skin count as
    one observation. Slopes of stereo say less: windows flatten what is smaller than them. What no model holds
    errs over whole regions alike, and that tells how sure the errors are: where they are not, M stays near
    the first and lamps stay far.
    """
    response = light.response
    solver = PositionSolver(stereo.vertices, stereo.faces, skin, _LOOSE * stereo.diagonal)
    surface = stereo.with_vertices(solver.positions())
    assert surface.normals is not None
    area = areas(surface.vertices, surface.faces)
    share = np.where(skin.known, np.minimum(area / side**2, 1.0), 0.0)
    cubes = np.floor(surface.vertices / (_REGION * surface.diagonal)).astype(np.int64)
    region = np.unique(cubes, axis=0, return_inverse=True)[1].ravel()
    errors = skins.light_errors(colours, skin, light, share, region)
    patterns = solver.moved_by(-errors.turned, surface) @ _FREE
    moved = ((surface.vertices - solver.stereo) * surface.normals).sum(axis=1)
    systems, rights = _FREE.T @ errors.system @ _FREE, errors.right @ _FREE
    agreement, right = systems.sum(axis=0), rights.sum(axis=0)
    back = np.linalg.solve(response.matrix, first.matrix)
    back = 3.0 * back / np.trace(back) - np.eye(3)
    back = np.append(back.ravel(), -light.nearness)
    spread = np.append(np.full(9, _FIRST_ERROR), np.full(3, _NEARNESS / surface.diagonal))
    near = _FREE.T @ (_FREE / spread[:, None] ** 2)
    back = _FREE.T @ (back / spread**2)
    step = np.zeros(_FREE.shape[1])
    for _ in range(_ROBUST_ROUNDS):
        left = moved + patterns @ step
        noise = 1.4826 * float(np.median(np.abs(left[skin.known])))
        weight = share / (1.0 + np.square(left / (2.0 * noise))) ** 2 / noise**2
        weighted = patterns * weight[:, None]
        system = agreement + patterns.T @ weighted
        step = np.linalg.solve(system + near, right - weighted.T @ moved + back)
    pulls = np.stack([np.bincount(region, column) for column in (weighted * left[:, None]).T], axis=1)
    pulls += systems @ step - rights
    information = system @ np.linalg.solve(agreement + pulls.T @ pulls, system)  # 1 / variance
    step = np.linalg.solve(information + near, information @ step + back)
    entries = _FREE @ step
    matrix = response.matrix @ (np.eye(3) + entries[:9].reshape(3, 3))
    scale = np.linalg.norm(response.matrix) / np.linalg.norm(matrix)
    return skins.SkinLight(
        response=replace(response, matrix=scale * matrix),
        nearness=np.maximum(light.nearness + entries[9:], 0.0),
    )


def _relative_change(first: LightResponse, second: LightResponse) -> float:
    """Change of M as a share, but for its scale, which is the skin's albedo."""
    a, b = first.matrix / np.linalg.norm(first.matrix), second.matrix / np.linalg.norm(second.matrix)
    return float(np.linalg.norm(a - b))


def divided(mesh: Mesh, edge: float) -> Mesh:
    """Divide every triangle in four (loop1987) until edges have this mean length or vertices get too many."""
    while len(mesh.vertices) * 4 < _MOST_VERTICES and 0.7 * _mean_edge(mesh) > edge:
        finer = Mesh.from_open3d(replace(mesh, normals=None, colours=None).to_open3d().subdivide_loop(1))
        mesh = replace(finer, normals=vertex_normals(finer.vertices, finer.faces))
    return mesh


def thinned(mesh: Mesh, edge: float) -> Mesh:
    """Collapse edges (garland1997) until they have about this mean length."""
    share = (_mean_edge(mesh) / edge) ** 2
    if share >= 1.0:
        return mesh
    plain = replace(mesh, normals=None, colours=None).to_open3d()
    thinner = Mesh.from_open3d(plain.simplify_quadric_decimation(int(share * len(mesh.faces))))
    return replace(thinner, normals=vertex_normals(thinner.vertices, thinner.faces))


def _mean_edge(mesh: Mesh) -> float:
    corners = mesh.vertices[mesh.faces]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())


class PositionSolver:
    """Positions that agree with stereo at long wavelengths and with normals at short ones (nehab2005).

    Minimises Σ_ij w_ij (n_ij · (x_j − x_i))² + (2π / λ)² Σ_i a_i |x_i − s_i|². w_ij is the cotangent weight,
    less where normals are noisy, n_ij the mean measured normal of an edge, a_i a vertex's area, s_i its
    position by stereo, and λ the crossover, the wavelength at which both count the same for the surest
    normals. Vertices move along the surface's own normals, which makes the sum quadratic in how far: folds of
    stereo lead nowhere. shared: (3,) standard deviation of errors that neighbours share, for edges along
    each axis: they do not average out, and make the wavelength shorter. support: (n,) how far stereo holds
    each vertex, 0 to 1, a factor of a_i.
    """

    def __init__(
        self,
        stereo: Points,
        faces: Faces,
        skin: skins.SkinNormals,
        crossover: float,
        shared: FloatArray | None = None,
        support: FloatArray | None = None,
    ) -> None:
        self.stereo, self._faces = stereo, faces
        pairs, cosines, sines = edge_cotangents(stereo, faces)
        self._from, self._to = pairs.T
        own = vertex_normals(stereo, faces)
        normals, noise = _normals_and_noise(own, skin)
        cotangents = 0.5 * cosines / np.maximum(sines, _SMALLEST_SINE)
        variance = 0.5 * (noise[self._from] ** 2 + noise[self._to] ** 2)
        if shared is not None:
            along = np.square(stereo[self._to] - stereo[self._from])
            variance += along @ shared**2 / np.maximum(along.sum(axis=1), _TINY)
        self._weight = np.clip(cotangents, _LEAST_COTANGENT, _MOST_COTANGENT) * _LEAST_NOISE**2 / variance
        self._stiffness = (2.0 * np.pi / crossover) ** 2
        self._anchor = self._stiffness * areas(stereo, faces) * (1.0 if support is None else support)
        upright = normals[self._from] + normals[self._to]
        self._upright = upright / np.maximum(np.linalg.norm(upright, axis=1, keepdims=True), _TINY)
        self._own, self._target = own, stereo
        self._move_along(own)

    def hold(self, rims: RimTargets, density: float) -> None:
        """Hold vertices to contours, too. density: of stereo's noise, as `NoiseLevels` has it.

        Stereo holds a vertex by its area over the density, contours by 1 / variance, in the same unit.
        """
        pull = self._stiffness * density * rims.weight
        held = np.maximum(self._anchor + pull, _TINY)[:, None]
        self._target = (self._anchor[:, None] * self.stereo + pull[:, None] * rims.places) / held
        self._anchor = self._anchor + pull
        self._move_along(self._own)

    def positions(self) -> Points:
        """Return (n, 3). A few rounds, as the surface's own normals turn on the way."""
        x, along = np.array(self.stereo), self._own
        for step in range(_STEPS):
            if step:
                along = vertex_normals(x, self._faces)
                self._move_along(along)
            pull = self._anchor * ((x - self._target) * along).sum(axis=1)
            x += self._solved(self._right(self._upright, x) - pull)[:, None] * along
        return x

    def _move_along(self, directions: Points) -> None:
        first, second = ((directions[ends] * self._upright).sum(axis=1) for ends in (self._from, self._to))
        weight, every = self._weight, np.arange(len(directions))
        rows = np.concatenate([self._from, self._to, self._from, self._to, every])
        columns = np.concatenate([self._to, self._from, self._from, self._to, every])
        across = -weight * first * second
        values = np.concatenate([across, across, weight * first**2, weight * second**2, self._anchor])
        self._slopes = first, second
        self._system = sp.csr_array((values, (rows, columns)), shape=(len(every), len(every)))

    def spread(self, surface: Mesh, levels: "NoiseLevels", rng: np.random.Generator) -> FloatArray:
        """Return the standard deviation (n,) of positions, by stereo's noise and shared errors of normals.

        Noise is drawn. Shared errors of unknown pattern turn all normals n by E n, for every entry of E.
        """
        assert surface.normals is not None
        own = np.sqrt(levels.stereo / np.maximum(areas(self.stereo, self._faces), _TINY))
        noise = (self._anchor * own)[:, None] * rng.standard_normal((len(own), _DRAWS))
        variance = np.square(self._solved_for_many(noise)).mean(axis=1)
        normals = surface.normals
        turned = np.einsum("ir,nc->nirc", np.eye(3), normals).reshape(-1, 3, _PATTERNS)
        turned -= normals[:, :, None] * np.einsum("ni,nip->np", normals, turned)[:, None]
        moves = self.moved_by(turned * (levels.shared / np.sqrt(_PATTERNS)), surface)
        return np.sqrt(variance + np.square(moves).sum(axis=1))

    def moved_by(self, turned: FloatArray, surface: Mesh) -> FloatArray:
        """Return the moves along the normals (n, p) where normals turn by (n, 3, p)."""
        rights = [
            self._right(0.5 * (each[self._from] + each[self._to]), surface.vertices)
            for each in np.moveaxis(turned, 2, 0)
        ]
        return self._solved_for_many(np.stack(rights, axis=1))

    def _right(self, normals: Points, vertices: Points) -> FloatArray:
        """Return (n,) what edges between vertices (n, 3) ask of them, to be at right angles to normals."""
        rise = -((vertices[self._to] - vertices[self._from]) * normals).sum(axis=1)
        (first, second), count = self._slopes, len(vertices)
        flow = self._weight * rise
        pushed = np.bincount(self._to, flow * second, count) - np.bincount(self._from, flow * first, count)
        return np.asarray(pushed, float)

    def _solved_for_many(self, rights: FloatArray) -> FloatArray:
        """Solve for every column of (n, k): a factor costs what three loose solutions by iteration do."""
        factor = splu(
            sp.csc_array(self._system),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        return np.asarray(factor.solve(rights))

    def _solved(self, right: FloatArray) -> FloatArray:
        """Solve by conjugate gradients: the anchors bound the condition number by (crossover / edge)²."""
        scale = sp.diags_array(1.0 / self._system.diagonal())
        found, failed = cg(self._system, right, rtol=_TOLERANCE, maxiter=_MOST_ITERATIONS, M=scale)
        if failed:
            raise SolverFailed("refinement: the positions did not converge; leave it out: --head-shape fused")
        return np.asarray(found)


@dataclass(frozen=True, kw_only=True)
class NoiseLevels:
    """How sure stereo and normals are.

    stereo: density of stereo's noise, its variance times the area over which it is the same, length units⁴.
    shared: error in radians that the normals of a region share.
    """

    stereo: float
    shared: float


def measured_noise(mesh: Mesh, stereo: Points, skin: skins.SkinNormals, pixel: float) -> NoiseLevels:
    """Measure both on the refined mesh.

    What patches of skin were moved by is stereo's noise. What the mean of their normals still turns from the
    mesh's is the shared error.
    """
    assert mesh.normals is not None
    area = np.where(np.isfinite(skin.noise), areas(stereo, mesh.faces), 0.0)

    def mean_square(values: FloatArray, side: float) -> float:
        patch, _ = _patches(mesh, side)
        total = np.bincount(patch, area)
        kept = total > _LEAST_SEEN * side**2
        means = [np.bincount(patch, area * column)[kept] / total[kept] for column in values.T]
        return float(np.median(np.square(means).sum(axis=0))) if kept.any() else 0.0

    moved = ((mesh.vertices - stereo) * mesh.normals).sum(axis=1)
    side = _PATCH_PX * pixel
    density = mean_square(moved[:, None], side) / _MEDIAN_OF_ONE * side**2
    shared = mean_square(skin.normals - mesh.normals, 3.0 * side) / _MEDIAN_OF_TWO
    return NoiseLevels(stereo=density, shared=float(np.sqrt(max(shared, _SHARED_NOISE**2))))


def stereo_support(vertices: Points, points: Points, levels: NoiseLevels, pixel: float) -> FloatArray:
    """Return how far stereo holds vertices (n, 3), from 1 at the points (p, 3) that it found towards 0.

    Where it found none, as in the fold behind an ear, the mesh is filled in, and errs by more the farther off
    the next point is. Each vertex counts by its variance.
    """
    gap = cKDTree(points).query(vertices, workers=1)[0]
    stray = _STRAY * np.maximum(gap - _SPACING_PX * pixel, 0.0)
    variance = levels.stereo / (_PATCH_PX * pixel) ** 2
    return np.asarray(variance / np.maximum(variance + stray**2, _TINY))


def followed_normals(stereo: Mesh, skin: skins.SkinNormals, pixel: float) -> skins.SkinNormals:
    """Return the normals to follow: the measured ones, drawn to stereo's of the skin around.

    Each counts as its variance tells. That of stereo's smoothed normals is how far they scatter around:
    little on cheeks and hair, much on an ear. Where normals were measured, what stereo flattens is added.
    """
    assert stereo.normals is not None
    own = stereo.normals
    smooth = _smoothed(own, stereo.faces, 2.0 * (0.5 * _PATCH_PX * pixel / _mean_edge(stereo)) ** 2)
    length = np.linalg.norm(smooth, axis=1)
    scatter = np.clip(0.5 * (1.0 - length**2), _LEAST_NOISE**2, _UNKNOWN_NOISE**2)
    smooth /= np.maximum(length, _TINY)[:, None]
    measured, noise = _normals_and_noise(smooth, skin)
    known = np.isfinite(skin.noise)
    scatter *= np.where(known, _FLATTENED**2, 1.0)
    trust = scatter / (scatter + noise**2)
    normals = smooth + trust[:, None] * (measured - smooth)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), _TINY)
    return replace(skin, normals=normals, noise=np.sqrt(trust) * noise)


def _smoothed(values: FloatArray, faces: Faces, rounds: float) -> FloatArray:
    """Average values (n, 3) with their neighbours', so many times. Each spreads them by half an edge²."""
    count = len(values)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    rows, columns = np.concatenate([ends, ends[:, ::-1]]).T
    near = sp.csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    share = sp.diags_array(1.0 / np.maximum(near.sum(axis=1), 1.0))
    smooth = np.array(values)
    for _ in range(max(1, round(rounds))):
        smooth = share @ (near @ smooth)
    return smooth


def shared_errors(stereo: Mesh, skin: skins.SkinNormals, pixel: float) -> FloatArray:
    """Return the standard deviation (3,) of slopes along each axis, of errors alike over whole patches.

    Stereo tells it. Along the turn's axis it may be several times larger: tint, ambient light and M are told
    there by the lamps' heights alone.
    """
    assert stereo.normals is not None
    side = _REGION_PX * pixel
    area = np.where(skin.known, areas(stereo.vertices, stereo.faces), 0.0)
    patch, _ = _patches(stereo, side)
    total = np.bincount(patch, area)
    kept = total > _LEAST_SEEN * side**2
    if not kept.any():
        return np.full(3, _SHARED_NOISE)
    off, normal = (
        np.stack([np.bincount(patch, area * column)[kept] / total[kept] for column in values.T], axis=1)
        for values in (skin.normals - stereo.normals, stereo.normals)
    )
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    off -= normal * (off * normal).sum(axis=1, keepdims=True)
    across = np.sqrt(np.maximum(1.0 - normal**2, 0.5))  # what of an axis lies in the surface
    slopes = np.abs(off) / across
    facing = [column[steep <= 0.5] for column, steep in zip(slopes.T, normal.T**2, strict=True)]
    return np.array([1.4826 * np.median(each) if each.size else _SHARED_NOISE for each in facing])


def _normals_and_noise(own: Points, skin: skins.SkinNormals) -> tuple[Points, FloatArray]:
    """Return the normals to follow and their noise: measured where they are sure, else the mesh's own."""
    known = np.isfinite(skin.noise) & ((skin.normals * own).sum(axis=1) > _LEAST_AGREEMENT)
    noise = np.where(known, np.maximum(skin.noise, _LEAST_NOISE), _UNKNOWN_NOISE)
    return np.where(known[:, None], skin.normals, own), noise


def areas(vertices: Points, faces: Faces) -> FloatArray:
    """Return a third of the area of the triangles around each vertex, (n,)."""
    third = np.linalg.norm(face_normals(vertices, faces), axis=1) / 6.0
    counted = np.bincount(np.asarray(faces).ravel(), np.repeat(third, 3), minlength=len(vertices))
    return np.asarray(counted, dtype=np.float64)


def patch_samples(
    mesh: Mesh, camera: Camera, colours: skins.SkinColours, skin: skins.SkinNormals, side: float
) -> HeadSamples:
    """Average normals and colours, less albedo, over patches of skin, as samples for the fit of M.

    The mean normal of a patch hangs on its outline alone, so relief that the mesh misses and noise within the
    patch do not shorten slopes and bend M; the mean colour is M times it. side: of a patch, length units.
    """
    assert mesh.normals is not None
    patch, first = _patches(mesh, side)
    area = areas(mesh.vertices, mesh.faces)
    whole = np.bincount(patch, area)
    columns: list[tuple[Array, ...]] = []
    for number, pose in enumerate(colours.camera_from_head):
        weight = np.where(skin.agrees[number], area, 0.0)
        seen = np.bincount(patch, weight)
        kept = np.flatnonzero((seen > _LEAST_SEEN * whole) & (whole > _LEAST_PATCH * side**2))
        place, normal, rgb = (
            np.stack([np.bincount(patch, weight * column)[kept] / seen[kept] for column in values.T], axis=1)
            for values in (mesh.vertices, mesh.normals, colours.rgb[number] / skin.albedo)
        )
        pixel = camera.project(pose.apply(place))
        columns.append((first[kept], np.full(len(kept), number), pose.rotate(normal), rgb, pixel))
    point, frame, normals, rgb, pixel = (np.concatenate(each) for each in zip(*columns, strict=True))
    return HeadSamples(
        point=point,
        frame=frame,
        normals_in_camera=normals,
        rgb=rgb,
        position_px=pixel,
        camera_from_head=colours.camera_from_head,
    )


def _patches(mesh: Mesh, side: float) -> tuple[IntArray, IntArray]:
    """Return the patch of every vertex (n,), of one cube and one side of the head, and a vertex of each."""
    assert mesh.normals is not None
    axis = np.abs(mesh.normals).argmax(axis=1)
    sign = np.take_along_axis(mesh.normals, axis[:, None], axis=1)[:, 0] > 0
    cells = np.column_stack([np.round(mesh.vertices / side).astype(np.int64), 2 * axis + sign])
    _, first, patch = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    return patch.ravel(), first


def _skin_colour(skin: skins.SkinNormals, response: LightResponse) -> FloatArray:
    """Return the skin's colour (n, 3), 0 to 1, under these lamps: albedo times each channel's light."""
    brightness = np.linalg.norm(response.matrix, axis=1)
    colour = skin.albedo * (brightness / brightness.max())
    return np.clip(colour / np.percentile(colour.max(axis=1), 99), 0.0, 1.0).astype(np.float32)


def _expected_error_deg(skin: skins.SkinNormals) -> FloatArray:
    noise = np.where(np.isfinite(skin.noise), np.hypot(skin.noise, _SHARED_NOISE), _UNKNOWN_NOISE)
    return np.rad2deg(_NINE_OF_TEN * noise).astype(np.float32)
