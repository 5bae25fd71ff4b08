"""A rippled egg and a wrong M, refined by the egg's colours in many poses."""

import numpy as np
import pytest

from tests.calibration.turning_egg import (
    AXES,
    CAMERA,
    DISTANCE,
    MATRIX,
    egg_surface,
    relative_error,
    render_egg,
    turning_poses,
)
from vntoolkit.calibration.fit import fit_quality
from vntoolkit.calibration.head.light import HeadLight
from vntoolkit.calibration.head.light_correction import light_errors
from vntoolkit.calibration.head.positions import PositionSolver
from vntoolkit.calibration.head.refinement import refine_head, thinned
from vntoolkit.calibration.head.samples import LightFrame, SkinColours
from vntoolkit.calibration.head.skin import SkinLight, SkinNormals, skin_normals
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.options.head import HeadSteps
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

SMALL = CAMERA.scaled(0.5)
PIXEL = DISTANCE / SMALL.matrix[0, 0]

POSES = turning_poses(9, 60.0)
WRONG = MATRIX * [[1.2, 0.9, 1.0], [1.0, 1.0, 1.06], [0.5, 1.1, 0.95]]


def rippled_egg(height):
    points, faces = egg_surface(2800)
    directions = np.random.default_rng(1).standard_normal((6, 3))
    directions *= 2 * np.pi / (9 * PIXEL) / np.linalg.norm(directions, axis=1, keepdims=True)
    ripple = np.cos(points @ directions.T + np.arange(6)).mean(axis=1)
    vertices = points * (1 + height * ripple[:, None])
    return Mesh(vertices=vertices, faces=faces, normals=vertex_normals(vertices, faces))


@pytest.fixture(scope="module")
def rippled():
    return rippled_egg(0.03)


@pytest.fixture(scope="module")
def refined(rippled):
    rng = np.random.default_rng(0)
    images = []
    for pose in POSES:
        image = render_egg(pose).reshape(SMALL.height, 2, SMALL.width, 2, 3).mean(axis=(1, 3))
        images.append((image + 0.003 * rng.standard_normal(image.shape)).astype(np.float32))

    def frames():
        for image, pose in zip(images, POSES, strict=True):
            mask = image.max(axis=2) > 0.02
            yield LightFrame(frame=LinearFrame(image), camera_from_head=pose, mask=mask)

    response = LightResponse(matrix=WRONG)
    nothing = np.zeros(0, np.bool_)
    quality = fit_quality(np.eye(3), WRONG.T, response, "head")
    light = HeadLight(
        response=response, quality=quality, inliers=nothing, shadowed=nothing, albedo=np.zeros((0, 3))
    )
    return refine_head(rippled, SMALL, frames, light, HeadSteps(), rng)


def errors(mesh):
    """Distance to the egg in pixels, and degrees between the normals, of the vertices that were lit."""
    lit = mesh.vertices[:, 2] < -0.3 * AXES[2]
    radii = np.linalg.norm(mesh.vertices[lit] / AXES, axis=1)
    distance = np.abs(1 - 1 / radii) * np.linalg.norm(mesh.vertices[lit], axis=1) / PIXEL
    normals = mesh.vertices[lit] / AXES**2
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosine = np.clip((mesh.normals[lit] * normals).sum(axis=1), -1, 1)
    return distance, np.rad2deg(np.arccos(cosine)), lit


def test_ripples_go(rippled, refined):
    before, slant, _ = errors(rippled)
    after, left, _ = errors(refined.mesh)
    assert slant.mean() > 6.0
    assert left.mean() < 0.27 * slant.mean()
    assert after.mean() < before.mean() / 2.5


def test_m_comes_right_again(refined):
    assert relative_error(WRONG) > 0.05
    assert relative_error(refined.light.response.matrix) < 0.02
    assert refined.changes[-1] < 0.1 * refined.changes[0]


def test_nine_of_ten_normals_are_within_their_expected_error(refined):
    _, off, lit = errors(refined.mesh)
    assert (off < refined.mesh.error_deg[lit]).mean() > 0.85


def skin_of(normals, noise):
    ones = np.ones((len(normals), 3))
    return SkinNormals(
        normals=normals,
        albedo=ones,
        noise=np.full(len(normals), noise),
        scaled=normals,
        weight=np.ones((1, len(normals)), np.float32),
        agrees=np.ones((1, len(normals)), bool),
    )


def test_a_thinned_mesh_has_the_edges_asked_and_stays_closed_and_in_place():
    points, faces = egg_surface(2800)
    egg = Mesh(vertices=points, faces=faces, normals=vertex_normals(points, faces))

    def edge(mesh):
        corners = mesh.vertices[mesh.faces]
        return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()

    thin = thinned(egg, 2.0 * edge(egg))
    assert edge(thin) == pytest.approx(2.0 * edge(egg), rel=0.1)
    sides = np.sort(np.concatenate([thin.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
    assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()
    radii = np.linalg.norm(thin.vertices / AXES, axis=1)
    assert np.abs(radii - 1.0).max() < 0.02
    assert thinned(egg, 0.5 * edge(egg)) is egg


def test_no_vertex_flies_off_where_stereo_is_folded():
    points, faces = egg_surface(2800)
    normals = points / AXES**2
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    folded = np.linalg.norm(points - points[1400], axis=1) < 20 * PIXEL
    stereo = points.copy()
    stereo[folded] = points[folded] + 10 * PIXEL * np.random.default_rng(3).standard_normal((folded.sum(), 3))
    moved = PositionSolver(stereo, faces, skin_of(normals, 0.01), 200 * PIXEL).positions()
    assert np.linalg.norm(moved - points, axis=1).max() < 1.25 * np.linalg.norm(stereo - points, axis=1).max()


@pytest.fixture(scope="module")
def lit_points():
    """Normals of 40 points, their places in the head, and what the light is thought to be less what it is."""
    rng = np.random.default_rng(2)
    normals = rng.standard_normal((40, 3)) * [0.5, 0.6, 0.3] - [0, 0, 1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals, normals * AXES, 0.02 * rng.standard_normal((3, 3))


def seen(normals, vertices, rows_at):
    """Colours under the rows that M has at places (f, n, 3), camera frame, from the mean one."""
    places = np.stack([pose.apply(vertices) for pose in POSES])
    rows = rows_at(places - places.mean(axis=(0, 1)))
    turned = np.stack([normals @ pose.rotation.T for pose in POSES])
    rgb = np.einsum("fncx,fnx->fnc", rows, turned).astype(np.float32)
    weight = np.ones(rgb.shape[:2], np.float32)
    return SkinColours(rgb=rgb, weight=weight, vertices=vertices, camera_from_head=POSES)


def test_frames_tell_all_of_m_but_what_commutes_with_the_turn(lit_points):
    normals, vertices, true = lit_points
    colours = seen(normals, vertices, lambda places: np.broadcast_to(MATRIX, (*places.shape, 3)))
    wrong = SkinLight(response=LightResponse(matrix=MATRIX @ np.linalg.inv(np.eye(3) + true)))
    skin = skin_normals(colours, wrong)
    found = light_errors(colours, skin, wrong, np.ones(40), np.arange(40) % 2)
    turned = np.einsum("nik,k->ni", found.turned[..., :9], true.ravel())
    assert np.abs(skin.normals - turned - normals).max() < 0.1 * np.abs(skin.normals - normals).max()
    values, directions = np.linalg.eigh(found.system.sum(axis=0)[:9, :9])
    assert values[2] < 1e-3 * values[3]  # scale, scale along the axis, turn about it
    told = directions[:, 3:].T
    step = told @ found.right.sum(axis=0)[:9] / values[3:]
    assert step == pytest.approx(told @ true.ravel(), abs=0.003)


def test_frames_tell_how_near_the_lamps_are(lit_points):
    normals, vertices, _ = lit_points
    length = np.linalg.norm(MATRIX, axis=1, keepdims=True)
    distance = 12.0 * np.linalg.norm(AXES) * np.array([1.0, 1.5, 1.2])

    def rows_at(places):
        towards = distance[:, None] * MATRIX / length - places[..., None, :]
        far = np.linalg.norm(towards, axis=-1, keepdims=True)
        return length * towards / far * (distance[:, None] / far) ** 2

    colours = seen(normals, vertices, rows_at)
    light = SkinLight(response=LightResponse(matrix=MATRIX))
    for _ in range(4):
        skin = skin_normals(colours, light)
        found = light_errors(colours, skin, light, np.ones(40), np.zeros(40, np.int64))
        step = np.linalg.lstsq(found.system[0, 9:, 9:], found.right[0, 9:])[0]
        light = SkinLight(response=light.response, nearness=light.nearness + step)
    assert light.nearness == pytest.approx(1.0 / distance, rel=0.1)
    assert np.abs(skin.normals - normals).max() < 0.02
