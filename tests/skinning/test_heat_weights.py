"""Weights by heat along the cloth: a flank keeps to the trunk, and what was only captured as one is cut."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recipes.walk_motion import walking_motion
from tests.result_files import write_mesh_sequence
from tests.skinning.conftest import tube
from vntoolkit.__main__ import main
from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh, MeshSequence, vertex_normals
from vntoolkit.geometry.motion import Motion, Skeleton, bone_segments, rest_pose
from vntoolkit.io.motion.bvh import write_bvh
from vntoolkit.options.dressing import (
    ClockOptions,
    DressOptions,
    Falloff,
    Loop,
    WeightOptions,
)
from vntoolkit.pipeline.dress import DressedFigure, dress, read_motion
from vntoolkit.skinning.attachment import covered_bones, weights_of_garment
from vntoolkit.skinning.weights import weights_from_distances

HEAT = WeightOptions()
PUBLISHED = WeightOptions(falloff=Falloff.INVERSE)


def raised_arms(angle_deg: float) -> Motion:
    """Return a figure that stands and lifts both arms, from 45° below level to `angle_deg` higher."""
    walk, frames = walking_motion(), 20
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (frames, len(walk.skeleton.names), 1))
    for name, sign in (("LeftArm", -1.0), ("RightArm", 1.0)):
        turns = Rotation.from_euler("z", sign * np.linspace(0, [angle_deg], frames), degrees=True)
        rotations[:, walk.skeleton.index_of(name)] = turns.as_quat()
    still = np.tile(walk.skeleton.offsets[:1], (frames, 1))
    return replace(walk, rotations=rotations, root_positions=still, frame_rate_hz=60)


def sheet_seen_from_the_front(cuff_x: float) -> MeshSequence:
    """Return one sheet over trunk and sleeves as a height field shows them, joined wherever they meet."""
    step = 0.008
    x, y = np.meshgrid(np.arange(-0.5, 0.5, step), np.arange(-0.05, 0.64, step))
    depth = np.full(x.shape, np.inf)
    trunk = (np.abs(x) < 0.18) & (y > 0) & (y < 0.62)
    depth[trunk] = -0.6 * np.sqrt(0.18**2 - x[trunk] ** 2)
    for side in (-1.0, 1.0):
        start, end = np.array([side * 0.15, 0.07]), np.array([side * cuff_x, 0.50])
        axis = (end - start) / np.linalg.norm(end - start)
        along = (x - start[0]) * axis[0] + (y - start[1]) * axis[1]
        across = (x - start[0]) * axis[1] - (y - start[1]) * axis[0]
        sleeve = (np.abs(across) < 0.065) & (along > -0.03) & (along < np.linalg.norm(end - start))
        height = -np.sqrt(0.065**2 - np.minimum(np.abs(across), 0.065) ** 2)
        depth[sleeve] = np.minimum(depth, height)[sleeve]
    seen = np.isfinite(depth)
    index = np.full(x.shape, -1)
    index[seen] = np.arange(seen.sum())
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    vertices = np.stack([x[seen], y[seen], 5 + depth[seen]], axis=1)
    sheet = Mesh(vertices=vertices, faces=faces[(faces >= 0).all(axis=1)].astype(np.int32))
    return MeshSequence(template=sheet, vertices=np.repeat(vertices[None], 30, axis=0))


def stretch(dressed: DressedFigure, frame: int) -> np.ndarray:
    """Return (m,): how much the most stretched edge of each triangle has grown since the attachment."""

    def lengths(vertices):
        corners = vertices[dressed.template.faces]
        return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)

    return (lengths(dressed.frame(frame)) / lengths(dressed.template.vertices)).max(axis=1)


def of_arms(dressed: DressedFigure) -> np.ndarray:
    """Return (n,): each vertex's weight on either arm."""
    arms = [i for i, name in enumerate(dressed.motion.skeleton.names) if name.endswith(("Arm", "Hand"))]
    return np.where(np.isin(dressed.weights.joints, arms), dressed.weights.weights, 0).sum(axis=1)


def test_heat_decays_along_a_tube_as_the_equation_says() -> None:
    skeleton = Skeleton(
        names=("left", "right"),
        parents=np.array([-1, 0]),
        offsets=np.array([[-1.0, 0, 0], [1.0, 0, 0]]),
        tip_joints=np.array([1]),
        tip_offsets=np.array([[1.0, 0, 0]]),
    )
    radius = 0.1
    points, faces = tube([-0.999, 0, 0], [0.999, 0, 0], radius, radius, 401, 48)
    points[:, 2] /= 0.65  # round
    weights = weights_of_garment(Mesh(vertices=points, faces=faces), skeleton, rest_pose(skeleton), HEAT)
    right = np.where(weights.joints == 1, weights.weights, 0).sum(axis=1)
    decay = 0.5 * np.exp(-np.sqrt(2) * np.abs(points[:, 0]) / radius)
    np.testing.assert_allclose(right, np.where(points[:, 0] > 0, 1 - decay, decay), rtol=0, atol=0.02)


def test_a_vertex_covers_the_bone_that_a_ball_within_meets_first(rng: np.random.Generator) -> None:
    count, bones = 300, 7
    vertices, normals = rng.normal(size=(2, count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    starts, ends = rng.normal(size=(2, bones, 3))
    found, distances = covered_bones(vertices, normals, np.arange(bones), starts, ends)
    t = np.linspace(0, 1, 4001)[:, None]
    for vertex, normal, joint, distance in zip(vertices, normals, found, distances, strict=True):
        away = starts[:, None] + t * (ends - starts)[:, None] - vertex
        depth = -away @ normal
        squared = (away**2).sum(axis=2)
        radii = np.where(depth > 1e-12, squared / (2 * np.maximum(depth, 1e-12)), np.inf)
        least = radii.min(axis=1)
        if not np.isfinite(least).any():
            assert joint == -1
            continue
        assert least[joint] <= least.min() * (1 + 1e-3)
        place = radii[joint].argmin()
        assert distance == pytest.approx(np.sqrt(squared[joint, place]), rel=0.02, abs=1e-3)


def test_a_flank_keeps_to_the_trunk_although_an_arm_hangs_nearer() -> None:
    sheet, share = sheet_seen_from_the_front(0.42), {}
    x, y, _ = sheet.template.vertices.T
    flank = (np.abs(x) > 0.13) & (np.abs(x) < 0.18) & (y > 0.32)  # below the armpit
    assert flank.sum() > 300
    for options in (HEAT, PUBLISHED):
        share[options.falloff] = of_arms(dress(sheet, raised_arms(90), DressOptions(weights=options)))[flank]
    assert np.quantile(share[Falloff.HEAT], 0.9) < 0.1
    assert (
        np.quantile(share[Falloff.INVERSE], 0.9) > 0.3
    )  # the published rule hands the flank to the arm: heat is needed


def test_raised_arms_stretch_less_cloth_than_with_the_published_weights() -> None:
    share = {}
    for options in (HEAT, PUBLISHED):
        dressed = dress(
            sheet_seen_from_the_front(0.42),
            raised_arms(90),
            DressOptions(weights=options, max_stretch=0),
        )
        share[options.falloff] = (stretch(dressed, 19) > 2).mean()
    # the trunk keeps still, so the cloth under a raised arm bears all of it
    assert share[Falloff.HEAT] < 0.4 * share[Falloff.INVERSE]


@pytest.mark.slow
def test_real_motion_stretches_less_cloth_than_with_the_published_weights(real_data: Path) -> None:
    sheet = sheet_seen_from_the_front(0.42)
    sheet = MeshSequence(template=sheet.template, vertices=sheet.vertices[:1], frame_rate_hz=60)
    for name in ("charleston1.amc", "lambada.amc", "131_01.bvh"):
        motion, share = read_motion(real_data / "mocap" / name), {}
        for options in (HEAT, PUBLISHED):
            clock = ClockOptions(loop=Loop.REPEAT, frame_rate_hz=4)
            dressed = dress(sheet, motion, DressOptions(weights=options, clock=clock))
            grown = np.stack([stretch(dressed, frame) for frame in range(len(dressed))])
            share[options.falloff] = (grown > 3).mean()
        assert share[Falloff.INVERSE] > 0.02  # a web of stretched triangles, under each raised arm
        assert share[Falloff.HEAT] < 0.0005


@pytest.mark.slow
def test_sleeves_captured_as_one_with_the_trunk_are_cut_loose() -> None:
    touching, apart = sheet_seen_from_the_front(0.24), sheet_seen_from_the_front(0.42)
    web = dress(touching, raised_arms(90), DressOptions(max_stretch=0))
    cut = dress(touching, raised_arms(90))
    assert web.cut_triangles == 0
    assert 0 < cut.cut_triangles == len(web.template.faces) - len(cut.template.faces)
    assert (stretch(web, 19) > 3).sum() > 100
    assert (stretch(cut, 19) > 3).sum() < 0.1 * (stretch(web, 19) > 3).sum()
    assert dress(apart, raised_arms(90)).cut_triangles < 0.25 * cut.cut_triangles
    assert dress(touching, raised_arms(90), DressOptions(weights=PUBLISHED)).cut_triangles == 0
    np.testing.assert_array_equal(cut.cloth.vertices, touching.vertices)


@pytest.mark.slow
def test_command_line_says_how_many_triangles_it_cut(tmp_path: Path, capsys) -> None:
    write_mesh_sequence(tmp_path / "track", sheet_seen_from_the_front(0.24))
    write_bvh(tmp_path / "raised.bvh", raised_arms(90))
    common = ["dress", str(tmp_path), "--motion", str(tmp_path / "raised.bvh"), "--out"]
    assert main([*common, str(tmp_path / "a.usdc")]) == 0
    assert re.search(r", 60 frames per second; \d{2,4} triangles cut\n", capsys.readouterr().out)
    assert main([*common, str(tmp_path / "b.usdc"), "--max-stretch", "0"]) == 0
    assert "cut" not in capsys.readouterr().out


@pytest.mark.parametrize("neighbours", [None, 1, 3, 100])
def test_weights_sum_to_one_on_any_mesh(jumper: Mesh, neighbours: int | None) -> None:
    motion = walking_motion().in_metres(1.7)
    centred = jumper.vertices - jumper.vertices.mean(axis=0) + motion.skeleton.rest_positions[1]
    vertices = np.concatenate([centred, centred[:40], motion.skeleton.rest_positions])  # some without a face
    corners = np.arange(40)
    flat = np.stack([corners, corners, corners + len(centred)], axis=1)  # triangles without area
    garment = Mesh(vertices=vertices, faces=np.concatenate([jumper.faces, flat]))
    options = WeightOptions(neighbours=neighbours)
    weights = weights_of_garment(garment, motion.skeleton, rest_pose(motion.skeleton), options)
    assert weights.weights.min() >= 0
    np.testing.assert_allclose(weights.weights.sum(axis=1), 1, rtol=0, atol=1e-12)
    assert weights.joints.shape[1] <= options.bones
    assert np.all(np.diff(np.sort(weights.joints, axis=1), axis=1) > 0)  # no bone twice
    assert np.all(np.diff(weights.weights, axis=1) <= 0)  # the heaviest first, as the dual blend expects


@pytest.mark.parametrize("faces", [np.zeros((0, 3), int), np.array([[0, 0, 1]]), np.array([[0, 1, 2]])])
def test_hardly_a_garment_is_dressed_too(faces: np.ndarray) -> None:
    vertices = np.array([[0, 0, 0], [0.2, 0.5, 0], [0.1, 0.1, 0.2], [0, 0.3, 0]])
    scrap = MeshSequence(template=Mesh(vertices=vertices, faces=faces), vertices=vertices[None])
    dressed = dress(scrap, walking_motion())
    np.testing.assert_allclose(dressed.weights.weights.sum(axis=1), 1, rtol=0, atol=1e-12)
    assert np.isfinite(dressed.frame(0)).all()


def test_a_scaled_garment_on_a_scaled_figure_has_the_same_weights(jumper: Mesh) -> None:
    motion = walking_motion().in_metres(1.7)
    skeleton, pose = motion.skeleton, rest_pose(motion.skeleton)
    aside = skeleton.rest_positions[1] + [0.013, 0, 0.007]  # so that left and right never tie
    centred = jumper.vertices - jumper.vertices.mean(axis=0) + aside
    small = weights_of_garment(jumper.with_vertices(centred), skeleton, pose, HEAT)
    large_skeleton = skeleton.scaled(1000.0)
    large = weights_of_garment(
        jumper.with_vertices(1000 * centred), large_skeleton, rest_pose(large_skeleton), HEAT
    )
    np.testing.assert_array_equal(large.joints[:, 0], small.joints[:, 0])
    np.testing.assert_allclose(large.weights, small.weights, rtol=0, atol=1e-9)


def test_normals_decide_which_side_is_within(jumper: Mesh) -> None:
    motion = walking_motion().in_metres(1.7)
    centred = jumper.vertices - jumper.vertices.mean(axis=0) + motion.skeleton.rest_positions[1]
    bones = bone_segments(motion.skeleton, rest_pose(motion.skeleton))
    normals = vertex_normals(centred, jumper.faces)
    trunk = slice(0, len(centred) // 3)
    gaps = [covered_bones(centred, sign * normals, *bones)[1][trunk] for sign in (1, -1)]
    assert np.median(gaps[0]) < 0.25
    assert np.median(gaps[1]) > 2 * np.median(gaps[0])


def test_refusals() -> None:
    skeleton = walking_motion().skeleton
    with pytest.raises(BadInput, match="use `weights_of_garment`"):
        weights_from_distances(np.zeros((1, 3)), skeleton, rest_pose(skeleton), HEAT)
