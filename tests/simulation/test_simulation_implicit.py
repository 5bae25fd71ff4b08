"""Implicit bodies and their meshes; the legs of the spandex scene."""

import numpy as np
import pytest

from recipes.scene_shapes import Capsule, Ellipsoid, both_sides, mesh_from_implicit, signed_distance
from vntoolkit.geometry.mesh import face_normals
from vntoolkit.simulation.spandex import LegPose, Legs, step_at


def test_a_ball_is_meshed_as_a_closed_outward_ball() -> None:
    body = [Ellipsoid((0.2, -0.1, 0.3), (2.0, 2.0, 2.0), 0.0)]
    vertices, faces = mesh_from_implicit(body, np.full(3, -2.6), np.full(3, 2.9), 0.1)
    offset = vertices - [0.2, -0.1, 0.3]
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), 2.0, atol=1e-4)
    normals = face_normals(vertices, faces)
    assert np.all(np.sum(normals * offset[faces[:, 0]], axis=1) > 0)
    volume = np.sum(normals * vertices[faces[:, 0]]) / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 8.0, rel=5e-3)
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    uses = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)[1]
    assert np.all(uses == 2)
    assert len(vertices) - len(uses) + len(faces) == 2


def test_a_mirrored_part_is_as_far_from_mirrored_points(rng: np.random.Generator) -> None:
    parts = both_sides(
        Capsule((1.0, 0.0, 0.0), (4.0, 1.0, 0.0), (0.5, 0.3), 0.4),
        Ellipsoid((0.5, 0.0, 0.0), (1.0, 0.6, 0.8), 0.5, (0.3, -0.2, 0.1)),
    )
    points = rng.uniform(-5.0, 5.0, (300, 3))
    for part, mirrored in zip(parts[::2], parts[1::2], strict=True):
        np.testing.assert_allclose(part.distance(points), mirrored.distance(points * [-1, 1, 1]), atol=1e-12)


def test_carving_takes_away_and_blending_adds() -> None:
    ball = Ellipsoid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.0)
    hole = Ellipsoid((1.0, 0.0, 0.0), (0.5, 0.5, 0.5), -0.05)
    more = Ellipsoid((1.0, 0.0, 0.0), (0.5, 0.5, 0.5), 0.05)
    point = np.array([[0.8, 0.0, 0.0]])
    assert signed_distance([ball], point)[0] == pytest.approx(-0.2)
    assert signed_distance([ball, hole], point)[0] == pytest.approx(0.3, abs=0.02)
    assert signed_distance([ball, more], point)[0] == pytest.approx(-0.3, abs=0.02)


@pytest.fixture(scope="module")
def legs() -> Legs:
    return Legs()


def test_the_rest_pose_is_the_rest_and_the_turn_is_rigid(legs: Legs) -> None:
    np.testing.assert_allclose(legs.vertices(LegPose()), legs.rest, atol=1e-9)
    some = legs.vertices(LegPose(turn_deg=30.0, sway_cm=(2.0, 1.0)))[::400]
    before = np.linalg.norm(legs.rest[::400][:, None] - legs.rest[::400][None], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(some[:, None] - some[None], axis=-1), before, atol=1e-9)


def test_a_raised_knee_comes_forward_and_leaves_the_other_leg(legs: Legs) -> None:
    raised = legs.vertices(LegPose(raise_deg=(40.0, 0.0), knee_deg=(50.0, 0.0)))
    knee = np.linalg.norm(legs.rest - [-9.2, -43.0, 6.0], axis=1).argmin()
    assert raised[knee, 2] > legs.rest[knee, 2] + 20.0
    other = legs.rest[:, 0] > 2.0
    np.testing.assert_allclose(raised[other], legs.rest[other], atol=1e-9)


def test_the_step_crosses_the_legs_without_pinching(legs: Legs) -> None:
    edges = np.unique(np.sort(legs.faces[:, :2], axis=1), axis=0)
    rest = np.linalg.norm(legs.rest[edges[:, 0]] - legs.rest[edges[:, 1]], axis=1)
    for time_s in np.linspace(0.0, 2.0, 9):
        points = legs.vertices(step_at(time_s, 0.0))
        stretch = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1) / rest
        assert np.percentile(stretch, 0.5) > 0.4
        assert np.percentile(stretch, 99.5) < 1.9
