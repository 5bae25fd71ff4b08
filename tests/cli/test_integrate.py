"""Depth from normal maps of any origin: files, encodings, axes and backgrounds are found out and said."""

import logging
import zipfile

import numpy as np
import pytest

from vntoolkit.cli import run_verb
from vntoolkit.cli.integrate import integrate
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.exr import write_exr
from vntoolkit.io.maps_and_meshes.maps import write_depth_map, write_normal_map
from vntoolkit.io.maps_and_meshes.masks import write_mask
from vntoolkit.io.maps_and_meshes.stored_normals import read_stored_normals
from vntoolkit.options.export import NormalConvention

SIZE, RADIUS = 96, 40.0


def ball():
    """Depth, normals in the camera frame and mask of the front of an ellipsoid, which curls if misread."""
    v, u = (np.mgrid[:SIZE, :SIZE] - 47.5) / RADIUS
    x, y = u + 0.5 * v, v
    rest = 1.0 - x * x - y * y
    mask = rest > 0.1
    z = np.sqrt(np.where(mask, rest, 1.0))
    normals = np.stack([x / z, (0.5 * x + y) / z, -np.ones_like(z)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return -RADIUS * z, normals * mask[..., None], mask


def encoded(normals, mask, convention, background=0.0, full=255):
    values = 0.5 + 0.5 * normals * np.array(convention.signs)
    values = np.where(mask[..., None], values, background)
    return values if full == 1 else np.rint(values * full).astype(np.uint8 if full == 255 else np.uint16)


def write_map(path, normals, mask, convention):
    import cv2
    from scipy.io import savemat

    signed = normals * np.array(convention.signs)
    match path.name.split("."):
        case [_, "8", "png"]:
            write_png(path, encoded(normals, mask, convention))
        case [_, "16", "png"]:
            write_png(path, encoded(normals, mask, convention, full=65535))
        case [_, "unit", "tiff"]:
            cv2.imwrite(str(path), encoded(normals, mask, convention, full=1)[..., ::-1].astype(np.float32))
        case [_, "signed", "tiff"]:
            cv2.imwrite(str(path), signed[..., ::-1].astype(np.float32))
        case [_, "npz"]:
            np.savez(path, normals=signed, other=np.zeros(3))
        case [_, "mat"]:
            savemat(path, {"Normal_gt": signed})
        case [_, "exr"]:
            write_exr(path, {name: signed[..., k].astype(np.float32) for k, name in enumerate("RGB")})


def error_of(result):
    depth, _, mask = ball()
    found = result.depth(0)
    assert (found.mask & ~mask).sum() == 0
    assert (found.mask & mask).sum() > 0.95 * mask.sum()
    difference = (found.depth - depth)[found.mask]
    return np.abs(difference - np.median(difference)).mean() / RADIUS


@pytest.mark.parametrize(
    "name", ["a.8.png", "a.16.png", "a.unit.tiff", "a.signed.tiff", "a.npz", "a.mat", "a.exr"]
)
@pytest.mark.parametrize("convention", list(NormalConvention))
def test_files_of_all_kinds_give_the_same_depth(tmp_path, name, convention, caplog):
    _, normals, mask = ball()
    write_map(tmp_path / name, normals, mask, convention)
    with caplog.at_level(logging.WARNING):
        result = integrate(tmp_path / name, out=tmp_path / "out", to="depth")
    assert error_of(result) < 0.01
    assert f"read as {convention.value}" in caplog.text
    assert "taken for orthographic" in caplog.text


@pytest.mark.parametrize(
    ("name", "value"), [("black", 0.0), ("white", 1.0), ("flat blue", [0.5, 0.5, 1.0]), ("grey", 0.5)]
)
def test_what_surrounds_the_subject_is_no_normal(tmp_path, name, value, caplog):
    _, normals, mask = ball()
    write_png(tmp_path / "a.png", encoded(normals, mask, NormalConvention.OPENGL, value))
    with caplog.at_level(logging.WARNING):
        result = integrate(tmp_path / "a.png", out=tmp_path / "out")
    assert error_of(result) < 0.01
    assert f"{name} at the border was taken for background" in caplog.text
    assert len(result.mesh(0).faces) > mask.sum()


def test_damaged_archives_are_one_line_and_end_no_process(tmp_path):
    """SciPy's reader of .mat files ended the process; a header of petabytes in a .npz was a traceback."""
    from scipy.io import savemat

    _, normals, mask = ball()
    np.savez(tmp_path / "a.npz", normals=normals)
    with zipfile.ZipFile(tmp_path / "a.npz", "a") as archive, archive.open("other.npy", "w") as member:
        header = {"descr": "<f8", "fortran_order": False, "shape": (10**15,)}
        np.lib.format.write_array_header_1_0(member, header)
    assert (read_stored_normals(tmp_path / "a.npz").mask == mask).mean() > 0.99
    rng, refused = np.random.default_rng(1), 0
    for packed in (False, True):
        savemat(tmp_path / "a.mat", {"Normal_gt": normals}, do_compression=packed)
        sound = (tmp_path / "a.mat").read_bytes()
        for case in range(60):
            damaged = bytearray(sound if case % 3 else sound[: int(rng.integers(130, len(sound)))])
            for _ in range(case % 4):
                damaged[int(rng.integers(120, 300))] = int(rng.integers(256))
            (tmp_path / "b.mat").write_bytes(damaged)
            try:
                read_stored_normals(tmp_path / "b.mat")
            except BadInput:
                refused += 1
    assert refused > 60


def test_words_in_an_archive_and_masks_of_another_size_are_one_line(tmp_path):
    np.savez(tmp_path / "a.npz", normals=np.full((4, 5, 3), "z"))
    with pytest.raises(BadInput, match=r"a\.npz: expected numbers, got <U1"):
        integrate(tmp_path / "a.npz", out=tmp_path / "out")
    _, normals, mask = ball()
    normal_map = NormalMap(normals_in_camera=np.where(mask[..., None], normals, 0), mask=mask)
    write_normal_map(tmp_path / "a.exr", normal_map)
    write_mask(tmp_path / "m.png", mask[:-1])
    with pytest.raises(BadInput, match=r"a\.exr: is .* but its mask is .*; give one of its size"):
        integrate(tmp_path / "a.exr", mask=tmp_path / "m.png", out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_folder_with_mask_and_camera_beside_the_map(tmp_path):
    _, normals, mask = ball()
    write_map(tmp_path / "Normal_gt.mat", normals, np.ones_like(mask), NormalConvention.OPENGL)
    write_mask(tmp_path / "mask.png", mask)
    np.savetxt(tmp_path / "K.txt", Camera.pinhole(width=SIZE, height=SIZE, focal_px=5000.0).matrix)
    result = integrate(tmp_path, out=tmp_path / "out", distance=2.0)
    assert result.camera.is_perspective
    assert result.depth(0).depth[mask].mean() == pytest.approx(2.0, rel=0.02)


def test_frames_of_a_folder_and_what_later_verbs_make_of_them(tmp_path):
    _, normals, mask = ball()
    for k in range(3):
        write_png(tmp_path / f"n{k}.png", encoded(normals, mask, NormalConvention.DIRECTX))
    run_verb(["integrate", str(tmp_path), "--out", str(tmp_path / "out"), "--frames", "1:3"])
    run_verb(["export", str(tmp_path / "out"), "--to", "ply"])
    assert len(list((tmp_path / "out" / "export").rglob("*.ply"))) == 2
    run_verb(["report", str(tmp_path / "out")])
    assert (tmp_path / "out" / "report.html").exists()


def test_numbers_that_are_missing_from_a_folder_are_said(tmp_path, caplog):
    _, normals, mask = ball()
    for number in (3, 4, 7):
        write_png(tmp_path / f"n{number}.png", encoded(normals, mask, NormalConvention.OPENGL))
    with caplog.at_level(logging.WARNING):
        result = integrate(tmp_path, out=tmp_path / "out")
    assert "numbers are missing between n3.png and n7.png: the maps become frames 0 to 2" in caplog.text
    assert list(result.numbers) == [0, 1, 2]


def test_an_interrupted_folder_goes_on_where_it_stopped(tmp_path):
    """The second time, the frames that are there are not written again, and all depths are as at once."""
    _, normals, mask = ball()
    (tmp_path / "maps").mkdir()
    for number in range(2):
        shown = np.roll(mask, number, axis=1)
        moved = np.roll(normals, number, axis=1)
        write_map(tmp_path / "maps" / f"{number}.16.png", moved, shown, NormalConvention.OPENGL)
    whole = integrate(tmp_path / "maps", out=tmp_path / "whole", to="depth")
    integrate(tmp_path / "maps", out=tmp_path / "parts", to="depth")
    before = [(tmp_path / "parts" / "depth" / f"00000{n}.exr").stat().st_mtime_ns for n in (0, 1)]
    (tmp_path / "parts" / "depth" / "000001.exr").unlink()
    went_on = integrate(tmp_path / "maps", out=tmp_path / "parts", to="depth")
    after = [(tmp_path / "parts" / "depth" / f"00000{n}.exr").stat().st_mtime_ns for n in (0, 1)]
    assert before[0] == after[0]
    assert before[1] < after[1]
    for number in (0, 1):
        np.testing.assert_allclose(went_on.depth(number).depth, whole.depth(number).depth, atol=1e-3)


def test_normals_that_face_away_are_left_out_or_refused(tmp_path, caplog):
    _, normals, _mask = ball()
    some = normals.copy()
    some[46:48, 46:48, 2] *= -1
    np.savez(tmp_path / "a.npz", normals=some)
    with caplog.at_level(logging.WARNING):
        integrate(tmp_path / "a.npz", out=tmp_path / "out", convention="opencv")
    assert "face away: left out" in caplog.text
    with pytest.raises(BadInput, match="100% of the normals face away from the viewer; give --convention"):
        integrate(tmp_path / "a.npz", out=tmp_path / "more", convention="opengl")


@pytest.mark.parametrize(
    ("stored", "line"),
    [
        ({"normals": np.full((9, 9, 3), 40.0)}, "expected normals, vectors of length 1, got none"),
        ({"a": np.zeros((9, 9))}, r"expected one array \(h, w, 3\) of normals, it holds a"),
    ],
)
def test_what_is_no_normal_map(tmp_path, stored, line):
    np.savez(tmp_path / "a.npz", **stored)
    with pytest.raises(BadInput, match=line):
        integrate(tmp_path / "a.npz", out=tmp_path / "out")


def test_sources_and_cameras_that_are_none(tmp_path):
    with pytest.raises(BadInput, match="expected a normal map"):
        integrate(tmp_path, out=tmp_path / "out")
    with pytest.raises(BadInput, match=r"nothing\.png: no such file or folder"):
        integrate(tmp_path / "nothing.png", out=tmp_path / "out")
    _, normals, _ = ball()
    np.savez(tmp_path / "a.npz", normals=normals)
    write_mask(tmp_path / "small.png", np.ones((8, 9), np.bool_))
    with pytest.raises(BadInput, match=f"is {SIZE}×{SIZE} but its mask is 9×8"):
        integrate(tmp_path / "a.npz", out=tmp_path / "out", mask=tmp_path / "small.png")
    with pytest.raises(BadInput, match="give --camera or --focal-px, not both"):
        integrate(tmp_path / "a.npz", out=tmp_path / "out", focal_px=9.0, camera=tmp_path / "K.txt")
    (tmp_path / "K.txt").write_text("1 2 3")
    with pytest.raises(BadInput, match="expected the 9 numbers of a 3 × 3 camera matrix, got 3 words"):
        integrate(tmp_path / "a.npz", out=tmp_path / "out")


def test_a_prior_fixes_distance_and_scale(tmp_path, caplog):
    depth, normals, mask = ball()
    camera = Camera.pinhole(width=SIZE, height=SIZE, focal_px=5000.0)
    np.savetxt(tmp_path / "K.txt", camera.matrix)
    write_map(tmp_path / "a.mat", normals, mask, NormalConvention.OPENGL)
    metres = 2.0 + depth * 2.0 / 5000.0
    metres[::3] = np.nan
    write_depth_map(tmp_path / "z.exr", DepthMap(depth=metres, mask=np.isfinite(metres)))
    given = {"camera": tmp_path / "K.txt", "prior": tmp_path / "z.exr", "to": "depth"}
    found = integrate(tmp_path / "a.mat", out=tmp_path / "out", prior_error="1", **given).depth(0)
    seen = mask & np.isfinite(metres)
    assert found.unit is LengthUnit.METRE
    assert np.abs(found.depth - metres)[seen].mean() < 3e-4
    assert "depth in metres, median 1.98" in caplog.text
    with pytest.raises(BadInput, match="states no error"):
        integrate(tmp_path / "a.mat", out=tmp_path / "o", **given)
    with pytest.raises(BadInput, match="--prior or --distance, not both"):
        integrate(tmp_path / "a.mat", out=tmp_path / "o", prior_error="1", distance=2.0, **given)
    write_depth_map(tmp_path / "z.exr", DepthMap(depth=metres[:-1], mask=np.isfinite(metres[:-1])))
    with pytest.raises(BadInput, match=f"expected {SIZE}×{SIZE}, the size of the normals"):
        integrate(tmp_path / "a.mat", out=tmp_path / "o", prior_error="1", **given)
    with pytest.raises(BadInput, match="give --prior, the depth"):
        integrate(tmp_path / "a.mat", out=tmp_path / "o", prior_error="1")
    assert not (tmp_path / "o").exists()
