"""What a renderer must obey whatever it draws: equation 1, occlusion, projection, flow."""

from dataclasses import replace

import numpy as np
import pytest

from vntoolkit.geometry.mesh import vertex_normals
from vntoolkit.geometry.rays import RayScene
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.simulation import Lighting, Nuisances, RenderOptions, SceneOptions
from vntoolkit.photometry.frame import ALL_LIT, lit_from_labels
from vntoolkit.simulation.grids import grid_faces
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.lights import studio_camera, studio_centre, studio_lights
from vntoolkit.simulation.render import Renderer, frame_generator, render_frame
from vntoolkit.simulation.rigid.sphere import ball_mesh
from vntoolkit.simulation.scene import Detail, Scene, SceneSurface, build_scene

SINGLE = RenderOptions(samples=1)
SMALL = SceneOptions(width=160, height=120)
GREY = np.array([0.6, 0.6, 0.6])


def ball_scene(**surface) -> Scene:
    """A coarse turning and drifting ball before the studio camera."""
    ball, faces = ball_mesh(0.3, 40, 80)

    def pose(frame: int) -> RigidTransform:
        return RigidTransform.from_rotation_vector(
            (0.0, 0.05 * frame, 0.01 * frame), studio_centre() + np.array([0.004, 0.002, 0.01]) * frame
        )

    return Scene(
        name="ball",
        camera=studio_camera(SMALL, field_width_m=1.0),
        surface=SceneSurface(faces=faces, reference_weights=GREY, **surface),
        vertices=lambda frame: pose(frame).apply(ball),
        frame_count=3,
        camera_from_object=pose,
    )


@pytest.fixture(scope="module")
def clean_ball():
    """Built-in sphere without nuisances, one ray per pixel."""
    scene = build_scene("sphere", SMALL)
    return scene, render_frame(scene, 0, nuisances=Nuisances.none(), options=SINGLE)


def test_sphere_without_nuisances_obeys_equation_1(clean_ball):
    scene, frame = clean_ball
    response = true_response(scene, Nuisances.none())
    lit = frame.truth.normals.mask & (frame.truth.labels == ALL_LIT)
    assert lit.mean() > 0.2
    expected = frame.truth.normals.normals_in_camera[lit].astype(float) @ response.matrix.T
    assert np.abs(frame.radiance[lit] - expected).max() < 1e-5
    assert np.abs(frame.linear.rgb[lit] - expected).max() < 1e-5


def test_sphere_normals_and_depth_are_the_analytic_ones(clean_ball):
    scene, frame = clean_ball
    mask = frame.truth.normals.mask
    centre = scene.camera_from_object(0).translation
    points = scene.camera.points_from_depth(frame.truth.depth.depth)[mask]
    radial = points - centre
    assert np.abs(np.linalg.norm(radial, axis=1) - 0.3).max() < 1e-4
    normals = frame.truth.normals.normals_in_camera[mask]
    facing = np.sum(radial * points, axis=1) / np.linalg.norm(points, axis=1) < -0.03  # off the rim
    cosine = np.sum(normals * radial, axis=1) / np.linalg.norm(radial, axis=1)
    assert np.rad2deg(np.arccos(np.clip(cosine[facing], -1, 1))).max() < 0.1


@pytest.mark.parametrize("name", ["near_lights", "ambient", "crosstalk", "gloss"])
def test_each_optical_nuisance_alone_moves_the_colours(name):
    scene = ball_scene(gloss=0.3)
    clean = render_frame(scene, 0, nuisances=Nuisances.none(), options=SINGLE)
    one = render_frame(scene, 0, nuisances=Nuisances().only(name), options=SINGLE)
    mask = clean.truth.normals.mask
    difference = np.abs(one.radiance - clean.radiance)
    assert difference[mask].max() > 5e-3
    assert difference[~mask].max() == 0


def test_ambient_light_is_the_same_for_every_normal():
    scene = ball_scene()
    clean = render_frame(scene, 0, nuisances=Nuisances.none(), options=SINGLE)
    glowing = render_frame(scene, 0, nuisances=Nuisances().only("ambient"), options=SINGLE)
    mask = clean.truth.normals.mask
    added = (glowing.radiance - clean.radiance)[mask]
    response = true_response(scene, Nuisances().only("ambient"))
    assert np.abs(added - response.ambient).max() < 1e-6
    assert response.ambient.min() > 1e-3


def test_point_light_falls_off_with_the_square_of_the_distance():
    """A small patch square to a single lamp, moved along the ray from it."""
    scene = build_scene("sphere", replace(SMALL, lighting=Lighting.WHITE_3))
    lamp = scene.lights.positions[0]
    quad = np.array([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]]) * 0.05
    faces = grid_faces(np.arange(4).reshape(2, 2))
    values = []
    for push in (0.0, 1.0):
        centre = studio_centre() + push * (studio_centre() - lamp) / np.linalg.norm(studio_centre() - lamp)
        towards = (lamp - centre) / np.linalg.norm(lamp - centre)
        across = np.cross([1.0, 0, 0], towards)
        across /= np.linalg.norm(across)
        frame = np.stack([np.cross(across, -towards), across, -towards])  # rows: x, y, z of the patch
        patch = centre + quad @ frame
        surface = SceneSurface(faces=faces, reference_weights=GREY)
        moved = replace(scene, surface=surface, vertices=lambda _f, patch=patch: patch, frame_count=1)
        shot = render_frame(moved, 0, nuisances=Nuisances().only("near_lights"), options=SINGLE)
        u, v = np.rint(scene.camera.project(centre)).astype(int)
        values.append(shot.radiance[v, u, 1])
    near = np.linalg.norm(lamp - studio_centre())
    assert values[1] / values[0] == pytest.approx((near / (near + 1.0)) ** 2, rel=2e-3)


def hit_by_triangle(origin, target, triangles) -> np.ndarray:
    """Whether the segment meets each triangle (m, 3, 3): signed volumes, not Möller and Trumbore's Embree."""

    def volume(a, b, c, d):
        return np.einsum("...i,...i", np.cross(b - a, c - a), d - a)

    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    sides = np.sign(volume(a, b, c, origin)) * np.sign(volume(a, b, c, target)) < 0
    edges = np.stack(
        [volume(origin, target, a, b), volume(origin, target, b, c), volume(origin, target, c, a)]
    )
    return sides & (np.all(edges > 0, axis=0) | np.all(edges < 0, axis=0))


def test_shadows_equal_an_independent_ray_triangle_test():
    generator = np.random.default_rng(5)
    corners = generator.uniform(-0.4, 0.4, (60, 1, 3)) + generator.normal(0, 0.12, (60, 3, 3))
    triangles = corners + studio_centre()
    vertices = triangles.reshape(-1, 3)
    caster = RayScene((vertices, np.arange(180).reshape(60, 3)))
    origins = studio_centre() + generator.uniform(-0.6, 0.6, (400, 3))
    for lamp in studio_lights().positions:
        blocked = caster.blocked(origins, targets=np.broadcast_to(lamp, origins.shape))
        expected = np.array([hit_by_triangle(o, lamp, triangles).any() for o in origins])
        assert 0.1 < expected.mean() < 0.9
        assert np.array_equal(blocked, expected)


def test_visibility_labels_equal_the_independent_test_in_the_image():
    """A ball before a wall: labels against segments traced from the truth's own points."""
    ball, ball_faces = ball_mesh(0.12, 16, 24)
    wall = np.array([[-1, -0.8, 0.4], [1, -0.8, 0.4], [-1, 0.8, 0.4], [1, 0.8, 0.4]])
    vertices = np.concatenate([wall, ball]) + studio_centre()
    faces = np.concatenate([grid_faces(np.arange(4).reshape(2, 2)), ball_faces + 4])
    scene = replace(
        ball_scene(),
        surface=SceneSurface(faces=faces, reference_weights=GREY),
        vertices=lambda _frame: vertices,
        frame_count=1,
    )
    frame = render_frame(scene, 0, nuisances=Nuisances(), options=SINGLE)
    lit = lit_from_labels(frame.truth.labels)
    points = scene.camera.points_from_depth(frame.truth.depth.depth)
    v, u = np.nonzero(frame.truth.depth.depth > 5.3)  # the wall
    chosen = np.random.default_rng(1).choice(len(v), 300, replace=False)
    for k, lamp in enumerate(scene.lights.positions):
        for v_, u_ in zip(v[chosen], u[chosen], strict=True):
            origin = points[v_, u_] - np.array([0, 0, 2e-4])
            assert lit[v_, u_, k] == (not hit_by_triangle(origin, lamp, vertices[faces[2:]]).any())
    wall_lit = lit[v, u].all(axis=1).mean()
    assert 0.6 < wall_lit < 0.98


@pytest.mark.slow
def test_turning_off_shadows_only_adds_light():
    scene = build_scene("jacket", SMALL)
    with_shadows = render_frame(scene, 0, nuisances=Nuisances(), options=SINGLE).truth.labels
    without = render_frame(scene, 0, nuisances=Nuisances().without("shadows"), options=SINGLE).truth.labels
    assert np.all((with_shadows & ~without) == 0)
    assert np.count_nonzero(without & ~with_shadows) > 50


def test_visible_vertices_project_onto_the_depth_map():
    scene = ball_scene()
    frame = render_frame(scene, 1, options=SINGLE)
    vertices = scene.vertices(1)
    normals = vertex_normals(vertices, scene.surface.faces)
    seen = np.sum(normals * vertices, axis=1) < -0.3 * np.linalg.norm(vertices, axis=1)
    pixels = scene.camera.project(vertices[seen])
    whole = np.rint(pixels).astype(int)
    assert frame.truth.depth.mask[whole[:, 1], whole[:, 0]].all()
    # Half a pixel off on a slope of at most 73°: the depth may differ by half a pixel's size × its tangent.
    pixel_m = 5.0 / scene.camera.matrix[0, 0]
    error = np.abs(frame.truth.depth.depth[whole[:, 1], whole[:, 0]] - vertices[seen, 2])
    assert error.max() < 0.75 * pixel_m * np.tan(np.arccos(0.3))


def test_flow_carries_vertices_onto_the_next_frame():
    """Visible vertices, by bilinear flow at their place in frame 0, land on themselves in frame 1."""
    scene = build_scene("sphere", SceneOptions(width=320, height=240))
    frame = render_frame(scene, 0, options=SINGLE)
    before, after = scene.vertices(0), scene.vertices(1)
    normals = vertex_normals(before, scene.surface.faces)
    seen = np.sum(normals * before, axis=1) < -0.3 * np.linalg.norm(before, axis=1)
    place = scene.camera.project(before[seen])
    low = np.floor(place).astype(int)
    f = place - low
    flow = sum(
        (f[:, [0]] if du else 1 - f[:, [0]]) * (f[:, [1]] if dv else 1 - f[:, [1]])
        * frame.truth.flow_px[low[:, 1] + dv, low[:, 0] + du]
        for du in (0, 1) for dv in (0, 1)
    )  # fmt: skip
    moved = scene.camera.project(after[seen]) - place
    assert np.linalg.norm(moved, axis=1).max() > 1.0
    assert np.linalg.norm(flow - moved, axis=1).max() < 0.05


def test_flow_leads_to_the_same_depth_in_the_next_frame():
    scene = ball_scene()
    first, second = (render_frame(scene, i, options=SINGLE) for i in (0, 1))
    inner = np.linalg.norm(scene.camera.pixel_grid() - [79.5, 59.5], axis=2) < 25
    target = scene.camera.pixel_grid()[inner] + first.truth.flow_px[inner]
    whole = np.rint(target).astype(int)
    depth = second.truth.depth.depth[whole[:, 1], whole[:, 0]]
    step = scene.camera_from_object(1).translation - scene.camera_from_object(0).translation
    # The ball comes 1 cm nearer or goes: its middle's depth changes by that, give or take its turn.
    assert np.median(depth - first.truth.depth.depth[inner]) == pytest.approx(step[2], abs=2e-3)
    assert render_frame(scene, 2, options=SINGLE).truth.flow_px is None


def test_detail_tilts_the_true_normal_by_its_slope():
    """A ramp of 10° painted as relief on a plane square to the camera."""
    tile = 64
    ramp = np.linspace(0, 1, tile, endpoint=False)[None, :] * np.ones((tile, 1))
    plane = np.array([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]]) * 0.2 + studio_centre()
    faces = grid_faces(np.arange(4).reshape(2, 2))
    corner_uv = np.array([[0, 0], [1, 0], [0, 1], [1, 1.0]])[faces]
    rise = 0.4 * np.tan(np.deg2rad(10))  # over the plane's width of 0.4 m
    scene = replace(
        ball_scene(),
        surface=SceneSurface(
            faces=faces, reference_weights=GREY, uv=corner_uv, detail=Detail(height_m=rise * ramp)
        ),
        vertices=lambda _frame: plane,
        frame_count=1,
    )
    frame = render_frame(scene, 0, nuisances=Nuisances.none(), options=SINGLE)
    v, u = (round(x) for x in scene.camera.project(studio_centre())[::-1])
    # The height grows to the right, towards the viewer: the normal leans to the left.
    expected = [-np.sin(np.deg2rad(10)), 0, -np.cos(np.deg2rad(10))]
    assert frame.truth.normals.normals_in_camera[v, u] == pytest.approx(expected, abs=1e-5)


def test_more_samples_soften_edges_only():
    scene = ball_scene()
    one, nine = (
        render_frame(scene, 0, nuisances=Nuisances.none(), options=RenderOptions(samples=n)) for n in (1, 9)
    )
    assert np.array_equal(one.truth.depth.depth, nine.truth.depth.depth)
    inner = np.linalg.norm(scene.camera.pixel_grid() - [79.5, 59.5], axis=2) < 40
    assert np.abs(one.radiance - nine.radiance)[inner].max() < 5e-3
    edge = (nine.radiance[..., 1] > 0.005) & (nine.radiance[..., 1] < 0.1)
    assert edge.sum() > (edge & (one.radiance[..., 1] > 0.005) & (one.radiance[..., 1] < 0.1)).sum()


def test_the_same_seed_gives_the_same_frame_on_any_number_of_threads():
    scene = ball_scene()
    first = Renderer(scene, options=RenderOptions(threads=1)).render(
        scene.vertices(0), scene.vertices(1), frame_generator(3, 0)
    )
    second = Renderer(scene, options=RenderOptions(threads=2)).render(
        scene.vertices(0), scene.vertices(1), frame_generator(3, 0)
    )
    other = render_frame(scene, 0, seed=4)
    assert np.array_equal(first.stored, second.stored)
    assert np.array_equal(first.truth.flow_px, second.truth.flow_px)
    assert not np.array_equal(first.stored, other.stored)
