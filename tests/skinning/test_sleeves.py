"""Both arms lie in their sleeves, whatever the figure is called and however the performer held them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recipes.walk_motion import walking_motion
from tests.result_files import write_mesh_sequence
from tests.skinning.test_heat_weights import of_arms, raised_arms, sheet_seen_from_the_front
from vntoolkit.__main__ import main
from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh, MeshSequence, edges_from_faces
from vntoolkit.geometry.motion import Motion, pose_of_frame
from vntoolkit.options.dressing import DressOptions, Garment, GarmentFitOptions
from vntoolkit.pipeline.dress import DressedFigure, dress
from vntoolkit.skinning.anatomy import anatomy_of, arms_of
from vntoolkit.skinning.findings import DressingFindings
from vntoolkit.skinning.sleeves import regions_of_garment
from vntoolkit.skinning.stretch import drawn_together


@pytest.fixture(scope="module")
def sheet() -> MeshSequence:
    return sheet_seen_from_the_front(0.42)


def measured(dressed: DressedFigure, frames: tuple[int, ...]) -> DressingFindings:
    meter = dressed.meter()
    for frame in frames:
        meter.add(dressed.frame(frame), pose_of_frame(dressed.motion, frame))
    return meter.findings


def renamed(motion: Motion, names: dict[str, str]) -> Motion:
    skeleton = motion.skeleton
    return replace(
        motion, skeleton=replace(skeleton, names=tuple(names.get(name, name) for name in skeleton.names))
    )


def test_sleeves_are_found_where_they_are(sheet: MeshSequence) -> None:
    regions = regions_of_garment(sheet.template)
    x, y, _ = sheet.template.vertices.T
    assert sorted(sleeve.side for sleeve in regions.sleeves) == [-1, 1]
    for sleeve in regions.sleeves:
        assert sleeve.side * sleeve.armpit[0] == pytest.approx(0.18, abs=0.02)
        start, end = np.array([0.15, 0.07]), np.array([0.42, 0.50])
        axis = (end - start) / np.linalg.norm(end - start)
        away = sleeve.axis[4:, :2] * [sleeve.side, 1] - start
        assert np.abs(away[:, 0] * axis[1] - away[:, 1] * axis[0]).max() < 0.02
        assert np.median(sleeve.axis[:, 2]) == pytest.approx(5.0, abs=0.02)
        assert np.median(sleeve.radii) == pytest.approx(0.065, abs=0.01)
        np.testing.assert_array_less(0.15, sleeve.side * x[np.isfinite(sleeve.along)])
    below = (np.abs(x) < 0.17) & (y > max(s.armpit[1] for s in regions.sleeves) + 0.01)
    assert regions.trunk[below].all()
    assert y[regions.trunk].min() > min(s.armpit[1] for s in regions.sleeves) - 0.01


def test_a_gap_at_the_collar_makes_no_trousers_of_a_sweater(sheet: MeshSequence) -> None:
    garment = sheet.template
    x, y, _ = garment.vertices.T
    height = np.ptp(y)
    open_collar = (np.abs(x) < 0.06) & (np.abs(y - y.min() - 0.1 * height) < 0.05 * height)
    faces = garment.faces[~open_collar[garment.faces].any(axis=1)]
    assert len(faces) < len(garment.faces)
    regions = regions_of_garment(Mesh(vertices=garment.vertices, faces=faces))
    assert regions.hems is None
    assert sorted(sleeve.side for sleeve in regions.sleeves) == [-1, 1]


def test_a_vest_and_trousers_have_no_sleeves() -> None:
    x, y = np.meshgrid(np.arange(-0.25, 0.25, 0.01), np.arange(0, 0.6, 0.01))
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    points = np.stack([x, y, 5 + 0 * x], axis=-1).reshape(-1, 3)
    legs = np.abs(points[:, 0]) > 0.3 * (points[:, 1] - 0.25)
    for kept in (np.ones(len(points), bool), legs):
        mesh = Mesh(vertices=points, faces=faces[kept[faces].all(axis=1)])
        regions = regions_of_garment(mesh)
        assert regions.sleeves == ()
        assert (regions.hems is None) == kept.all()


def relief(
    width: float, height: float, bones: list[tuple[list[float], list[float], float, float]]
) -> MeshSequence:
    """Return a sheet over cones (start, end, radii), five metres away, as a height field shows them."""
    step = 0.01
    x, y = np.meshgrid(np.arange(-width, width, step), np.arange(-0.02, height, step))
    depth = np.full(x.shape, np.inf)
    for start, end, first, last in bones:
        axis, length = np.subtract(end, start), np.linalg.norm(np.subtract(end, start))
        along = ((x - start[0]) * axis[0] + (y - start[1]) * axis[1]) / length**2
        across = ((x - start[0]) * axis[1] - (y - start[1]) * axis[0]) / length
        radius = first + (last - first) * along
        inside = (np.abs(across) < radius) & (along >= 0) & (along <= 1)
        depth[inside] = np.minimum(depth, -np.sqrt(np.maximum(radius**2 - across**2, 0)))[inside]
    seen = np.isfinite(depth)
    index = np.full(x.shape, -1)
    index[seen] = np.arange(seen.sum())
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    points = np.stack([x[seen], y[seen], 5 + depth[seen]], axis=-1)
    mesh = Mesh(vertices=points, faces=faces[(faces >= 0).all(axis=1)])
    return MeshSequence(template=mesh, vertices=points[None].astype(np.float32))


def trousers() -> MeshSequence:
    hips = ([0.0, 0.0], [0.0, 0.22], 0.19, 0.2)
    legs = [([side * 0.1, 0.15], [side * 0.2, 0.95], 0.1, 0.06) for side in (-1.0, 1.0)]
    return relief(0.4, 1.0, [hips, *legs])


def worn(cloth: MeshSequence, kind: Garment) -> DressedFigure:
    return dress(cloth, walking_motion(), DressOptions(fitting=GarmentFitOptions(garment=kind)))


def test_trousers_follow_the_leg_on_their_side_and_nothing_above_the_hips() -> None:
    dressed = worn(trousers(), Garment.AUTO)
    skeleton, weights = dressed.motion.skeleton, dressed.weights
    assert dressed.fitting.garment is Garment.TROUSERS
    legs = anatomy_of(skeleton).legs
    assert set(np.unique(weights.joints[weights.weights > 0])) <= {0, *legs}
    x, y, _ = dressed.cloth[0].vertices.T
    sides = dressed.fitting.rest_from_model[:, 0, 3] - dressed.fitting.rest_from_model[0, 0, 3]
    for side in (-1, 1):
        own = [joint for joint in legs if np.sign(sides[joint]) == side]
        share = np.where(np.isin(weights.joints, own), weights.weights, 0).sum(axis=1)
        assert share[(np.sign(x) == side) & (y > 0.5)].min() > 0.95
    # Each hem stays about its ankle through the walk.
    stretched = measured(dressed, tuple(range(0, len(dressed), 6)))
    assert stretched.stretched.max() < 0.02
    assert "no sleeve" not in stretched.sentence


def test_legs_that_cross_below_the_knee_are_legs() -> None:
    hips = ([0.0, 0.0], [0.0, 0.22], 0.24, 0.24)
    legs = [([side * 0.16, 0.15], [side * 0.03, 0.95], 0.1, 0.06) for side in (-1.0, 1.0)]
    assert worn(relief(0.4, 1.0, [hips, *legs]), Garment.AUTO).fitting.garment is Garment.TROUSERS


def test_cloth_is_attached_where_legs_stand_apart() -> None:
    apart = trousers()
    together = np.array(apart.vertices)
    together[0, together[0, :, 1] > 0.2, 0] *= 0.05
    moving = replace(apart, vertices=np.concatenate([together, apart.vertices]))
    dressed = worn(moving, Garment.AUTO)
    assert (dressed.fitting.garment, dressed.attached_in) == (Garment.TROUSERS, 1)


def test_a_garment_without_limbs_is_said(caplog: pytest.LogCaptureFixture) -> None:
    worn(relief(0.4, 0.7, [([0.0, 0.0], [0.0, 0.6], 0.2, 0.2)]), Garment.AUTO)
    assert "worn as a sweater; film them apart" in caplog.text


def test_each_kind_is_worn_on_its_own_bones() -> None:
    skirt = relief(0.4, 0.7, [([0.0, 0.0], [0.0, 0.6], 0.17, 0.32)])
    dressed = worn(skirt, Garment.SKIRT)
    legs = anatomy_of(dressed.motion.skeleton).legs
    assert set(np.unique(dressed.weights.joints[dressed.weights.weights > 0])) <= {0, *legs}
    assert (
        dressed.template.vertices[:, 1].min() < dressed.fitting.rest_from_model[0, 1, 3]
    )  # the waist is above the hips
    vest = relief(0.4, 0.7, [([0.0, 0.0], [0.0, 0.6], 0.2, 0.2)])
    dressed = worn(vest, Garment.SLEEVELESS)
    assert of_arms(dressed).max() == 0
    for kind, cloth in ((Garment.SWEATER, vest), (Garment.TROUSERS, skirt)):
        with pytest.raises(BadInput, match=f"{kind.value}: .* outline"):
            worn(cloth, kind)


def test_no_arm_moves_the_trunk_and_both_stay_in_their_sleeves(sheet: MeshSequence) -> None:
    dressed = dress(sheet, raised_arms(90))
    on_trunk = of_arms(dressed)[dressed.fitting.regions.trunk]
    assert on_trunk.mean() <= 0.02
    assert np.quantile(on_trunk, 0.99) <= 0.1
    findings = measured(dressed, (0, 10, 19))
    assert findings.off_axis.shape == (3, 2, 3)
    assert findings.off_axis[:, :, 1:].max() < 1  # forearm and wrist; the elbow bends the axis
    assert "wrist" in findings.sentence or "elbow" in findings.sentence


def test_what_a_track_pulled_apart_is_drawn_together(sheet: MeshSequence) -> None:
    moved = np.array(sheet.vertices[:2], dtype=np.float64)
    x, y, _ = moved[0].T
    slipped = np.hypot(x, y - 0.4) < 0.03
    moved[1, slipped, 2] -= 0.06
    torn = dress(replace(sheet, vertices=moved), walking_motion())
    growth = [torn.meter().stretch(rest).max() for rest in map(torn.rest_frame, range(len(torn)))]
    assert growth[0] == pytest.approx(1, abs=1e-4)  # kept in float32
    assert 1.3 < max(growth) < 1.6  # 7 times without
    edges = edges_from_faces(sheet.template.faces)
    longest = 1.5 * np.linalg.norm(moved[0, edges[:, 0]] - moved[0, edges[:, 1]], axis=1)
    drawn = drawn_together(moved[1], edges, longest)
    far = np.hypot(x, y - 0.4) > 0.25
    np.testing.assert_array_equal(drawn[far], moved[1, far])
    np.testing.assert_allclose(drawn.mean(axis=0), moved[1].mean(axis=0), atol=1e-12)  # both ends as far


def test_an_arm_beside_its_sleeve_is_said(sheet: MeshSequence) -> None:
    findings = measured(dress(sheet, raised_arms(0)), (0,))
    stray = replace(findings, off_axis=findings.off_axis + np.array([[[0, 0, 3.0], [0, 0, 0]]]))
    assert "right arm outside its sleeve (wrist at most 3." in stray.sentence


def test_longer_arms_reach_the_cuffs_too(sheet: MeshSequence) -> None:
    walk = raised_arms(60)
    longer = np.array(walk.skeleton.offsets)
    arms = [
        walk.skeleton.index_of(f"{side}{part}") for side in ("Left", "Right") for part in ("ForeArm", "Hand")
    ]
    longer[arms] *= 1.25
    dressed = dress(sheet, replace(walk, skeleton=replace(walk.skeleton, offsets=longer)))
    assert measured(dressed, (0, 19)).off_axis[:, :, 2].max() < 0.7


def test_the_performers_sleeves_do_not_swing_on_top_of_the_figures(sheet: MeshSequence) -> None:
    """A sleeve that the capture turned about the shoulder hangs as the one that stayed."""
    x = sheet.template.vertices[:, 0]
    sleeve = np.isfinite(next(s for s in regions_of_garment(sheet.template).sleeves if s.side > 0).along)
    turned, shoulder = np.array(sheet.vertices[:3], np.float64), np.array([0.15, 0.07, 5.0])
    for frame in range(3):
        turn = Rotation.from_euler("z", -8.0 * frame, degrees=True)
        turned[frame, sleeve] = shoulder + turn.apply(turned[frame, sleeve] - shoulder)
    still = dress(replace(sheet, vertices=sheet.vertices[:3]), raised_arms(0))
    swung = dress(replace(sheet, vertices=turned), raised_arms(0))
    cuff = x > 0.36
    assert cuff.any()
    assert np.abs(swung.frame(2)[cuff] - still.frame(2)[cuff]).max() < 0.02
    assert np.abs(turned[2][cuff] - turned[0][cuff]).max() > 0.08


@pytest.mark.parametrize(
    "names",
    [
        ("mixamorig:{0}Shoulder", "mixamorig:{0}Arm", "mixamorig:{0}ForeArm", "mixamorig:{0}Hand"),
        ("{1}clavicle", "{1}humerus", "{1}radius", "{1}wrist"),
        ("{0}Collar", "{0}Shoulder", "{0}Elbow", "{0}Wrist"),
        ("{2}_collar", "{2}_shoulder", "{2}_elbow", "{2}_wrist"),
        ("m_avg_{3}_Collar", "m_avg_{3}_Shoulder", "m_avg_{3}_Elbow", "m_avg_{3}_Wrist"),
        ("clavicle_{1}", "upperarm_{1}", "lowerarm_{1}", "hand_{1}"),
        ("a{3}", "b{3}", "c{3}", "d{3}"),  # told by their lengths
    ],
)
def test_arms_are_known_by_many_names_and_by_none(names: tuple[str, ...]) -> None:
    walk = walking_motion()
    changed = {}
    for side in ("Left", "Right"):
        for own, name in zip(("Shoulder", "Arm", "ForeArm", "Hand"), names, strict=True):
            changed[f"{side}{own}"] = name.format(side, side[0].lower(), side.lower(), side[0])
    skeleton = renamed(walk, changed).skeleton
    arms = arms_of(skeleton, anatomy_of(skeleton))
    assert [arm.side for arm in arms] == [-1, 1]
    assert [(arm.upper, arm.fore, arm.hand) for arm in arms] == [(10, 11, 12), (6, 7, 8)]


def test_an_unknown_arm_is_asked_for_and_named(sheet: MeshSequence, tmp_path: Path, capsys) -> None:
    walk = walking_motion()
    lame = np.array(walk.skeleton.offsets)
    lame[[walk.skeleton.index_of(name) for name in ("LeftForeArm", "LeftHand")]] = 0.0
    motion = replace(walk, skeleton=replace(walk.skeleton, offsets=lame))
    with pytest.raises(BadInput, match="no arm for the garment's left sleeve: name its joints, as --map"):
        dress(sheet, motion)
    given = ("left-upper-arm=LeftShoulder", "left-forearm=LeftArm", "left-hand=LeftForeArm")
    assert len(dress(sheet, renamed(walk, {}), DressOptions(map=given)).fitting.sleeved) == 2
    for wrong, message in (("left-arm=x", "no role 'left-arm'"), ("Bone7", "expected ROLE=JOINT")):
        with pytest.raises(BadInput, match=message):
            dress(sheet, walk, DressOptions(map=(wrong,)))
    write_mesh_sequence(tmp_path / "track", sheet)
    out = str(tmp_path / "a.usdc")
    arguments = ["dress", str(tmp_path), "--motion", "data/walk.bvh", "--out", out, "--stop", "0.05"]
    assert main([*arguments, "--map", "left-upper-arm=LeftArm", "--map", "left-forearm=LeftForeArm"]) == 0
    assert "arm inside its sleeve" in capsys.readouterr().out


def test_an_arm_is_called_outside_by_the_figure_that_is_printed() -> None:
    for off, said in (
        (1.04, "inside its sleeve (elbow at most 1.0"),
        (np.nextafter(1.05, 0), "inside its sleeve (elbow at most 1.0"),
        (1.05, "outside its sleeve (elbow at most 1.1"),
        (1.06, "outside its sleeve (elbow at most 1.1"),
    ):
        none, off_axis = np.zeros(1), np.array([[[off, 0.0, 0.0]]])
        findings = DressingFindings(stretched=none, torn=none, off_axis=off_axis, sides=(1,), short=(False,))
        assert f"left arm {said} radii off its axis, frame 0)" in findings.sentence
