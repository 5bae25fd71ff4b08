"""The rigid scenes are what they claim: poses, shapes, markers that a detector finds where truth says."""

from functools import cache

import cv2
import numpy as np
import pytest

from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.board_layout import MARKER_DICTIONARY, BoardLayout
from vntoolkit.geometry.rays import RayScene
from vntoolkit.options.simulation import Nuisances, RenderOptions, SceneOptions, nuisance_names
from vntoolkit.simulation.render import Renderer, frame_generator, render_frame
from vntoolkit.simulation.rigid.gel import BALL_RADIUS_M, dent
from vntoolkit.simulation.scene import build_scene

MINE = ("sphere", "cylinder", "board", pytest.param("jacket", marks=pytest.mark.slow))


@cache
def small(name):
    """A scene of few pixels; the jacket takes seconds to sew."""
    return build_scene(name, SceneOptions(width=160, height=120, seed=2))


@pytest.fixture(scope="module")
def board():
    return build_scene("board", SceneOptions(width=960, height=720))


def test_a_detector_finds_the_boards_corners_where_its_pose_puts_them(board):
    """ChArUco corners against the projected layout; nuisances on. Also proves that nothing is mirrored."""
    layout = BoardLayout()
    size = (layout.columns, layout.rows)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, MARKER_DICTIONARY))
    charuco = cv2.aruco.CharucoBoard(size, layout.square_mm, layout.marker_mm, dictionary)
    detector = cv2.aruco.CharucoDetector(charuco)
    for number in (0, 140):
        frame = render_frame(board, number, options=RenderOptions(samples=5))
        grey = cv2.cvtColor(frame.stored, cv2.COLOR_RGB2GRAY)
        found, ids, _, _ = detector.detectBoard(grey)
        sound = np.isin(ids.ravel(), layout.sound_corner_ids)
        assert sound.sum() > 0.7 * len(layout.sound_corner_ids)
        flat = np.column_stack([layout.corners_mm, np.zeros(len(layout.corners_mm))]) / 1000
        expected = board.camera.project(board.camera_from_object(number).apply(flat))
        error = np.linalg.norm(found.reshape(-1, 2)[sound] - expected[ids.ravel()[sound]], axis=1)
        assert np.median(error) < 0.25
        assert error.max() < 1.5


def test_the_sample_fills_the_hole_and_the_board_turns_through_many_orientations(board):
    layout, normals = BoardLayout(), []
    for number in range(board.frame_count):
        pose = board.camera_from_object(number)
        normals.append(pose.rotate(np.array([0.0, 0.0, -1.0])))
        corners = layout.hole_mm
        outline = np.array([[-12, -12], [188, -12], [188, 188], [-12, 188]], dtype=float)
        outside = board.camera.project(pose.apply(np.column_stack([outline, np.zeros(4)]) / 1000))
        assert outside.min() > 0
        assert np.all(outside < [960, 720])
    normals = np.array(normals)
    tilt = np.rad2deg(np.arccos(-normals[:, 2]))
    assert tilt.max() > 40
    assert np.ptp(normals[:, 0]) > 1.0
    assert np.ptp(normals[:, 1]) > 1.0
    frame = render_frame(board, 10, options=RenderOptions(samples=9))  # which even out the weave
    grid = np.stack(np.meshgrid(*np.linspace(corners[0] + 2, corners[2] - 2, 20).T), -1).reshape(-1, 2)
    points = board.camera_from_object(10).apply(np.column_stack([grid, np.ones(len(grid))]) / 1000)
    u, v = np.rint(board.camera.project(points)).astype(int).T
    assert np.abs(frame.truth.depth.depth[v, u] - points[:, 2]).max() < 1e-3
    assert frame.radiance[v, u, 1].std() < 0.1 * frame.radiance[v, u, 1].mean()


def test_cylinder_points_lie_at_its_radius_under_every_pose():
    scene = build_scene("cylinder", SceneOptions(width=320, height=240))
    moved = []
    for number in (0, 50, 120, 179):
        frame = render_frame(scene, number, options=RenderOptions(samples=1))
        mask = frame.truth.depth.mask
        points = scene.camera.points_from_depth(frame.truth.depth.depth)[mask]
        pose = scene.camera_from_object(number)
        in_object = pose.inverse().apply(points)
        radius = np.hypot(in_object[:, 0], in_object[:, 2])
        side = np.abs(in_object[:, 1]) < scene.facts["length_m"] / 2 - 1e-4
        assert side.sum() > 1000
        assert np.abs(radius[side] - scene.facts["radius_m"]).max() < 1e-4
        assert not mask[[0, -1]].any()
        assert not mask[:, [0, -1]].any()
        moved.append(np.concatenate([pose.rotation_vector, pose.translation]))
    assert np.all(np.ptp(moved, axis=0) > [0.2, 0.2, 0.2, 0.02, 0.02, 0.02])


@pytest.mark.parametrize("name", MINE)
def test_faces_look_outwards(name):
    """Rays from the camera meet faces whose own normal looks at it (the jacket shows some of its inside)."""
    scene = small(name)
    frame = render_frame(scene, 0, options=RenderOptions(samples=1))
    vertices, faces = scene.vertices(0), scene.surface.faces
    directions = scene.camera.unproject(scene.camera.pixel_grid(), np.ones((120, 160))).reshape(-1, 3)
    rays = np.concatenate([np.zeros_like(directions), directions], axis=1).astype(np.float32)
    hits = RayScene((vertices, faces)).first_hits(rays)
    a, b, c = (vertices[faces[hits.faces, i]] for i in range(3))
    facing = np.sum(np.cross(b - a, c - a) * directions[hits.rays], axis=1) < 0
    assert facing.mean() > (0.97 if name == "jacket" else 0.9999)
    normals = frame.truth.normals
    seen_from = directions.reshape(120, 160, 3)
    assert np.all(np.sum(normals.normals_in_camera * seen_from, axis=2)[normals.mask] <= 1e-6)


@pytest.mark.parametrize("name", MINE)
def test_vertices_do_not_depend_on_the_order_of_asking(name):
    scene = small(name)
    last = scene.vertices(scene.frame_count - 1)
    scene.vertices(0)
    assert np.array_equal(scene.vertices(scene.frame_count - 1), last)


def test_every_nuisance_can_be_turned_off_alone():
    given = Nuisances(transfer="srgb")
    worlds = {"all": given, "none": Nuisances.none(), **{n: given.without(n) for n in nuisance_names()}}
    for name in nuisance_names():
        changed = [f for f in vars(worlds["all"]) if getattr(worlds[name], f) != getattr(worlds["all"], f)]
        assert changed == [name]
        assert not getattr(worlds["none"], name) or name == "transfer"
    assert worlds["none"].transfer == "linear"


def test_a_frame_beyond_the_end_and_another_topology_are_refused():
    scene = build_scene("sphere", SceneOptions(width=64, height=48))
    with pytest.raises(BadInput, match="frame from 0 to 59, got 60"):
        render_frame(scene, 60)
    with pytest.raises(BadMesh, match="another topology"):
        Renderer(scene).render(scene.vertices(0)[:-1], None, frame_generator(0, 0))
    broken = scene.vertices(0).copy()
    broken[5] = np.nan
    with pytest.raises(BadMesh, match="NaN"):
        Renderer(scene).render(broken, None, frame_generator(0, 0))


def test_the_gel_is_the_ball_inside_the_contact_and_comes_to_rest_around_it():
    scene = build_scene("gel", SceneOptions(width=160, height=120, seed=2))
    assert np.ptp(scene.vertices(0)[:, 2]) == 0
    contact_m = 0.5 * BALL_RADIUS_M
    distance = np.linspace(0, 5 * contact_m, 2001)
    depth = dent(distance, contact_m)
    assert depth[0] == pytest.approx(contact_m**2 / BALL_RADIUS_M)  # Hertz
    inside = distance < contact_m
    ball = np.sqrt(BALL_RADIUS_M**2 - distance[inside] ** 2)
    np.testing.assert_allclose(depth[0] - depth[inside], BALL_RADIUS_M - ball, atol=1e-12)
    assert np.all(np.diff(depth) <= 0)
    assert np.abs(np.diff(depth)).max() < 1.5 * contact_m / BALL_RADIUS_M * distance[1]  # no step at the rim
    assert depth[-1] < 1e-3 * depth[0]
    pressed = scene.vertices(5)
    assert pressed[:, 2].max() <= scene.centre[2]
    assert scene.centre[2] - pressed[:, 2].min() > 0.4e-3  # towards the camera
    seen = scene.camera.project(pressed)
    assert seen.min() < 0
    assert np.all(seen.max(axis=0) > [160, 120])  # the gel fills the picture
    stored = render_frame(scene, 5, options=RenderOptions(samples=1)).stored
    assert stored.max() < 255
