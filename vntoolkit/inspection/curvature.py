"""Mean and Gaussian curvature of a surface, from how its normals turn from pixel to pixel.

Print changes the colour of a surface and not its normals, so that it disappears in a picture of the
curvature; dents, scratches and edges remain, however the surface lies. do Carmo's Differential Geometry of
Curves and Surfaces, section 3.3, has the formulas.
"""

import numpy as np

from vntoolkit.arrays import Float64Array, FloatArray, Mask, Normals

_FLATTEST = 1e-9  # of the squared area between two columns and two rows, below which there is no surface


def curvature(points: FloatArray, normals: Normals, mask: Mask) -> tuple[Float64Array, Float64Array, Mask]:
    """Return mean and Gaussian curvature (h, w), and where they are known: in all four neighbours' midst.

    points, normals: (h, w, 3), in the camera frame. The mean curvature is positive where the surface bulges
    towards the viewer, as a ball of radius R does with 1/R, and negative in a dent; the Gaussian curvature is
    1/R² for both, and negative on a saddle. In 1 over the unit of the points, and its square.
    """
    known = np.zeros(mask.shape, np.bool_)
    known[1:-1, 1:-1] = mask[1:-1, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:] & mask[:-2, 1:-1] & mask[2:, 1:-1]
    points = np.where(mask[..., None], points, 0.0)
    normals = np.where(mask[..., None], np.asarray(normals, np.float64), 0.0)
    x_v, x_u, n_v, n_u = (
        np.asarray(slope, np.float64)
        for image in (points, normals)
        for slope in np.gradient(image, axis=(0, 1))
    )
    first_uu, first_uv, first_vv = (_dot(x_u, x_u), _dot(x_u, x_v), _dot(x_v, x_v))
    second_uu, second_vv = _dot(x_u, n_u), _dot(x_v, n_v)
    second_uv = 0.5 * (_dot(x_u, n_v) + _dot(x_v, n_u))
    area = first_uu * first_vv - first_uv**2
    known &= area > _FLATTEST * (first_uu + first_vv) ** 2
    area = np.where(known, area, 1.0)
    mean = 0.5 * (second_uu * first_vv - 2.0 * second_uv * first_uv + second_vv * first_uu) / area
    gaussian = (second_uu * second_vv - second_uv**2) / area
    return np.where(known, mean, 0.0), np.where(known, gaussian, 0.0), known


def _dot(a: Float64Array, b: Float64Array) -> Float64Array:
    return np.einsum("vuk,vuk->vu", a, b)


def signed_picture(values: FloatArray, mask: Mask) -> "np.ndarray[tuple[int, ...], np.dtype[np.uint8]]":
    """Return (h, w, 3): 0 in white, the largest values in red, the smallest in blue, grey outside the mask.

    The colours are full at the 98th percentile of the sizes.
    """
    limit = float(np.percentile(np.abs(values[mask]), 98.0)) if mask.any() else 0.0
    share = np.clip(values / (limit or 1.0), -1.0, 1.0)[..., None]
    red, blue = np.array([178, 24, 43]), np.array([33, 102, 172])
    colours = 255.0 + np.abs(share) * (np.where(share > 0, red, blue) - 255.0)
    return np.where(mask[..., None], np.rint(colours), 128).astype(np.uint8)
