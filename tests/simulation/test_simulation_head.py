"""The head: symmetric, outward, closed where it should be, and its mouth and eyes open."""

from itertools import pairwise

import numpy as np
import pytest

from recipes.scene_shapes import MOUTH_HEIGHT, NECK_CUT, cut_slit, gradient, sculpt_head, signed_distance
from vntoolkit.geometry.mesh import vertex_normals
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.simulation.head import rig as parts
from vntoolkit.simulation.head import scenes
from vntoolkit.simulation.head.rig import (
    Expression,
    Head,
    HeadPose,
    HeadRig,
    Makeup,
    performance_at,
    read_head,
    seam_lines_px,
    turning_pose,
)
from vntoolkit.simulation.head.scenes import build_face_makeup
from vntoolkit.simulation.scene import Scene
from vntoolkit.simulation.spandex import build_spandex

STILL = HeadPose()


@pytest.fixture(scope="module")
def head() -> Head:
    return read_head()


@pytest.fixture(scope="module")
def rig(head: Head) -> HeadRig:
    return HeadRig(head)


def mouth_gap(head: Head, points: np.ndarray) -> float:
    middle = len(head.mouth.upper) // 2
    return float(points[head.mouth.upper[middle], 1] - points[head.mouth.lower[middle], 1])


def eye_gap(head: Head, points: np.ndarray, eye: int) -> float:
    slit = head.eyes[eye]
    middle = len(slit.upper) // 2
    return float(np.linalg.norm(points[slit.upper[middle]] - points[slit.lower[middle]]))


def test_the_sculpture_is_symmetric(rng: np.random.Generator) -> None:
    points = rng.uniform([-9, -15, -11], [9, 12, 12], (4000, 3))
    body = sculpt_head()
    there = signed_distance(body, points)
    mirrored = signed_distance(body, points * [-1, 1, 1])
    near = np.abs(there) < 0.3
    np.testing.assert_allclose(there[near], mirrored[near], atol=0.02)  # blending depends on the order


def test_landmarks_mirror_each_other(head: Head) -> None:
    mouth = head.vertices[head.mouth.upper]
    np.testing.assert_allclose(mouth[0] * [-1, 1, 1], mouth[-1], atol=0.16)  # one cell of the mesh
    left, right = (head.vertices[slit.upper] for slit in head.eyes)
    np.testing.assert_allclose(left[0] * [-1, 1, 1], right[-1], atol=0.16)
    np.testing.assert_allclose(left[-1] * [-1, 1, 1], right[0], atol=0.16)


def test_the_head_has_human_measures(head: Head) -> None:
    skin = head.vertices[head.part == parts.SKIN]
    face = skin[(np.abs(skin[:, 0]) < 0.3) & (skin[:, 2] > 4.0)]
    chin = face[face[:, 2] > 7.0][:, 1].min()
    assert 20.0 < skin[:, 1].max() - chin < 25.0  # centimetres from chin to crown
    assert 14.0 < np.ptp(skin[skin[:, 1] > 3.0, 0]) < 18.0
    tip = face[face[:, 2].argmax()]
    assert abs(tip[0]) < 0.1
    assert MOUTH_HEIGHT + 2.0 < tip[1] < -2.0


def test_normals_of_the_skin_point_outwards(head: Head) -> None:
    skin = (head.part == parts.SKIN) & (head.hair == 0.0)
    outwards = gradient(sculpt_head(), head.vertices[skin], 0.05)
    normals = vertex_normals(head.vertices, head.faces)[skin]
    assert (np.sum(outwards * normals, axis=1) > 0).mean() > 0.995


def test_the_skin_is_open_at_the_neck_alone(head: Head) -> None:
    with_pocket = np.isin(head.part[head.faces].max(axis=1), (parts.SKIN, parts.CAVITY, parts.LID_RIM))
    faces = head.faces[with_pocket]
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges, uses = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    open_ends = np.unique(edges[uses == 1])
    behind_lids = head.part[open_ends] == parts.LID_RIM
    assert np.all(head.vertices[open_ends[~behind_lids], 1] < NECK_CUT + 0.5)
    assert np.count_nonzero(uses > 2) <= 4  # surface nets pinch at a few places in nostrils and ears


def test_seams_are_loops_along_edges_of_the_mesh(head: Head) -> None:
    directed = np.concatenate([head.faces[:, [0, 1]], head.faces[:, [1, 2]], head.faces[:, [2, 0]]])
    weights = np.array([len(head.vertices), 1])
    edges = np.sort(directed, axis=1).astype(np.int64) @ weights
    for loop in (slit.loop for slit in (head.mouth, *head.eyes)):
        assert len(np.unique(loop)) == len(loop)
        pairs = np.sort(np.stack([loop, np.roll(loop, -1)], axis=1), axis=1)
        assert np.isin(pairs @ weights, edges).all()


def test_speech_opens_the_mouth_ever_further(head: Head, rig: HeadRig) -> None:
    gaps = [mouth_gap(head, rig.vertices(Expression(jaw=jaw), STILL)) for jaw in (0.0, 0.25, 0.5, 0.75, 1.0)]
    assert gaps[0] == pytest.approx(0.0, abs=1e-9)
    assert np.all(np.diff(gaps) > 0.2)
    assert 1.0 < gaps[-1] < 4.0  # centimetres


def test_lids_close_and_open(head: Head, rig: HeadRig) -> None:
    for eye in (0, 1):
        gaps = [eye_gap(head, rig.vertices(Expression(lids=lids), STILL), eye) for lids in (0.0, 0.5, 1.0)]
        assert gaps[0] == pytest.approx(0.0, abs=1e-9)
        assert gaps[0] < gaps[1] < gaps[2]
        assert 0.7 < gaps[2] < 1.4


def test_open_lids_do_not_cut_into_the_eyeball(head: Head, rig: HeadRig) -> None:
    points = rig.vertices(Expression(lids=1.0), STILL)
    for slit, sign in zip(head.eyes, (-1.0, 1.0), strict=True):
        edge = points[np.concatenate([slit.upper, slit.lower])]
        radius = np.linalg.norm(edge - np.array([sign * 3.15, 0.0, 6.75]), axis=1)
        assert radius.min() > 1.22


def test_a_smile_lifts_and_widens_the_corners(head: Head, rig: HeadRig) -> None:
    still, smiling = (rig.vertices(Expression(smile=s), STILL)[head.mouth.upper[[0, -1]]] for s in (0.0, 1.0))
    assert smiling[1, 0] - smiling[0, 0] > still[1, 0] - still[0, 0] + 0.6
    assert np.all(smiling[:, 1] > still[:, 1] + 0.2)


def test_turning_the_head_is_rigid_above_the_neck_and_still_at_the_cut(head: Head, rig: HeadRig) -> None:
    still, turned = (rig.vertices(Expression(), HeadPose(turn_deg=t)) for t in (0.0, 60.0))
    above = np.flatnonzero(head.vertices[:, 1] > -8.0)[::50]
    before = np.linalg.norm(still[above[:, None]] - still[above[None, :]], axis=-1)
    after = np.linalg.norm(turned[above[:, None]] - turned[above[None, :]], axis=-1)
    np.testing.assert_allclose(after, before, atol=1e-9)
    below = head.vertices[:, 1] < -16.6
    np.testing.assert_allclose(turned[below], still[below], atol=1e-9)
    nose = still[:, 2].argmax()
    assert turned[nose, 0] > still[nose, 0] + 5.0  # to the image's right


def test_the_turn_goes_all_the_way_both_ways() -> None:
    turns = [turning_pose(share, 68.0).turn_deg for share in np.linspace(0.0, 1.0, 90)]
    assert turns[0] == pytest.approx(-68.0)
    assert turns[-1] == pytest.approx(68.0)
    assert np.all(np.diff(turns) > 0)


def test_the_performance_smiles_grimaces_speaks_and_blinks() -> None:
    phases = np.linspace(0.0, 3.0, 8)
    shown = [performance_at(frame / 60.0, phases) for frame in range(1000)]
    assert max(e.smile for e in shown) > 0.8
    assert max(e.grimace for e in shown) > 0.9
    assert max(e.jaw for e in shown) > 0.6
    assert min(e.lids for e in shown) < 0.1
    assert max(abs(b.jaw - a.jaw) for a, b in pairwise(shown)) < 0.15


def test_freckles_stand_out_most_in_blue(rng: np.random.Generator) -> None:
    texture = scenes.skin_texture(rng, Makeup.NONE)
    cheek = texture[500:600, 1150:1250].reshape(-1, 3)  # beside the nose
    contrast = cheek.std(axis=0) / cheek.mean(axis=0)
    assert contrast[2] > 1.3 * contrast[1] > 1.3 * contrast[0] > 0.01


def test_makeup_is_one_colour_over_the_skin(head: Head, rng: np.random.Generator) -> None:
    colours = head.colours[Makeup.UNIFORM]
    skin = (head.part == parts.SKIN) & (head.hair == 0.0)
    np.testing.assert_allclose(colours[skin], np.broadcast_to(colours[skin][0], colours[skin].shape))
    bare = head.colours[Makeup.NONE][skin]
    assert bare.std(axis=0).min() > 0.01
    texture = scenes.skin_texture(rng, Makeup.UNIFORM)
    np.testing.assert_allclose(texture[300:600, 1000:1050], 1.0)  # chin to brow, midline


def test_texture_coordinates_do_not_wrap_across_a_face(head: Head) -> None:
    uv = scenes.corner_uv(head)
    skin = (head.part[head.faces] == parts.SKIN).all(axis=1)
    away_from_pole = head.vertices[head.faces, 1].max(axis=1) < 10.0
    assert np.ptp(uv[skin & away_from_pole, :, 0], axis=1).max() < 0.1
    assert uv[..., 1].min() >= 0.0
    assert uv[..., 1].max() < 1.0


def test_a_slit_in_a_grid_parts_into_two_sides() -> None:
    x, y = np.meshgrid(np.arange(9.0), np.arange(7.0))
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    quad = (np.arange(6)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate(
        [np.stack([quad, quad + 1, quad + 10], 1), np.stack([quad, quad + 10, quad + 9], 1)]
    )
    inside = (vertices[:, 0] > 1.5) & (vertices[:, 0] < 6.5)
    cut, new_faces, slit = cut_slit(vertices, faces.astype(np.int32), vertices[:, 1] - 3.4, inside)
    np.testing.assert_allclose(cut[slit.upper, 1], 3.4)
    assert np.array_equal(cut[slit.upper], cut[slit.lower])
    assert np.intersect1d(slit.upper, slit.lower).tolist() == sorted([slit.upper[0], slit.upper[-1]])
    a, b, c = (cut[new_faces[:, i], :2] for i in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert area.min() > 0
    assert area.sum() / 2 == pytest.approx(48.0)
    directed = np.concatenate([new_faces[:, [0, 1]], new_faces[:, [1, 2]], new_faces[:, [2, 0]]])
    assert len(np.unique(directed, axis=0)) == len(directed)
    uses = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)[1]
    assert np.count_nonzero(uses == 1) == 28 + 2 * (len(slit.upper) - 1)  # the grid's border and the slit


@pytest.fixture(scope="module")
def face() -> Scene:
    return build_face_makeup(SceneOptions())


def loops_px(face: Scene, frame: int) -> list[np.ndarray]:
    """Return the closed loops of mouth, left eye and right eye, each (k, 2) pixels."""
    head, vertices = read_head(), face.vertices(frame)
    return [face.camera.project(vertices[slit.loop]) for slit in (head.mouth, *head.eyes)]


def test_seams_lie_in_the_picture_and_open_with_the_mouth(face: Scene) -> None:
    mouth, left, right = loops_px(face, 0)
    assert left[:, 0].max() < right[:, 0].min()
    assert mouth[:, 1].min() > left[:, 1].max()  # v grows downwards
    for loop in (mouth, left, right):
        assert loop.min() > 0
        assert np.all(loop.max(axis=0) < [640, 480])
    heights = [np.ptp(loops_px(face, frame)[0][:, 1]) for frame in range(380, 500, 10)]
    assert max(heights) > 2.0 * min(heights)


def test_seam_lines_are_the_two_edges_of_each_loop(face: Scene) -> None:
    lines = seam_lines_px(face, 0)
    assert len(lines) == 6
    for loop, upper, lower in zip(loops_px(face, 0), lines[::2], lines[1::2], strict=True):
        np.testing.assert_array_equal(np.concatenate([upper, lower[-2:0:-1]]), loop)
    assert seam_lines_px(build_spandex(SceneOptions()), 0) == ()
