"""A skinned surface with its animation: bind pose, joints, weights and blend shapes."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Points, Vector3
from vntoolkit.checks import set_arrays
from vntoolkit.errors import BadMesh
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.motion import Motion

_FRAMES_AT_ONCE = 16  # in memory
_FITTED_POINTS = 20_000  # of the vertices: enough to see how the shapes weigh in each frame


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinnedClip:
    """A surface bound to a moving skeleton; metres, camera axes.

    mesh: in the pose of attachment, with all shapes at 0; its normals are those of the garment at rest.
    joints, weights: (n, k), heaviest first, rows sum to 1. rest_from_model: (j, 4, 4), pose of attachment.
    motion: one frame a frame. shapes: (m, n, 3) offsets from the mesh. shape_weights: (frames, m), 0 to 1:
    in each frame their weighted sum is added before skinning. shape_error: what the shapes leave out, 95th
    percentile over vertices and frames, metres.
    """

    mesh: Mesh
    joints: IntArray
    weights: FloatArray
    rest_from_model: FloatArray
    motion: Motion
    shapes: FloatArray
    shape_weights: FloatArray
    shape_error: float = 0.0

    def __post_init__(self) -> None:
        count, frames = len(self.mesh.vertices), len(self.motion)
        shapes = {
            "joints": (count, None),
            "weights": self.joints.shape,
            "shapes": (None, count, 3),
            "shape_weights": (frames, len(self.shapes)),
        }
        set_arrays(self, shapes, called="skinned clip: {}", error=BadMesh)

    def with_influences(self, count: int) -> "SkinnedClip":
        """Return the clip with at most `count` joints a vertex: the heaviest, less the weight of the next."""
        if self.weights.shape[1] <= count:
            return self
        kept = self.weights[:, :count] - self.weights[:, count : count + 1]
        kept = np.where(kept.sum(axis=1, keepdims=True) > 1e-6, kept, self.weights[:, :count])
        kept = kept / kept.sum(axis=1, keepdims=True)
        return replace(self, joints=self.joints[:, :count], weights=kept)

    def with_shapes(self, count: int) -> "SkinnedClip":
        """Return the clip with the first `count` shapes; of the others their mean stays."""
        if len(self.shapes) <= count:
            return self
        mean = np.einsum("m,mnc->nc", self.shape_weights[:, count:].mean(axis=0), self.shapes[count:])
        mesh = replace(self.mesh, vertices=self.mesh.vertices + mean)
        return replace(
            self, mesh=mesh, shapes=self.shapes[:count], shape_weights=self.shape_weights[:, :count]
        )

    def moved(self, offset: Vector3) -> "SkinnedClip":
        """Return the clip, the whole scene moved by an offset (3,): the animation, not the bind pose."""
        motion = replace(self.motion, root_positions=self.motion.root_positions + offset)
        return replace(self, motion=motion)


def blend_shapes(
    rest: Points, frames: Callable[[], Iterator[Points]], count: int
) -> tuple[Points, FloatArray, FloatArray, float]:
    """Return a base (n, 3), shapes (m, n, 3) and weights (frames, m) that come nearest to all frames.

    count: most shapes. rest: (n, 3). frames: gives all frames (n, 3), and gives them again. Each weight runs
    from 0 to 1, as a slider does in other programs. Returns also the 95th percentile of what is left out.
    Principal components (pearson1901), through the products of the frames with each other.
    """
    chosen = slice(None, None, max(1, len(rest) // _FITTED_POINTS))
    rows = np.stack([(frame - rest)[chosen].astype(np.float32).ravel() for frame in frames()])
    values, vectors = np.linalg.eigh((rows @ rows.T).astype(np.float64))
    order = np.argsort(values)[::-1][: min(count, len(rows))]
    order = order[values[order] > 1e-10 * max(float(values.max(initial=0.0)), 1e-12)]
    directions = vectors[:, order]
    summed = np.zeros((len(order), rest.size), np.float32)
    moved = ((frame - rest).astype(np.float32).ravel() for frame in frames())
    for some in np.array_split(directions.astype(np.float32), max(1, len(rows) // _FRAMES_AT_ONCE)):
        summed += some.T @ np.stack([next(moved) for _ in some])
    shapes = summed.reshape(len(order), len(rest), 3)
    left = rows - directions.astype(np.float32) @ shapes[:, chosen].reshape(len(order), rows.shape[1])
    error = np.linalg.norm(left.reshape(len(rows), -1, 3), axis=2)
    least, span = directions.min(axis=0), np.maximum(np.ptp(directions, axis=0), 1e-12)
    base = rest + np.einsum("m,mnc->nc", least, shapes)
    shapes *= span[:, None, None].astype(np.float32)
    return base, shapes, (directions - least) / span, float(np.quantile(error, 0.95)) if error.size else 0.0
