"""Ground truth of a simulated head turn, and the errors of a calibration against it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d as o3d
from scipy.spatial.transform import Rotation

from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.rigs import read_rig
from vntoolkit.pipeline.calibrate_head import HeadCalibration

_STILL = 1e-5  # of the length unit: what a rigid part may be off
_LEAST_COSINE = 0.15  # between a truth's normal and a viewer that sees it
_SHOWN_BY = 15  # frames that decide what is seen
_KEPT_SHARE = 0.9


class HeadTruth:
    """Poses, and the surface of head and face that some frame sees, in the frame amid the turn."""

    def __init__(self, folder: Path) -> None:
        vertices = np.load(folder / "vertices.npy", mmap_mode="r")
        self._focal_px = read_rig(folder / "rig.json").camera.matrix[0, 0]
        middle = np.asarray(vertices[len(vertices) // 2], dtype=np.float64)
        head = _turning_part(middle, np.asarray(vertices[0]), np.asarray(vertices[-1]))
        self.poses = [_rigid(middle[head], np.asarray(each, dtype=np.float64)[head]) for each in vertices]
        faces = read_mesh(folder / "template.ply").faces
        seen = self._seen(middle, faces) & head
        chosen = faces[seen[faces].all(axis=1)]
        used, places = np.unique(chosen, return_inverse=True)
        self.surface = Mesh(vertices=middle[used], faces=places.reshape(-1, 3).astype(np.int32))

    def _seen(self, middle: np.ndarray, faces: np.ndarray) -> np.ndarray:
        normals, scene = vertex_normals(middle, faces), _scene(middle, faces)
        seen = np.zeros(len(middle), bool)
        for pose in self.poses[:: max(1, len(self.poses) // _SHOWN_BY)]:
            towards = pose.inverse().translation - middle
            towards /= np.linalg.norm(towards, axis=1, keepdims=True)
            rays = np.concatenate([middle + 2e-4 * normals, towards], axis=1).astype(np.float32)
            free = ~scene.test_occlusions(o3d.core.Tensor(rays)).numpy()
            seen |= free & ((normals * towards).sum(axis=1) > _LEAST_COSINE)
        return seen

    def pose_errors_deg(self, result: HeadCalibration) -> np.ndarray:
        """Return the rotation's error per frame, after one constant rotation between the head frames."""
        pairs = zip(result.motion.camera_from_head, result.footage.numbers, strict=True)
        relative = Rotation.from_matrix([self.poses[k].rotation.T @ found.rotation for found, k in pairs])
        return np.rad2deg((relative.mean().inv() * relative).magnitude())

    def shape_errors(self, mesh: Mesh, result: HeadCalibration) -> dict[str, float]:
        """Return mean distance in % of the diagonal and angles of normals, after a similarity."""
        pose = self.poses[result.footage.numbers[result.motion.reference]]
        truth = pose.apply(self.surface.vertices)
        normals = vertex_normals(truth, self.surface.faces)
        # Lengths of a calibration are in distances from the camera, which its focal length tells.
        unit = float(np.median(truth[:, 2])) * result.motion.camera.matrix[0, 0] / self._focal_px
        moved = _aligned(mesh.vertices * unit, mesh.faces, truth, normals)
        hits = _scene(moved, mesh.faces).compute_closest_points(o3d.core.Tensor(truth.astype(np.float32)))
        distance = np.linalg.norm(hits["points"].numpy() - truth, axis=1)
        faces = mesh.faces[hits["primitive_ids"].numpy()]
        u, v = hits["primitive_uvs"].numpy().T
        corners = vertex_normals(moved, mesh.faces)[faces]
        found = np.einsum("nc,nci->ni", np.column_stack([1 - u - v, u, v]), corners)
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        angle = np.rad2deg(np.arccos(np.clip((found * normals).sum(axis=1), -1, 1)))
        diagonal = float(np.linalg.norm(np.ptp(truth, axis=0)))
        return {
            "distance_percent": float(100 * distance.mean() / diagonal),
            "normals_mean_deg": float(angle.mean()),
            "normals_median_deg": float(np.median(angle)),
            "normals_mean_by_area_deg": float(np.average(angle, weights=self._areas())),
        }

    def _areas(self) -> np.ndarray:
        corners = self.surface.vertices[self.surface.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        shares = np.repeat(np.linalg.norm(across, axis=1) / 6, 3)
        return np.bincount(self.surface.faces.ravel(), shares, len(self.surface.vertices))


def _turning_part(middle: np.ndarray, *others: np.ndarray) -> np.ndarray:
    """Return which vertices (n,) move as the upper half does: the head without the neck, which twists."""
    upper = middle[:, 1] < np.median(middle[:, 1])
    rigid = np.ones(len(middle), bool)
    for other in others:
        moved = _rigid(middle[upper], other[upper].astype(np.float64)).apply(middle)
        rigid &= np.abs(moved - other).max(axis=1) < _STILL
    if rigid[upper].mean() < 0.99:
        raise ValueError("the head of this scene does not move rigidly: give a head_turn")
    return rigid


def _rigid(source: np.ndarray, target: np.ndarray) -> RigidTransform:
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    rotation, _ = Rotation.align_vectors(b[::11], a[::11])
    return RigidTransform(
        rotation=rotation.as_matrix(),
        translation=target.mean(axis=0) - rotation.as_matrix() @ source.mean(axis=0),
    )


def _scene(vertices: np.ndarray, faces: np.ndarray) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
        o3d.core.Tensor(np.ascontiguousarray(faces, np.uint32)),
    )
    return scene


def _aligned(moved: np.ndarray, faces: np.ndarray, truth: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Move a mesh onto the truth by a similarity: closest points of 15,000 of its vertices (chen1992)."""
    moved = moved - np.median(moved, axis=0) + np.median(truth, axis=0)
    chosen = np.random.default_rng(0).choice(len(truth), min(15_000, len(truth)), replace=False)
    points, towards = truth[chosen], normals[chosen]
    for _ in range(60):
        hits = _scene(moved, faces).compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
        near = hits["points"].numpy().astype(np.float64)
        distance = np.linalg.norm(near - points, axis=1)
        kept = distance <= np.quantile(distance, _KEPT_SHARE)
        centre, n = near[kept].mean(axis=0), towards[kept]
        arm = near[kept] - centre
        rows = np.column_stack([np.cross(arm, n), n, (arm * n).sum(axis=1)])
        gap = ((points[kept] - near[kept]) * n).sum(axis=1)
        step = np.linalg.lstsq(rows, gap, rcond=None)[0]
        turned = (moved - centre) @ Rotation.from_rotvec(step[:3]).as_matrix().T
        moved = (1 + step[6]) * turned + centre + step[3:6]
        if np.abs(step).max() < 1e-7:
            break
    return moved
