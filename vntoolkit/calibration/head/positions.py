"""Positions of a mesh that agree with stereo, and at short wavelengths with normals (nehab2005)."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import cg

from vntoolkit.arrays import Faces, FloatArray, Points
from vntoolkit.calibration.head.skin import SkinNormals
from vntoolkit.errors import SolverFailed
from vntoolkit.geometry.mesh import Mesh, edge_cotangents, face_normals, factored, vertex_normals

LEAST_NOISE = 0.01  # rad, of a normal: what registration and the mesh's resolution leave
UNKNOWN_NOISE = 0.2  # rad: of the mesh's own normals, where no light shows the skin's
_LEAST_AGREEMENT = 0.3  # cosine between a measured normal and the surface's: a wrong visibility below it
_LEAST_COTANGENT, _MOST_COTANGENT = 0.05, 5.0
_DRAWS = 8  # of the noise
_STEPS = 2  # of the positions: more change nothing
_TOLERANCE, _MOST_ITERATIONS = 1e-4, 2000
_TINY, _SMALLEST_SINE = 1e-30, 1e-9


class PositionSolver:
    """Positions that agree with stereo at long wavelengths and with normals at short ones (nehab2005).

    Minimises Σ_ij w_ij (n_ij · (x_j − x_i))² + (2π / λ)² Σ_i a_i |x_i − s_i|². w_ij is the cotangent weight,
    less where normals are noisy, n_ij the mean measured normal of an edge, a_i a vertex's area, s_i its
    position by stereo, and λ the crossover, the wavelength at which both count the same for the surest
    normals. Vertices move along the surface's own normals, which makes the sum quadratic in how far: folds of
    stereo lead nowhere.
    """

    def __init__(
        self,
        stereo: Points,
        faces: Faces,
        skin: SkinNormals,
        crossover: float,
    ) -> None:
        self.stereo, self._faces = stereo, faces
        pairs, cosines, sines = edge_cotangents(stereo, faces)
        self._from, self._to = pairs.T
        own = vertex_normals(stereo, faces)
        normals, noise = normals_and_noise(own, skin)
        cotangents = 0.5 * cosines / np.maximum(sines, _SMALLEST_SINE)
        variance = 0.5 * (noise[self._from] ** 2 + noise[self._to] ** 2)
        self._weight = np.clip(cotangents, _LEAST_COTANGENT, _MOST_COTANGENT) * LEAST_NOISE**2 / variance
        self._stiffness = (2.0 * np.pi / crossover) ** 2
        self._anchor = self._stiffness * areas(stereo, faces)
        upright = normals[self._from] + normals[self._to]
        self._upright = upright / np.maximum(np.linalg.norm(upright, axis=1, keepdims=True), _TINY)
        self._own, self._target = own, stereo
        self._move_along(own)

    def add_contours(self, places: Points, certainty: FloatArray, density: float) -> None:
        """Let contours tell the places (n, 3) of vertices, too, each by its 1 / variance (n,).

        density: of stereo's noise, as of `measured_noise`; stereo counts by a vertex's area over it.
        """
        weight = self._stiffness * density * certainty
        total = np.maximum(self._anchor + weight, _TINY)[:, None]
        self._target = (self._anchor[:, None] * self.stereo + weight[:, None] * places) / total
        self._anchor = self._anchor + weight
        self._move_along(self._own)

    def positions(self) -> Points:
        """Return (n, 3). A few rounds, as the surface's own normals turn on the way."""
        x, along = np.array(self.stereo), self._own
        for step in range(_STEPS):
            if step:
                along = vertex_normals(x, self._faces)
                self._move_along(along)
            right = self._right(self._upright, x) - self._anchor * ((x - self._target) * along).sum(axis=1)
            x += self._solved(right)[:, None] * along
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

    def spread(self, surface: Mesh, density: float, shared: float, rng: np.random.Generator) -> FloatArray:
        """Return the standard deviation (n,) of positions, by stereo's noise and shared errors of normals.

        density, shared: as of `measured_noise`. Noise is drawn. Shared errors of unknown pattern turn all
        normals n by E n, for every entry of E.
        """
        assert surface.normals is not None
        own = np.sqrt(density / np.maximum(areas(self.stereo, self._faces), _TINY))
        noise = (self._anchor * own)[:, None] * rng.standard_normal((len(own), _DRAWS))
        variance = np.square(self._solved_for_many(noise)).mean(axis=1)
        normals = surface.normals
        turned = np.einsum("ir,nc->nirc", np.eye(3), normals).reshape(-1, 3, 9)
        turned -= normals[:, :, None] * np.einsum("ni,nip->np", normals, turned)[:, None]
        moves = self.moved_by(turned * (shared / np.sqrt(9)), surface)
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
        return np.asarray(factored(self._system).solve(rights))

    def _solved(self, right: FloatArray) -> FloatArray:
        """Solve by conjugate gradients: the anchors bound the condition number by (crossover / edge)²."""
        scale = sp.diags_array(1.0 / self._system.diagonal())
        found, failed = cg(self._system, right, rtol=_TOLERANCE, maxiter=_MOST_ITERATIONS, M=scale)
        if failed:
            raise SolverFailed("refinement: the positions did not converge; leave it out: --head-shape fused")
        return np.asarray(found)


def normals_and_noise(own: Points, skin: SkinNormals) -> tuple[Points, FloatArray]:
    """Return the normals to follow and their noise: measured where they are sure, else the mesh's own."""
    known = np.isfinite(skin.noise) & ((skin.normals * own).sum(axis=1) > _LEAST_AGREEMENT)
    noise = np.where(known, np.maximum(skin.noise, LEAST_NOISE), UNKNOWN_NOISE)
    return np.where(known[:, None], skin.normals, own), noise


def areas(vertices: Points, faces: Faces) -> FloatArray:
    """Return a third of the area of the triangles around each vertex, (n,)."""
    third = np.linalg.norm(face_normals(vertices, faces), axis=1) / 6.0
    counted = np.bincount(np.asarray(faces).ravel(), np.repeat(third, 3), minlength=len(vertices))
    return np.asarray(counted, dtype=np.float64)
