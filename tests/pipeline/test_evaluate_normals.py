import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from vntoolkit.__main__ import main
from vntoolkit.cli.evaluate import evaluate_mesh
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.maps_and_meshes.maps import write_normal_map
from vntoolkit.io.maps_and_meshes.meshes import write_mesh
from vntoolkit.options.export import NormalConvention
from vntoolkit.pipeline.evaluate import compare_normal_files, pairs_of


def tilted(degrees: float, size: tuple[int, int] = (20, 30), valid: slice = slice(None)) -> NormalMap:
    angle = np.deg2rad(degrees)
    normals = np.broadcast_to([np.sin(angle), 0.0, -np.cos(angle)], (*size, 3))
    mask = np.zeros(size, dtype=bool)
    mask[:, valid] = True
    return NormalMap(normals_in_camera=np.where(mask[..., None], normals, 0), mask=mask)


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    for name, degrees in (("000000", 3.0), ("000001", 12.0)):
        write_normal_map(tmp_path / "ours" / "normals" / f"{name}.exr", tilted(degrees))
        write_normal_map(tmp_path / "sim" / "truth" / "normals" / f"{name}.png", tilted(0.0))
    return tmp_path / "ours", tmp_path / "sim"


def test_folders_are_compared_frame_by_frame(folders, tmp_path, capsys):
    assert main(list(map(str, ["evaluate", "normals", *folders, "--out", tmp_path / "out"]))) == 0
    written = json.loads((tmp_path / "out" / "normals.json").read_text())
    assert written["overall"]["mean_deg"] == pytest.approx(7.5, abs=0.05)
    assert written["overall"]["below_5"] == pytest.approx(0.5)
    assert written["frames"]["000001"]["mean_deg"] == pytest.approx(12.0, abs=0.05)
    for figure in ("normals_map.png", "normals_curve.png"):
        assert (tmp_path / "out" / figure).read_bytes()[:4] == b"\x89PNG"
    assert "12.0" in capsys.readouterr().out


@pytest.mark.parametrize("convention", list(NormalConvention))
def test_axes_and_encodings_of_either_side_are_found_out(
    convention: NormalConvention, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A ball by another program: floats from 0 to 1 in an archive, in each of three conventions."""
    v, u = np.mgrid[:60, :80]
    x, y = (u - 40) / 28.0, (v - 30) / 28.0
    inside = x**2 + y**2 < 0.8
    z = -np.sqrt(np.where(inside, 1 - x**2 - y**2, 1))
    normals = np.where(inside[..., None], np.stack([x, y, z], axis=-1), 0).astype(np.float32)
    write_normal_map(tmp_path / "ours.exr", NormalMap(normals_in_camera=normals, mask=inside))
    stored = np.where(inside[..., None], 0.5 + 0.5 * normals * convention.signs, 0)
    np.savez(tmp_path / "theirs.npz", normals=stored)
    pair = pairs_of(tmp_path / "ours.exr", tmp_path / "theirs.npz")
    assert compare_normal_files(pair).overall.mean_deg < 0.1
    assert f"read as {convention.value}" in caplog.text
    wrong = NormalConvention.OPENGL if convention is NormalConvention.DIRECTX else NormalConvention.DIRECTX
    if convention is not NormalConvention.OPENCV:  # its z turns the map away, which is refused
        assert compare_normal_files(pair, (None, wrong)).overall.mean_deg > 10


def test_bad_pairs_get_one_clear_line(tmp_path: Path, folders: tuple[Path, Path]) -> None:
    write_normal_map(tmp_path / "a.exr", tilted(0, valid=slice(0, 10)))
    write_normal_map(tmp_path / "b.exr", tilted(0, valid=slice(10, 20)))
    write_normal_map(tmp_path / "wide.exr", tilted(0, size=(20, 40)))
    with pytest.raises(BadInput, match=r"b\.exr: common mask of the two normal maps: no valid pixel"):
        compare_normal_files(pairs_of(tmp_path / "a.exr", tmp_path / "b.exr"))
    with pytest.raises(BadInput, match="is 30×20 but reference normal map is 40×20"):
        compare_normal_files(pairs_of(tmp_path / "a.exr", tmp_path / "wide.exr"))
    with pytest.raises(BadInput, match="give two files or two folders"):
        pairs_of(folders[0], tmp_path / "a.exr")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadInput, match="none of one name"):
        pairs_of(folders[0], tmp_path / "empty")


def test_a_mesh_is_measured_and_one_without_faces_is_refused(tmp_path: Path) -> None:
    v, u = np.mgrid[:10, :10].astype(float)
    index = np.arange(100).reshape(10, 10)
    a, b, c, d = (x.ravel() for x in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    faces = np.concatenate([np.stack([a, c, b], axis=-1), np.stack([b, c, d], axis=-1)])
    for name, height in (("low", 4.0), ("high", 4.5)):
        flat = np.stack([u, v, np.full(u.shape, height)], axis=-1).reshape(-1, 3)
        write_mesh(tmp_path / f"{name}.ply", Mesh(vertices=flat, faces=faces))
    evaluate_mesh(tmp_path / "high.ply", tmp_path / "low.ply", out=tmp_path / "out")
    written = json.loads((tmp_path / "out" / "mesh.json").read_text())
    assert written["distance"]["mean"] == pytest.approx(0.5, rel=1e-5)
    assert written["distance"]["hausdorff_percent"] == pytest.approx(100 * 0.5 / np.hypot(9, 9), rel=1e-4)
    assert written["quality"]["low.ply"]["faces"] == 162
    for folder, name in (("ours", "high"), ("truth", "low")):
        (tmp_path / folder).mkdir()
        shutil.copy(tmp_path / f"{name}.ply", tmp_path / folder / "000000.ply")
    pair = tmp_path / "ours" / "000000.ply", tmp_path / "truth" / "000000.ply"
    evaluate_mesh(*pair, out=tmp_path / "out")
    assert list(json.loads((tmp_path / "out" / "mesh.json").read_text())["quality"]) == [str(p) for p in pair]
    write_mesh(tmp_path / "points.ply", Mesh(vertices=flat, faces=np.zeros((0, 3), int)))
    evaluate_mesh(tmp_path / "points.ply", tmp_path / "low.ply", out=tmp_path / "out")
    written = json.loads((tmp_path / "out" / "mesh.json").read_text())
    assert (written["distance"]["mean"], list(written["quality"])) == (pytest.approx(0.5), ["low.ply"])
    with pytest.raises(BadMesh, match=r"points.ply: expected a surface, got 100 vertices and no face"):
        evaluate_mesh(tmp_path / "points.ply", out=tmp_path / "out")
    write_mesh(tmp_path / "none.ply", Mesh(vertices=flat[:0], faces=np.zeros((0, 3), int)))
    for pair in (("none.ply", "low.ply"), ("low.ply", "none.ply")):
        with pytest.raises(BadMesh, match=r"none.ply: expected a surface or points, got no vertex"):
            evaluate_mesh(*(tmp_path / name for name in pair), out=tmp_path / "out")
