"""Normals of a tactile gel, frame by frame: the drift of the light removed, then M⁻¹ and its correction.

Lamps warm up and a camera adjusts itself, so that the untouched gel's colour moves by some grey levels from
one frame to the next. That drift is smooth over the gel, whereas a touch is local: a quadratic of the place,
fitted robustly to the change of colour, follows the drift and not the touch. It is removed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, LinearImage, Mask, read_only
from vntoolkit.checks import require_mask, require_shape
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.native import njit
from vntoolkit.normals.inversion import FLAGS
from vntoolkit.photometry.gel import COLOUR_FACTORS, STEEPEST, GelResponse
from vntoolkit.photometry.response import LightResponse

Array = npt.NDArray[Any]
_VOTES = 1200  # pixels that the drift is fitted to, evenly spread
_ROUNDS = 6
_LEAST_NOISE = 0.004  # of full scale: one grey level of 8 bits; smaller residuals are no evidence
_DRIFT_TERMS = 6  # of a quadratic of the place

# Every monomial of m is one before it (or 1, number −1) times one component of m.
_PARENTS = np.array(
    [(*COLOUR_FACTORS, ()).index(factors[:-1]) if factors[:-1] else -1 for factors in COLOUR_FACTORS]
)
_FACTORS = np.array([factors[-1] for factors in COLOUR_FACTORS])


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
    if len(values) < 2 * _DRIFT_TERMS:
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
        self._model = _Model(
            inverse=response.inverse.astype(np.float32),
            terms=gel.terms.astype(np.float32),
            centre_u=np.float32(centre_u),
            centre_v=np.float32(centre_v),
            inverse_scale=np.float32(1.0 / gel.scale_px),
            reach=np.float32(gel.reach),
        )

    def normals(self, change: LinearImage, drift: FloatArray, mask: Mask) -> NormalMap:
        """Normals of a change of colour (h, w, 3) less a drift; valid within `mask`."""
        normals = np.empty(change.shape, np.float32)
        _invert(
            np.ascontiguousarray(change), drift.astype(np.float32), self._model, _PARENTS, _FACTORS, normals
        )
        if not mask.all():
            normals[~mask] = 0.0
        return NormalMap(normals_in_camera=normals, mask=read_only(mask))


class _Model(NamedTuple):
    """What the loop needs, float32. inverse: M⁻¹. terms: as `GelResponse.terms`."""

    inverse: Array
    terms: Array
    centre_u: np.float32
    centre_v: np.float32
    inverse_scale: np.float32
    reach: np.float32


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _invert(
    change: Array, drift: Array, model: _Model, parents: Array, factors: Array, normals: Array
) -> None:
    height, width = change.shape[:2]
    terms = model.terms
    count = len(parents)
    for v in prange(height):
        rows = np.empty((8 + count, width), np.float32)  # rgb, then m; x; s; 1; monomials of m
        place, ones = rows[3], rows[6]
        for u in range(width):
            place[u] = (np.float32(u) - model.centre_u) * model.inverse_scale
            ones[u] = np.float32(1)
        _take_drift(change[v], drift, v, height, rows)
        _estimate_row(rows[0], rows[1], rows[2], rows[4], rows[5], model.inverse, model.reach)
        y = (np.float32(v) - model.centre_v) * model.inverse_scale
        for k in range(count):
            _add_row(
                rows[factors[k]],
                rows[7 + parents[k]],
                place,
                (terms[0, k, 0, 2] * y + terms[0, k, 0, 1]) * y + terms[0, k, 0, 0],
                terms[0, k, 1, 1] * y + terms[0, k, 1, 0],
                terms[0, k, 2, 0],
                (terms[1, k, 0, 2] * y + terms[1, k, 0, 1]) * y + terms[1, k, 0, 0],
                terms[1, k, 1, 1] * y + terms[1, k, 1, 0],
                terms[1, k, 2, 0],
                rows[7 + k],
                rows[4],
                rows[5],
            )
        _normals_row(rows[4], rows[5], rows[0], rows[1], rows[2])
        for u in range(width):
            normals[v, u, 0], normals[v, u, 1], normals[v, u, 2] = rows[0, u], rows[1, u], rows[2, u]


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _take_drift(change: Array, drift: Array, v: int, height: int, rows: Array) -> None:
    """Put a row's colours (w, 3), less the drift, into rows 0 to 2."""
    width = len(change)
    over = np.float32(2.0 / max(width - 1, 1))
    y = np.float32(2.0 * v / max(height - 1, 1) - 1.0)
    for c in range(3):
        p0 = drift[0, c] + y * (drift[2, c] + y * drift[5, c])
        p1 = drift[1, c] + y * drift[4, c]
        p2 = drift[3, c]
        row = rows[c]
        for u in range(width):
            x = np.float32(u) * over - np.float32(1)
            row[u] = change[u, c] - (p0 + x * (p1 + x * p2))


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
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


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _add_row(
    m: Array,
    before: Array,
    x: Array,
    p0: Any,
    p1: Any,
    p2: Any,
    q0: Any,
    q1: Any,
    q2: Any,
    colour: Array,
    s: Array,
    t: Array,
) -> None:
    """Make one monomial of m and add its terms to s and t."""
    for u in range(len(m)):
        value = m[u] * before[u]
        colour[u] = value
        s[u] += value * ((p2 * x[u] + p1) * x[u] + p0)
        t[u] += value * ((q2 * x[u] + q1) * x[u] + q0)


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
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


@njit(cache=True)
def _votes(change: Array, usable: Array, step: int) -> tuple[Array, Array]:
    height, width = usable.shape
    most = ((height + step - 1) // step) * ((width + step - 1) // step)
    values, positions = np.empty((most, 3)), np.empty((most, _DRIFT_TERMS))
    count = 0
    for v in range(step // 2, height, step):
        y = 2.0 * v / (height - 1) - 1.0 if height > 1 else 0.0
        for u in range(step // 2, width, step):
            if usable[v, u]:
                x = 2.0 * u / (width - 1) - 1.0 if width > 1 else 0.0
                positions[count, 0], positions[count, 1], positions[count, 2] = 1.0, x, y
                positions[count, 3], positions[count, 4], positions[count, 5] = x * x, x * y, y * y
                for c in range(3):
                    values[count, c] = change[v, u, c]
                count += 1
    return values[:count], positions[:count]


@njit(cache=True)
def _fit_drift(values: Array, positions: Array, least_noise: float) -> Array:
    """Iteratively reweighted least squares with Geman and McClure's weights."""
    count = len(values)
    drift: Array = np.zeros((_DRIFT_TERMS, 3))
    weight, residual = np.ones(count), np.empty(count)
    for _ in range(_ROUNDS):
        normal, right = np.zeros((_DRIFT_TERMS, _DRIFT_TERMS)), np.zeros((_DRIFT_TERMS, 3))
        for n in range(count):
            for i in range(_DRIFT_TERMS):
                w = weight[n] * positions[n, i]
                for j in range(i, _DRIFT_TERMS):
                    normal[i, j] += w * positions[n, j]
                for c in range(3):
                    right[i, c] += w * values[n, c]
        for i in range(_DRIFT_TERMS):
            for j in range(i):
                normal[i, j] = normal[j, i]
            normal[i, i] += 1e-9 * count
        drift = np.linalg.solve(normal, right)
        for n in range(count):
            total = 0.0
            for c in range(3):
                rest = values[n, c]
                for i in range(_DRIFT_TERMS):
                    rest -= positions[n, i] * drift[i, c]
                total += rest * rest
            residual[n] = np.sqrt(total)
        scale = 2.0 * max(1.4826 * np.median(residual), least_noise)
        for n in range(count):
            weight[n] = 1.0 / (1.0 + (residual[n] / scale) ** 2) ** 2
    return drift
