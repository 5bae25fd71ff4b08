"""The texture of a tracked surface: colours without shading, relief in tangent space, holes; its exports."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdShade, UsdValidation

from tests.dome_result import DomeResult
from tests.pipeline.conftest import RESPONSE
from vntoolkit.geometry.mesh import vertex_normals
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.maps_and_meshes.maps import write_normal_map
from vntoolkit.options.export import ExportArguments, ExportFormat
from vntoolkit.photometry.transfer import Transfer, TransferCurve, encoded_from_linear
from vntoolkit.pipeline.dress import (
    captured_look,
    read_tracked_cloth,
)
from vntoolkit.pipeline.export import export
from vntoolkit.pipeline.opened_result import read_result
from vntoolkit.pipeline.texture import filled, tangent_frames, texels_of, write_texture
from vntoolkit.pipeline.texture_files import read_texture


def bumpy_sheet(size: int = 24) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices, faces and places in a texture of a sheet that faces the camera and waves."""
    v, u = np.mgrid[:size, :size].astype(float)
    vertices = np.stack([u, v, 100 + 2 * np.sin(u / 4) * np.cos(v / 5)], axis=-1).reshape(-1, 3)
    i = np.arange(size * size).reshape(size, size)
    a, b, c, d = (x.ravel() for x in (i[:-1, :-1], i[1:, :-1], i[:-1, 1:], i[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]).astype(np.int32)
    return vertices, faces, np.stack([u, v], axis=-1).reshape(-1, 2)


def test_tangents_are_square_and_follow_the_texture() -> None:
    vertices, faces, places = bumpy_sheet()
    along_u, along_v, outward = tangent_frames(vertices, faces, places)
    for a, b in ((along_u, along_v), (along_u, outward), (along_v, outward)):
        np.testing.assert_allclose(np.sum(a * b, axis=1), 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(along_v, axis=1), 1, atol=1e-9)
    assert along_u[:, 0].min() > 0.5  # u runs to the right
    assert along_v[:, 1].max() < -0.5  # v runs up the picture
    np.testing.assert_allclose(outward, vertex_normals(vertices, faces))
    turned = tangent_frames(vertices, faces, places[:, ::-1] * [1, -1])  # the texture a quarter turn on
    assert np.abs(turned[0][:, 1]).min() > 0.5


def test_texels_interpolate_as_the_triangles_do() -> None:
    _vertices, faces, places = bumpy_sheet()
    texels = texels_of(places + 0.25, faces, (26, 26))
    found = texels.of_vertices(places + 0.25, faces)
    v, u = np.divmod(texels.places, 26)
    np.testing.assert_allclose(found, np.stack([u, v], axis=1), atol=1e-9)
    assert len(texels.places) == 23 * 23


def test_holes_are_filled_from_around_and_nothing_else_changes(rng: np.random.Generator) -> None:
    v, u = np.mgrid[:37, :50].astype(float)
    ramp = np.stack([u, v], axis=-1)
    known = rng.random((37, 50)) < 0.4
    known[10:20, 10:22] = False
    out = filled(np.concatenate([np.where(known[..., None], ramp, -99.0), known[..., None]], axis=2))
    np.testing.assert_allclose(out[known], ramp[known])
    assert np.abs(out - ramp)[10:20, 10:22].max() < 6  # the hole is 12 wide
    assert np.abs(out - ramp)[~known].mean() < 1.5


def test_the_albedo_is_the_material_without_its_shading(dome_result: DomeResult) -> None:
    """Each channel sees one lamp: square on it gives the length of M's row."""
    texture = read_texture(dome_result.folder / "track")
    assert texture is not None
    assert texture.albedo is not None
    picture = read_image(texture.albedo).astype(float)
    square_on = np.linalg.norm(RESPONSE.matrix, axis=1)
    truth = 255 * encoded_from_linear(square_on, Transfer(curve=TransferCurve.SRGB))
    np.testing.assert_allclose(picture[16:32, 24:40], np.broadcast_to(truth, (16, 16, 3)), atol=2)
    facts = json.loads((dome_result.folder / "track" / "texture" / "texture.json").read_text())
    assert facts["covered"] > 0.7  # without the two pixels at the outline of a small dome
    assert facts["colour_scale"] == 1


def test_no_texel_holds_a_normal_below_the_surface(dome_result: DomeResult, tmp_path: Path) -> None:
    """Renderers show such a texel black. Here the left flank's normals lean right, as if of what hid it."""
    shutil.copytree(dome_result.folder, tmp_path / "out")
    result, spoilt = read_result(tmp_path / "out"), 0
    for number in result.numbers:
        found = result.normals(number)
        normals = np.array(found.normals_in_camera)
        behind = np.float32([0.995, 0.0, -0.0995])
        flank = found.mask & (normals @ behind < -0.1)
        normals[flank] = behind
        write_normal_map(result.folder.file("normals", number), replace(found, normals_in_camera=normals))
        spoilt += int(flank.sum())
    assert spoilt > 200
    texture = write_texture(tmp_path / "out", footage=str(dome_result.footage)).texture
    assert read_image(texture.normal)[..., 2].min() >= 128


def test_mesh_and_relief_together_have_the_measured_normals(dome_result: DomeResult) -> None:
    result = read_result(dome_result.folder)
    texture, track = read_texture(dome_result.folder / "track"), result.track
    assert texture is not None
    assert track is not None
    relief = read_image(texture.normal) / 127.5 - 1
    mesh = track.mesh(track.template)
    places = result.camera.project(mesh.vertices)
    texels = texels_of(places, mesh.faces, relief.shape[:2])
    axes = [texels.of_vertices(a, mesh.faces) for a in tangent_frames(mesh.vertices, mesh.faces, places)]
    local = relief.reshape(-1, 3)[texels.places]
    told = sum(local[:, k : k + 1] * axes[k] for k in range(3))
    told /= np.linalg.norm(told, axis=1, keepdims=True)
    normal_map = result.normals(track.template)
    assert normal_map is not None
    measured = normal_map.normals_in_camera.reshape(-1, 3)[texels.places]
    v, u = np.divmod(texels.places, 64)
    inner = (np.abs(u - 31) < 10) & (np.abs(v - 23) < 10)
    angle = np.degrees(np.arccos(np.clip(np.sum(told * measured, axis=1), -1, 1)))[inner]
    assert np.median(angle) < 1.0  # eight bits tell half a degree


@pytest.mark.parametrize("kind", [ExportFormat.USD, ExportFormat.GLB, ExportFormat.OBJ])
def test_tracked_exports_carry_the_texture(dome_result, tmp_path, kind):
    name = {ExportFormat.USD: "a.usdc", ExportFormat.GLB: "a.glb", ExportFormat.OBJ: "obj"}[kind]
    out = export(ExportArguments(dome_result.folder, to=kind, out=tmp_path / name, frames="0:2")).out
    match kind:
        case ExportFormat.USD:
            stage = Usd.Stage.Open(str(out))
            images = [UsdShade.Shader(stage.GetPrimAtPath(f"/World/Cloth/{n}")) for n in ("Albedo", "Normal")]
            files = [image.GetInput("file").Get().path for image in images]
            assert files == ["./a_albedo.png", "./a_normal.png"]
            registry = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
            assert not UsdValidation.ValidationContext(registry).Validate(stage)
        case ExportFormat.GLB:
            content = out.read_bytes()
            document = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
            assert len(document["images"]) == 2
            assert "normalTexture" in document["materials"][0]
            assert "COLOR_0" not in document["meshes"][0]["primitives"][0]["attributes"]
        case _:
            assert (out / "000001.obj").read_text().splitlines()[1] == "mtllib surface.mtl"
            assert "map_Kd surface_albedo.png" in (out / "surface.mtl").read_text()
    for image in [*tmp_path.glob("*.png"), *out.glob("*.png")] if kind is not ExportFormat.GLB else []:
        assert read_image(image).shape == (48, 64, 3)


def test_without_footage_or_texture_that_is_said(dome_result, tmp_path, caplog):
    folder = tmp_path / "moved"
    shutil.copytree(dome_result.folder, folder)
    made = write_texture(folder, footage=str(tmp_path / "nowhere"))
    assert made.texture.albedo is None
    assert made.texture.normal.exists()
    assert "no colours" in caplog.text
    assert read_tracked_cloth(folder).template.uv is not None
    (folder / "track" / "texture" / "normal.png").unlink()
    assert captured_look(folder)[1] is None
    assert "run `vntoolkit track" in caplog.text
