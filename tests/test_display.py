"""What objects show of themselves: one short line, and in a notebook a picture with a few figures."""

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image

import vntoolkit as vt
from vntoolkit.errors import BadInput
from vntoolkit.io.footage.image_writing import write_png

CAMERA = vt.Camera.orthographic(width=40, height=30)
MATRIX = [[0.35, -0.02, -0.5], [-0.17, 0.3, -0.48], [-0.15, -0.28, -0.52]]


@pytest.fixture
def objects(tmp_path) -> dict[str, object]:
    frame = vt.LinearFrame(np.full((30, 40, 3), 0.4))
    normals = vt.normals_from_frame(frame, vt.LightResponse(matrix=MATRIX))
    depth = vt.DepthIntegrator(CAMERA).integrate(normals)
    mesh = vt.mesh_from_depth(depth, CAMERA)
    write_png(tmp_path / "frame.png", np.full((30, 40, 3), 90, dtype=np.uint8))
    return {
        "LinearFrame": frame,
        "NormalMap": normals,
        "DepthMap": depth,
        "Mesh": mesh,
        "PointCloud": vt.point_cloud_from_depth(depth, CAMERA),
        "MeshSequence": vt.MeshSequence(template=mesh, vertices=np.stack([mesh.vertices, mesh.vertices])),
        "Rig": vt.Rig(camera=CAMERA, response=vt.LightResponse(matrix=MATRIX)),
        "Capture": vt.open_capture(tmp_path / "frame.png"),
    }


def test_a_line_tells_no_array(objects) -> None:
    for name, shown in objects.items():
        assert repr(shown).startswith(f"{name}(")
        assert repr(shown).endswith(")")
        assert len(repr(shown)) < 200
        assert "array(" not in repr(shown)
    assert "size 40×30" in repr(objects["LinearFrame"])
    assert "vertices 1200, faces 2262" in repr(objects["Mesh"])


def test_a_notebook_shows_a_picture_of_what_can_be_seen(objects) -> None:
    for name, shown in objects.items():
        page = shown._repr_html_()
        assert f"<b>{name}</b>" in page
        picture = re.search(r"data:image/png;base64,([^']+)'", page)
        assert (picture is None) == (name == "Rig")
        if picture is not None:
            assert max(Image.open(io.BytesIO(base64.b64decode(picture[1]))).size) >= 40


def test_a_picture_of_normals_has_blenders_colours() -> None:
    facing = np.zeros((4, 4, 3), np.float32)
    facing[..., 2] = -1.0
    mask = np.ones((4, 4), bool)
    mask[0, 0] = False
    seen = vt.NormalMap(normals_in_camera=facing, mask=mask)._picture()
    assert seen[1, 1].tolist() == [128, 128, 255]
    assert seen[0, 0].tolist() == [255, 255, 255]


def test_nothing_at_all_is_shown_too() -> None:
    empty = np.zeros((4, 4), bool)
    for shown in (
        vt.NormalMap(normals_in_camera=np.zeros((4, 4, 3)), mask=empty),
        vt.DepthMap(depth=np.zeros((4, 4)), mask=empty),
        vt.PointCloud(points=np.zeros((0, 3))),
        vt.Mesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), int)),
    ):
        assert shown._repr_html_()
        assert repr(shown)


def test_a_frame_is_made_of_an_array_alone() -> None:
    rgb = np.full((3, 4, 3), 0.5)
    rgb[1, 2, 0] = 1.0
    frame = vt.LinearFrame(rgb)
    assert frame.rgb.dtype == np.float32
    assert np.argwhere(frame.clipped).tolist() == [[1, 2]]


def test_a_camera_tells_which_normals_face_away_from_it() -> None:
    pinhole = vt.Camera.pinhole(width=40, height=30, focal_px=20.0)  # 45 degrees to the left and right border
    grazing = np.array([0.9, 0.0, -np.sqrt(1 - 0.81)])
    response = vt.LightResponse(matrix=MATRIX, ambient=np.full(3, 0.5))
    frame = vt.LinearFrame(np.broadcast_to(response.matrix @ grazing + 0.5, (30, 40, 3)))
    assert vt.normals_from_frame(frame, response).mask.all()
    seen = vt.normals_from_frame(frame, response, camera=pinhole)
    rays = pinhole.points_from_depth(np.ones((30, 40)))
    assert np.array_equal(seen.mask, rays @ grazing < 0)
    assert seen.mask.any()
    assert not seen.mask.all()
    assert not seen.weight[~seen.mask].any()
    assert vt.normals_from_frame(frame, response, camera=CAMERA).mask.all()
    with pytest.raises(BadInput, match="frame is 40×30 but the camera is 20×30"):
        vt.normals_from_frame(frame, response, camera=vt.Camera.pinhole(width=20, height=30, focal_px=20.0))
