"""Integration of the normal maps of one camera to depth maps, frame after frame."""

import logging
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy import ndimage

from vntoolkit.arrays import Array, Float32Array, Float64Array, Mask, Normals, Weight
from vntoolkit.checks import checks_kinds, require_finite, require_same_size, require_some, sum_is_finite
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import HALF_WEIGHT_DEG, DepthMap, LengthUnit, NormalMap
from vntoolkit.integration.cast_shadows import DepthSteps, with_steps
from vntoolkit.integration.discontinuity import (
    JumpSolver,
    SlopeErrors,
    are_explained,
    deviation_of,
    inverse_of,
    normalised_residuals,
)
from vntoolkit.integration.edges import Components, EdgeField, edges_from_slopes
from vntoolkit.integration.expected_error import depth_deviations
from vntoolkit.integration.poisson import CosineSolver, FourierSolver, MaskedSolver, RectangleSolver
from vntoolkit.integration.prior import DepthPrior
from vntoolkit.integration.slopes import RayField, rays_from_camera, slopes_from_normals
from vntoolkit.native import njit
from vntoolkit.options.depth import IntegrationOptions, Integrator

_logger = logging.getLogger(__name__)
_RECTANGLE = (Integrator.COSINE, Integrator.FOURIER)
_LEAST_TRUST = np.float32(1e-4)  # of a pixel in the domain: with none, what lies beyond it would float
_LEAST_WEIGHT = 0.02  # confidence of a pixel that is left out
_LEAST_SIZE = 5  # pixels that the one-sided stencils need
_FEWEST_PIXELS = 64
_VOTES = 20_000  # pixels that the median is taken over, evenly spread
_NOTICED = 2.0  # standard deviations of the depth that cutting has to change somewhere
_SMALLEST_SHARE = 0.02  # of a part's pixels that the reference must cover


class DepthIntegrator:
    """Integrates the normal maps of one camera; keeps the operator and the last depth between frames.

    Depth from normals lacks one constant per connected component of the domain (pixels that share a side):
    orthographic depth is shifted to mean 0 over each component, perspective depth is scaled to mean 1
    over each (`LengthUnit.FREE`): components are **not** placed relative to each other. The domain is the
    mask without the pixels whose confidence is below 0.02, and without normals that turn
    away from the camera or have no length, whose number is logged.

    Confidence beyond that threshold weighs the equations of POISSON and DISCONTINUITY. COSINE and FOURIER
    cannot weigh, nor leave pixels out: they refuse a domain that is not the full rectangle.

    may_jump: False for one sheet, such as a gel's: DISCONTINUITY then stays at least squares.
    """

    @checks_kinds
    def __init__(
        self, camera: Camera, options: IntegrationOptions | None = None, *, may_jump: bool = True
    ) -> None:
        self._camera, self._may_jump = camera, may_jump
        self._options = options or IntegrationOptions()
        self._rays = rays_from_camera(camera)
        self._rectangle: RectangleSolver | None = None
        self._domain: DomainSolver | None = None
        self.parts: Components | None = None  # of the map integrated last, where they had to be found

    @checks_kinds
    def integrate(
        self, normal_map: NormalMap, steps: DepthSteps | None = None, prior: DepthPrior | None = None
    ) -> DepthMap:
        """Return the depth of `normal_map` (h, w), in the camera frame.

        steps: what is known of steps of depth between neighbours. prior: depth that is known beside the
        normals, which fixes offset and scale. COSINE and FOURIER cannot use them.

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
        choice, full = self._options.integrator, bool(domain.all())
        self._require_domain(domain)
        if prior is not None:
            if choice in _RECTANGLE:
                raise BadInput(f"the {choice.value} integrator takes no prior: use poisson or discontinuity")
            require_same_size(prior.mask, "prior depth", domain, "normals")
            require_some(prior.mask & domain, "prior depth where normals are valid")
        plain = steps is None and prior is None
        if choice in _RECTANGLE or (choice is Integrator.DISCONTINUITY and full and plain):
            self.parts = None
            p, q = slopes_from_normals(normal_map.normals_in_camera, self._rays)
            solution = self._solve_rectangle(p, q)
            if (
                choice in _RECTANGLE
                or not self._may_jump
                or slope_errors(normal_map, p, q, self._rays).explain(solution * self._rays.pixels_per_unit)
            ):
                return self._finish(solution, domain)
        return self._integrate_domain(normal_map, domain, steps, prior)

    def _integrate_domain(
        self, normal_map: NormalMap, domain: Mask, steps: DepthSteps | None, prior: DepthPrior | None
    ) -> DepthMap:
        normals = normal_map.normals_in_camera
        if not sum_is_finite(normals):  # a pixel outside the domain may be anything
            require_finite(normals[domain], "normals to integrate")
        if self._domain is None or not np.array_equal(domain, self._domain.domain):
            self._domain = DomainSolver(domain, self._rays)
        self.parts = self._domain.components
        poisson = self._options.integrator is Integrator.POISSON or not self._may_jump
        solve = self._domain.poisson if poisson else self._domain.discontinuity
        solution = solve(normal_map, steps)
        if prior is None:
            return self._finish(solution, domain, self._domain.components)
        solution = self._domain.fused(normal_map, steps, prior, solution)
        if self._camera.is_perspective:
            depth = np.where(domain, np.exp(solution), 0.0)
            return DepthMap(depth=depth, mask=domain, unit=LengthUnit.METRE)
        return self._finish(solution, domain, self._domain.components)

    def _domain_of(self, normal_map: NormalMap) -> Mask:
        domain = normal_map.mask
        if normal_map.weight is not None:
            domain = domain & (normal_map.weight >= _LEAST_WEIGHT)
        unseen = domain & self._unseen(normal_map.normals_in_camera)
        if unseen.any():
            _logger.warning(
                "%d of %d normals turn away from the camera or have no length: no camera measures these, so "
                "they are left out of the depth", np.count_nonzero(unseen), np.count_nonzero(domain),
            )  # fmt: skip
            domain = domain & ~unseen
        require_some(domain, "normals to integrate")
        return domain

    def _unseen(self, normals: Normals) -> Mask:
        """Return where a surface would be seen from behind, or not at all: n_z >= 0, and n·ray >= 0 too."""
        behind: Mask = normals[..., 2] >= 0
        if behind.any() and self._camera.is_perspective:
            rays = self._camera.unproject(
                np.argwhere(behind)[:, ::-1].astype(np.float64), np.ones(np.count_nonzero(behind))
            )
            behind[behind] = (normals[behind] * rays).sum(axis=1) >= 0
        return behind

    def _require_domain(self, domain: Mask) -> None:
        if self._options.integrator in _RECTANGLE and not domain.all():
            raise BadInput(
                f"the {self._options.integrator.value} integrator needs every pixel of the rectangle, "
                f"{np.count_nonzero(~domain)} are masked or doubtful: use poisson or discontinuity"
            )

    def _solve_rectangle(self, p: Float32Array, q: Float32Array) -> Array:
        if self._rectangle is None:
            fourier = self._options.integrator is Integrator.FOURIER
            self._rectangle = (FourierSolver if fourier else CosineSolver)(p.shape[0], p.shape[1])
        solution = self._rectangle.solve(divergence_from_slopes(p, q))
        if not np.isfinite(solution[0, 0]):  # every pixel of a transform holds a little of every other
            raise BadInput("normals to integrate: some are NaN or infinite; leave them out of the mask")
        return solution

    def _finish(self, solution: Array, domain: Mask, components: Components | None = None) -> DepthMap:
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


class DomainSolver:
    """Solvers inside one domain, (h, w) bool; each keeps its operator and starts from the depth before.

    Solutions are depth (orthographic) or log depth (perspective), (h, w) float64, of mean 0 over each
    connected component and 0 outside.
    """

    def __init__(self, domain: Mask, rays: RayField) -> None:
        self.domain = domain
        self.components = Components(domain)
        self.iterations = 0
        self._rays = rays
        self._last: Float64Array | None = None
        self._jumps: JumpSolver | None = None  # of the last solution, where edges were cut

    @cached_property
    def _masked(self) -> MaskedSolver:
        return MaskedSolver(self.domain[self.components.box])

    @cached_property
    def _near(self) -> RayField:
        return self._rays.cropped(*self.components.box)

    def poisson(self, normal_map: NormalMap, steps: DepthSteps | None = None) -> Float64Array:
        """Least squares over all edges of the domain.

        Conjugate gradients: the cosine transform is the preconditioner without weights, multigrid with them.
        """
        p, q = self._slopes(normal_map)
        self._jumps = None
        return self.components.remove_means(self._least_squares(p, q, self._weight(normal_map), steps))

    def discontinuity(self, normal_map: NormalMap, steps: DepthSteps | None = None) -> Float64Array:
        """Least squares; where the errors of the normals do not explain its residuals, with edges cut.

        What cutting changes less than the stated errors of the normals may bend the depth is left as it is.
        """
        box, scale = self.components.box, self._rays.pixels_per_unit
        p, q = self._slopes(normal_map)
        self._jumps = None
        errors = slope_errors(normal_map, p, q, self._rays, self.domain, box, steps)
        edges = edges_from_slopes(p, q, self.domain[box])
        trusted = errors.error_deg is not None or errors.steps is not None
        if errors.steps is not None:
            edges = replace(edges, difference=edges.difference + errors.steps / np.float32(scale))
        if trusted:
            edges = replace(edges, weight=inverse_of(errors.variance))
        smooth = self._solve(edges, weighted=trusted)
        wanted = edges.difference * np.float32(scale)
        if are_explained(normalised_residuals(smooth * scale, wanted, errors.variance)):
            return self.components.remove_means(smooth)
        jumps = JumpSolver(self._masked, errors)
        if normal_map.error_deg is not None:
            change = self.components.remove_means(jumps.cut_once(smooth * scale) / scale - smooth)
            if np.all(np.abs(change) <= _NOTICED * depth_deviations(normal_map, self.domain, self._rays)):
                return self.components.remove_means(smooth)
        if trusted:  # with the weights of errors, parts that hang on grazing normals may lie far off
            smooth = self._least_squares(p, q, self._weight(normal_map), steps)
        self._jumps = jumps
        return self.components.remove_means(jumps.solve(smooth * scale) / scale)

    def fused(
        self, normal_map: NormalMap, steps: DepthSteps | None, prior: DepthPrior, solution: Float64Array
    ) -> Float64Array:
        """Return (h, w), the least squares of edges and prior, each as exact as its errors are small.

        solution: of the normals alone; what it cut stays cut. The errors of slopes are no smaller than its
        residuals say. A component without prior keeps its form, at the mean of the others.
        """
        box, scale = self.components.box, self._rays.pixels_per_unit
        p, q = self._slopes(normal_map)
        errors, own = (
            slope_errors(normal_map, p, q, self._rays, self.domain, box, steps),
            solution[box] * scale,
        )
        if self._jumps is None:
            difference = edges_from_slopes(p, q, self.domain[box]).difference * np.float32(scale)
            difference += 0.0 if errors.steps is None else errors.steps
            weight, far = inverse_of(errors.variance), None
        else:
            difference, weight, far = self._jumps.difference, self._jumps.held, self._jumps.held_far
        off = max(deviation_of(normalised_residuals(own, difference, errors.variance)), 1.0)
        unit = off**2 * float(errors.variance[errors.variance > 0].min())  # variance of the weight 1
        values, information = prior.measurements(scale, self._rays.depth_scales_ray > 0)
        value, known_weight = values[box], np.where(self.domain[box], information[box], 0.0) * unit
        field = EdgeField(difference=np.asarray(difference, np.float32), weight=weight)
        start = self.components.moved_to(own, value, known_weight)
        found = self._masked.solve(field, start, weighted=True, known=(value, known_weight), far=far)
        out = np.zeros_like(solution)
        out[box] = np.where(self.domain[box], found, 0.0) / scale
        return out

    def _slopes(self, normal_map: NormalMap) -> tuple[Float32Array, Float32Array]:
        normals = normal_map.normals_in_camera[self.components.box]
        return slopes_from_normals(normals, self._near)

    def _weight(self, normal_map: NormalMap) -> Weight | None:
        weight = normal_map.weight
        return None if weight is None else np.maximum(weight[self.components.box], _LEAST_TRUST)

    def _least_squares(
        self, p: Float32Array, q: Float32Array, weight: Weight | None, steps: DepthSteps | None
    ) -> Float64Array:
        """Return the solution in the box; the next one starts from it."""
        box = self.components.box
        edges = edges_from_slopes(p, q, self.domain[box], weight)
        if steps is not None:
            known, variances = steps.images(*box)
            edges = with_steps(edges, known / np.float32(self._rays.pixels_per_unit), variances)
        return self._solve(edges, weighted=weight is not None or steps is not None)

    def _solve(self, edges: EdgeField, *, weighted: bool) -> Float64Array:
        self._last = self._masked.solve(edges, self._last, weighted=weighted)
        self.iterations = self._masked.iterations
        return self._last


def slope_errors(
    normal_map: NormalMap,
    p: Float32Array,
    q: Float32Array,
    rays: RayField,
    domain: Mask | None = None,
    box: tuple[slice, slice] = np.s_[:, :],
    steps: DepthSteps | None = None,
) -> SlopeErrors:
    """Return what tells of jumps in a window: slopes p, q (h, w), and the errors that the map states.

    A confidence without an error states one, too (`HALF_WEIGHT_DEG`).
    """
    error, scale = normal_map.error_deg, np.float32(rays.pixels_per_unit)
    if error is None and normal_map.weight is not None:
        error = HALF_WEIGHT_DEG * np.sqrt(1.0 / np.maximum(normal_map.weight, _LEAST_TRUST) - 1.0)
    known, variances = (None, None) if steps is None else steps.images(*box)
    inside = normal_map.mask if domain is None else domain
    return SlopeErrors(
        p=p * scale,
        q=q * scale,
        inside=np.ascontiguousarray(inside[box]),
        error_deg=None if error is None else np.ascontiguousarray(error[box], dtype=np.float32),
        steps=known,
        of_steps=variances,
        far=None if steps is None else steps.far.within(inside, *box),
    )


def divergence_from_slopes(p: Float32Array, q: Float32Array) -> Float32Array:
    """Divergence (h, w) float32 of the wanted differences, from slopes per pixel along u (p) and v (q).

    Sums to zero: the border is the natural one of least squares, not a slope of zero.
    """
    require_same_size(p, "slopes along u", q, "slopes along v")
    if min(p.shape) < _LEAST_SIZE:
        raise BadInput(f"slopes: expected at least {_LEAST_SIZE}×{_LEAST_SIZE} pixels, got {p.shape[::-1]}")
    p = np.ascontiguousarray(p, dtype=np.float32)
    q = np.ascontiguousarray(q, dtype=np.float32)
    divergence = np.empty(p.shape, dtype=np.float32)
    _divergence(p, q, divergence)
    return divergence


@njit
def _divergence(p, q, out):  # type: ignore[no-untyped-def]
    height, width = p.shape
    k = np.float32(1.0 / 24.0)
    c14, c9, c19, c13, c5 = (
        np.float32(14.0), np.float32(9.0), np.float32(19.0), np.float32(13.0), np.float32(5.0),
    )  # fmt: skip
    for v in range(height):
        row = p[v]
        to = out[v]
        inner, before, after, after2 = to[2:], row[1:], row[3:], row[4:]
        for u in range(width - 4):  # u - 2 as an index, which may be negative, would keep it from vectors
            inner[u] = (row[u] - after2[u] + c14 * (after[u] - before[u])) * k
        first = (c9 * row[0] + c19 * row[1] - c5 * row[2] + row[3]) * k
        second = (c13 * (row[1] + row[2]) - row[0] - row[3]) * k
        to[0] = first
        to[1] = second - first
        n = width - 1
        first = (c9 * row[n] + c19 * row[n - 1] - c5 * row[n - 2] + row[n - 3]) * k
        second = (c13 * (row[n - 1] + row[n - 2]) - row[n] - row[n - 3]) * k
        to[n] = -first
        to[n - 1] = first - second
        if 2 <= v < height - 2:
            above2, above, below, below2 = q[v - 2], q[v - 1], q[v + 1], q[v + 2]
            for u in range(width):
                to[u] += (above2[u] - below2[u] + c14 * (below[u] - above[u])) * k
    n = height - 1
    for u in range(width):
        first = (c9 * q[0, u] + c19 * q[1, u] - c5 * q[2, u] + q[3, u]) * k
        second = (c13 * (q[1, u] + q[2, u]) - q[0, u] - q[3, u]) * k
        out[0, u] += first
        out[1, u] += second - first
        first = (c9 * q[n, u] + c19 * q[n - 1, u] - c5 * q[n - 2, u] + q[n - 3, u]) * k
        second = (c13 * (q[n - 1, u] + q[n - 2, u]) - q[n, u] - q[n - 3, u]) * k
        out[n, u] -= first
        out[n - 1, u] += first - second


class DepthAnchor:
    """Ties depth maps to a reference; parts that the reference does not cover stay as they are."""

    def __init__(self, reference: DepthMap) -> None:
        self._reference = reference

    def align(self, depth_map: DepthMap, parts: Components | None = None) -> DepthMap:
        """Return `depth_map` with the reference's offset (`FREE` depth: its scale).

        parts: of its mask, where they are known.
        """
        depth, mask = np.array(depth_map.depth), depth_map.mask
        if not mask.all():
            parts = parts or Components(mask)
            if parts.count > 1:
                labels = parts.labels
                for label, box in enumerate(ndimage.find_objects(labels), start=1):
                    self._align_part(depth[box], labels[box] == label, box, depth_map.unit)
                return replace(depth_map, depth=depth)
        self._align_part(depth, mask, np.s_[:, :], depth_map.unit)
        return replace(depth_map, depth=depth)

    def _align_part(self, depth: Array, part: Mask, box: tuple[slice, slice], unit: LengthUnit) -> None:
        """Shift or scale `depth`, the view of one part's bounding box, in place where `part` is."""
        common = np.flatnonzero(part & self._reference.mask[box])
        if len(common) < max(_FEWEST_PIXELS, _SMALLEST_SHARE * np.count_nonzero(part)):
            return
        common = common[:: max(1, len(common) // _VOTES)]
        ours = depth.ravel()[common].astype(np.float64)
        wanted = self._reference.depth[box].ravel()[common]
        if unit is LengthUnit.FREE:
            np.multiply(depth, np.median(wanted / ours), out=depth, where=part)
        else:
            np.add(depth, np.median(wanted - ours), out=depth, where=part)
