"""End-point errors of tracked vertices in pixels of the footage, frame by frame.

A tracked vertex starts at a pixel of the template frame, on a triangle of the true mesh. Where that point of
the triangle is in any later frame, it is known; the distance in the image is the end-point error. Every
vertex whose true point can be seen in that frame is judged, whether the tracker believes to see it or not.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import BoolArray, Faces, FloatArray, Int32Array, Points, Points2, read_only
from vntoolkit.checks import require_positive, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rays import RayScene, pixel_rays
from vntoolkit.options.tracking import LOST_PX

_OUTLIER_PX = 4.0
_HIDDEN_SHARE = 0.002  # of its depth: a true point further behind the frontmost surface is hidden, not judged


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceAnchors:
    """Points fixed to a true mesh. corners: (n, 3) vertex indices; weights: (n, 3), barycentric.

    found: (n,) False where no triangle lay under the pixel; its corners and weights mean nothing.
    """

    corners: Int32Array
    weights: FloatArray
    found: BoolArray

    def points(self, vertices: Points) -> FloatArray:
        """Return the (n, 3) points on the mesh at `vertices`."""
        corners = np.asarray(vertices, dtype=np.float64)[self.corners]
        return np.asarray(np.einsum("nc,nck->nk", self.weights, corners))


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedPixels:
    """Where a tracker puts its vertices in one frame.

    positions_px: (n, 2) in pixels of the footage. uncertainty_px: (n,) the error that the tracker expects, or
    None where it expects none.
    """

    frame: int
    positions_px: Points2
    uncertainty_px: FloatArray | None = None


@dataclass(frozen=True, kw_only=True)
class TrackError:
    """End-point error of one frame, over the vertices whose true point is seen in it.

    median_px, p95_px: of all of them, lost or not. outliers: share that is off by more than
    4 pixels. vertices: how many were judged. lost: share that the tracker itself
    declares lost. found_median_px, found_p95_px: of the others alone; they say nothing without the share
    lost beside them, since a tracker may declare lost what it likes. NaN where there is none.
    """

    frame: int
    median_px: float
    p95_px: float
    outliers: float
    vertices: int
    lost: float = 0.0
    found_median_px: float = np.nan
    found_p95_px: float = np.nan


def anchors_on_mesh(positions_px: Points2, vertices: Points, faces: Faces, camera: Camera) -> SurfaceAnchors:
    """Fix pixel positions (n, 2) to the frontmost triangle of a mesh that covers each, in its frame."""
    require_shape(vertices, (None, 3), "true vertices")
    if not camera.is_perspective:
        raise BadInput("track error: expected the perspective camera that the truth was filmed with")
    _, rays = pixel_rays(camera, np.asarray(positions_px, dtype=np.float64))
    hits = RayScene((vertices, faces)).first_hits(np.hstack([np.zeros_like(rays), rays]))
    corners = np.zeros((len(rays), 3), dtype=np.int32)
    weights, found = np.tile([1.0, 0.0, 0.0], (len(rays), 1)), np.zeros(len(rays), dtype=np.bool_)
    corners[hits.rays], found[hits.rays] = faces[hits.faces], True
    met = np.swapaxes(np.asarray(vertices, dtype=np.float64)[corners[hits.rays]], 1, 2)
    along = np.linalg.solve(met, rays[hits.rays][..., None])[..., 0]  # Embree's own are float32
    weights[hits.rays] = along / along.sum(axis=1, keepdims=True)
    return SurfaceAnchors(corners=read_only(corners), weights=read_only(weights), found=read_only(found))


def visible(points: FloatArray, vertices: Points, faces: Faces, camera: Camera) -> BoolArray:
    """Return (n,) True where a point (n, 3) on the mesh is in the image and no triangle is before it."""
    pixels = camera.project(points)
    front = anchors_on_mesh(pixels, vertices, faces, camera)
    depth = front.points(vertices)[:, 2]
    inside = np.all((pixels > 0) & (pixels < [camera.width - 1, camera.height - 1]), axis=1)
    return np.asarray(inside & front.found & (points[:, 2] <= depth * (1 + _HIDDEN_SHARE)))


def track_errors(
    tracked: Iterable[TrackedPixels],
    truth: Iterable[tuple[int, Points]],
    anchors: SurfaceAnchors,
    faces: Faces,
    camera: Camera,
    lost_px: float = LOST_PX,
) -> Iterator[TrackError]:
    """Yield the error of each frame; truth: (frame number, vertices) in step with tracked.

    camera: the one that truly filmed; the tracker may have believed in another. lost_px: a vertex of which
    the tracker expects a greater error than this is declared lost.
    """
    require_positive(lost_px, "track error: lost_px")
    for pixels, (number, true_vertices) in zip(tracked, truth, strict=True):
        if pixels.frame != number:
            raise BadInput(f"track error: expected the true frame {pixels.frame}, got frame {number}")
        points = anchors.points(true_vertices)
        judged = anchors.found & visible(points, true_vertices, faces, camera)
        distance = np.linalg.norm(pixels.positions_px[judged] - camera.project(points[judged]), axis=1)
        uncertainty = (
            np.zeros(len(points)) if pixels.uncertainty_px is None else np.asarray(pixels.uncertainty_px)
        )
        yield error_of_frame(number, distance, uncertainty[judged] <= lost_px)


def error_of_frame(number: int, distance_px: FloatArray, found: BoolArray) -> TrackError:
    """Summarise end-point errors (n,) in pixels; found: (n,) False where the tracker declares them lost."""
    if not len(distance_px):
        nan = np.nan
        return TrackError(frame=number, median_px=nan, p95_px=nan, outliers=nan, vertices=0, lost=nan)
    median, p95 = np.percentile(distance_px, [50, 95])
    found_median, found_p95 = np.percentile(distance_px[found], [50, 95]) if found.any() else (np.nan, np.nan)
    return TrackError(
        frame=number,
        median_px=float(median),
        p95_px=float(p95),
        outliers=float(np.mean(distance_px > _OUTLIER_PX)),
        vertices=len(distance_px),
        lost=float(1 - np.mean(found)),
        found_median_px=float(found_median),
        found_p95_px=float(found_p95),
    )
