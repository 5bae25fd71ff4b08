"""The divergence of the wanted differences on a full rectangle, straight from the slopes.

The same quadrature as `edges.py` without masks, fused into one pass: it is what the fast path spends its
time on besides the transforms.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from vntoolkit.checks import require_same_size
from vntoolkit.errors import BadInput

_LEAST_SIZE = 5  # pixels that the one-sided stencils need


def divergence_from_slopes(p: npt.NDArray[np.float32], q: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
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


@numba.njit(cache=True, fastmath=True, parallel=True)
def _divergence(p, q, out):  # type: ignore[no-untyped-def]
    height, width = p.shape
    k = np.float32(1.0 / 24.0)
    c14, c9, c19, c13, c5 = (
        np.float32(14.0), np.float32(9.0), np.float32(19.0), np.float32(13.0), np.float32(5.0),
    )  # fmt: skip
    for v in numba.prange(height):
        row = p[v]
        to = out[v]
        for u in range(2, width - 2):
            to[u] = (row[u - 2] - row[u + 2] + c14 * (row[u + 1] - row[u - 1])) * k
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
