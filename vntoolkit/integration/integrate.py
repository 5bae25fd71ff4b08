"""The door of this package: normal maps in, depth maps out, one camera, frame after frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Mask
from vntoolkit.checks import require_finite, require_some
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.integration.components import Components
from vntoolkit.integration.divergence import divergence_from_slopes
from vntoolkit.integration.domain import DomainSolver
from vntoolkit.integration.options import IntegrationOptions, Integrator, Precision
from vntoolkit.integration.slopes import Float32Image, rays_from_camera, slopes_from_normals
from vntoolkit.integration.spectral import CosineSolver, FourierSolver, RectangleSolver

_RECTANGLE = (Integrator.COSINE, Integrator.FOURIER)
_LEAST_TRUST = np.float32(1e-4)  # of a pixel in the domain: with none, what lies beyond it would float


class DepthIntegrator:
    """Integrates the normal maps of one camera; keeps the operator and the last depth between frames.

    Depth from normals lacks one constant per connected component of the domain (pixels that share a side):
    orthographic depth is shifted to mean 0 over each component, perspective depth is scaled to mean 1
    over each (`LengthUnit.FREE`): components are **not** placed relative to each other. The domain is the
    mask without the pixels whose confidence is below `options.least_weight`.

    Confidence beyond that threshold weighs the equations of POISSON and DISCONTINUITY. COSINE and FOURIER
    cannot weigh, nor leave pixels out: they refuse a domain that is not the full rectangle.
    """

    def __init__(self, camera: Camera, options: IntegrationOptions | None = None) -> None:
        self._camera = camera
        self._options = options or IntegrationOptions()
        self._rays = rays_from_camera(camera)
        self._rectangle: dict[Integrator, RectangleSolver] = {}
        self._domain: DomainSolver | None = None

    def integrate(self, normal_map: NormalMap) -> DepthMap:
        """Return the depth of `normal_map` (h, w), in the camera frame.

        Lengths are in pixels for an orthographic camera of scale 1, in its length unit for another scale,
        and free (mean 1) for a perspective camera. Raises `BadInput` where the size is not the camera's,
        nothing is valid, a normal is not finite, or the integrator cannot take the domain; `SolverFailed`
        where iterations run out.
        """
        wanted = (self._camera.height, self._camera.width)
        if normal_map.shape != wanted:
            have = f"{normal_map.shape[1]}×{normal_map.shape[0]}"
            raise BadInput(f"normals are {have} but the camera is {wanted[1]}×{wanted[0]}")
        domain = self._domain_of(normal_map)
        choice = self._choice(domain)
        if choice in _RECTANGLE:
            p, q = slopes_from_normals(
                normal_map.normals_in_camera, self._rays, self._options.steepest_slope_deg
            )
            return self._finish(self._solve_rectangle(p, q, choice), domain)
        return self._integrate_domain(normal_map, domain, choice)

    def _integrate_domain(self, normal_map: NormalMap, domain: Mask, choice: Integrator) -> DepthMap:
        normals, weight = normal_map.normals_in_camera, normal_map.weight
        if not np.isfinite(normals.sum()):  # a pixel outside the domain may be anything
            require_finite(normals[domain], "normals to integrate")
        if weight is not None:
            weight = np.maximum(weight, _LEAST_TRUST)
        if self._domain is None or not np.array_equal(domain, self._domain.domain):
            self._domain = DomainSolver(domain, self._rays, self._options)
        solve = self._domain.poisson if choice is Integrator.POISSON else self._domain.discontinuity
        return self._finish(solve(normals, weight), domain, self._domain.components)

    def _domain_of(self, normal_map: NormalMap) -> Mask:
        domain = normal_map.mask
        if normal_map.weight is not None:
            domain = domain & (normal_map.weight >= self._options.least_weight)
        require_some(domain, "normals to integrate")
        return domain

    def _choice(self, domain: Mask) -> Integrator:
        full = bool(domain.all())
        if self._options.integrator is None:
            return Integrator.COSINE if full else Integrator.POISSON
        if self._options.integrator in _RECTANGLE and not full:
            raise BadInput(
                f"the {self._options.integrator.value} integrator needs every pixel of the rectangle, "
                f"{np.count_nonzero(~domain)} are masked or doubtful: use poisson or discontinuity"
            )
        return self._options.integrator

    def _solve_rectangle(self, p: Float32Image, q: Float32Image, choice: Integrator) -> npt.NDArray[Any]:
        if choice not in self._rectangle:
            solver = CosineSolver if choice is Integrator.COSINE else FourierSolver
            dtype = np.float32 if self._options.precision is Precision.SINGLE else np.float64
            self._rectangle[choice] = solver(p.shape[0], p.shape[1], dtype)
        solution = self._rectangle[choice].solve(divergence_from_slopes(p, q))
        if not np.isfinite(solution[0, 0]):  # every pixel of a transform holds a little of every other
            raise BadInput("normals to integrate: some are NaN or infinite; leave them out of the mask")
        return solution

    def _finish(
        self, solution: npt.NDArray[Any], domain: Mask, components: Components | None = None
    ) -> DepthMap:
        """Fix the free constants: solution is depth or log depth of mean 0 over each component."""
        if not self._camera.is_perspective:
            unit = LengthUnit.PIXEL if self._camera.matrix[0, 0] == 1.0 else LengthUnit.METRE
            return DepthMap(depth=solution, mask=domain, unit=unit)
        depth = np.exp(solution)
        if components is None:
            depth /= depth.mean(dtype=np.float64)
        else:
            depth = components.scale_means(depth)
        return DepthMap(depth=depth, mask=domain, unit=LengthUnit.FREE)
