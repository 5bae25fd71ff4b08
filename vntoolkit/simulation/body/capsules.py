"""A body of tapered capsules, and how deep a point lies inside it."""

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Points, Vectors
from vntoolkit.native import njit


@dataclass(frozen=True, kw_only=True, eq=False)
class Capsules:
    """Spheres swept from `starts` to `ends` (k, 3) with radii (k, 2) that change linearly; metres."""

    starts: Points
    ends: Points
    radii: FloatArray

    def signed_distance(self, points: Points) -> FloatArray:
        """Return (n,) the distance to the union's surface, negative inside."""
        return _signed_distances(
            np.ascontiguousarray(points, dtype=np.float64), self.starts, self.ends, self.radii
        )


@njit(cache=True)
def closest_capsule(
    x: float, y: float, z: float, starts: Points, ends: Points, radii: FloatArray
) -> tuple[int, float, float]:
    """Return the nearest capsule, the place along it from 0 to 1, and the signed distance to it."""
    best, best_along, best_distance = 0, 0.0, 1e9
    for k in range(len(starts)):
        ax, ay, az = ends[k, 0] - starts[k, 0], ends[k, 1] - starts[k, 1], ends[k, 2] - starts[k, 2]
        px, py, pz = x - starts[k, 0], y - starts[k, 1], z - starts[k, 2]
        along = (px * ax + py * ay + pz * az) / max(ax * ax + ay * ay + az * az, 1e-12)
        along = min(1.0, max(0.0, along))
        dx, dy, dz = px - along * ax, py - along * ay, pz - along * az
        radius = radii[k, 0] + along * (radii[k, 1] - radii[k, 0])
        distance = np.sqrt(dx * dx + dy * dy + dz * dz) - radius
        if distance < best_distance:
            best, best_along, best_distance = k, along, distance
    return best, best_along, best_distance


@njit(cache=True)
def _signed_distances(points: Points, starts: Points, ends: Points, radii: FloatArray) -> Vectors:
    distances = np.empty(len(points))
    for i in range(len(points)):
        _, _, distances[i] = closest_capsule(points[i, 0], points[i, 1], points[i, 2], starts, ends, radii)
    return distances
