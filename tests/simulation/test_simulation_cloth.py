"""The sweater: one topology, cloth that neither stretches nor bursts nor enters the body."""

import numpy as np
import pytest

from recipes.scene_shapes import sew_sweater
from vntoolkit.geometry.mesh import edges_from_faces
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.simulation.garment.solver import AIR_DRAG, Capsules, ClothSolver
from vntoolkit.simulation.garment.sweater import (
    DancingGarment,
    Pose,
    body_from_pose,
    build_sweater,
    loop_subdivision,
)

COARSE_M = 0.03
THICK_M = 0.02


def edge_uses(faces: np.ndarray) -> np.ndarray:
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)[1]


@pytest.mark.parametrize("edge_length", [0.0125, 0.02, 0.03])
def test_a_sewn_sweater_is_a_sphere_with_four_openings(edge_length: float) -> None:
    garment = sew_sweater(edge_length)
    uses = edge_uses(garment.faces)
    assert set(uses) == {1, 2}
    assert len(garment.flat) - len(uses) + len(garment.faces) == 2 - 4  # neck, two cuffs, hem
    assert len(np.unique(garment.faces)) == len(garment.flat)


def test_faces_of_the_dressed_garment_point_away_from_the_body() -> None:
    body = body_from_pose(Pose())
    garment = sew_sweater(COARSE_M)
    solver = ClothSolver(garment, body, THICK_M)
    for _ in range(10):
        solver.settle(body)
    a, b, c = (solver.positions[garment.faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    step = 1e-3 * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    middle = (a + b + c) / 3
    outwards = body.signed_distance(middle + step) > body.signed_distance(middle - step)
    assert outwards.mean() > 0.95


def test_capsule_distance_is_that_of_spheres_and_cylinders() -> None:
    body = Capsules(
        starts=np.array([[0.0, 0, 0]]), ends=np.array([[0.0, 2, 0]]), radii=np.array([[0.5, 0.5]])
    )
    points = np.array([[2.0, 1, 0], [0, 3, 0], [0, -1, 0], [0, 1, 0.1]])
    np.testing.assert_allclose(body.signed_distance(points), [1.5, 0.5, 0.5, -0.4], atol=1e-12)


def test_flat_cloth_has_no_curvature_and_a_cylinder_has_its_own() -> None:
    far = Capsules(starts=np.full((1, 3), 50.0), ends=np.full((1, 3), 51.0), radii=np.ones((1, 2)))
    garment = sew_sweater(COARSE_M)
    solver = ClothSolver(garment, far, THICK_M)
    uses_front = (garment.panel[solver.hinges] == 0).all(axis=1)
    hinges, stencils = solver.hinges[uses_front], solver.stencils[uses_front]
    middle = garment.flat[hinges].mean(axis=1)
    inner = (np.abs(middle[:, 0]) < 0.2) & (middle[:, 1] < -0.2) & (middle[:, 1] > -0.6)
    plane = garment.flat @ np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0]])
    flat = np.linalg.norm(np.einsum("hc,hcd->hd", stencils[inner], plane[hinges[inner]]), axis=1)
    np.testing.assert_allclose(flat, 0.0, atol=1e-12)
    radius = 0.5
    angle = garment.flat[:, 0] / radius
    cylinder = np.stack([radius * np.sin(angle), garment.flat[:, 1], radius * np.cos(angle)], axis=1)
    bent = np.linalg.norm(np.einsum("hc,hcd->hd", stencils[inner], cylinder[hinges[inner]]), axis=1)
    # in a lattice of equilateral triangles of edge l, one row of edges round the cylinder, an edge at angle
    # φ to the axis has |Σ k x| = 2/√3 (3/4 cos²φ − 1/4 sin²φ) l²/r: 0.481 l²/r in the mean
    corners = garment.flat[garment.faces[: len(garment.faces) // 2]]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    doubled_area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).mean()
    squared_edge = doubled_area / np.sqrt(0.75)
    assert bent.mean() == pytest.approx(0.481 * squared_edge / radius, rel=0.06)


def test_cloth_in_the_air_falls_as_drag_lets_it() -> None:
    far = Capsules(starts=np.full((1, 3), 50.0), ends=np.full((1, 3), 51.0), radii=np.ones((1, 2)))
    solver = ClothSolver(sew_sweater(COARSE_M), far, 1e-4)
    solver.positions[:, 2] = 0.0
    before = solver.positions[:, 1].mean()
    frames, drag = 30, AIR_DRAG
    for _ in range(frames):
        solver.advance(far, far)
    time = frames / 60.0
    fall = 9.81 / drag * (time - (1.0 - np.exp(-drag * time)) / drag)
    assert before - solver.positions[:, 1].mean() == pytest.approx(fall, rel=0.02)


@pytest.fixture(scope="module")
def danced() -> tuple[DancingGarment, list[np.ndarray], list[float]]:
    garment = DancingGarment(3, sew_sweater(COARSE_M), THICK_M)
    cages, energies = [], []
    for frame in range(60):
        cages.append(garment.cage(frame))
        energies.append(0.5 * float(np.mean(np.sum(garment.solver.velocities**2, axis=1))))
    return garment, cages, energies


def test_the_dance_does_not_stretch_the_cloth(danced):
    solver = danced[0].solver
    ends = solver.positions[solver.edges]
    strain = np.abs(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / solver.rest_lengths - 1.0)
    assert np.median(strain) < 0.03
    assert np.percentile(strain, 99) < 0.20  # ribbing stretched over hips and wrists; the fine cage: 0.15


def test_no_point_of_the_cloth_is_inside_the_body(danced):
    garment, cages, _ = danced
    for frame, cage in enumerate(cages):
        assert garment.body(frame).signed_distance(cage).min() > 0.003  # of a margin of 6 mm


def test_the_dance_neither_stops_nor_bursts(danced):
    energies = np.array(danced[2])  # per mass, m²/s²: a dancer sways at some tenths of a metre per second
    assert 0.002 < energies.mean() < 0.3
    assert energies.max() < 1.0
    jumps = [np.linalg.norm(b - a, axis=1) for a, b in zip(danced[1][:-1], danced[1][1:], strict=True)]
    assert np.max([np.percentile(jump, 95) for jump in jumps]) < 0.02  # metres a frame


def test_the_same_seed_dances_the_same_and_another_does_not(danced):
    garment, cages, _ = danced
    again = DancingGarment(3, sew_sweater(COARSE_M), THICK_M)
    for frame in (4, 6, 5):  # an earlier frame starts again
        assert np.array_equal(again.cage(frame), cages[frame])
    other = DancingGarment(4, sew_sweater(COARSE_M), THICK_M)
    assert not np.allclose(garment.body(0).ends, other.body(0).ends)


def test_loop_subdivision_reproduces_planes_and_smooths_a_rim_within_itself(rng):
    garment = sew_sweater(COARSE_M)
    smooth, halve, finer = loop_subdivision(garment.faces, len(garment.flat))
    count = len(garment.flat)
    for matrix in (smooth, halve):
        np.testing.assert_allclose(np.asarray(matrix.sum(axis=1)).ravel(), 1.0, atol=1e-12)
        assert matrix.min() >= 0.0
        np.testing.assert_allclose(matrix @ np.full(count, 7.0), 7.0)
    assert len(finer) == 4 * len(garment.faces)
    assert smooth.shape[0] == count + len(edges_from_faces(garment.faces))
    noise = rng.standard_normal(count)
    assert np.ptp(smooth @ noise) <= np.ptp(noise)


@pytest.mark.slow
def test_the_scene_is_dense_keeps_its_topology_and_moves_a_few_pixels() -> None:
    scene = build_sweater(SceneOptions())
    count = scene.surface.faces.max() + 1
    first, second = scene.vertices(0), scene.vertices(1)
    assert count >= 60_000
    assert first.shape == second.shape == (count, 3)
    motion = np.linalg.norm(scene.camera.project(second) - scene.camera.project(first), axis=1)
    assert 0.05 < np.median(motion) < 4.0
    inside = (scene.camera.project(first) >= 0) & (scene.camera.project(first) <= [639, 479])
    assert inside.mean() > 0.97
