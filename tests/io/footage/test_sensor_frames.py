"""Camera raw files and Bayer mosaics: the sensor's own linear samples, in RGB."""

import struct
from pathlib import Path

import av
import numpy as np
import pytest
import tifffile
from PIL import Image

from tests.pipeline.conftest import dome_light, dome_normals, to_normals
from vntoolkit.__main__ import main
from vntoolkit.errors import BadCapture
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.mosaics import rgb_from_mosaic
from vntoolkit.options.footage import Bayer, Demosaic, SensorOptions

BLACK, WHITE = 64, 1023
LIGHT = np.array([0.2, 0.5, 0.8])


def _mosaic(rgb: np.ndarray, bayer: Bayer) -> np.ndarray:
    """Take one colour of each pixel."""
    height, width = rgb.shape[:2]
    out = np.zeros((height, width), rgb.dtype)
    for k, colour in enumerate(bayer.value):
        out[k // 2 :: 2, k % 2 :: 2] = rgb[k // 2 :: 2, k % 2 :: 2, "rgb".index(colour)]
    return out


def _write_dng(path: Path, light: np.ndarray, bayer: Bayer = Bayer.RGGB, orientation: int = 1) -> None:
    """A DNG of 10 bits with a matrix and gains that must not be used. light: (h, w, 3), 1 = saturation."""
    samples = np.rint(BLACK + _mosaic(light, bayer) * (WHITE - BLACK)).astype(np.uint16)
    matrix = [n for k in range(9) for n in ((3, 2) if k % 4 == 0 else (-1, 4))]
    tags = [
        (50706, "B", 4, bytes([1, 4, 0, 0]), True), (50708, "s", 0, "A Camera", True),
        (33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes("rgb".index(c) for c in bayer.value), True),
        (50714, "H", 1, BLACK, True), (50717, "H", 1, WHITE, True), (274, "H", 1, orientation, True),
        (50721, "2i", 9, tuple(matrix), True), (50728, "2I", 3, (1, 2, 1, 1, 2, 3), True),
        (50778, "H", 1, 21, True),
    ]  # fmt: skip
    tifffile.imwrite(path, samples, photometric=32803, extratags=tags, metadata=None)


@pytest.mark.parametrize("demosaic", list(Demosaic))
@pytest.mark.parametrize("bayer", list(Bayer))
def test_a_raw_file_is_linear_light_of_the_sensor(tmp_path, bayer, demosaic):
    """Black is 0 and saturation 1, whatever else the frame shows; no gain and no matrix is applied."""
    light = np.full((40, 64, 3), LIGHT)
    light[:16, :16] = 1.0
    light[24:, :16] = 0.0
    _write_dng(tmp_path / "a.dng", light, bayer)
    capture = open_capture(tmp_path / "a.dng", CaptureOptions(sensor=SensorOptions(demosaic=demosaic)))
    frame = capture.frame(0)
    half = 2 if demosaic is Demosaic.HALF else 1
    assert (capture.info.height, capture.info.width) == frame.shape == (40 // half, 64 // half)
    assert (capture.info.stated_transfer, capture.info.bits, capture.info.chroma) == ("linear", 16, "Bayer")
    step = 0.6 / (WHITE - BLACK)
    np.testing.assert_allclose(frame.rgb[20 // half, 40 // half], LIGHT, atol=step)
    np.testing.assert_allclose(frame.rgb[4 // half, 4 // half], 1.0, atol=1e-6)
    np.testing.assert_allclose(frame.rgb[36 // half, 4 // half], 0.0, atol=1e-6)
    assert frame.clipped[4 // half, 4 // half]
    assert not frame.clipped[20 // half, 40 // half]


def test_full_scale_does_not_follow_the_picture(tmp_path):
    """A folder of raw frames, one dark and one bright, has one scale; one of them was held upright."""
    for number, level in enumerate((0.3, 0.9)):
        _write_dng(
            tmp_path / f"f{number}.dng", level + np.random.default_rng(number).normal(0, 0.01, (40, 64, 3))
        )
    values = [frame.rgb.mean() for frame in open_capture(tmp_path).frames()]
    np.testing.assert_allclose(values, (0.3, 0.9), atol=1e-3)
    _write_dng(tmp_path / "turned.dng", np.full((40, 64, 3), 0.5), orientation=6)
    info = open_capture(tmp_path / "turned.dng").info
    assert (info.width, info.height, info.orientation) == (40, 64, "turned by 90°")


def test_a_damaged_raw_file_is_one_line(tmp_path):
    (tmp_path / "a.cr2").write_bytes(b"II*\0" + bytes(200))
    with pytest.raises(BadCapture, match=r"a\.cr2: cannot be read as a camera raw file"):
        open_capture(tmp_path / "a.cr2")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("demosaic", list(Demosaic))
@pytest.mark.parametrize("bayer", list(Bayer))
def test_a_flat_mosaic_becomes_its_colour(bayer, demosaic, dtype):
    rgb = np.tile(np.array([20, 130, 240], dtype), (8, 12, 1))
    out = rgb_from_mosaic(_mosaic(rgb, bayer), bayer, demosaic)
    assert out.dtype == dtype
    np.testing.assert_array_equal(out, rgb[: out.shape[0], : out.shape[1]])


def _packed(samples: np.ndarray, photometric: int) -> bytes:
    """A TIFF of 12 bits a sample, packed, row by row."""
    height, width = samples.shape
    bits = np.unpackbits(samples.astype(">u2").view(np.uint8).reshape(height, width, 2), axis=2)[..., 4:]
    data = np.packbits(bits.reshape(height, -1), axis=1).tobytes()
    shorts = {256: width, 257: height, 258: 12, 259: 1, 262: photometric, 277: 1, 278: height}
    longs = {273: 8, 279: len(data)}
    entries = [struct.pack("<HHIHH", tag, 3, 1, value, 0) for tag, value in shorts.items()]
    entries += [struct.pack("<HHII", tag, 4, 1, value) for tag, value in longs.items()]
    entries.sort(key=lambda entry: struct.unpack("<H", entry[:2])[0])
    head = b"II*\0" + struct.pack("<I", 8 + len(data))
    return head + data + struct.pack("<H", len(entries)) + b"".join(entries) + bytes(4)


@pytest.mark.parametrize("bayer", list(Bayer))
def test_mosaics_in_tiff_and_png(tmp_path, bayer):
    """8 bits, 12 in 16, 12 packed; as grey with --bayer, and as the mosaic that a TIFF can state."""
    colour = np.array([300, 2000, 4000], np.uint16)
    mosaic = _mosaic(np.tile(colour, (8, 12, 1)), bayer)
    twelve, given = SensorOptions(bayer=bayer, bits=12), SensorOptions(bayer=bayer)
    write_png(tmp_path / "in16.png", mosaic)
    write_png(tmp_path / "8.png", (mosaic >> 4).astype(np.uint8))
    (tmp_path / "packed.tif").write_bytes(_packed(mosaic, 1))
    (tmp_path / "stated.tif").write_bytes(_packed(mosaic, 32803))
    codes = bytes("rgb".index(letter) for letter in bayer.value)
    tags = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, codes, True)]
    tifffile.imwrite(tmp_path / "own.tif", mosaic << 4, photometric=32803, extratags=tags, metadata=None)
    all_given = dict.fromkeys(("8.png", "packed.tif", "stated.tif"), given)
    for name, sensor in {"in16.png": twelve, "own.tif": SensorOptions(), **all_given}.items():
        capture = open_capture(tmp_path / name, CaptureOptions(sensor=sensor))
        assert capture.info.chroma == "Bayer"
        np.testing.assert_allclose(capture.frame(0).rgb, np.tile(colour / 4095, (8, 12, 1)), atol=4e-3)


def test_a_pattern_that_is_missing_or_too_much_is_said(tmp_path):
    (tmp_path / "a.tif").write_bytes(_packed(np.zeros((4, 4), np.uint16), 32803))
    with pytest.raises(BadCapture, match="is stored as a Bayer mosaic; give --bayer"):
        open_capture(tmp_path / "a.tif")
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "rgb.png")
    with pytest.raises(BadCapture, match="--bayer needs one sample a pixel, got 3"):
        open_capture(tmp_path / "rgb.png", CaptureOptions(sensor=SensorOptions(bayer=Bayer.RGGB)))


def _film(path: Path, codec: str, pixels: str, mosaics: list[np.ndarray]) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.height, stream.width = mosaics[0].shape
        stream.pix_fmt = pixels
        for values in mosaics:
            picture = av.VideoFrame(values.shape[1], values.shape[0], pixels)
            plane = picture.planes[0]
            rows = np.zeros((values.shape[0], plane.line_size // values.dtype.itemsize), values.dtype)
            rows[:, : values.shape[1]] = values
            plane.update(rows.tobytes())
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))


@pytest.mark.parametrize(
    ("name", "codec", "pixels", "bits", "given"),
    [
        ("a.mkv", "ffv1", "gray", 8, True),
        ("a.mkv", "ffv1", "gray10le", 10, True),
        ("a.mkv", "ffv1", "gray12le", 12, True),
        ("a.mkv", "ffv1", "gray16le", 16, True),
        ("a.nut", "rawvideo", "bayer_grbg8", 8, False),
        ("a.nut", "rawvideo", "bayer_grbg16le", 16, False),
    ],
)
def test_mosaics_in_video(tmp_path, name, codec, pixels, bits, given):
    colour = np.rint(LIGHT * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    mosaic = _mosaic(np.tile(colour, (16, 24, 1)), Bayer.GRBG)
    _film(tmp_path / name, codec, pixels, [mosaic, mosaic])
    sensor = SensorOptions(bayer=Bayer.GRBG if given else None)
    capture = open_capture(tmp_path / name, CaptureOptions(sensor=sensor))
    assert (capture.info.chroma, capture.info.bits, len(capture)) == ("Bayer", bits, 2)
    np.testing.assert_allclose(capture.frame(1).rgb, np.tile(LIGHT, (16, 24, 1)), atol=0.6 / (2**bits - 1))
    half = open_capture(
        tmp_path / name, CaptureOptions(sensor=SensorOptions(bayer=sensor.bayer, demosaic=Demosaic.HALF))
    )
    assert (half.info.width, half.info.height, half.frame(0).shape) == (12, 8, (8, 12))


def test_a_mosaic_is_reconstructed_and_read_again_by_the_report(tmp_path):
    """--bayer is kept in the manifest, so that later verbs see the footage in colour."""
    light, (_, mask) = dome_light(), dome_normals(31.5)
    (tmp_path / "take").mkdir()
    for number in range(2):
        mosaic = _mosaic(np.rint(light * 65535).astype(np.uint16), Bayer.RGGB)
        write_png(tmp_path / f"take/f{number}.png", mosaic)
    command = to_normals(tmp_path, tmp_path / "take")
    assert main(command) == 1  # grey
    assert main([*command, "--bayer", "rggb"]) == 0
    from vntoolkit.pipeline.opened_result import read_result

    shown = read_result(tmp_path / "out").linear(0).rgb
    inside = mask & np.roll(mask, 3, 0) & np.roll(mask, -3, 0) & np.roll(mask, 3, 1) & np.roll(mask, -3, 1)
    assert np.abs(shown - light)[inside].max() < 0.02
