"""The K-cycle of an algebraic multigrid hierarchy, and the conjugate gradients around it; compiled.

`levels` is the tuple (first, row_start, neighbour, weight, diagonal, parent, coarsest_inverse) of
`multigrid.Hierarchy`. Vectors span all levels; a level uses its own index range of each. The recursion of
the cycle is spelled out as a walk with a state per level, because numba cannot cache recursive functions.
"""

from __future__ import annotations

import numba
import numpy as np

_DESCEND, _CORRECTED_ONCE, _CORRECTED_TWICE = 0, 1, 2
_GOOD_ENOUGH = 0.0625  # squared residual share after one coarse step that spares the second


@numba.njit(cache=True, fastmath=True)
def _multiply(levels, begin, end, x, out):  # type: ignore[no-untyped-def]
    _, row_start, neighbour, weight, diagonal, _, _ = levels
    for i in range(begin, end):
        total = diagonal[i] * x[i]
        for slot in range(row_start[i], row_start[i + 1]):
            total -= weight[slot] * x[neighbour[slot]]
        out[i] = total


@numba.njit(cache=True, fastmath=True)
def _smooth_forward(levels, begin, end, b, x):  # type: ignore[no-untyped-def]
    """Gauss-Seidel from zero: later neighbours are still 0."""
    _, row_start, neighbour, weight, diagonal, _, _ = levels
    for i in range(begin, end):
        total = b[i]
        for slot in range(row_start[i], row_start[i + 1]):
            if neighbour[slot] < i:
                total += weight[slot] * x[neighbour[slot]]
        x[i] = total / diagonal[i]


@numba.njit(cache=True, fastmath=True)
def _smooth_backward(levels, begin, end, b, x):  # type: ignore[no-untyped-def]
    _, row_start, neighbour, weight, diagonal, _, _ = levels
    for i in range(end - 1, begin - 1, -1):
        total = b[i]
        for slot in range(row_start[i], row_start[i + 1]):
            total += weight[slot] * x[neighbour[slot]]
        x[i] = total / diagonal[i]


@numba.njit(cache=True, fastmath=True)
def _restrict_residual(levels, level, b, x):  # type: ignore[no-untyped-def]
    """Sum the residual of a level into the load of the next."""
    first, row_start, neighbour, weight, diagonal, parent, _ = levels
    b[first[level + 1] : first[level + 2]] = 0.0
    for i in range(first[level], first[level + 1]):
        total = b[i] - diagonal[i] * x[i]
        for slot in range(row_start[i], row_start[i + 1]):
            total += weight[slot] * x[neighbour[slot]]
        b[parent[i]] += total


@numba.njit(cache=True, fastmath=True)
def _solve_coarsest(levels, begin, end, b, x):  # type: ignore[no-untyped-def]
    inverse = levels[6]
    for i in range(end - begin):
        total = 0.0
        for j in range(end - begin):
            total += inverse[i, j] * b[begin + j]
        x[begin + i] = total


@numba.njit(cache=True, fastmath=True)
def _first_step(levels, low, high, b, x, kept, kept_product):  # type: ignore[no-untyped-def]
    """Best multiple of the first correction; return (rho, step) and whether a second one is worth it."""
    _multiply(levels, low, high, x, kept_product)
    rho, alpha, size, left = 0.0, 0.0, 0.0, 0.0
    for i in range(low, high):
        kept[i] = x[i]
        rho += x[i] * kept_product[i]
        alpha += x[i] * b[i]
        size += b[i] * b[i]
    if rho <= 0.0:
        return 1.0, 0.0, False
    step = alpha / rho
    for i in range(low, high):
        b[i] -= step * kept_product[i]
        left += b[i] * b[i]
        x[i] *= step
    return rho, step, left > _GOOD_ENOUGH * size


@numba.njit(cache=True, fastmath=True)
def _second_step(levels, low, high, rho, step, b, x, kept, kept_product, work):  # type: ignore[no-untyped-def]
    """Best combination of both corrections (two steps of flexible conjugate gradients)."""
    _multiply(levels, low, high, x, work)
    gamma, beta, alpha = 0.0, 0.0, 0.0
    for i in range(low, high):
        gamma += x[i] * kept_product[i]
        beta += x[i] * work[i]
        alpha += x[i] * b[i]
    rest = beta - gamma * gamma / rho
    second = alpha / rest if rest > 1e-12 * beta else 0.0
    for i in range(low, high):
        x[i] = (step - gamma * second / rho) * kept[i] + second * x[i]


@numba.njit(cache=True, fastmath=True)
def _finish(levels, level, b, x):  # type: ignore[no-untyped-def]
    """Add the coarse correction to a level and smooth it."""
    first, parent = levels[0], levels[5]
    for i in range(first[level], first[level + 1]):
        x[i] += x[parent[i]]
    _smooth_backward(levels, first[level], first[level + 1], b, x)


@numba.njit(cache=True, fastmath=True)
def _cycle(levels, b, x, kept, kept_product, work, state, rho, step):  # type: ignore[no-untyped-def]
    """One K-cycle from the finest level: x = approximate solution with load b."""
    first, inverse = levels[0], levels[6]
    last = len(first) - 2
    level = 0
    state[0] = _DESCEND
    while level >= 0:
        begin, end = first[level], first[level + 1]
        if level == last:
            if len(inverse) > 0:
                _solve_coarsest(levels, begin, end, b, x)
            else:
                _smooth_forward(levels, begin, end, b, x)
                _smooth_backward(levels, begin, end, b, x)
            level -= 1
        elif state[level] == _DESCEND:
            _smooth_forward(levels, begin, end, b, x)
            _restrict_residual(levels, level, b, x)
            state[level] = _CORRECTED_ONCE
            level += 1
            state[level] = _DESCEND
        else:
            again = False
            low, high = end, first[level + 2]
            if state[level] == _CORRECTED_TWICE:
                _second_step(levels, low, high, rho[level], step[level], b, x, kept, kept_product, work)
            elif level + 1 < last:
                rho[level], step[level], again = _first_step(levels, low, high, b, x, kept, kept_product)
            if again:
                state[level] = _CORRECTED_TWICE
                level += 1
                state[level] = _DESCEND
            else:
                _finish(levels, level, b, x)
                level -= 1


@numba.njit(cache=True, fastmath=True)
def _dot(a, b, count):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(count):
        total += a[i] * b[i]
    return total


@numba.njit(cache=True, fastmath=True)
def flexible_conjugate_gradients(levels, load, start, tolerance, most):  # type: ignore[no-untyped-def]
    """Solve L x = load; return x, the number of iterations and the relative residual reached."""
    first = levels[0]
    count, total, depth = first[1], first[-1], len(first)
    b, x = np.empty(total), np.empty(total)
    kept, kept_product, work = np.empty(total), np.empty(total), np.empty(total)
    state, rho, step = np.zeros(depth, np.int64), np.ones(depth), np.zeros(depth)
    solution, residual = start.copy(), np.empty(count)
    direction, product = np.zeros(count), np.zeros(count)
    b[:count] = load
    _cycle(levels, b, x, kept, kept_product, work, state, rho, step)
    scale = _dot(load, x, count)
    if scale <= 0.0:  # nothing is asked for, whatever the start
        return np.zeros(count), 0, 0.0
    _multiply(levels, 0, count, solution, product)
    started = False
    for i in range(count):
        residual[i] = load[i] - product[i]
        product[i] = 0.0
        started |= solution[i] != 0.0
    curvature, relative = 1.0, np.inf
    for iteration in range(most + 1):
        if iteration > 0 or started:  # else x is still that of the load
            b[:count] = residual
            _cycle(levels, b, x, kept, kept_product, work, state, rho, step)
        relative = np.sqrt(max(_dot(residual, x, count), 0.0) / scale)
        if relative <= tolerance:
            return solution, iteration, relative
        # made conjugate to the last direction explicitly: the cycle is not a fixed linear operator
        factor = -_dot(product, x, count) / curvature
        for i in range(count):
            direction[i] = x[i] + factor * direction[i]
        _multiply(levels, 0, count, direction, product)
        curvature = _dot(direction, product, count)
        length = _dot(direction, residual, count) / curvature
        for i in range(count):
            solution[i] += length * direction[i]
            residual[i] -= length * product[i]
    return solution, most, relative
