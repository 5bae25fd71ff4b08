"""The inner loops of the cloth solver: constraints projected one after another (Gauss–Seidel)."""

from __future__ import annotations

import numpy as np
from numba import njit

from vntoolkit.arrays import FloatArray, IntArray, Points
from vntoolkit.simulation.body.capsules import closest_capsule


@njit(cache=True)
def project_edges(x: Points, edges: IntArray, rest: FloatArray, inverse_mass: float, softness: float) -> None:
    """Bring every edge to its rest length; softness = compliance / dt² (macklin2016)."""
    share = inverse_mass / (2.0 * inverse_mass + softness)
    count = len(edges)
    for sweep in range(2 * count):  # there and back, so that the order favours no direction
        e = sweep if sweep < count else 2 * count - 1 - sweep
        i, j = edges[e, 0], edges[e, 1]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        pull = share * (length - rest[e]) / max(length, 1e-9)
        x[i, 0] += pull * dx
        x[i, 1] += pull * dy
        x[i, 2] += pull * dz
        x[j, 0] -= pull * dx
        x[j, 1] -= pull * dy
        x[j, 2] -= pull * dz


@njit(cache=True)
def project_hinges(
    x: Points, hinges: IntArray, stencils: FloatArray, softness: FloatArray, inverse_mass: float
) -> None:
    """Flatten every pair of triangles: the constraint is |Σ k_i x_i|, their mean curvature (bergou2006)."""
    for h in range(len(hinges)):
        cx, cy, cz, weight = 0.0, 0.0, 0.0, 0.0
        for c in range(4):
            k, i = stencils[h, c], hinges[h, c]
            cx += k * x[i, 0]
            cy += k * x[i, 1]
            cz += k * x[i, 2]
            weight += k * k
        share = inverse_mass / (inverse_mass * weight + softness[h])
        for c in range(4):
            step, i = share * stencils[h, c], hinges[h, c]
            x[i, 0] -= step * cx
            x[i, 1] -= step * cy
            x[i, 2] -= step * cz


@njit(cache=True)
def separate_pairs(x: Points, pairs: IntArray, thickness: float) -> None:
    """Push two parts of the cloth apart that come closer than its thickness."""
    for p in range(len(pairs)):
        i, j = pairs[p, 0], pairs[p, 1]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        squared = dx * dx + dy * dy + dz * dz
        if squared < thickness * thickness and squared > 1e-16:
            push = 0.5 * (1.0 - thickness / np.sqrt(squared))
            x[i, 0] += push * dx
            x[i, 1] += push * dy
            x[i, 2] += push * dz
            x[j, 0] -= push * dx
            x[j, 1] -= push * dy
            x[j, 2] -= push * dz


@njit(cache=True)
def collide(
    x: Points,
    before: Points,
    starts: Points,
    ends: Points,
    radii: FloatArray,
    starts_step: Points,
    ends_step: Points,
    margin: float,
    friction: float,
) -> None:
    """Push points out of the body to `margin`; friction drags them along with the body's motion.

    starts_step, ends_step: how far the capsules' ends moved in this step.
    """
    for i in range(len(x)):
        k, along, distance = closest_capsule(x[i, 0], x[i, 1], x[i, 2], starts, ends, radii)
        depth = margin - distance
        if depth <= 0.0:
            continue
        n = np.empty(3)
        for a in range(3):
            n[a] = x[i, a] - (starts[k, a] + along * (ends[k, a] - starts[k, a]))
        n /= max(np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2), 1e-9)
        slip, normal_slip = np.empty(3), 0.0
        for a in range(3):
            x[i, a] += depth * n[a]
            body = starts_step[k, a] + along * (ends_step[k, a] - starts_step[k, a])
            slip[a] = x[i, a] - before[i, a] - body
            normal_slip += slip[a] * n[a]
        slip -= normal_slip * n
        length = np.sqrt(slip[0] ** 2 + slip[1] ** 2 + slip[2] ** 2)
        held = min(1.0, friction * depth / max(length, 1e-12))
        for a in range(3):
            x[i, a] -= held * slip[a]


@njit(cache=True)
def damp_edges(v: Points, edges: IntArray, share: float) -> None:
    """Take `share` of the velocity difference out of every edge: the yarn's inner friction."""
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        for a in range(3):
            change = 0.5 * share * (v[j, a] - v[i, a])
            v[i, a] += change
            v[j, a] -= change
