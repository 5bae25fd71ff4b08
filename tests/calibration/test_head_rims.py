"""Contours of an egg of known shape say where the rims of a mesh should lie."""

import numpy as np
import pytest

from tests.calibration.test_head_refinement import skin_of
from tests.calibration.turning_egg import AXES, CAMERA, DISTANCE, egg_surface, turning_poses
from vntoolkit.calibration.head.positions import PositionSolver
from vntoolkit.calibration.head.rims import rim_targets
from vntoolkit.calibration.head.samples import LightFrame
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

PIXEL = DISTANCE / CAMERA.matrix[0, 0]
POSES = turning_poses(7, 60.0)
# lamps to the left, the right and above, that light every rim but those below
ROUND = LightResponse(matrix=np.array([[-0.8, 0.0, -0.6], [0.8, 0.0, -0.6], [0.0, -0.8, -0.6]]))


def silhouette(pose):
    """The exact silhouette of the egg, (h, w) bool."""
    inverse = pose.inverse()
    origin = inverse.apply(np.zeros(3)) / AXES
    rays = CAMERA.unproject(CAMERA.pixel_grid(), np.ones((CAMERA.height, CAMERA.width)))
    rays = inverse.rotate(rays) / AXES
    return (rays @ origin) ** 2 > (rays**2).sum(-1) * (origin @ origin - 1.0)


def frames(brightness=lambda pose, mask: mask * 0.5):
    for pose in POSES:
        mask = silhouette(pose)
        image = np.repeat(brightness(pose, mask)[..., None], 3, axis=2).astype(np.float32)
        yield LightFrame(frame=LinearFrame(image), camera_from_head=pose, mask=mask)


def egg(grown_px=0.0):
    points, faces = egg_surface(12_000)
    normals = points / AXES**2
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    vertices = points + grown_px * PIXEL * normals
    return Mesh(vertices=vertices, faces=faces, normals=vertex_normals(vertices, faces))


@pytest.mark.parametrize("grown_px", [-2.0, 0.0, 1.0, 2.0])
def test_contours_call_a_mesh_back_that_is_too_large_or_too_small(grown_px):
    mesh = egg(grown_px)
    places, weight = rim_targets(mesh, CAMERA, frames(), ROUND)
    moves = ((places - mesh.vertices) * mesh.normals).sum(axis=1) / PIXEL
    held = weight > np.median(weight[weight > 0])
    # contours of whole pixels are off by 0.3 px each
    assert np.median(moves[held]) == pytest.approx(-grown_px, abs=0.15)
    assert np.abs(moves[held] + grown_px).mean() < 0.3


def test_only_vertices_that_some_frame_sees_edge_on_are_called():
    mesh = egg()
    _, weight = rim_targets(mesh, CAMERA, frames(), ROUND)
    cosines = []
    for pose in POSES:
        position = pose.apply(mesh.vertices)
        cosines.append((pose.rotate(mesh.normals) * position).sum(1) / np.linalg.norm(position, axis=1))
    least = np.abs(cosines).min(axis=0)
    below = mesh.normals[:, 1] > 0.8
    assert (weight[least > 0.1] == 0).all()
    assert (weight[(least < 0.002) & ~below] > 0).mean() > 0.8


def test_a_rim_that_no_lamp_reaches_is_not_called():
    above = LightResponse(matrix=np.array([[-0.3, -0.8, -0.5], [0.3, -0.8, -0.5], [0.0, -0.8, -0.6]]))
    mesh = egg()
    _, weight = rim_targets(mesh, CAMERA, frames(), above)
    assert not weight[mesh.normals[:, 1] > 0.8].any()
    assert weight[mesh.normals[:, 1] < -0.8].any()


def test_a_contour_where_little_light_arrives_counts_less():
    def half_dark(pose, mask):
        columns = np.arange(mask.shape[1])
        return mask * np.where(columns < CAMERA.matrix[0, 2], 0.5, 0.05)

    mesh = egg()
    _, weight = rim_targets(mesh, CAMERA, frames(half_dark), ROUND)
    right = mesh.vertices[:, 0] > 0.9 * AXES[0]
    left = mesh.vertices[:, 0] < -0.9 * AXES[0]
    assert weight[right].sum() < 0.1 * weight[left].sum()


def test_what_is_farther_off_than_four_pixels_is_no_rim_of_this_contour():
    assert not rim_targets(egg(6.0), CAMERA, frames(), ROUND)[1].any()


def test_held_vertices_go_to_their_places_and_take_their_neighbours_along():
    mesh = egg()
    solver = PositionSolver(mesh.vertices, mesh.faces, skin_of(mesh.normals, 0.01), 200 * PIXEL)
    ring = np.abs(mesh.normals[:, 2]) < 0.05
    places = mesh.vertices + PIXEL * mesh.normals
    density = (0.5 * PIXEL) ** 2 * (16 * PIXEL) ** 2  # stereo is off by half a pixel over 16 by 16
    solver.add_contours(places, ring / (0.1 * PIXEL) ** 2, density)
    moved = ((solver.positions() - mesh.vertices) * mesh.normals).sum(axis=1) / PIXEL
    assert moved[ring].mean() == pytest.approx(1.0, abs=0.1)
    beside = (np.abs(mesh.normals[:, 2]) > 0.1) & (np.abs(mesh.normals[:, 2]) < 0.2)
    far = np.abs(mesh.normals[:, 2]) > 0.98
    assert moved[beside].mean() > 0.5
    assert np.abs(moved[far]).max() < 0.6
