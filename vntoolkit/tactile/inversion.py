"""Normals of a tactile gel, frame by frame: the drift of the light removed, then M⁻¹ and its correction.

Lamps warm up and a camera adjusts itself, so that the untouched gel's colour moves by some grey levels from
one frame to the next. That drift is smooth over the gel, whereas a touch is local: a quadratic of the place,
fitted robustly to the change of colour, follows the drift and not the touch. It is removed.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from vntoolkit.arrays import Array, Float32Array, FloatArray, LinearImage, Mask, read_only
from vntoolkit.checks import require_mask, require_shape
from vntoolkit.geometry.maps import NOISE_CELL_PX, NormalMap
from vntoolkit.native import njit
from vntoolkit.photometry.gel import GelResponse
from vntoolkit.photometry.response import LightResponse
from vntoolkit.spread import MEDIAN_TO_DEVIATION, NINE_OF_TEN_IN_PLANE, robust_deviation
from vntoolkit.tactile.response import STEEPEST

_VOTES = 1200  # pixels that the drift is fitted to, evenly spread
_ROUNDS = 6
_LEAST_NOISE = 0.004  # of full scale: one grey level of 8 bits; smaller residuals are no evidence
_TILTS = 4096  # steps of the cosine in the table of errors
_LEAST_FACING = 0.1
_DRIFT_TERMS = 6  # of a quadratic of the place


def drift_of_change(change: LinearImage, usable: Mask) -> FloatArray:
    """The drift as coefficients (6, 3) of 1, x, y, x², x y, y² by channel.

    x and y run from −1 to 1 over the frame. change: (h, w, 3), a frame less the untouched gel. usable:
    (h, w), pixels that count. 0 where fewer than a dozen of them do.
    """
    require_shape(change, (None, None, 3), "change of colour")
    require_mask(usable, change.shape[:2])
    height, width = usable.shape
    step = max(1, round(float(np.sqrt(height * width / _VOTES))))
    values, positions = _votes(np.ascontiguousarray(change), usable, step)
    if values.shape[1] < 2 * _DRIFT_TERMS:
        return np.zeros((_DRIFT_TERMS, 3))
    return np.asarray(_fit_drift(values, positions, _LEAST_NOISE))


def change_without_drift(change: LinearImage, usable: Mask) -> LinearImage:
    """A change of colour (h, w, 3) less its drift."""
    height, width = usable.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    return (change - terms @ drift_of_change(change, usable)).astype(np.float32)


class GelInverter:
    """Turns changes of colour of one size into normals."""

    def __init__(self, response: LightResponse, gel: GelResponse) -> None:
        centre_u, centre_v = gel.centre_px.tolist()
        self._errors_deg: Float32Array | None = None
        if gel.errors_deg is not None:
            tilts = np.degrees(np.arccos(np.arange(_TILTS + 1) / _TILTS))
            self._errors_deg = np.interp(tilts, *gel.errors_deg.T).astype(np.float32)
        self._model = _Model(
            inverse=response.inverse.astype(np.float32),
            terms=gel.terms.astype(np.float32),
            centre_u=np.float32(centre_u),
            centre_v=np.float32(centre_v),
            inverse_scale=np.float32(1.0 / gel.scale_px),
            reach=np.float32(gel.reach),
        )

    def with_expected_error(self, normal_map: NormalMap) -> NormalMap:
        """The map with the angle that nine of ten normals so tilted stay within; as it is where not known."""
        if self._errors_deg is None:
            return normal_map
        cosine = np.clip(-normal_map.normals_in_camera[..., 2], 0.0, 1.0)
        error = self._errors_deg.take((cosine * _TILTS).astype(np.int32))
        cells = tuple(-(-length // NOISE_CELL_PX) for length in normal_map.shape)
        noise = np.full(cells, _noise_deg(normal_map.normals_in_camera))
        return replace(normal_map, error_deg=error, noise_deg=noise)

    def normals(self, change: LinearImage, drift: FloatArray, mask: Mask) -> NormalMap:
        """Normals of a change of colour (h, w, 3) less a drift; valid within `mask`."""
        normals = np.empty(change.shape, np.float32)
        _invert(np.ascontiguousarray(change), drift.astype(np.float32), self._model, normals)
        if not mask.all():
            normals[~mask] = 0.0
        return NormalMap(normals_in_camera=normals, mask=read_only(mask))


def _noise_deg(normals: Array) -> float:
    """The angle that nine of ten normals of noise alone stay within, from the curl of one row in sixteen.

    A surface's ∂p/∂v − ∂q/∂u is 0. Central differences of white noise make it as large as the noise.
    """
    rows = np.arange(1, len(normals) - 1, NOISE_CELL_PX)
    if not len(rows) or normals.shape[1] < 3:
        return 0.0
    x, y, z = np.moveaxis(normals, -1, 0)
    z = np.minimum(z, -_LEAST_FACING)
    p = x[rows + 1] / z[rows + 1] - x[rows - 1] / z[rows - 1]
    q = y[rows] / z[rows]
    curl = 0.5 * (p[:, 1:-1] - (q[:, 2:] - q[:, :-2]))
    return NINE_OF_TEN_IN_PLANE * float(np.degrees(robust_deviation(curl)))


class _Model(NamedTuple):
    """What the loop needs, float32. inverse: M⁻¹. terms: as `GelResponse.terms`."""

    inverse: Array
    terms: Array
    centre_u: np.float32
    centre_v: np.float32
    inverse_scale: np.float32
    reach: np.float32


@njit
def _invert(change: Array, drift: Array, model: _Model, normals: Array) -> None:
    height, width = change.shape[:2]
    filmed, found = change.reshape(height, -1), normals.reshape(height, -1)
    for v in range(height):
        rows = np.empty((6, width), np.float32)  # rgb, then m, then the normal; x; s
        place, bent = rows[3], np.zeros(model.terms.shape[1:3], np.float32)
        for u in range(width):
            place[u] = (np.float32(u) - model.centre_u) * model.inverse_scale
        _take_drift(filmed[v], drift, v, height, rows)
        _estimate_row(rows[0], rows[1], rows[2], rows[4], rows[5], model.inverse, model.reach)
        y = (np.float32(v) - model.centre_v) * model.inverse_scale
        for coordinate in range(2):
            terms = model.terms[coordinate]
            for k in range(terms.shape[0]):
                for i in range(terms.shape[1]):
                    bent[k, i] = terms[k, i, -1]
                    for j in range(terms.shape[2] - 2, -1, -1):
                        bent[k, i] = bent[k, i] * y + terms[k, i, j]
            _bend_row(rows[0], rows[1], rows[2], place, bent, rows[4 + coordinate])
        _normals_row(rows[4], rows[5], rows[0], rows[1], rows[2])
        line, nx, ny, nz = found[v], rows[0], rows[1], rows[2]
        for u in range(width):
            line[3 * u], line[3 * u + 1], line[3 * u + 2] = nx[u], ny[u], nz[u]


@njit
def _take_drift(change: Array, drift: Array, v: int, height: int, rows: Array) -> None:
    """Put a row's colours, r g b r g b …, less the drift, into rows 0 to 2."""
    r, g, b = rows[0], rows[1], rows[2]
    width = len(r)
    over, one = np.float32(2.0 / max(width - 1, 1)), np.float32(1)
    y = np.float32(2.0 * v / max(height - 1, 1) - 1.0)
    constant, linear = drift[0] + y * (drift[2] + y * drift[5]), drift[1] + y * drift[4]
    r0, g0, b0 = constant[0], constant[1], constant[2]
    r1, g1, b1 = linear[0], linear[1], linear[2]
    r2, g2, b2 = drift[3, 0], drift[3, 1], drift[3, 2]
    for u in range(width):
        x = np.float32(u) * over - one
        r[u] = change[3 * u] - (r0 + x * (r1 + x * r2))
        g[u] = change[3 * u + 1] - (g0 + x * (g1 + x * g2))
        b[u] = change[3 * u + 2] - (b0 + x * (b1 + x * b2))


@njit
def _estimate_row(r: Array, g: Array, b: Array, s: Array, t: Array, inverse: Array, reach: Any) -> None:
    """Replace colours by m, shortened to `reach`, and put s of M alone into s and t."""
    one, tiny = np.float32(1), np.float32(1e-9)
    for u in range(len(r)):
        x = inverse[0, 0] * r[u] + inverse[0, 1] * g[u] + inverse[0, 2] * b[u]
        y = inverse[1, 0] * r[u] + inverse[1, 1] * g[u] + inverse[1, 2] * b[u]
        z = inverse[2, 0] * r[u] + inverse[2, 1] * g[u] + inverse[2, 2] * b[u]
        across = x * x + y * y
        scale = one / max(np.sqrt(across + (z - one) * (z - one)) + (one - z), tiny)
        s[u], t[u] = x * scale, y * scale
        within = min(one, reach / max(np.sqrt(across + z * z), tiny))
        r[u], g[u], b[u] = x * within, y * within, z * within


@njit
def _bend_row(r: Array, g: Array, b: Array, place: Array, c: Array, s: Array) -> None:
    """Add the correction to one coordinate s of a row, by Horner's rule in m = (i, j, k) and the place x.

    c: (34, 4), of every monomial of m, in the order of `COLOUR_FACTORS`, the coefficients of 1, x, x², x³.
    One pass with all terms in registers takes a fifth of a pass a term. ijk1 is the coefficient of i j k x.
    """
    i0, i1, i2, i3 = c[0, 0], c[0, 1], c[0, 2], c[0, 3]
    j0, j1, j2, j3 = c[1, 0], c[1, 1], c[1, 2], c[1, 3]
    k0, k1, k2, k3 = c[2, 0], c[2, 1], c[2, 2], c[2, 3]
    ii0, ii1, ii2 = c[3, 0], c[3, 1], c[3, 2]
    ij0, ij1, ij2 = c[4, 0], c[4, 1], c[4, 2]
    ik0, ik1, ik2 = c[5, 0], c[5, 1], c[5, 2]
    jj0, jj1, jj2 = c[6, 0], c[6, 1], c[6, 2]
    jk0, jk1, jk2 = c[7, 0], c[7, 1], c[7, 2]
    kk0, kk1, kk2 = c[8, 0], c[8, 1], c[8, 2]
    iii0, iii1, iij0, iij1 = c[9, 0], c[9, 1], c[10, 0], c[10, 1]
    iik0, iik1, ijj0, ijj1 = c[11, 0], c[11, 1], c[12, 0], c[12, 1]
    ijk0, ijk1, ikk0, ikk1 = c[13, 0], c[13, 1], c[14, 0], c[14, 1]
    jjj0, jjj1, jjk0, jjk1 = c[15, 0], c[15, 1], c[16, 0], c[16, 1]
    jkk0, jkk1, kkk0, kkk1 = c[17, 0], c[17, 1], c[18, 0], c[18, 1]
    iiii, iiij, iiik, iijj, iijk = c[19, 0], c[20, 0], c[21, 0], c[22, 0], c[23, 0]
    iikk, ijjj, ijjk, ijkk, ikkk = c[24, 0], c[25, 0], c[26, 0], c[27, 0], c[28, 0]
    jjjj, jjjk, jjkk, jkkk, kkkk = c[29, 0], c[30, 0], c[31, 0], c[32, 0], c[33, 0]
    for u in range(len(s)):
        i, j, k, x = r[u], g[u], b[u], place[u]
        ii = (ii2 * x + ii1) * x + ii0 + i * (iii1 * x + iii0 + iiii * i + iiij * j + iiik * k)
        ii += j * (iij1 * x + iij0 + iijj * j + iijk * k) + k * (iik1 * x + iik0 + iikk * k)
        ij = (ij2 * x + ij1) * x + ij0 + j * (ijj1 * x + ijj0 + ijjj * j + ijjk * k)
        ij += k * (ijk1 * x + ijk0 + ijkk * k)
        ik = (ik2 * x + ik1) * x + ik0 + k * (ikk1 * x + ikk0 + ikkk * k)
        jj = (jj2 * x + jj1) * x + jj0 + j * (jjj1 * x + jjj0 + jjjj * j + jjjk * k)
        jj += k * (jjk1 * x + jjk0 + jjkk * k)
        jk = (jk2 * x + jk1) * x + jk0 + k * (jkk1 * x + jkk0 + jkkk * k)
        kk = (kk2 * x + kk1) * x + kk0 + k * (kkk1 * x + kkk0 + kkkk * k)
        by_i = ((i3 * x + i2) * x + i1) * x + i0 + i * ii + j * ij + k * ik
        by_j = ((j3 * x + j2) * x + j1) * x + j0 + j * jj + k * jk
        by_k = ((k3 * x + k2) * x + k1) * x + k0 + k * kk
        s[u] += i * by_i + j * by_j + k * by_k


@njit
def _normals_row(s: Array, t: Array, x: Array, y: Array, z: Array) -> None:
    one, two = np.float32(1), np.float32(2)
    steepest, tiny = np.float32(STEEPEST), np.float32(1e-12)
    for u in range(len(s)):
        squared = s[u] * s[u] + t[u] * t[u]
        short = min(one, steepest / np.sqrt(max(squared, tiny)))
        squared = squared * short * short
        scale = one / (one + squared)
        x[u] = two * short * s[u] * scale
        y[u] = two * short * t[u] * scale
        z[u] = (squared - one) * scale


@njit
def _votes(change: Array, usable: Array, step: int) -> tuple[Array, Array]:
    """Colours (3, n) and terms of the place (6, n) of every step-th pixel of every step-th row."""
    height, width = usable.shape
    most = ((height + step - 1) // step) * ((width + step - 1) // step)
    values, positions = np.empty((3, most)), np.empty((_DRIFT_TERMS, most))
    count = 0
    for v in range(step // 2, height, step):
        y = 2.0 * v / (height - 1) - 1.0 if height > 1 else 0.0
        for u in range(step // 2, width, step):
            if usable[v, u]:
                x = 2.0 * u / (width - 1) - 1.0 if width > 1 else 0.0
                positions[0, count], positions[1, count], positions[2, count] = 1.0, x, y
                positions[3, count], positions[4, count], positions[5, count] = x * x, x * y, y * y
                for c in range(3):
                    values[c, count] = change[v, u, c]
                count += 1
    return values[:, :count].copy(), positions[:, :count].copy()


@njit
def _fit_drift(values: Array, positions: Array, least_noise: float) -> Array:
    """Iteratively reweighted least squares with Geman and McClure's weights."""
    count = values.shape[1]
    drift: Array = np.zeros((_DRIFT_TERMS, 3))
    weight, weighted, residual = np.ones(count), np.empty(count), np.empty(count)
    for _ in range(_ROUNDS):
        normal, right = np.zeros((_DRIFT_TERMS, _DRIFT_TERMS)), np.zeros((_DRIFT_TERMS, 3))
        for i in range(_DRIFT_TERMS):
            _multiply(weight, positions[i], weighted)
            for j in range(i, _DRIFT_TERMS):
                normal[i, j] = normal[j, i] = _dot(weighted, positions[j])
            for c in range(3):
                right[i, c] = _dot(weighted, values[c])
            normal[i, i] += 1e-9 * count
        drift = np.linalg.solve(normal, right)
        _measure(values, positions, drift, residual)
        scale = 2.0 * max(MEDIAN_TO_DEVIATION * np.median(residual[::2]), least_noise)
        weight = 1.0 / (1.0 + (residual / scale) ** 2) ** 2
    return drift


@njit
def _measure(values: Array, positions: Array, drift: Array, residual: Array) -> None:
    """Lengths (n,) of what the drift leaves of the colours."""
    x, y, xx, xy, yy = positions[1], positions[2], positions[3], positions[4], positions[5]
    residual[:] = 0.0
    for c in range(3):
        d0, d1, d2, d3, d4, d5 = drift[0, c], drift[1, c], drift[2, c], drift[3, c], drift[4, c], drift[5, c]
        colour = values[c]
        for n in range(len(residual)):
            rest = colour[n] - d0 - d1 * x[n] - d2 * y[n] - d3 * xx[n] - d4 * xy[n] - d5 * yy[n]
            residual[n] += rest * rest
    for n in range(len(residual)):
        residual[n] = np.sqrt(residual[n])


@njit
def _multiply(first: Array, second: Array, out: Array) -> None:
    for n in range(len(first)):
        out[n] = first[n] * second[n]


@njit
def _dot(first: Array, second: Array) -> float:
    total = 0.0
    for n in range(len(first)):
        total += first[n] * second[n]
    return total
