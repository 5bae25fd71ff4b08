"""A response that varies over the image, fitted to normals and colours at known pixels.

Near lights change M from pixel to pixel. Its entries are polynomials of the position; their coefficients
minimise the angle between given and recovered normals (not the error of the colour, which the steepest
normals would rule), softly limited so that wrong pairs count little, by Levenberg and Marquardt's method
(levenberg1944, marquardt1963). Angles alone would leave M's size free at every pixel; the recovered length,
which should be 1, holds it.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Int64Array, Points, Points2
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadCalibration, BadInput, BadRig
from vntoolkit.photometry.response import HIGHEST_DEGREE, LightResponse, ResponseVariation, powers_to_degree

_ROUNDS = 60
_SETTLED = 1e-5  # relative decrease of the cost at which the fit rests
_LARGEST_DAMPING = 1e9
_DARKEST = 1e-3  # length of a recovered normal, which should be 1, below which it has no direction


@dataclass(frozen=True, kw_only=True)
class VariationOptions:
    """Options of a response that varies over the image.

    degree: degree of the polynomials by which M varies over the image, 0 (one response for the whole image)
    to 3. softness_deg: angular error in degrees from which a pair counts less and less. length_share: how
    much an error of the length counts against one of the direction. stiffness: how strongly coefficients are
    held at 0 where the pairs say little: the cost, per pair, of a coefficient as large as M itself.
    """

    degree: int = 3
    softness_deg: float = 8.0
    length_share: float = 0.3
    stiffness: float = 3e-4

    def __post_init__(self) -> None:
        if not 0 <= self.degree <= HIGHEST_DEGREE:
            raise BadInput(f"degree of the variation: expected 0 to {HIGHEST_DEGREE}, got {self.degree}")
        positive = 0 < self.softness_deg < np.inf and 0 < self.length_share < np.inf
        if not (positive and 0 <= self.stiffness < np.inf):
            raise BadInput("softness, length share and stiffness of the variation: expected positive numbers")


def fit_varying_response(
    normals: Points,
    rgb: Points,
    positions_px: Points2,
    size: tuple[int, int],
    start: LightResponse,
    options: VariationOptions | None = None,
    *,
    fit_ambient: bool = True,
) -> LightResponse:
    """Refine `start` to a response whose entries are polynomials of the pixel position.

    normals, rgb: (n, 3), lit by all three lights. positions_px: (n, 2), in the image without lens distortion,
    of size (width, height). fit_ambient: whether the ambient light is fitted and varies too, else it stays.
    Pairs so dark that `start` makes no direction of them are left out. Raises `BadCalibration` where the
    positions do not determine the polynomials, or the fit is singular somewhere in the image.
    """
    options = options or VariationOptions()
    require_shape(normals, (None, 3), "normals")
    require_shape(rgb, (len(normals), 3), "colours")
    require_shape(positions_px, (len(normals), 2), "positions")
    for values, name in ((normals, "normals"), (rgb, "colours"), (positions_px, "positions")):
        require_finite(values, name)
    seen = np.linalg.norm((rgb - start.ambient) @ start.inverse.T, axis=1) > _DARKEST
    normals, rgb, positions_px = normals[seen], rgb[seen], positions_px[seen]
    powers = powers_to_degree(options.degree)
    centre, scale = (np.array(size) - 1.0) / 2, max(size) / 2.0
    xy = (positions_px - centre) / scale
    monomials = np.column_stack([np.ones(len(xy)), *(xy[:, 0] ** i * xy[:, 1] ** j for i, j in powers)])
    _require_spread(monomials)
    problem = _Problem(normals, rgb, monomials, start, options, fit_ambient)
    terms: FloatArray = np.zeros((monomials.shape[1], problem.rows, 3))
    terms[0, :3] = start.matrix.T
    if fit_ambient:
        terms[0, 3] = start.ambient
    terms = _minimise(problem, terms)
    response = _response(terms, powers, centre, scale, start.ambient)
    _require_regular(response, size)
    return response


class _Problem:
    """Cost and normal equations for coefficients `terms` (monomial, row, channel); rows: n_x, n_y, n_z, 1."""

    def __init__(
        self,
        normals: Points,
        rgb: Points,
        monomials: FloatArray,
        start: LightResponse,
        options: VariationOptions,
        fit_ambient: bool,
    ) -> None:
        self._normals, self._rgb, self._monomials = normals, rgb, monomials
        self._ambient, self._options = start.ambient, options
        self.rows = 4 if fit_ambient else 3
        self._stiffness = options.stiffness * len(rgb) / float(np.sum(start.matrix**2))

    def recovered(self, terms: FloatArray) -> tuple[FloatArray, FloatArray]:
        """M⁻¹ (n, 3, 3) and M⁻¹(r − a) (n, 3) of every pair."""
        local = np.tensordot(self._monomials, terms, axes=1)
        ambient = local[:, 3] if self.rows == 4 else self._ambient
        inverse = np.linalg.inv(local[:, :3].transpose(0, 2, 1))
        return inverse, (inverse @ (self._rgb - ambient)[..., None])[..., 0]

    def cost(self, terms: FloatArray) -> float:
        """Sum of pseudo-Huber losses of direction and length."""
        try:
            _, scaled = self.recovered(terms)
        except np.linalg.LinAlgError:
            return np.inf
        squared = self._squared(scaled)[0]
        soft = np.deg2rad(self._options.softness_deg) ** 2
        total = float(np.sum(soft * (np.sqrt(1.0 + squared / soft) - 1.0)))
        total += 0.5 * self._stiffness * float(np.sum(terms[1:] ** 2))
        return total if np.isfinite(total) else np.inf

    def _squared(self, scaled: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        length = np.linalg.norm(scaled, axis=1, keepdims=True)
        unit = scaled / length
        error = unit - self._normals
        squared = (error**2).sum(axis=1) + (self._options.length_share * (length[:, 0] - 1.0)) ** 2
        return squared, length, unit

    def normal_equations(self, terms: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gauss and Newton's matrix and gradient, coefficients flattened as (monomial, row, channel)."""
        inverse, scaled = self.recovered(terms)
        squared, length, unit = self._squared(scaled)
        weight = 1.0 / np.sqrt(1.0 + squared / np.deg2rad(self._options.softness_deg) ** 2)
        share = self._options.length_share
        across = (np.eye(3) - unit[:, :, None] * unit[:, None, :]) / length[:, :, None]
        # by colour, (n, 4, 3)
        jacobian = -np.concatenate([across, share * unit[:, None, :]], axis=1) @ inverse
        residual = np.concatenate([unit - self._normals, share * (length - 1.0)], axis=1)
        rows = np.concatenate([scaled, np.ones((len(scaled), 1))], axis=1)[:, : self.rows]
        factors = (self._monomials[:, :, None] * rows[:, None, :]).reshape(len(rows), -1)
        weighted = jacobian * weight[:, None, None]
        curvature = np.einsum("nac,nad->ncd", weighted, jacobian)
        gradient = factors.T @ np.einsum("nac,na->nc", weighted, residual)
        count = factors.shape[1]
        matrix = np.empty((count, 3, count, 3))
        for c, d in itertools.combinations_with_replacement(range(3), 2):
            matrix[:, c, :, d] = factors.T @ (factors * curvature[:, c, d, None])
            matrix[:, d, :, c] = matrix[:, c, :, d]
        # all but the constant terms, in the flattened order
        held = self._stiffness * (np.arange(terms.size) >= 3 * self.rows)
        matrix = matrix.reshape(3 * count, 3 * count) + np.diag(held)
        return matrix, gradient.ravel() + held * terms.ravel()


def _minimise(problem: _Problem, terms: FloatArray) -> FloatArray:
    cost, damping = problem.cost(terms), 1e-3
    for _ in range(_ROUNDS):
        matrix, gradient = problem.normal_equations(terms)
        diagonal = np.diag(np.maximum(np.diag(matrix), 1e-12))
        while True:
            step = np.linalg.solve(matrix + damping * diagonal, -gradient).reshape(terms.shape)
            update = problem.cost(terms + step)
            if update < cost:
                break
            damping *= 5.0
            if damping > _LARGEST_DAMPING:
                return terms
        settled = cost - update < _SETTLED * cost
        terms, cost, damping = terms + step, update, max(damping / 5.0, 1e-9)
        if settled:
            break
    return terms


def _response(
    terms: FloatArray, powers: Int64Array, centre: FloatArray, scale: float, ambient: FloatArray
) -> LightResponse:
    fitted = terms.shape[1] == 4
    variation = None
    if len(powers):
        variation = ResponseVariation(
            powers=powers,
            matrices=terms[1:, :3].transpose(0, 2, 1),
            ambients=terms[1:, 3] if fitted else np.zeros((len(powers), 3)),
            centre_px=centre,
            scale_px=scale,
        )
    try:
        return LightResponse(
            matrix=terms[0, :3].T, ambient=terms[0, 3] if fitted else ambient, variation=variation
        )
    except BadRig as error:
        raise BadCalibration(f"calibration: {error}") from error


_PAIRS_PER_TERM = 4  # positions that each monomial needs at least, at very least
_FLATTEST = 0.02  # smallest over largest singular value of the monomials over the positions seen


def _require_spread(monomials: FloatArray) -> None:
    """Raise if the positions do not determine the monomials."""
    terms = monomials.shape[1]
    singular = np.linalg.svd(monomials, compute_uv=False) if len(monomials) >= terms else np.zeros(1)
    if len(monomials) < 3 * _PAIRS_PER_TERM * terms or not singular[-1] > _FLATTEST * singular[0]:
        raise BadCalibration(
            "calibration: the target was seen in too few places of the image to tell how the light varies; "
            "show it all over the image, or lower the degree of the variation"
        )


_LARGEST_CONDITION = 1e3  # of M anywhere in the image


def _require_regular(response: LightResponse, size: tuple[int, int]) -> None:
    """Raise if the fitted M is singular in some part of the image."""
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, 9), np.linspace(0, size[1] - 1, 9))
    matrices, _ = response.at(np.stack([u, v], axis=-1))
    singular = np.linalg.svd(matrices, compute_uv=False)
    sign = np.sign(np.linalg.det(matrices))
    if singular[..., 2].min() * _LARGEST_CONDITION < singular[..., 0].max() or np.ptp(sign) > 0:
        raise BadCalibration(
            "calibration: the response that varies becomes singular in a part of the image where the target "
            "was not seen; show it there too, or lower the degree of the variation"
        )
