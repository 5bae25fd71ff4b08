"""GLB: a file that the specification allows, whose morph targets are the frames."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recipes.walk_motion import walking_motion
from vntoolkit.errors import BadMesh, CannotWrite
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.io.maps_and_meshes import glb
from vntoolkit.io.maps_and_meshes.glb import write_glb
from vntoolkit.pipeline.dress import dress, write_dressed_figure

COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
KINDS = {5126: np.float32, 5125: np.uint32, 5123: np.uint16}


def chunks(path: Path) -> tuple[dict, bytes]:
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    assert kind == b"JSON"
    assert size % 4 == 0
    binary_size, binary_kind = struct.unpack_from("<I4s", content, 20 + size)
    assert binary_kind == b"BIN\0"
    assert 28 + size + binary_size == len(content)
    return json.loads(content[20 : 20 + size]), content[28 + size :]


def accessor(document: dict, binary: bytes, index: int) -> np.ndarray:
    described = document["accessors"][index]
    view = document["bufferViews"][described["bufferView"]]
    assert view["byteOffset"] % 4 == 0
    width = COMPONENTS[described["type"]]
    values = np.frombuffer(
        binary, KINDS[described["componentType"]], described["count"] * width, view["byteOffset"]
    )
    assert values.nbytes == view["byteLength"]
    values = values.reshape(-1, width)
    if "min" in described:
        np.testing.assert_array_equal(values.min(axis=0), np.array(described["min"], values.dtype))
        np.testing.assert_array_equal(values.max(axis=0), np.array(described["max"], values.dtype))
    return values


def test_frames_come_back_from_the_morph_targets(tmp_path: Path, moving_jumper: MeshSequence) -> None:
    path = tmp_path / "clip.glb"
    template, captured = moving_jumper.template, moving_jumper.vertices[:7]
    assert write_glb(path, template, iter(captured), frame_rate_hz=50) == 7
    document, binary = chunks(path)
    assert document["asset"]["version"] == "2.0"
    primitive = document["meshes"][0]["primitives"][0]
    base = accessor(document, binary, primitive["attributes"]["POSITION"])
    targets = [accessor(document, binary, target["POSITION"]) for target in primitive["targets"]]
    sampler = document["animations"][0]["samplers"][0]
    times = accessor(document, binary, sampler["input"]).ravel()
    weights = accessor(document, binary, sampler["output"]).reshape(7, 6)
    np.testing.assert_allclose(times, np.arange(7) / 50, rtol=1e-6)
    assert "min" in document["accessors"][sampler["input"]]
    for frame in range(7):
        shown = base + sum(w * target for w, target in zip(weights[frame], targets, strict=True))
        np.testing.assert_allclose(shown, captured[frame] * [1, -1, -1], atol=1e-6)
    indices = accessor(document, binary, primitive["indices"])
    np.testing.assert_array_equal(indices.reshape(-1, 3), template.faces)
    np.testing.assert_array_equal(
        accessor(document, binary, primitive["attributes"]["COLOR_0"]), template.colours
    )
    uv = accessor(document, binary, primitive["attributes"]["TEXCOORD_0"])
    np.testing.assert_allclose(uv, np.column_stack([template.uv[:, 0], 1 - template.uv[:, 1]]), atol=1e-6)


def test_another_library_reads_it(tmp_path: Path, moving_jumper: MeshSequence) -> None:
    import open3d as o3d

    write_glb(tmp_path / "clip.glb", moving_jumper.template, moving_jumper.vertices[:3], frame_rate_hz=60)
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / "clip.glb"))
    assert len(mesh.triangles) == len(moving_jumper.template.faces)
    low, high = mesh.get_min_bound(), mesh.get_max_bound()
    shown = moving_jumper.vertices[0] * [1, -1, -1]
    np.testing.assert_allclose([low, high], [shown.min(axis=0), shown.max(axis=0)], atol=1e-5)


def test_one_frame_is_a_still_mesh(tmp_path: Path, jumper: Mesh) -> None:
    write_glb(tmp_path / "still.glb", jumper, [jumper.vertices], frame_rate_hz=60)
    document, _ = chunks(tmp_path / "still.glb")
    assert "animations" not in document
    assert "targets" not in document["meshes"][0]["primitives"][0]


def test_a_long_clip_is_sent_to_usd(tmp_path: Path, jumper: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(glb, "MAX_BYTES", 10**6)
    with pytest.raises(CannotWrite, match=r"write \.usdc"):
        write_glb(tmp_path / "long.glb", jumper, (jumper.vertices for _ in range(10**6)), frame_rate_hz=60)
    with pytest.raises(BadMesh, match="at least one frame"):
        write_glb(tmp_path / "none.glb", jumper, [], frame_rate_hz=60)
    assert not list(tmp_path.iterdir())


def test_a_skin_holds_joints_weights_and_folds(tmp_path: Path, moving_jumper: MeshSequence) -> None:
    """The specification's own sum, joints × inverse bind × (position + shapes), gives the dressed garment."""
    dressed = dress(moving_jumper, walking_motion())
    write_dressed_figure(dressed, tmp_path / "skin.glb")
    document, binary = chunks(tmp_path / "skin.glb")
    primitive = document["meshes"][0]["primitives"][0]
    values = {name: accessor(document, binary, i) for name, i in primitive["attributes"].items()}
    assert {"POSITION", "NORMAL", "COLOR_0", "TEXCOORD_0", "JOINTS_0", "WEIGHTS_0"} <= set(values)
    np.testing.assert_allclose(np.linalg.norm(values["NORMAL"], axis=1), 1, atol=1e-3)
    shapes = [accessor(document, binary, target["POSITION"]) for target in primitive["targets"]]
    animation, frame = document["animations"][0], 17
    tracks = {}
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        tracks[channel["target"]["node"], channel["target"]["path"]] = accessor(
            document, binary, sampler["output"]
        )
    sliders = tracks[0, "weights"].reshape(len(dressed), len(shapes))
    assert sliders.min() >= 0
    assert sliders.max() <= 1
    points = values["POSITION"] + sum(w * shape for w, shape in zip(sliders[frame], shapes, strict=True))
    skin, world = document["skins"][0], {}
    inverse = accessor(document, binary, skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)

    def place(node: int, above: np.ndarray) -> None:
        own = np.eye(4)
        own[:3, :3] = Rotation.from_quat(tracks[node, "rotation"][frame]).as_matrix()
        own[:3, 3] = document["nodes"][node]["translation"]
        if (node, "translation") in tracks:
            own[:3, 3] = tracks[node, "translation"][frame]
        world[node] = above @ own
        for child in document["nodes"][node].get("children", ()):
            place(child, world[node])

    place(skin["skeleton"], np.eye(4))
    moved = np.stack([world[node] for node in skin["joints"]]) @ inverse
    shown = np.zeros_like(points)
    for number in range(2):
        if f"JOINTS_{number}" in values:
            joints, weights = values[f"JOINTS_{number}"], values[f"WEIGHTS_{number}"] / 65535
            for k in range(4):
                matrices = moved[joints[:, k]]
                turned = np.einsum("nij,nj->ni", matrices[:, :3, :3], points) + matrices[:, :3, 3]
                shown += weights[:, k : k + 1] * turned
    np.testing.assert_allclose(shown * [1, -1, -1], dressed.frame(frame) + dressed.offset, atol=1e-4)
