"""Pictures at the edge of what a format holds: one row, grey with alpha, soft masks, depth in lists."""

import errno
import os
import struct

import numpy as np
import pytest
import tifffile

from vntoolkit.diagnosis.axes import curl_share
from vntoolkit.errors import BadCapture
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io import files
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.images import read_image, read_image_with_alpha
from vntoolkit.io.footage.sequence import find_capture_files
from vntoolkit.io.maps_and_meshes.exr import read_exr, write_exr
from vntoolkit.io.maps_and_meshes.maps import read_normal_map, write_normal_map
from vntoolkit.io.maps_and_meshes.masks import read_mask


@pytest.mark.parametrize("shape", [(1, 500), (500, 1), (1, 1)])
def test_a_normal_map_of_one_row_or_column_comes_back(tmp_path, shape):
    normals = np.broadcast_to(np.float32([0, 0, -1]), (*shape, 3))
    write_normal_map(tmp_path / "a.png", NormalMap(normals_in_camera=normals, mask=np.ones(shape, bool)))
    assert read_normal_map(tmp_path / "a.png").normals_in_camera == pytest.approx(normals, abs=1e-4)


def test_slopes_of_no_area_have_no_curl():
    assert np.isnan(curl_share(np.ones((1, 9, 3)), np.ones((1, 9), bool)))


def test_a_grey_exr_with_alpha_is_its_grey(tmp_path):
    grey = np.array([[0.25, 0.5]], np.float32)
    write_exr(tmp_path / "a.exr", {"Y": grey, "A": np.ones((1, 2), np.float32)})
    assert read_image(tmp_path / "a.exr")[..., 1].tolist() == grey.tolist()
    write_exr(tmp_path / "b.exr", {"Y": grey, "A": np.array([[1, 0.5]], np.float32)})
    with pytest.raises(BadCapture, match="not opaque at 1 pixels"):
        read_image(tmp_path / "b.exr")
    rgb, mask = read_image_with_alpha(tmp_path / "b.exr")
    assert (rgb[..., 0].tolist(), mask.tolist()) == (grey.tolist(), [[True, True]])


def test_a_soft_float_mask_is_cut_at_half(tmp_path):
    write_exr(tmp_path / "a.exr", {"Y": np.array([[0, 0.2, 0.6, 1]], np.float32)})
    assert read_mask(tmp_path / "a.exr").tolist() == [[False, False, True, True]]


def test_a_deep_exr_is_refused(tmp_path):
    import OpenEXR

    samples = np.empty((2, 2), object)
    for place in np.ndindex(2, 2):
        samples[place] = np.float32([1, 2])
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    OpenEXR.File(header, {"Y": samples}).write(str(tmp_path / "a.exr"))
    with pytest.raises(BadCapture, match="expected one value a pixel"):
        read_exr(tmp_path / "a.exr")


def test_file_names_with_digits_of_other_kinds_sort(tmp_path):
    for name in ("f10.png", "f9²4.png", "f٣.png"):
        (tmp_path / name).write_bytes(b"x")
    found = find_capture_files(tmp_path / "f*.png")
    assert [path.name for path in found.files] == ["f٣.png", "f9²4.png", "f10.png"]
    assert [path.name for path in find_capture_files(tmp_path).left_out] == ["f9²4.png"]


def test_a_name_too_long_for_any_file_is_one_line():
    with pytest.raises(BadCapture, match="cannot be read"):
        find_capture_files("x" * 300)


def test_a_process_without_descriptors_left_loses_none_to_quiet_reading(monkeypatch):
    def next_descriptor():
        number = os.dup(2)
        os.close(number)
        return number

    def none_left(*arguments):
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(files.os, "open", none_left)
    before = next_descriptor()
    with files.silenced_native_output():
        pass
    assert next_descriptor() == before


def _packed_tiff(samples, bits):
    """Bytes of an RGB TIFF (h, w, 3) whose samples follow each other without padding, as sensors deliver."""
    height, width, _ = samples.shape
    rows = ["".join(f"{value:0{bits}b}" for value in row) for row in samples.reshape(height, -1).tolist()]
    body = b"".join(int(row + "0" * (-len(row) % 8), 2).to_bytes(-(-len(row) // 8), "big") for row in rows)
    start = 8 + 2 + 12 * 10 + 4
    entries = [
        (256, 4, 1, width), (257, 4, 1, height), (258, 3, 3, start), (259, 3, 1, 1), (262, 3, 1, 2),
        (273, 4, 1, start + 6), (277, 3, 1, 3), (278, 4, 1, height), (279, 4, 1, len(body)), (284, 3, 1, 1),
    ]  # fmt: skip
    directory = b"".join(struct.pack("<HHII", *entry) for entry in entries)
    head = b"II*\0" + struct.pack("<IH", 8, len(entries))
    return head + directory + struct.pack("<I3H", 0, bits, bits, bits) + body


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_packed_samples_reach_full_scale(tmp_path, bits):
    full = 2**bits - 1
    samples = np.linspace(0, full, 48).round().astype(int).reshape(4, 4, 3)
    (tmp_path / "a.tif").write_bytes(_packed_tiff(samples, bits))
    frame = open_capture(tmp_path / "a.tif").frame(0)
    assert frame.rgb == pytest.approx(samples / full, abs=1 / 65535)
    assert frame.clipped.tolist() == (samples == full).any(axis=2).tolist()


def test_pages_without_end_are_counted_to_a_limit(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((70, 4, 5, 3), np.uint8), photometric="rgb")
    with pytest.raises(BadCapture, match="holds 64 pages, expected one picture a file"):
        read_image(tmp_path / "a.tif")
