"""Animated USD: what is written reads back, passes the validator, and does not pile up in memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdShade, UsdSkel

from recipes.walk_motion import walking_motion
from tests.skinning.test_heat_weights import raised_arms, sheet_seen_from_the_front
from tests.usd_reading import complaints, read_usd_sequence
from vntoolkit.errors import BadMesh
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.geometry.motion import pose_of_frame
from vntoolkit.io.maps_and_meshes import usd
from vntoolkit.io.maps_and_meshes.usd import write_usd_meshes, write_usd_sequence
from vntoolkit.pipeline.dress import dress, write_dressed_figure


def test_the_validator_does_complain(tmp_path: Path) -> None:
    path = tmp_path / "bad.usda"
    path.write_text('#usda 1.0\ndef Mesh "m" {\n}\n')
    assert complaints(path)


def test_sequence_reads_back_and_is_valid(tmp_path: Path, moving_jumper: MeshSequence) -> None:
    path = tmp_path / "cloth.usdc"
    motion = walking_motion().in_metres(1.7)
    count = write_usd_sequence(
        path, moving_jumper.template, iter(moving_jumper.vertices), frame_rate_hz=59.94, motion=motion
    )
    assert count == 30
    assert complaints(path) == []
    back = read_usd_sequence(path)
    np.testing.assert_array_equal(back.vertices, moving_jumper.vertices)
    np.testing.assert_array_equal(back.template.faces, moving_jumper.template.faces)
    np.testing.assert_array_equal(back.template.colours, moving_jumper.template.colours)
    np.testing.assert_allclose(back.template.uv, moving_jumper.template.uv, atol=1e-7)
    assert back.frame_rate_hz == pytest.approx(59.94)
    assert list(tmp_path.iterdir()) == [path]


def test_other_programs_find_scale_axis_and_rate(tmp_path: Path, moving_jumper: MeshSequence) -> None:
    path = tmp_path / "cloth.usd"
    write_usd_sequence(
        path, moving_jumper.template, iter(moving_jumper.vertices), frame_rate_hz=60, metres_per_unit=0.01
    )
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == 60
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 29)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Surface"))
    assert stage.GetDefaultPrim().GetPath() == "/World"
    points = np.array(mesh.GetPointsAttr().Get(3))
    np.testing.assert_array_equal(points, moving_jumper.vertices[3] * np.float32([1, -1, -1]))  # y up
    np.testing.assert_array_equal(
        np.array(mesh.GetExtentAttr().Get(3)), [points.min(axis=0), points.max(axis=0)]
    )
    normals = mesh.GetOrientationAttr().Get()
    assert normals == UsdGeom.Tokens.rightHanded


def test_colours_are_shown_by_a_material(tmp_path: Path, moving_jumper: MeshSequence) -> None:
    path, plain = tmp_path / "cloth.usdc", tmp_path / "plain.usdc"
    coloured = moving_jumper.template
    write_usd_sequence(path, coloured, iter(moving_jumper.vertices), frame_rate_hz=60)
    bare = Mesh(vertices=coloured.vertices, faces=coloured.faces)
    write_usd_meshes(plain, iter([bare]), frame_rate_hz=60)
    stages = [Usd.Stage.Open(str(file)) for file in (path, plain)]
    bindings = [UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/World/Surface")) for stage in stages]
    material = bindings[0].ComputeBoundMaterial()[0]
    shader = material.ComputeSurfaceSource()[0]
    assert shader.GetShaderId() == "UsdPreviewSurface"
    reader = UsdShade.Shader(shader.GetInput("diffuseColor").GetConnectedSources()[0][0].source)
    assert reader.GetShaderId() == "UsdPrimvarReader_float3"
    assert reader.GetInput("varname").Get() == "displayColor"
    assert complaints(path) == []
    assert not bindings[1].ComputeBoundMaterial()[0]


def test_usd_skeleton_moves_as_ours(tmp_path: Path, moving_jumper: MeshSequence) -> None:
    path = tmp_path / "cloth.usdc"
    motion = walking_motion().in_metres(1.7)
    write_usd_sequence(
        path, moving_jumper.template, iter(moving_jumper.vertices), frame_rate_hz=60, motion=motion
    )
    stage = Usd.Stage.Open(str(path))
    root = UsdSkel.Root(stage.GetPrimAtPath("/World/Figure"))
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.TraverseInstanceProxies())
    query = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/World/Figure/Skeleton")))
    assert [name.rsplit("/", 1)[-1] for name in query.GetJointOrder()] == list(motion.skeleton.names)
    flip = np.diag([1.0, -1, -1, 1])
    for frame in (0, 29, 200):
        theirs = np.array(query.ComputeJointSkelTransforms(frame)).transpose(0, 2, 1)
        # UsdSkel keeps single precision; the walker is up to 5 m from the origin
        np.testing.assert_allclose(theirs, flip @ pose_of_frame(motion, frame) @ flip, atol=3e-6)


def test_joint_names_that_usd_forbids_are_spelt_out(tmp_path: Path, moving_jumper: MeshSequence) -> None:
    from dataclasses import replace

    motion = walking_motion()
    names = tuple(f"mixamorig:{name} 1" if i else "1 Hips" for i, name in enumerate(motion.skeleton.names))
    motion = replace(motion, skeleton=replace(motion.skeleton, names=names))
    path = tmp_path / "cloth.usdc"
    write_usd_sequence(
        path, moving_jumper.template, [moving_jumper.vertices[0]], frame_rate_hz=60, motion=motion
    )
    assert complaints(path) == []


def test_meshes_of_changing_topology(tmp_path: Path, rng: np.random.Generator) -> None:
    meshes = []
    for count in (5, 9, 4):
        vertices = rng.normal(size=(count, 3)).astype(np.float32)
        faces = np.stack([rng.permutation(count)[:3] for _ in range(2 * count)])
        meshes.append(Mesh(vertices=vertices, faces=faces, colours=rng.random((count, 3), dtype=np.float32)))
    path = tmp_path / "meshes.usdc"
    assert write_usd_meshes(path, iter(meshes), frame_rate_hz=24) == 3
    assert complaints(path) == []
    stage = Usd.Stage.Open(str(path))
    surface = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Surface"))
    for time, mesh in enumerate(meshes):
        np.testing.assert_array_equal(
            surface.GetPointsAttr().Get(time), mesh.vertices * np.float32([1, -1, -1])
        )
        np.testing.assert_array_equal(surface.GetFaceVertexIndicesAttr().Get(time), mesh.faces.ravel())
        assert list(surface.GetFaceVertexCountsAttr().Get(time)) == [3] * len(mesh.faces)
        colours = UsdGeom.PrimvarsAPI(surface).GetPrimvar("displayColor").Get(time)
        np.testing.assert_array_equal(colours, mesh.colours)


def test_memory_does_not_grow_with_the_number_of_frames(tmp_path: Path) -> None:
    template = Mesh(vertices=np.zeros((100_000, 3)), faces=np.array([[0, 1, 2]]))

    def own_memory() -> int:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) * 1024

    seen = []

    def frames():
        for index in range(120):
            seen.append(own_memory())
            yield np.full((100_000, 3), index, dtype=np.float32)

    write_usd_sequence(tmp_path / "long.usdc", template, frames(), frame_rate_hz=60)
    written = 120 * 1.2e6
    # A frame is 1.2 MB; between two saves 12.6 MB may gather, in the first 40 frames as in the last 40.
    growth = max(seen[80:]) - max(seen[:40])
    assert growth < 0.05 * written
    assert max(seen) - seen[0] < 3 * 24 * usd._FLUSH_VERTICES  # positions and normals, bytes
    assert (
        tmp_path / "long.usdc"
    ).stat().st_size < 1.2 * written  # the normals, which do not change, are there once


def test_nothing_half_written_is_left(tmp_path: Path, moving_jumper: MeshSequence) -> None:
    def broken():
        yield moving_jumper.vertices[0]
        yield np.full_like(moving_jumper.vertices[0], np.nan)

    with pytest.raises(BadMesh, match=r"frame 1: .* NaN"):
        write_usd_sequence(tmp_path / "cloth.usdc", moving_jumper.template, broken(), frame_rate_hz=60)
    with pytest.raises(BadMesh, match="frame 0: expected shape"):
        write_usd_sequence(
            tmp_path / "cloth.usdc", moving_jumper.template, [np.zeros((3, 3))], frame_rate_hz=60
        )
    assert not list(tmp_path.iterdir())


def test_a_skin_is_bound_valid_and_moves_as_the_dressed_garment(tmp_path: Path) -> None:
    sheet = sheet_seen_from_the_front(0.42)
    rippled = np.array(sheet.vertices[:4])
    rippled[:, :, 2] += 0.005 * np.sin(20 * rippled[:, :, 1] + np.arange(4)[:, None])
    colours = np.full((len(sheet.template.vertices), 3), 0.5, np.float32)
    template = replace(sheet.template, colours=colours, uv=np.abs(sheet.template.vertices[:, :2]))
    dressed = dress(MeshSequence(template=template, vertices=rippled), raised_arms(90))
    summary = write_dressed_figure(dressed, tmp_path / "skin.usdc")
    assert summary.fold_error < 1e-6
    assert complaints(tmp_path / "skin.usdc") == []
    stage = Usd.Stage.Open(str(tmp_path / "skin.usdc"))
    cloth = UsdGeom.Mesh(stage.GetPrimAtPath(f"{usd.FIGURE}/Cloth"))
    assert cloth.GetNormalsInterpolation() == "vertex"
    primvars = UsdGeom.PrimvarsAPI(cloth)
    assert primvars.HasPrimvar("st")
    np.testing.assert_array_equal(primvars.GetPrimvar("displayColor").Get(), colours)
    UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath(usd.FIGURE)), Gf.Interval(0, 3))
    for frame in range(4):
        shown = np.array(cloth.GetPointsAttr().Get(float(frame))) * [1, -1, -1]
        np.testing.assert_allclose(shown, dressed.frame(frame) + dressed.offset, atol=2e-5)
