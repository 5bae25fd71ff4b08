"""Images keep every bit on the way through a file, and a bad one is refused in one clear line."""

import cv2
import numpy as np
import pytest
import tifffile

from vntoolkit.errors import BadCapture, BadInput, CannotWrite
from vntoolkit.io import atomic
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.maps_and_meshes.exr import ExrCompression, read_exr, write_exr
from vntoolkit.io.maps_and_meshes.label_images import read_labels, write_labels
from vntoolkit.io.maps_and_meshes.masks import read_mask, write_mask


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_integers_come_back_exactly_and_in_rgb_order(tmp_path, rng, dtype, suffix):
    pixels = rng.integers(0, np.iinfo(dtype).max, (13, 17, 3), dtype=dtype, endpoint=True)
    path = tmp_path / f"image{suffix}"
    if suffix == ".png":
        write_png(path, pixels)
    else:
        tifffile.imwrite(path, pixels, photometric="rgb")
    np.testing.assert_array_equal(read_image(path), pixels)


def test_grey_fills_three_channels(tmp_path, rng):
    grey = rng.integers(0, 65535, (5, 6), dtype=np.uint16)
    write_png(tmp_path / "g.png", grey)
    np.testing.assert_array_equal(read_image(tmp_path / "g.png"), np.repeat(grey[..., None], 3, axis=2))


@pytest.mark.parametrize("compression", list(ExrCompression))
def test_exr_keeps_floats_and_attributes(tmp_path, rng, compression):
    channels = {
        "Z": rng.normal(size=(19, 23)).astype(np.float32),
        "half": rng.normal(size=(19, 23)).astype(np.float16),
    }
    path = tmp_path / "a.exr"
    write_exr(path, channels, attributes={"unit": "m"}, compression=compression)
    back, header = read_exr(path)
    assert header.texts["unit"] == "m"
    for name, values in channels.items():
        assert back[name].dtype == values.dtype
        np.testing.assert_array_equal(back[name], values)


@pytest.mark.parametrize("bits", [8, 16])
def test_opaque_alpha_is_dropped_and_any_other_refused(tmp_path, bits):
    full = 2**bits - 1
    pixels = np.full((4, 5, 4), full, dtype=np.uint8 if bits == 8 else np.uint16)
    pixels[..., :3] = [1, 2, 3]
    write_png(tmp_path / "a.png", pixels)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png")[0, 0], [1, 2, 3])
    pixels[2, 3, 3] = full // 2
    write_png(tmp_path / "a.png", pixels)
    with pytest.raises(BadCapture, match=rf"{bits}-bit alpha channel is not opaque at 1 pixels.*--mask"):
        read_image(tmp_path / "a.png")


def test_nan_in_exr_is_refused_with_its_place(tmp_path):
    channels = {name: np.zeros((4, 5), np.float32) for name in "RGB"}
    channels["G"][1, 2] = np.nan
    write_exr(tmp_path / "a.exr", channels)
    with pytest.raises(BadCapture, match=r"1 values are NaN or infinite, the first at pixel \(2, 1\)"):
        read_image(tmp_path / "a.exr")


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg", ".bmp", ".exr"])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.9])
def test_a_file_cut_off_is_refused_in_one_quiet_line(tmp_path, rng, capfd, suffix, share):
    path = tmp_path / f"a{suffix}"
    pixels = rng.integers(0, 255, (40, 50, 3), dtype=np.uint8)
    if suffix == ".exr":
        write_exr(path, {name: rng.normal(size=(40, 50)).astype(np.float32) for name in "RGB"})
    else:
        cv2.imwrite(str(path), pixels)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    with pytest.raises(BadCapture, match=r"a\.\w+: .*(cut off|damaged|not a PNG)") as caught:
        read_image(path)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_missing_empty_folder_and_text_are_named(tmp_path):
    (tmp_path / "empty.png").touch()
    (tmp_path / "text.png").write_text("hello, I am no image")
    for name, line in {
        "none.png": "no such file",
        "empty.png": "is empty",
        "text.png": "is not a PNG, TIFF, JPEG, BMP, WebP or EXR",
        "": "is a folder",
    }.items():
        with pytest.raises(BadCapture, match=line):
            read_image(tmp_path / name)


def test_labels_show_their_lights_and_come_back(tmp_path, rng):
    labels = rng.integers(0, 8, (9, 11), dtype=np.uint8)
    write_labels(tmp_path / "l.png", labels)
    np.testing.assert_array_equal(read_labels(tmp_path / "l.png"), labels)
    shown = cv2.imread(str(tmp_path / "l.png"))[..., ::-1].astype(int)
    for light in range(3):  # the colour of a light alone is strongest in its own channel
        assert (shown[labels == 1 << light].argmax(axis=1) == light).all()
    shown[0, 0] = [1, 222, 3]
    write_png(tmp_path / "l.png", shown.astype(np.uint8))
    with pytest.raises(BadInput, match=r"pixel \(0, 0\) has the colour \[1, 222, 3\]"):
        read_labels(tmp_path / "l.png")


def test_masks_come_back_and_must_fit(tmp_path, rng):
    mask = rng.random((6, 7)) > 0.5
    write_mask(tmp_path / "m.png", mask)
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", size=(7, 6)), mask)
    with pytest.raises(BadInput, match="the mask is 7×6, the capture 8×6"):
        read_mask(tmp_path / "m.png", size=(8, 6))
    write_mask(tmp_path / "m.png", np.zeros((6, 7), bool))
    with pytest.raises(BadInput, match="no valid pixel"):
        read_mask(tmp_path / "m.png")


def test_a_failed_write_leaves_the_old_file_and_no_temporary(tmp_path):
    path = tmp_path / "a.txt"
    atomic.write_text(path, "old")

    def break_off() -> None:
        with atomic.atomic_path(path) as temporary:
            temporary.write_text("half of the n")
            raise RuntimeError("in the middle")

    with pytest.raises(RuntimeError, match="in the middle"):
        break_off()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_in_place_of_a_folder_is_one_line(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(CannotWrite, match="a file stands where a folder is needed"):
        write_png(tmp_path / "file" / "a.png", np.zeros((2, 2), np.uint8))
    with pytest.raises(CannotWrite, match="cannot write /proc/none"):
        atomic.require_writable_folder("/proc/none")
