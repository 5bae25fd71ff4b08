"""Exports: other programs find the right axes, lengths, topology and rate; nothing half-written is left."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from rerun.chunk import RrdReader

from tests.dome_result import DomeResult
from tests.each_step import EachStep
from tests.io.test_recordings import messages_of
from tests.result_files import read_point_cloud
from tests.skinning.test_glb_export import accessor, chunks
from tests.usd_reading import complaints
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.mesh_comparison import mesh_distance
from vntoolkit.geometry.mesh import face_normals
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.footage.images import read_image, read_image_with_alpha
from vntoolkit.io.light_files import read_lights
from vntoolkit.io.maps_and_meshes.arrays import StreamedArray, write_npz
from vntoolkit.io.maps_and_meshes.maps import read_depth_map, read_normal_map
from vntoolkit.io.maps_and_meshes.masks import read_mask
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.normals.photometric_stereo import normals_from_lights
from vntoolkit.options.export import (
    ExportArguments,
    ExportedSurface,
    ExportFormat,
    ExportOptions,
    FileUnit,
    MeshUpAxis,
    NormalConvention,
)
from vntoolkit.options.tracking import TrackArguments
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.pipeline.export import export
from vntoolkit.pipeline.track import track
from vntoolkit.progress import heard_by

FRAMES = "0:3"


def exported(result: DomeResult, out: Path | None, to: ExportFormat, **options: object) -> Path:
    return export(ExportArguments(result.folder, to=to, out=out, frames=FRAMES, **options)).out


def points_of(path: Path, time: float) -> np.ndarray:
    stage = Usd.Stage.Open(str(path))  # a prim dies with its stage
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Surface"))
    return np.array(mesh.GetPointsAttr().Get(time))


def test_every_frame_is_played_at_the_time_it_was_filmed(dome_result: DomeResult, tmp_path: Path) -> None:
    """Of six frames at uneven times, number 3 was skipped, and every second one can be asked for."""
    times = np.array([0.0, 0.033, 0.066, 0.15, 0.4, 1.0])
    folder = tmp_path / "out"
    shutil.copytree(dome_result.folder, folder)
    shutil.rmtree(folder / "track")
    content = json.loads((folder / "reconstruction.json").read_text())
    content["input"] |= {"times_s": times.tolist(), "frame_rate_hz": 25.0}
    (folder / "reconstruction.json").write_text(json.dumps(content))
    track(TrackArguments(folder))
    np.testing.assert_allclose(read_mesh_sequence(folder / "track").instants_s, times)
    for frames, kept in ((None, [0, 1, 2, 4, 5]), ("::2", [0, 2, 4])):
        filmed = times[kept] - times[kept[0]]
        made = {}
        for to, mesh in (("glb", "tracked"), ("usd", "tracked"), ("usd", "frames")):
            options = {"to": to, "mesh": mesh, "scale": 0.01}
            out = tmp_path / f"{len(kept)}_{mesh}.{to}"
            made[to, mesh] = export(ExportArguments(folder, out=out, frames=frames, **options)).out
        document, binary = chunks(made["glb", "tracked"])
        sampler = document["animations"][0]["samplers"][0]
        shown = accessor(document, binary, sampler["input"]).ravel()
        np.testing.assert_allclose(shown, filmed, atol=1e-6)
        for mesh in ("tracked", "frames"):
            stage = Usd.Stage.Open(str(made["usd", mesh]))
            points = stage.GetPrimAtPath("/World/Surface").GetAttribute("points")
            rate = stage.GetTimeCodesPerSecond()
            np.testing.assert_allclose(np.array(points.GetTimeSamples()) / rate, filmed, atol=1e-6)
            assert stage.GetEndTimeCode() == pytest.approx(filmed[-1] * rate)


@pytest.mark.parametrize("up", MeshUpAxis)
@pytest.mark.parametrize("surface", [ExportedSurface.TRACKED, ExportedSurface.FRAMES])
def test_usd_is_valid_and_holds_the_surface(dome_result, tmp_path, surface, up):
    path = exported(
        dome_result, tmp_path / "a.usdc", ExportFormat.USD, mesh=surface, up=up, scale=0.002, centre=False,
        units=FileUnit.CM,
    )  # fmt: skip
    assert complaints(path) == []
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert UsdGeom.GetStageUpAxis(stage) == up.value.upper()
    assert stage.GetTimeCodesPerSecond() == 30
    assert stage.GetEndTimeCode() == 2
    if surface is ExportedSurface.TRACKED:
        sequence = read_mesh_sequence(dome_result.folder / "track")
        vertices, faces = sequence.vertices[1], sequence.template.faces
    else:
        mesh = read_mesh(dome_result.folder / "mesh/000001.ply")
        vertices, faces = mesh.vertices, mesh.faces
    found = points_of(path, 1)
    np.testing.assert_allclose(found, graphics_from_camera(vertices, up) * 0.2, atol=1e-5)
    towards = {"y": [0, 0, 1], "z": [0, -1, 0]}[up.value]
    assert (face_normals(found, faces) @ towards > 0).mean() > 0.98  # outside is outside


def test_registered_usd_has_one_topology_and_the_other_many(dome_result: DomeResult, tmp_path: Path) -> None:
    counts = {}
    for surface in (ExportedSurface.TRACKED, ExportedSurface.FRAMES):
        path = exported(dome_result, tmp_path / f"{surface.value}.usdc", ExportFormat.USD, mesh=surface)
        stage = Usd.Stage.Open(str(path))
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Surface"))
        counts[surface] = mesh.GetFaceVertexIndicesAttr().GetNumTimeSamples()
        assert mesh.GetPointsAttr().GetNumTimeSamples() == 3
    assert counts == {ExportedSurface.TRACKED: 0, ExportedSurface.FRAMES: 3}


def test_glb_is_metres_and_whole(dome_result: DomeResult, tmp_path: Path) -> None:
    path = exported(dome_result, tmp_path / "a.glb", ExportFormat.GLB, scale=0.01)
    content = path.read_bytes()
    assert content[:4] == b"glTF"
    assert int.from_bytes(content[8:12], "little") == len(content)
    document = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    sequence = read_mesh_sequence(dome_result.folder / "track")
    extent = np.ptp(sequence.vertices[0], axis=0) * 0.01
    position = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    np.testing.assert_allclose(np.subtract(position["max"], position["min"]), extent, rtol=1e-5)
    assert len(document["meshes"][0]["primitives"][0]["targets"]) == 2
    folder = exported(dome_result, tmp_path / "own", ExportFormat.GLB, mesh=ExportedSurface.FRAMES)
    assert [p.name for p in sorted(folder.glob("*.glb"))] == [f"{n:06d}.glb" for n in range(3)]


@pytest.mark.parametrize("kind", [ExportFormat.PLY, ExportFormat.OBJ])
def test_meshes_come_back(dome_result: DomeResult, tmp_path: Path, kind: ExportFormat) -> None:
    out = exported(dome_result, tmp_path, kind, mesh=ExportedSurface.FRAMES)
    mesh, truth = (
        read_mesh(path) for path in (out / f"000002.{kind.value}", dome_result.folder / "mesh/000002.ply")
    )
    np.testing.assert_allclose(mesh.vertices, truth.vertices, rtol=1e-5, atol=1e-5)
    assert np.array_equal(mesh.faces, truth.faces)
    tall = exported(dome_result, tmp_path / "z", kind, mesh=ExportedSurface.FRAMES, up=MeshUpAxis.Z)
    standing = read_mesh(tall / f"000002.{kind.value}")  # as if y were up: so undo the half turn
    as_stored = graphics_from_camera(standing.vertices)
    np.testing.assert_allclose(as_stored[:, 2], -truth.vertices[:, 1], rtol=1e-5, atol=1e-5)
    assert "z up" in (tall / f"000002.{kind.value}").read_bytes()[:200].decode("ascii", "replace")


@pytest.mark.parametrize("convention", NormalConvention)
def test_normal_maps_keep_to_the_convention(dome_result, tmp_path, convention):
    truth = read_normal_map(dome_result.folder / "normals/000001.exr")
    out = exported(dome_result, tmp_path / "png", ExportFormat.PNG, normal_convention=convention)
    back = read_normal_map(out / "000001.png", convention=convention)
    assert np.array_equal(back.mask, truth.mask)
    angles = angles_deg(back.normals_in_camera[back.mask], truth.normals_in_camera[back.mask])
    assert angles.max() < 0.01
    green = read_image_with_alpha(out / "000001.png")[0][..., 1]  # the top of a dome points up
    v, u = np.nonzero(truth.mask)
    top = (v.min() + 2, int(np.median(u)))
    assert (green[top] > 40000) == (convention is NormalConvention.OPENGL)


def test_arrays_are_those_of_the_result(dome_result: DomeResult, tmp_path: Path) -> None:
    out = exported(dome_result, tmp_path, ExportFormat.NPZ, scale=2.0)
    with np.load(out / "000002.npz") as arrays:
        names = {"normals", "mask", "depth", "depth_mask", "labels", "vertices", "faces", "camera_matrix"}
        assert names <= set(arrays)
        mesh = read_mesh(dome_result.folder / "mesh/000002.ply")
        np.testing.assert_allclose(arrays["vertices"], graphics_from_camera(mesh.vertices) * 2, rtol=1e-6)
        assert arrays["normals"][arrays["mask"]][:, 2].min() > 0  # towards the viewer
    with np.load(out / "track.npz") as arrays:
        sequence = read_mesh_sequence(dome_result.folder / "track")
        np.testing.assert_allclose(
            arrays["vertices"], graphics_from_camera(sequence.vertices[:3]) * 2, rtol=1e-6
        )
        np.testing.assert_array_equal(arrays["uncertainty_px"], sequence.uncertainty_px[:3])


def test_a_diligent_folder_gives_the_normals_by_classical_stereo(dome_result, tmp_path):
    folder = exported(dome_result, tmp_path, ExportFormat.DILIGENT) / "000001"
    lights = read_lights(folder)
    images = np.stack([read_image(path)[..., 0] / 65535.0 for path in lights.images])
    images = images / lights.intensities[:, 0][:, None, None]
    mask = read_mask(folder / "mask.png")
    normal_map = normals_from_lights(images, lights.directions, mask)
    truth = read_normal_map(dome_result.folder / "normals/000001.exr")
    both = normal_map.mask & truth.mask
    angles = angles_deg(normal_map.normals_in_camera[both], truth.normals_in_camera[both])
    assert both.sum() > 0.95 * mask.sum()
    assert np.median(angles) < 0.1  # the rig's own material, no shadow on most of the dome
    assert (folder / "Normal_est.mat").exists()


def test_an_interrupted_export_goes_on(dome_result: DomeResult, tmp_path: Path) -> None:
    job = ExportArguments(dome_result.folder, to=ExportFormat.PLY, out=tmp_path)
    seen: list[int] = []

    def interrupt() -> None:
        seen.append(1)
        if len(seen) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), heard_by(EachStep(interrupt)):
        export(job)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["000000.ply", "000001.ply", "export.json"]
    assert export(job).kept == 2
    other = ExportArguments(dome_result.folder, to=ExportFormat.PLY, up=MeshUpAxis.Z, out=tmp_path)
    with pytest.raises(BadInput, match=r"an export made differently: options\.up \(y → z\).*; add --overwr"):
        export(other)
    assert export(replace(other, overwrite=True)).kept == 0


def test_overwriting_leaves_no_frame_of_another_format(dome_result: DomeResult, tmp_path: Path) -> None:
    exported(dome_result, tmp_path, ExportFormat.NPZ)
    job = ExportArguments(dome_result.folder, to=ExportFormat.PNG, out=tmp_path, frames=FRAMES)
    export(replace(job, overwrite=True))
    names = ["000000.png", "000001.png", "000002.png", "export.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names


def test_a_refused_export_writes_nothing(dome_result: DomeResult, tmp_path: Path) -> None:
    folder = shutil.copytree(dome_result.folder, tmp_path / "result")
    shutil.rmtree(folder / "mesh")
    options = {"mesh": ExportedSurface.FRAMES}
    with pytest.raises(BadInput, match="holds no mesh of those frames"):
        exported(DomeResult(folder, folder), tmp_path / "out", ExportFormat.PLY, **options)
    with pytest.raises(BadInput, match=r"a\.glb: expected the name of a folder, for one \.glb a frame"):
        exported(dome_result, tmp_path / "a.glb", ExportFormat.GLB, **options)
    moved = ExportArguments(
        dome_result.folder, to=ExportFormat.DILIGENT, out=tmp_path / "out",
        footage="nowhere.mkv",
    )  # fmt: skip
    with pytest.raises(BadInput, match=r"nowhere\.mkv: no such file"):
        export(moved)
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_what_has_changed_is_written_again(dome_result: DomeResult, tmp_path: Path) -> None:
    folder = shutil.copytree(dome_result.folder, tmp_path / "result")
    job = ExportArguments(folder, to=ExportFormat.PNG)
    count = export(job).frames
    later = (folder / "export/png/000002.png").stat().st_mtime + 5
    os.utime(folder / "normals/000002.exr", (later, later))
    assert export(job).kept == count - 1


def test_an_animation_that_fails_leaves_nothing(dome_result: DomeResult, tmp_path: Path) -> None:
    folder = shutil.copytree(dome_result.folder, tmp_path / "result")
    (folder / "mesh/000002.ply").write_bytes(b"ply\n")
    out = tmp_path / "out"
    with pytest.raises(BadInput, match=r"000002\.ply"):
        export(ExportArguments(folder, to="usd", mesh="frames", out=out / "a.usdc"))
    assert list(out.iterdir()) == []


def test_streamed_rows_must_be_as_many_as_promised(tmp_path: Path) -> None:
    rows = (np.zeros(2) for _ in range(3))
    with pytest.raises(ValueError, match="3 rows came, 4 were promised"):
        write_npz(tmp_path / "a.npz", {"a": StreamedArray(shape=(4, 2), dtype=np.float32, rows=rows)})
    assert list(tmp_path.iterdir()) == []


def test_points_are_every_pixel_with_a_depth(dome_result: DomeResult, tmp_path: Path) -> None:
    out = exported(dome_result, tmp_path, ExportFormat.POINTS, up=MeshUpAxis.Z)
    assert [p.name for p in sorted(out.glob("*.ply"))] == [f"{n:06d}.ply" for n in range(3)]
    cloud = read_point_cloud(out / "000001.ply")
    depth_map = read_depth_map(dome_result.folder / "depth/000001.exr")
    rows, columns = np.nonzero(depth_map.mask)
    assert len(cloud.points) == len(rows) == len(cloud.normals) == len(cloud.colours)
    # in pixels from the picture's centre, x right, y down
    seen = np.stack([columns - 31.5, rows - 23.5, depth_map.depth[rows, columns]], axis=1)
    in_file = graphics_from_camera(cloud.points)  # undoes what reading did
    np.testing.assert_allclose(in_file, graphics_from_camera(seen, MeshUpAxis.Z), atol=1e-4)


def test_stl_holds_the_triangles_in_millimetres(dome_result: DomeResult, tmp_path: Path) -> None:
    options = {"mesh": ExportedSurface.FRAMES, "scale": 0.002}
    written = (exported(dome_result, tmp_path, ExportFormat.STL, **options) / "000001.stl").read_bytes()
    mesh = read_mesh(dome_result.folder / "mesh/000001.ply")
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.frombuffer(written, kind, offset=84)
    assert np.frombuffer(written, "<u4", 1, 80) == len(triangles) == len(mesh.faces)
    in_file = graphics_from_camera(mesh.vertices)[mesh.faces]
    np.testing.assert_allclose(triangles["corners"], 2 * in_file, atol=1e-4)
    normals = face_normals(in_file.reshape(-1, 3), np.arange(3 * len(in_file)).reshape(-1, 3))
    np.testing.assert_allclose(
        triangles["normal"], normals / np.linalg.norm(normals, axis=1)[:, None], atol=1e-3
    )


def test_recordings_of_a_tracked_surface(dome_result: DomeResult, tmp_path: Path) -> None:
    """All opened frames at their times: with pictures and mesh for Rerun, with the depth as messages."""
    job = {"folder": dome_result.folder, "frames": "::2"}
    rrd = ExportArguments(to="rrd", scale=0.001, out=tmp_path / "a.rrd", **job)
    summary = export(rrd)
    assert summary.is_tracked
    found: dict[str, list[float]] = {}
    for chunk in RrdReader(summary.out).stream():
        columns = chunk.to_record_batch().to_pydict()
        found.setdefault(chunk.entity_path, []).extend(t.total_seconds() for t in columns.get("time", []))
    times = np.array([0, 2, 4]) / 30
    for name in ("/picture", "/normals", "/depth", "/surface", "/error_deg"):
        np.testing.assert_allclose(sorted(found[name]), times, atol=1e-8)
    assert "/contact" not in found
    out = export(ExportArguments(to="mcap", **job)).out
    depths = [each for each in messages_of(out) if each[0] == "/vntoolkit/depth"]
    np.testing.assert_allclose([time for _, time, _ in depths], 1e9 * times, atol=1)
    stored = read_depth_map(dome_result.folder / "depth" / "000004.exr")
    written = np.frombuffer(depths[2][2].data, "<f4").reshape(stored.depth.shape)
    np.testing.assert_array_equal(written[stored.mask], stored.depth[stored.mask])


def test_cleaned_meshes_have_the_faces_asked_for(dome_result: DomeResult, tmp_path: Path) -> None:
    cleaning = {"most_faces": 300}
    with pytest.raises(BadInput, match="add --mesh frames"):
        exported(dome_result, tmp_path, ExportFormat.PLY, **cleaning)
    with pytest.raises(BadInput, match="cleaning is for meshes, and npz has none"):
        exported(dome_result, tmp_path, ExportFormat.NPZ, **cleaning)
    out = exported(dome_result, tmp_path, ExportFormat.PLY, mesh=ExportedSurface.FRAMES, **cleaning)
    mesh, whole = read_mesh(out / "000001.ply"), read_mesh(dome_result.folder / "mesh/000001.ply")
    assert 200 < len(mesh.faces) <= 300 < len(whole.faces)
    assert mesh_distance(mesh, whole).mean_percent < 0.5


@pytest.mark.parametrize(
    ("to", "options", "names"),
    [
        (ExportFormat.HEIGHTS, {"scale": 0.001}, ("000000.png", "000000.json")),
        (ExportFormat.LOCAL_SHAPE, {"longest": 20.0}, ("000000.exr", "000000.png")),
        (ExportFormat.CURVATURE, {"shortest": 6.0}, ("000000.exr", "000000.png")),
        (ExportFormat.PROFILE, {"line": (20.0, 24.0, 44.0, 24.0)}, ("000000.csv",)),
        (ExportFormat.ROUGHNESS, {"longest": 20.0}, ("000000.json",)),
        (ExportFormat.SUR, {"scale": 0.001}, ("000000.sur",)),
        (ExportFormat.X3P, {"scale": 0.001}, ("000000.x3p",)),
    ],
)
def test_files_for_inspection(
    dome_result: DomeResult,
    tmp_path: Path,
    to: ExportFormat,
    options: dict[str, object],
    names: tuple[str, ...],
) -> None:
    out = exported(dome_result, tmp_path / "out", to, **options)
    assert {name for name in names if (out / name).stat().st_size > 0} == set(names)
    job = ExportArguments(dome_result.folder, to=to, **options, out=out, frames=FRAMES)
    assert export(job).kept == export(job).frames
    export(ExportArguments(dome_result.folder, to="png", out=out, overwrite=True))
    assert not [name for name in names if name != "000000.png" and (out / name).exists()]


def test_a_height_picture_says_what_its_values_mean(dome_result: DomeResult, tmp_path: Path) -> None:
    out = exported(dome_result, tmp_path, ExportFormat.HEIGHTS, scale=0.001)
    stored, told = read_image(out / "000000.png")[..., 0], json.loads((out / "000000.json").read_text())
    assert (told["unit"], told["not_measured"]) == ("mm", 0)
    depth_map = read_depth_map(dome_result.folder / "depth" / "000000.exr")
    assert ((stored > 0) == depth_map.mask).all()
    span = told["height_at_65535"] - told["height_at_1"]
    heights = told["height_at_1"] + (stored[depth_map.mask] - 1.0) / 65534.0 * span
    relief = np.corrcoef(heights, -depth_map.depth[depth_map.mask])[0, 1]
    assert relief > 0.99


def test_heights_without_a_scale_are_in_pixels_and_no_files_of_micrometres(
    dome_result: DomeResult, tmp_path: Path
) -> None:
    out = exported(dome_result, tmp_path / "a", ExportFormat.ROUGHNESS)
    assert json.loads((out / "000000.json").read_text())["unit"] == "px"
    with pytest.raises(BadInput, match="sur: its lengths are micrometres and the result has no scale"):
        exported(dome_result, tmp_path / "b", ExportFormat.SUR)


@pytest.mark.parametrize(
    ("to", "options", "line"),
    [
        (ExportFormat.PLY, {"longest": 1.0}, "ply: longest, shortest and line are for inspection"),
        (ExportFormat.HEIGHTS, {"units": FileUnit.CM}, "heights: its lengths are millimetres, or pixels"),
        (ExportFormat.HEIGHTS, {"longest": -1.0}, "longest: expected a positive wavelength, got -1"),
        (ExportFormat.HEIGHTS, {"longest": 1.0, "shortest": 2.0}, "expected a longer wavelength"),
        (ExportFormat.LOCAL_SHAPE, {}, "local-shape: expected --longest"),
        (ExportFormat.CURVATURE, {"longest": 1.0}, "curvature: a form is not removed from it"),
        (ExportFormat.PROFILE, {}, "--line COLUMN ROW COLUMN ROW and --to profile belong together"),
        (ExportFormat.HEIGHTS, {"line": (0.0, 0.0, 1.0, 1.0)}, "--to profile belong together"),
        (ExportFormat.MCAP, {"units": FileUnit.MM}, "mcap: its depth is in the result's own unit"),
    ],
)
def test_refused_options_for_inspection(to: ExportFormat, options: dict[str, object], line: str) -> None:
    with pytest.raises(BadInput, match=line):
        ExportOptions(to=to, **options)
