"""Maps and meshes come back as they were, and lie on disk the way other tools expect them."""

import cv2
import numpy as np
import pytest

from tests.result_files import read_flow, read_point_cloud
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.geometry.point_cloud import PointCloud
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.maps_and_meshes.exr import write_exr
from vntoolkit.io.maps_and_meshes.maps import (
    read_depth_map,
    read_normal_map,
    write_depth_map,
    write_flow,
    write_normal_map,
)
from vntoolkit.io.maps_and_meshes.meshes import (
    read_mesh,
    write_mesh,
    write_point_cloud,
)
from vntoolkit.io.results.sequences import MeshSequenceWriter, read_mesh_sequence
from vntoolkit.options.export import NormalConvention


@pytest.fixture
def ball() -> NormalMap:
    v, u = np.mgrid[:41, :51]
    x, y = (u - 25) / 19, (v - 20) / 19
    mask = x * x + y * y < 1
    z = -np.sqrt(np.where(mask, 1 - x * x - y * y, 0))
    return NormalMap(normals_in_camera=np.where(mask[..., None], np.stack([x, y, z], -1), 0), mask=mask)


@pytest.fixture
def patch(rng) -> Mesh:
    """A bulge towards the camera, 6×5 vertices, faces counter-clockwise seen from the camera."""
    v, u = np.mgrid[:5, :6]
    vertices = np.stack([u - 2.5, v - 2.0, 9 + 0.1 * ((u - 2.5) ** 2 + (v - 2.0) ** 2)], -1).reshape(-1, 3)
    i = np.arange(30).reshape(5, 6)
    a, b, c, d = (x.ravel() for x in (i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]))
    faces = np.concatenate([np.stack([a, d, b], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    colours = (rng.integers(0, 256, (30, 3)) / 255).astype(np.float32)
    uv = np.stack([u / 5, 1 - v / 4], -1).reshape(-1, 2)
    return Mesh(
        vertices=vertices, faces=faces, normals=vertex_normals(vertices, faces), colours=colours, uv=uv
    )


@pytest.mark.parametrize("convention", list(NormalConvention))
@pytest.mark.parametrize(
    ("name", "bits", "error_deg"), [("n.exr", 16, 0.04), ("n.png", 16, 0.04), ("n.png", 8, 0.4)]
)
def test_normals_survive_every_format_and_convention(tmp_path, ball, convention, name, bits, error_deg):
    # Half a level of an 8-bit component is 0.0039, of a half float near 1 0.00024: times √3, in degrees.
    write_normal_map(tmp_path / name, ball, convention=convention)
    if bits == 8:
        stored = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(tmp_path / name), np.rint(stored / 257).astype(np.uint8))
    back = read_normal_map(tmp_path / name, convention=convention)
    np.testing.assert_array_equal(back.mask, ball.mask)
    chord = np.linalg.norm(back.normals_in_camera - ball.normals_in_camera, axis=2)
    assert np.rad2deg(chord.max()) < error_deg
    if name.endswith("exr"):  # the header says which convention it is
        np.testing.assert_array_equal(
            read_normal_map(tmp_path / name).normals_in_camera, back.normals_in_camera
        )


def test_a_normal_png_shows_a_ball_lit_the_blender_way(tmp_path, ball):
    """The upper side is green, the right side red, the centre blue: x right, y up, z to the viewer."""
    write_normal_map(tmp_path / "n.png", ball)
    blue, green, red, alpha = np.moveaxis(cv2.imread(str(tmp_path / "n.png"), cv2.IMREAD_UNCHANGED), -1, 0)
    assert blue.dtype == np.uint16
    assert green[4, 25] > 60_000 > 6_000 > green[36, 25]
    assert red[20, 41] > 60_000 > 6_000 > red[20, 9]
    assert blue[20, 25] == 65_535
    np.testing.assert_array_equal(alpha > 0, ball.mask)


def test_weights_travel_in_the_alpha_of_an_exr(tmp_path, ball, rng):
    weight = rng.uniform(0.1, 1, ball.shape).astype(np.float32)
    graded = NormalMap(normals_in_camera=ball.normals_in_camera, mask=ball.mask, weight=weight)
    write_normal_map(tmp_path / "n.exr", graded)
    back = read_normal_map(tmp_path / "n.exr")
    np.testing.assert_allclose(back.weight, weight * ball.mask, atol=5e-4)


def test_nan_normals_are_refused(tmp_path):
    channels = {name: np.full((3, 4), np.nan, np.float32) for name in "RGB"}
    write_exr(tmp_path / "n.exr", {**channels, "A": np.ones((3, 4), np.float32)})
    with pytest.raises(BadInput, match="12 normals are NaN or infinite"):
        read_normal_map(tmp_path / "n.exr")
    write_exr(tmp_path / "n.exr", channels)
    with pytest.raises(BadInput, match="expected normals, vectors of length 1, got none"):
        read_normal_map(tmp_path / "n.exr")


@pytest.mark.parametrize("unit", list(LengthUnit))
def test_depth_keeps_its_mask_and_unit(tmp_path, rng, unit):
    mask = rng.random((7, 9)) > 0.4
    depth = np.where(mask, rng.uniform(1, 5, (7, 9)), 0).astype(np.float32)
    write_depth_map(tmp_path / "z.exr", DepthMap(depth=depth, mask=mask, unit=unit))
    back = read_depth_map(tmp_path / "z.exr")
    np.testing.assert_array_equal(back.depth, depth)
    np.testing.assert_array_equal(back.mask, mask)
    assert back.unit is unit


def test_flow_comes_back(tmp_path, rng):
    flow = rng.normal(size=(5, 6, 2)).astype(np.float32)
    write_flow(tmp_path / "f.exr", flow)
    np.testing.assert_array_equal(read_flow(tmp_path / "f.exr"), flow)


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_meshes_come_back(tmp_path, patch, suffix):
    write_mesh(tmp_path / f"m{suffix}", patch)
    back = read_mesh(tmp_path / f"m{suffix}")
    np.testing.assert_array_equal(back.faces, patch.faces)
    for name in ("vertices", "normals", "colours", "uv"):
        np.testing.assert_allclose(getattr(back, name), getattr(patch, name), atol=2e-6, err_msg=name)


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_other_tools_see_it_upright_and_from_outside(tmp_path, patch, suffix):
    """In MeshLab's view (y up, viewer at +z) the bulge faces the viewer, the top row of pixels is on top."""
    pymeshlab = pytest.importorskip("pymeshlab")
    write_mesh(tmp_path / f"m{suffix}", patch)
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(tmp_path / f"m{suffix}"))
    seen = meshes.current_mesh()
    assert (seen.face_normal_matrix()[:, 2] > 0).all()
    assert (seen.vertex_normal_matrix()[:, 2] > 0).all()
    vertices = seen.vertex_matrix().reshape(5, 6, 3)
    assert (np.diff(vertices[..., 1], axis=0) < 0).all()
    assert (np.diff(vertices[..., 0], axis=1) > 0).all()
    assert vertices[2, 2:4, 2].mean() > vertices[0, 0, 2]
    level = 1 / 255 if suffix == ".obj" else 0  # MeshLab cuts an OBJ's decimal colours down to bytes
    np.testing.assert_allclose(seen.vertex_color_matrix()[:, :3], patch.colours, atol=level + 1e-6)


def test_open3d_reads_the_ply(tmp_path, patch):
    open3d = pytest.importorskip("open3d")
    write_mesh(tmp_path / "m.ply", patch)
    seen = open3d.io.read_triangle_mesh(str(tmp_path / "m.ply"))
    assert (len(seen.vertices), len(seen.triangles)) == (30, 40)
    assert seen.has_vertex_normals()
    np.testing.assert_allclose(np.asarray(seen.vertex_colors), patch.colours, atol=1e-6)


def test_a_ply_from_open3d_ascii_or_binary_is_read(tmp_path, patch):
    open3d = pytest.importorskip("open3d")
    for ascii_ in (True, False):
        open3d.io.write_triangle_mesh(str(tmp_path / "m.ply"), patch.to_open3d(), write_ascii=ascii_)
        back = read_mesh(tmp_path / "m.ply")
        np.testing.assert_allclose(back.vertices, patch.vertices * [1, -1, -1], atol=1e-4)
        np.testing.assert_array_equal(back.faces, patch.faces)
        np.testing.assert_allclose(back.colours, patch.colours, atol=1e-6)


def test_texture_travels_with_an_obj(tmp_path, patch, rng):
    texture = rng.integers(0, 255, (8, 9, 3), dtype=np.uint8)
    write_mesh(tmp_path / "m.obj", patch, texture=texture)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m.mtl", "m.obj", "m.png"]
    np.testing.assert_array_equal(read_image(tmp_path / "m.png"), texture)


def test_obj_polygons_seams_and_backward_indices(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt .5 .5\n"
    (tmp_path / "m.obj").write_text(text + "f 1/1 2/2 3/3 4/4\nf -4/5 -3/2 -2/3\n")
    mesh = read_mesh(tmp_path / "m.obj")
    assert (len(mesh.vertices), len(mesh.faces)) == (5, 3)  # vertex 1 has two texture coordinates
    for corners, uv in zip(mesh.faces, mesh.uv[mesh.faces], strict=True):
        assert len(set(corners)) == 3
        assert np.isfinite(uv).all()


def test_polygons_in_a_ply_are_cut_into_triangles(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 2\nproperty list uchar int vertex_index\nend_header\n"
    (tmp_path / "m.ply").write_text(header + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n2 2 0\n4 0 1 2 3\n3 2 4 3\n")
    mesh = read_mesh(tmp_path / "m.ply")
    assert sorted(map(tuple, mesh.faces.tolist())) == [(0, 1, 2), (0, 2, 3), (2, 4, 3)]


def test_point_clouds_come_back(tmp_path, patch):
    cloud = PointCloud(points=patch.vertices, normals=patch.normals, colours=patch.colours)
    write_point_cloud(tmp_path / "c.ply", cloud)
    back = read_point_cloud(tmp_path / "c.ply")
    np.testing.assert_allclose(back.points, cloud.points, atol=1e-6)
    np.testing.assert_allclose(back.normals, cloud.normals, atol=1e-6)
    np.testing.assert_allclose(back.colours, cloud.colours, atol=1e-6)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8, 0.99])
def test_a_ply_cut_off_is_one_line(tmp_path, patch, share):
    write_mesh(tmp_path / "m.ply", patch)
    content = (tmp_path / "m.ply").read_bytes()
    (tmp_path / "m.ply").write_bytes(content[: int(len(content) * share)])
    with pytest.raises(BadMesh, match=r"m\.ply: "):
        read_mesh(tmp_path / "m.ply")


def test_moving_meshes_stay_on_disk_and_resume(tmp_path, patch, rng):
    frames = patch.vertices + rng.normal(size=(5, 30, 3)).astype(np.float32)
    confidence = rng.random((5, 30)).astype(np.float32)
    with MeshSequenceWriter(tmp_path / "s", patch, frame_rate_hz=25) as writer:
        for k in range(3):
            writer.append(frames[k], confidence[k])
            assert len(read_mesh_sequence(tmp_path / "s")) == k + 1  # readable at any moment
    with (tmp_path / "s" / "vertices.npy").open("ab") as torn:
        torn.write(b"half a frame that a crash left")
    with MeshSequenceWriter(tmp_path / "s", patch, frame_rate_hz=25, resume=True) as writer:
        assert writer.frame_count == 3
        for k in (3, 4):
            writer.append(frames[k], confidence[k])
    sequence = read_mesh_sequence(tmp_path / "s")
    assert isinstance(sequence.vertices.base, np.memmap)
    np.testing.assert_allclose(sequence.vertices, frames, rtol=1e-6)
    np.testing.assert_array_equal(sequence.uncertainty_px, confidence)
    assert sequence.frame_rate_hz == 25
    np.testing.assert_array_equal(sequence.template.faces, patch.faces)
