"""A response that varies over the image, fitted to normals and colours at known pixels.

Near lights change M from pixel to pixel. Its entries are polynomials of the position. Equation 4 stays linear
in their coefficients: `r = Σ_m x^i y^j [M_m a_m] [n; 1]`, solved like that of one M. Few poses determine so
many coefficients badly: those beyond one M are held near 0, as strongly as the pairs themselves ask for.
"""

import numpy as np

from vntoolkit.arrays import FloatArray, Points, Points2
from vntoolkit.calibration.fit import LARGEST_CONDITION, Design, fit_by_trimming, response_from_unknowns
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadCalibration
from vntoolkit.options.calibration import ResponseFitOptions, ResponseModel
from vntoolkit.photometry.response import LightResponse, ResponseVariation, powers_to_degree

_PAIRS_PER_TERM = 4  # positions that each monomial needs at least, at very least
_FLATTEST = 0.02  # smallest over largest singular value of the monomials over the positions seen
_ROUNDS = 100  # of the ridge's fixed point; it rests after ten or twenty
_SETTLED = 1e-3  # relative change of the ridge at which it rests


def fit_varying_response(
    normals: Points,
    rgb: Points,
    positions_px: Points2,
    size: tuple[int, int],
    degree: int,
    options: ResponseFitOptions,
) -> LightResponse:
    """Equation 4 with M, and with `ResponseModel.AMBIENT` a too, as polynomials of the pixel position.

    normals, rgb: (n, 3), lit by all three lights. positions_px: (n, 2), in the image without lens distortion,
    of size (width, height). degree: of the polynomials. Raises `BadCalibration` where the positions do not
    determine the polynomials, or the fit is singular somewhere in the image.
    """
    require_shape(normals, (None, 3), "normals")
    require_shape(rgb, (len(normals), 3), "colours")
    require_shape(positions_px, (len(normals), 2), "positions")
    for values, name in ((normals, "normals"), (rgb, "colours"), (positions_px, "positions")):
        require_finite(values, name)
    powers = powers_to_degree(degree)
    centre, scale = (np.array(size) - 1.0) / 2, max(size) / 2.0
    x, y = ((positions_px - centre) / scale).T
    monomials = np.column_stack([np.ones(len(x)), *(x**i * y**j for i, j in powers)])
    _require_spread(monomials)
    one = Design.from_pairs(normals, rgb, with_ambient=options.model is ResponseModel.AMBIENT)
    products = monomials[:, :, None] * one.rows[:, None, :]
    # the spread of the positions is checked above, that of the normals when one M was fitted
    design = Design(rows=products.reshape(len(rgb), -1), colours=rgb, flattest=0.0)
    unknowns, chosen = fit_by_trimming(design, np.ones(len(rgb), np.bool_), 0.0)
    unknowns = _shrunk(unknowns, design.rows[chosen], rgb[chosen], free=one.unknown_count)
    middle, *terms = unknowns.reshape(monomials.shape[1], one.unknown_count, 3)
    response = response_from_unknowns(middle)
    variation = ResponseVariation(
        powers=powers,
        matrices=np.array([term[:3].T for term in terms]),
        ambients=np.array([term[3] if len(term) == 4 else np.zeros(3) for term in terms]),
        centre_px=centre,
        scale_px=scale,
    )
    varying = LightResponse(matrix=response.matrix, ambient=response.ambient, variation=variation)
    _require_regular(varying, size)
    return varying


def _shrunk(unknowns: FloatArray, rows: Points, colours: Points, free: int) -> FloatArray:
    """Solve rows @ unknowns = colours again by ridge regression, all but the first `free` rows held near 0.

    rows: (n, k), unknowns: (k, 3). The ridge is the variance of the colours over that of the
    coefficients; both maximise the evidence, by MacKay's fixed point (mackay1992).
    """
    shrunk = np.arange(len(unknowns)) >= free
    normal, right = rows.T @ rows, rows.T @ colours
    ridge, before = 0.0, np.inf
    for _ in range(_ROUNDS):
        inverse = np.linalg.inv(normal + np.diag(ridge * shrunk))
        unknowns = inverse @ right
        determined = (
            shrunk.sum() - ridge * np.diag(inverse)[shrunk].sum()
        )  # coefficients that the pairs determine
        noise = np.square(rows @ unknowns - colours).sum() / (len(rows) - free - determined)
        size = np.square(unknowns[shrunk]).sum()
        if abs(ridge - before) <= _SETTLED * ridge or size == 0.0:
            break
        before, ridge = ridge, determined * noise / size
    return unknowns


def _require_spread(monomials: FloatArray) -> None:
    """Raise if the positions do not determine the monomials."""
    terms = monomials.shape[1]
    singular = np.linalg.svd(monomials, compute_uv=False) if len(monomials) >= terms else np.zeros(1)
    if len(monomials) < 3 * _PAIRS_PER_TERM * terms or not singular[-1] > _FLATTEST * singular[0]:
        raise BadCalibration(
            "calibration: the target was seen in too few places of the image to tell how the light varies; "
            "show it all over the image, or lower the degree of the variation"
        )


def _require_regular(response: LightResponse, size: tuple[int, int]) -> None:
    """Raise if the fitted M is singular in some part of the image."""
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, 9), np.linspace(0, size[1] - 1, 9))
    matrices, _ = response.at(np.stack([u, v], axis=-1))
    singular = np.linalg.svd(matrices, compute_uv=False)
    sign = np.sign(np.linalg.det(matrices))
    if singular[..., 2].min() * LARGEST_CONDITION < singular[..., 0].max() or np.ptp(sign) > 0:
        raise BadCalibration(
            "calibration: the response that varies becomes singular in a part of the image where the target "
            "was not seen; show it there too, or lower the degree of the variation"
        )
