"""From a tracked garment and a motion to files: it hangs on the figure and moves with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recipes.walk_motion import walking_motion
from tests.result_files import write_mesh_sequence
from tests.usd_reading import read_usd_sequence
from vntoolkit.__main__ import main
from vntoolkit.errors import BadInput, BadMotion
from vntoolkit.geometry.garment_fit import GarmentFit, Landmark, fit_similarity
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.geometry.motion import Motion, Skeleton, bone_segments, pose_of_frame
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.motion.bvh import write_bvh
from vntoolkit.options.dressing import (
    Anchor,
    Blend,
    ClockOptions,
    DressOptions,
    Garment,
    GarmentFitOptions,
    MotionUpAxis,
)
from vntoolkit.pipeline.dress import DressedFigure, dress, read_motion
from vntoolkit.skinning.anatomy import anatomy_of, facing_of, shoulders_of

WALK = Path(__file__).parents[2] / "data" / "walk.bvh"


def gaps_to_torso(dressed: DressedFigure, frame: int) -> np.ndarray:
    """Distance of every vertex to the nearest bone in a frame."""
    _, starts, ends = bone_segments(dressed.motion.skeleton, pose_of_frame(dressed.motion, frame))
    axis = ends - starts
    best = np.full(len(dressed.cloth.template.vertices), np.inf)
    for start, bone in zip(starts, axis, strict=True):
        away = dressed.frame(frame) - start
        along = np.clip(away @ bone / (bone @ bone), 0, 1)
        best = np.minimum(best, np.linalg.norm(away - along[:, None] * bone, axis=1))
    return best


@pytest.mark.parametrize("blend", list(Blend))
def test_garment_stays_on_the_figure(moving_jumper: MeshSequence, blend: Blend) -> None:
    dressed = dress(moving_jumper, walking_motion(), DressOptions(blend=blend))
    assert len(dressed) == 30
    for frame in (0, 12, 29):
        assert gaps_to_torso(dressed, frame).max() < 0.30  # metres: a wide jumper's radius
        hips = dressed.motion.root_positions[frame]
        assert np.linalg.norm(dressed.frame(frame).mean(axis=0) - hips) < 0.45
    frames = list(dressed.frames())
    np.testing.assert_array_equal(frames[12], dressed.frame(12))


def test_garment_keeps_its_own_motion(moving_jumper: MeshSequence) -> None:
    """The ripple of the capture survives: a still skeleton shows the captured shape, scaled."""
    walk = walking_motion()
    still = Motion(
        skeleton=walk.skeleton,
        rotations=np.tile([0.0, 0, 0, 1], (60, 19, 1)),
        root_positions=np.tile(walk.skeleton.offsets[:1], (60, 1)),
        frame_rate_hz=60,
    )
    dressed = dress(moving_jumper, still, DressOptions(anchor=Anchor.NONE), GarmentFit(bind_frame=0))
    for frame in (0, 13):
        expected = dressed.fitting.rest_from_cloth.apply(moving_jumper.vertices[frame])
        np.testing.assert_allclose(dressed.frame(frame), expected, atol=1e-9)


def test_steps_of_the_performer_are_taken_out(moving_jumper: MeshSequence) -> None:
    stepped = np.array(moving_jumper.vertices, dtype=np.float64)
    centre = stepped.mean(axis=(0, 1))
    for frame in range(30):
        step = RigidTransform.from_rotation_vector(
            [0, 0.02 * frame, 0.01 * frame], [0.01 * frame, 0, 0.02 * frame]
        )
        stepped[frame] = centre + step.apply(stepped[frame] - centre)
    wandering = MeshSequence(template=moving_jumper.template, vertices=stepped)
    plain, held = dress(moving_jumper, walking_motion()), dress(wandering, walking_motion())
    free = dress(wandering, walking_motion(), DressOptions(anchor=Anchor.NONE))
    for frame in (10, 29):
        np.testing.assert_allclose(held.frame(frame), plain.frame(frame), atol=1e-6)
        assert np.abs(free.frame(frame) - plain.frame(frame)).max() > 0.05


def test_the_walk_that_the_package_ships_is_found_anywhere(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    walk = read_motion("data/walk.bvh")
    assert np.array_equal(walk.root_positions, read_motion(WALK).root_positions)
    write_bvh(Path("data/walk.bvh"), replace(walking_motion(), frame_rate_hz=50.0))
    assert read_motion("data/walk.bvh").frame_rate_hz == pytest.approx(50.0)  # a file of one's own wins
    with pytest.raises(BadInput, match=r"data/run.bvh"):
        read_motion("data/run.bvh")


def test_an_installed_package_holds_the_walk_in_itself(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_bvh(Path("site/vntoolkit/data/walk.bvh"), walking_motion())
    monkeypatch.setattr("vntoolkit.shipped._FOLDERS", (Path("site/data"), Path("site/vntoolkit/data")))
    assert len(read_motion("data/walk.bvh").root_positions) == len(walking_motion().root_positions)


def test_real_motions_are_understood(real_data: Path, moving_jumper: MeshSequence) -> None:
    for name in ("131_01.bvh", "lambada.amc", "charleston1.amc"):
        motion = read_motion(real_data / "mocap" / name)
        anatomy = anatomy_of(motion.skeleton)
        assert len(anatomy.legs) == 10
        assert len(anatomy.arms) == 2
        assert motion.skeleton.names[anatomy.trunk[0]].lower() in ("hips", "root")
        assert facing_of(motion.skeleton, anatomy.legs)[2] < -0.99  # towards the camera
        dressed = dress(moving_jumper, motion, DressOptions(clock=ClockOptions(start=1.0)))
        shoulders = list(shoulders_of(motion.skeleton, anatomy))
        top = dressed.template.vertices[:, 1].min()  # y points down
        assert (
            top < dressed.fitting.rest_from_model[shoulders, 1, 3].min() - 0.04
        )  # the collar: above both shoulders
        for frame in (0, 29):
            assert gaps_to_torso(dressed, frame).max() < 0.35


def test_arms_are_turned_into_the_sleeves(real_data: Path, moving_jumper: MeshSequence) -> None:
    motion = read_motion(real_data / "mocap" / "lambada.amc")  # rests with arms out
    dressed = dress(moving_jumper, motion)
    skeleton = dressed.motion.skeleton
    vertices = dressed.fitting.rest_from_cloth.apply(moving_jumper.vertices[0])
    shoulder = dressed.fitting.rest_from_model[skeleton.index_of("lhumerus"), :3, 3]
    wrist = dressed.fitting.rest_from_model[skeleton.index_of("lwrist"), :3, 3]
    cuff = vertices[len(vertices) * 2 // 3 - 32 : len(vertices) * 2 // 3].mean(axis=0)  # of the left sleeve
    cosine = (wrist - shoulder) @ (cuff - shoulder)
    cosine /= np.linalg.norm(wrist - shoulder) * np.linalg.norm(cuff - shoulder)
    assert np.degrees(np.arccos(cosine)) < 5  # the way to it may bend


@pytest.mark.parametrize("tips", [0, 1])
def test_a_joint_that_leads_nowhere_is_no_arm_to_aim(jumper: Mesh, tips: int) -> None:
    """Files mark props and collars by joints beside the chest that end where they begin."""
    walk = walking_motion()
    plain, number = walk.skeleton, len(walk.skeleton.names)
    marked = replace(
        plain,
        names=(*plain.names, "Marker"),
        parents=np.append(plain.parents, plain.index_of("Chest")),
        offsets=np.vstack([plain.offsets, [10.0, -5.0, 0.0]]),
        tip_joints=np.append(plain.tip_joints, [number] * tips).astype(np.int64),
        tip_offsets=np.vstack([plain.tip_offsets, np.zeros((tips, 3))]),
    )
    still = np.tile([0.0, 0, 0, 1], (len(walk), 1, 1))
    motion = replace(walk, skeleton=marked, rotations=np.concatenate([walk.rotations, still], axis=1))
    cloth = MeshSequence(template=jumper, vertices=np.array(jumper.vertices)[None])
    dressed, expected = dress(cloth, motion), dress(cloth, walk)
    np.testing.assert_allclose(
        dressed.fitting.rest_from_model[:number], expected.fitting.rest_from_model, atol=1e-12
    )
    assert np.isfinite(dressed.frame(0)).all()


def test_a_sheet_seen_from_the_front_lies_before_the_bones(jumper: Mesh) -> None:
    front = jumper.faces[np.all(jumper.vertices[jumper.faces][..., 2] <= 5.0, axis=1)]
    sheet = MeshSequence(
        template=Mesh(vertices=jumper.vertices, faces=front), vertices=np.array(jumper.vertices)[None]
    )
    closed = MeshSequence(template=jumper, vertices=np.array(jumper.vertices)[None])
    depths = {}
    for name, cloth in (("sheet", sheet), ("closed", closed)):
        dressed = dress(cloth, walking_motion())
        trunk = list(anatomy_of(dressed.motion.skeleton).trunk)
        covered = dressed.fitting.rest_from_cloth.apply(jumper.vertices)[np.unique(cloth.template.faces)]
        depths[name] = covered[:, 2] - dressed.fitting.rest_from_model[trunk, 2, 3].mean()
    assert depths["sheet"].max() == pytest.approx(0, abs=1e-9)
    assert depths["closed"].max() == pytest.approx(-depths["closed"].min(), abs=1e-9)


def test_a_collar_seen_from_within_does_not_push_the_bones_back(jumper: Mesh) -> None:
    front = jumper.faces[np.all(jumper.vertices[jumper.faces][..., 2] <= 5.0, axis=1)]
    low = jumper.vertices.min(axis=0)
    flap = low + np.array([[0.4, 0.0, 0.5], [0.5, 0.0, 0.5], [0.45, 0.01, 0.5]])
    with_collar = np.concatenate([jumper.vertices, flap])
    faces = np.concatenate([front, len(jumper.vertices) + np.array([[0, 2, 1]])])
    bones = []
    for vertices, triangles in ((jumper.vertices, front), (with_collar, faces)):
        sheet = Mesh(vertices=vertices, faces=triangles)
        dressed = dress(MeshSequence(template=sheet, vertices=vertices[None]), walking_motion())
        bones.append(dressed.fitting.rest_from_cloth.rigid.translation[2])
    assert bones[1] == pytest.approx(bones[0], abs=1e-9)


def test_fit_is_adjustable(moving_jumper: MeshSequence) -> None:
    plain = dress(moving_jumper, walking_motion())
    moved = RigidTransform.from_rotation_vector([0, 0.3, 0], [0.02, -0.05, 0.01])
    fitted = dress(moving_jumper, walking_motion(), None, GarmentFit(scale=1.2, adjustment=moved))
    before, after = (d.fitting.rest_from_cloth.apply(moving_jumper.vertices[0]) for d in (plain, fitted))
    centre = (before.min(axis=0) + before.max(axis=0)) / 2
    expected = centre + moved.translation + 1.2 * moved.rotate(before - centre)
    np.testing.assert_allclose(after, expected, atol=1e-9)


def test_landmarks_decide(jumper: Mesh) -> None:
    cloth = MeshSequence(template=jumper, vertices=np.array(jumper.vertices)[None])
    names = ("Neck", "LeftUpLeg", "RightUpLeg", "LeftHand")
    skeleton = walking_motion().in_metres(1.7).skeleton  # 1.73 m: the shipped figure carries its unit
    truth = RigidTransform.from_rotation_vector([0.1, 0.2, -0.1], [0.3, 0.1, 4.0])
    vertices = np.array(jumper.vertices)
    targets = np.array([skeleton.rest_positions[skeleton.index_of(name)] for name in names])
    vertices[:4] = truth.apply(targets) / 2  # a garment at half scale, elsewhere
    cloth = MeshSequence(template=jumper.with_vertices(vertices), vertices=vertices[None])
    fit = GarmentFit(landmarks=tuple(Landmark(vertex=i, joint=name) for i, name in enumerate(names)))
    dressed = dress(cloth, walking_motion(), DressOptions(figure_height=1.7), fit)
    np.testing.assert_allclose(dressed.fitting.rest_from_cloth.apply(vertices[:4]), targets, atol=1e-9)
    with pytest.raises(BadMotion, match="no joint 'Nose'; it has Hips"):
        dress(cloth, walking_motion(), None, GarmentFit(landmarks=(Landmark(vertex=0, joint="Nose"),) * 3))
    with pytest.raises(BadInput, match="landmark vertex 999999"):
        dress(
            cloth, walking_motion(), None, GarmentFit(landmarks=(Landmark(vertex=999999, joint="Hips"),) * 3)
        )


def test_similarity_recovers_itself(rng: np.random.Generator) -> None:
    points = rng.normal(size=(5, 3))
    truth = RigidTransform.from_rotation_vector([1, -2, 0.5], [1, 2, 3])
    found = fit_similarity(points, truth.apply(2.5 * points))
    assert found.scale == pytest.approx(2.5)
    np.testing.assert_allclose(found.rigid.matrix, truth.matrix, atol=1e-12)


def test_a_motion_with_z_up_is_righted(moving_jumper: MeshSequence) -> None:
    walk = walking_motion()
    lying = walk.turned(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))
    upright = dress(moving_jumper, walk)
    righted = dress(moving_jumper, lying)
    np.testing.assert_allclose(righted.frame(7), upright.frame(7), atol=1e-9)
    told = dress(moving_jumper, lying, DressOptions(up_axis=MotionUpAxis.Z))
    np.testing.assert_allclose(told.frame(7), upright.frame(7), atol=1e-9)


def test_a_figure_without_legs_cannot_wear_trousers(moving_jumper: MeshSequence) -> None:
    walk = walking_motion()
    torso = Skeleton(
        names=walk.skeleton.names[:5], parents=walk.skeleton.parents[:5], offsets=walk.skeleton.offsets[:5]
    )
    motion = replace(walk, skeleton=torso, rotations=walk.rotations[:, :5])
    options = DressOptions(fitting=GarmentFitOptions(garment=Garment.SKIRT), up_axis=MotionUpAxis.Y)
    with pytest.raises(BadInput, match="no lower body for the skirt; use landmarks"):
        dress(moving_jumper, motion, options)


def test_command_line_writes_every_format(tmp_path: Path, moving_jumper: MeshSequence, capsys) -> None:
    write_mesh_sequence(tmp_path / "capture" / "track", moving_jumper)
    fit = tmp_path / "fit.json"
    fit.write_text('{"version": 1, "scale": 1.05}')
    common = ["dress", str(tmp_path / "capture"), "--motion", str(WALK)]
    out = tmp_path / "out"
    by_distance = ["--fit", str(fit), "--falloff", "inverse", "--carrier", "cache"]
    assert main([*common, "--out", str(out / "a.usdc"), *by_distance]) == 0
    assert "30 frames of 2304 vertices" in capsys.readouterr().out
    assert main([*common, "--out", str(out / "a.glb"), "--stop", "0.1", "--blend", "dual-quaternion"]) == 0
    assert main([*common, "--out", str(out / "a_%03d.ply"), "--stop", "0.05", "--loop", "ping-pong"]) == 0
    assert main([*common, "--out", str(out / "a_%03d.obj"), "--start", "1", "--stop", "1.02"]) == 0
    assert len(list(out.glob("a_*.ply"))) == 4
    assert len(list(out.glob("a_*.obj"))) == 2
    sequence = read_usd_sequence(out / "a.usdc")
    assert len(sequence) == 30
    first = read_mesh(out / "a_000.ply")
    plain = dress(moving_jumper, read_motion(WALK))
    moved = first.vertices - plain.frame(0)  # onto the floor and over the origin
    np.testing.assert_allclose(moved, np.tile(moved[:1], (len(moved), 1)), atol=1e-4)
    np.testing.assert_allclose(moved[0], plain.offset, atol=0.05)  # the floor of a shorter clip
    assert first.normals is not None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--motion", "walk.txt", "--out", "a.usdc"], "expected a motion in .bvh or .amc"),
        (["--motion", "none.bvh", "--out", "a.usdc"], "no such file"),
        (["--motion", "alone.amc", "--out", "a.usdc"], "no skeleton (.asf) of that name"),
        (["--motion", str(WALK), "--out", "a.usdc", "--start", "100"], "nothing lies between"),
        (["--motion", str(WALK), "--out", "a.usdc", "--fullness", "-1"], "fullness: expected a positive"),
        (["--motion", str(WALK), "--out", "a.usdc", "--distance-power", "2"], "take --falloff heat"),
        (["--motion", str(WALK), "--out", "a.usdc", "--falloff", "continuous"], '"heat", "inverse"'),
        (["--motion", str(WALK), "--out", "a.usdc", "--garment", "jacket"], '"sweater", "sleeveless"'),
    ],
)
def test_command_line_refuses_in_one_line(arguments, message, tmp_path, moving_jumper, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_mesh_sequence(tmp_path / "track", moving_jumper)
    (tmp_path / "alone.amc").write_text("1\n")
    assert main(["dress", ".", *arguments]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
