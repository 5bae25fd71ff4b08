import numpy as np
import pytest

from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import face_normals
from vntoolkit.meshing.surface import mesh_from_depth, point_cloud_from_depth
from vntoolkit.options.depth import MeshOptions

ORTHOGRAPHIC = Camera.orthographic(width=40, height=30)
PINHOLE = Camera.pinhole(width=40, height=30, focal_px=60)


def dome(height: int = 30, width: int = 40, radius: float = 14.0) -> DepthMap:
    v, u = np.mgrid[:height, :width]
    squared = radius**2 - (u - (width - 1) / 2) ** 2 - (v - (height - 1) / 2) ** 2
    mask = squared > 4
    return DepthMap(depth=np.where(mask, -np.sqrt(np.maximum(squared, 0)), 0.0), mask=mask)


@pytest.mark.parametrize("camera", [ORTHOGRAPHIC, PINHOLE], ids=lambda c: c.model.value)
def test_triangles_face_the_camera(camera: Camera) -> None:
    depth = DepthMap(depth=np.full((30, 40), 3.0), mask=np.ones((30, 40), bool))
    mesh = mesh_from_depth(depth, camera)
    assert len(mesh.vertices) == 30 * 40
    assert len(mesh.faces) == 2 * 29 * 39
    assert np.all(face_normals(mesh.vertices, mesh.faces)[:, 2] < 0)
    np.testing.assert_allclose(mesh.normals, np.tile([0, 0, -1.0], (1200, 1)), atol=1e-12)


def test_a_dome_bulges_towards_the_viewer_and_its_normals_point_out() -> None:
    mesh = mesh_from_depth(dome(), ORTHOGRAPHIC, options=MeshOptions(largest_step=1e6))
    centre = mesh.vertices[np.argmin(mesh.vertices[:, 2])]
    np.testing.assert_allclose(centre[:2], [0, 0], atol=0.51)
    outwards = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    assert np.median(np.sum(mesh.normals * outwards, axis=1)) > 0.99


def test_projected_vertices_are_the_pixels_but_at_the_rim() -> None:
    depth = dome()
    shifted = DepthMap(depth=np.where(depth.mask, depth.depth + 60, 0), mask=depth.mask)
    mesh = mesh_from_depth(shifted, PINHOLE, options=MeshOptions(largest_step=1e6))
    pixels = PINHOLE.project(mesh.vertices)
    moved = np.linalg.norm(pixels - np.round(pixels), axis=1)
    assert np.mean(moved < 1e-9) > 0.8
    inside = np.argwhere(depth.mask)[:, ::-1]
    assert np.linalg.norm(pixels[:, None] - inside, axis=-1).min(axis=1).max() <= 1.0 + 1e-9
    np.testing.assert_allclose(mesh.uv[:, 0] * 40 - 0.5, pixels[:, 0], atol=1e-9)
    np.testing.assert_allclose((1 - mesh.uv[:, 1]) * 30 - 0.5, pixels[:, 1], atol=1e-9)


def test_a_jump_is_not_bridged() -> None:
    depth = np.zeros((30, 40))
    depth[:, 20:] = 100
    mesh = mesh_from_depth(DepthMap(depth=depth, mask=np.ones((30, 40), bool)), ORTHOGRAPHIC)
    assert np.ptp(mesh.vertices[:, 2][mesh.faces], axis=1).max() == 0
    assert len(mesh.faces) == 2 * 29 * (19 + 19)


def test_a_quad_of_three_gives_one_triangle_whichever_corner_is_missing() -> None:
    camera = Camera.orthographic(width=2, height=2)
    for missing in np.ndindex(2, 2):
        mask = np.ones((2, 2), bool)
        mask[missing] = False
        mesh = mesh_from_depth(DepthMap(depth=np.zeros((2, 2)), mask=mask), camera)
        assert mesh.faces.shape == (1, 3)
        assert face_normals(mesh.vertices, mesh.faces)[0, 2] < 0


def test_colours_normals_and_stride(rng: np.random.Generator) -> None:
    depth = dome()
    rgb = rng.uniform(-0.1, 1.2, (30, 40, 3)).astype(np.float32)
    normals = np.zeros((30, 40, 3), np.float32)
    normals[..., 2] = -1
    normal_map = NormalMap(normals_in_camera=normals, mask=depth.mask)
    options = MeshOptions(stride=2, largest_step=1e6)
    mesh = mesh_from_depth(depth, ORTHOGRAPHIC, rgb=rgb, normal_map=normal_map, options=options)
    pixels = 2 * np.round(ORTHOGRAPHIC.project(mesh.vertices) / 2).astype(int)
    inner = np.abs(ORTHOGRAPHIC.project(mesh.vertices) - pixels).max(axis=1) < 1e-9
    assert inner.mean() > 0.6
    pixels = pixels[inner]
    np.testing.assert_allclose(mesh.colours[inner], np.clip(rgb[pixels[:, 1], pixels[:, 0]], 0, 1))
    np.testing.assert_array_equal(mesh.normals[:, 2], -1)


def test_a_point_cloud_has_one_point_a_pixel() -> None:
    depth = dome()
    cloud = point_cloud_from_depth(depth, ORTHOGRAPHIC)
    assert len(cloud.points) == depth.mask.sum()


def test_refusals() -> None:
    empty = DepthMap(depth=np.zeros((30, 40)), mask=np.zeros((30, 40), bool))
    with pytest.raises(BadInput, match="mask is empty"):
        mesh_from_depth(empty, ORTHOGRAPHIC)
    cliffs = DepthMap(depth=100.0 * np.arange(1200.0).reshape(30, 40), mask=np.ones((30, 40), bool))
    with pytest.raises(BadMesh, match="jumps by more than 10 pixel widths in every triangle"):
        mesh_from_depth(cliffs, ORTHOGRAPHIC)
    with pytest.raises(BadInput, match="but the camera is"):
        mesh_from_depth(dome(20, 20), ORTHOGRAPHIC)


def test_a_stride_that_meets_no_valid_pixel_is_refused() -> None:
    mask = np.zeros((30, 40), bool)
    mask[1::2, 1::2] = True
    with pytest.raises(BadMesh, match="no three neighbouring pixels"):
        mesh_from_depth(
            DepthMap(depth=np.zeros((30, 40)), mask=mask), ORTHOGRAPHIC, options=MeshOptions(stride=2)
        )


def test_a_mesh_is_the_same_wherever_its_subject_lies() -> None:
    """Only the rows and columns of the subject are looked at."""
    mask = np.zeros((30, 40), bool)
    mask[3:11, 4:13] = True
    depth = np.where(mask, np.arange(1200.0).reshape(30, 40) % 7, 0.0)
    there = mesh_from_depth(
        DepthMap(depth=np.roll(depth, (15, 20), (0, 1)), mask=np.roll(mask, (15, 20), (0, 1))), ORTHOGRAPHIC
    )
    here = mesh_from_depth(DepthMap(depth=depth, mask=mask), ORTHOGRAPHIC)
    np.testing.assert_array_equal(there.faces, here.faces)
    np.testing.assert_allclose(there.vertices - here.vertices, np.tile([20.0, 15.0, 0.0], (72, 1)), atol=1e-9)


def rim_of(faces: np.ndarray) -> np.ndarray:
    """Vertices of edges that belong to one triangle alone."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    return np.unique(unique[counts == 1])


@pytest.mark.parametrize("behind", [False, True], ids=["outline", "jump"])
def test_the_rim_of_a_disc_is_round(behind: bool) -> None:
    """Centres of pixels lie up to a pixel within the true edge; the rim lies on it but for flat runs."""
    camera = Camera.orthographic(width=80, height=70)
    v, u = np.mgrid[:70, :80]
    radius = np.hypot(u - 40.2, v - 34.7)
    disc = radius < 27.3
    depth = DepthMap(depth=np.where(disc, 5.0, 90.0), mask=disc | behind)
    mesh = mesh_from_depth(depth, camera)
    ours = rim_of(mesh.faces)
    ours = ours[mesh.vertices[ours, 2] < 6]
    off = np.hypot(*(camera.project(mesh.vertices[ours]) - [40.2, 34.7]).T) - 27.3
    assert np.sqrt(np.mean(off**2)) < 0.17
    assert abs(off.mean()) < 0.1
    assert np.all(face_normals(mesh.vertices, mesh.faces)[:, 2] < 0)
    assert (
        np.abs(mesh.vertices[:, 2, None] - [5.0, 90.0]).min(axis=1).max() < 1e-6
    )  # neither bends to the other


def test_the_rim_of_a_ball_is_smooth_from_the_side() -> None:
    """Depth falls by √(2 r) = 7.4 pixels within the last one, where each row's outermost centre lies."""
    v, u = np.mgrid[:70, :80]
    squared = 27.3**2 - (u - 40.2) ** 2 - (v - 34.7) ** 2
    depth = DepthMap(depth=90.0 - np.sqrt(np.maximum(squared, 0.0)), mask=squared > 0)
    mesh = mesh_from_depth(depth, Camera.orthographic(width=80, height=70))
    rim = mesh.vertices[rim_of(mesh.faces)]
    assert np.std(rim[:, 2]) < 0.7
    assert np.std(depth.depth[depth.mask & (squared < 54)]) > 1.5  # of the pixels as they are
    centre = np.array([40.2 - 39.5, 34.7 - 34.5, 90.0])
    assert np.abs(np.linalg.norm(rim - centre, axis=1) - 27.3).max() < 0.8  # a plane bends less than the ball


def test_rims_stay_on_a_tilted_plane_and_at_the_border_of_the_picture() -> None:
    v, u = np.mgrid[:30, :40]
    depth = 60.0 + 0.5 * u - 0.3 * v
    mask = np.hypot(u - 2, v - 15) < 13
    normals = np.zeros((30, 40, 3)) + np.array([0.5, -0.3, -1.0]) / np.linalg.norm([0.5, -0.3, -1.0])
    mesh = mesh_from_depth(
        DepthMap(depth=depth, mask=mask), ORTHOGRAPHIC,
        normal_map=NormalMap(normals_in_camera=normals, mask=mask),
    )  # fmt: skip
    places = ORTHOGRAPHIC.project(mesh.vertices)
    wanted = 60.0 + 0.5 * places[:, 0] - 0.3 * places[:, 1]
    np.testing.assert_allclose(mesh.vertices[:, 2], wanted, atol=1e-5)
    assert places[:, 0].min() > -1e-9
