"""Captures: every frame arrives, with its bits, its number and its light; bad ones say which frame."""

from fractions import Fraction

import av
import numpy as np
import pytest

from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.sequence import CaptureKind, find_capture_files
from vntoolkit.io.footage.video import VideoReader, write_video
from vntoolkit.io.maps_and_meshes.exr import write_exr
from vntoolkit.options.footage import SensorOptions
from vntoolkit.photometry.transfer import (
    Transfer,
    TransferCurve,
    encoded_from_linear,
    linear_from_encoded,
)


def _frames(rng, count=12, dtype=np.uint8):
    return list(rng.integers(0, np.iinfo(dtype).max, (count, 36, 48, 3), dtype=dtype, endpoint=True))


@pytest.mark.parametrize(("dtype", "bits"), [(np.uint8, 8), (np.uint16, 16)])
def test_video_is_lossless_and_reads_from_any_frame(tmp_path, rng, dtype, bits):
    frames = _frames(rng, dtype=dtype)
    assert write_video(tmp_path / "a.mkv", iter(frames), 29.97) == 12
    capture = open_capture(tmp_path / "a.mkv")
    info = capture.info
    assert (info.kind, info.width, info.height, info.frame_count, info.bits) == (
        CaptureKind.VIDEO, 48, 36, 12, bits,
    )  # fmt: skip
    assert info.frame_rate_hz == pytest.approx(29.97, abs=1e-3)
    for start, stop, step in [(0, None, 1), (3, None, 1), (2, 11, 4), (11, 12, 1), (5, 100, 1)]:
        read = list(capture.encoded_frames(start, stop, step))
        assert [frame.number for frame in read] == list(range(12))[start:stop:step]
        for frame in read:
            np.testing.assert_array_equal(frame.values, frames[frame.number])


def _write_yuv(path, rgb, bits, full_range, weights, colour_space, chroma):
    """Store RGB 0 to 1 as YUV by the definition of ITU-R BT.709-6 items 3 and 4, in float, then rounded."""
    kr, kb = weights
    r, g, b = np.moveaxis(rgb, -1, 0)
    y = kr * r + (1 - kr - kb) * g + kb * b
    cb, cr = (b - y) / (2 * (1 - kb)), (r - y) / (2 * (1 - kr))
    step, full = 2 ** (bits - 8), 2**bits - 1
    if full_range:
        planes = [y * full, cb * full + 128 * step, cr * full + 128 * step]
    else:
        planes = [step * (16 + 219 * y), step * (128 + 224 * cb), step * (128 + 224 * cr)]
    name = f"yuv{chroma}p" + ("" if bits == 8 else f"{bits}le")
    across, down = {"444": (1, 1), "422": (2, 1), "420": (2, 2)}[chroma]
    height, width = rgb.shape[:2]
    frame = av.VideoFrame(width, height, name)
    frame.colorspace, frame.color_range, frame.pts = colour_space, 2 if full_range else 1, 0
    for i, plane in enumerate(planes):
        if i:
            shape = (height // down, down, width // across, across)
            plane = plane.reshape(shape).mean(axis=(1, 3))  # noqa: PLW2901
        stored = np.clip(np.rint(plane), 0, full).astype(np.uint8 if bits == 8 else np.uint16)
        rows = np.zeros((stored.shape[0], frame.planes[i].line_size), np.uint8)
        packed = np.ascontiguousarray(stored).view(np.uint8)
        rows[:, : packed.shape[1]] = packed
        frame.planes[i].update(rows.tobytes())
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = width, height, name
        stream.codec_context.color_range = frame.color_range
        stream.codec_context.colorspace = colour_space
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


@pytest.mark.parametrize("bits", [8, 10, 12])
@pytest.mark.parametrize("full_range", [False, True], ids=["limited", "full"])
@pytest.mark.parametrize(("weights", "colour_space"), [((0.2126, 0.0722), 1), ((0.299, 0.114), 5)])
def test_yuv_keeps_depth_range_and_matrix(tmp_path, rng, bits, full_range, weights, colour_space):
    rgb = rng.uniform(0.0, 1.0, (64, 96, 3))
    _write_yuv(tmp_path / "a.mkv", rgb, bits, full_range, weights, colour_space, "444")
    capture = open_capture(tmp_path / "a.mkv")
    frame = next(capture.encoded_frames())
    error = (frame.values / (2**frame.bits - 1) - rgb) * (2**bits - 1)
    # Rounding Y and chroma to half a level moves a channel by 0.5 (1 + 1.86) × 255 / 219 = 1.7 at most;
    # 8-bit output adds its own half.
    assert np.abs(error).max() < (1.7 if bits > 8 else 2.2)
    assert abs(error.mean()) < 0.02
    assert (capture.info.chroma, frame.values.dtype) == ("4:4:4", np.uint8 if bits == 8 else np.uint16)


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("chroma", ["422", "420"])
def test_subsampled_chroma_is_named_and_right_on_smooth_colour(tmp_path, bits, chroma):
    v, u = np.mgrid[:64, :96]
    rgb = np.stack([0.3 + 0.004 * u, 0.2 + 0.005 * v, 0.7 - 0.003 * u], axis=-1)
    _write_yuv(tmp_path / "a.mkv", rgb, bits, False, (0.2126, 0.0722), 1, chroma)
    capture = open_capture(tmp_path / "a.mkv")
    frame = next(capture.encoded_frames())
    assert capture.info.chroma == ":".join(chroma)
    inside = (slice(4, -4), slice(4, -4))
    # Where chroma is sited shifts it by half a pixel at most, worth 0.5 × 0.009 × 1.86 here.
    assert np.abs(frame.values / (2**frame.bits - 1) - rgb)[inside].max() < 0.5 * 0.009 * 1.86 + 2.2 / 255


@pytest.mark.parametrize("share", [0.3, 0.7, 0.97, 0.99])
def test_a_truncated_video_says_where_it_ends_and_can_be_used_up_to_there(tmp_path, rng, share, capfd):
    write_video(tmp_path / "a.mkv", _frames(rng, 20), 25)
    content = (tmp_path / "a.mkv").read_bytes()
    (tmp_path / "a.mkv").write_bytes(content[: int(len(content) * share)])
    capture = open_capture(tmp_path / "a.mkv")
    have = capture.info.frame_count
    assert 20 * share - 2 <= have < 20
    with pytest.raises(BadCapture, match=rf"cut off: {have} of 20 frames .*--frames 0:{have}"):
        list(capture.frames())
    assert len(list(capture.frames(0, have))) == have
    assert capfd.readouterr().err == ""


def test_a_video_cut_off_behind_its_last_frame_loses_none(tmp_path, rng):
    pictures = _frames(rng, 20)
    write_video(tmp_path / "a.mkv", pictures, 25)
    content = (tmp_path / "a.mkv").read_bytes()
    (tmp_path / "a.mkv").write_bytes(content[:-100])  # within the index for seeking, which comes last
    capture = open_capture(tmp_path / "a.mkv")
    for number in (19, 7):
        np.testing.assert_array_equal(next(capture.encoded_frames(number)).values, pictures[number])
    assert len(list(capture.frames())) == 20


def test_any_frame_of_a_written_video_decodes_without_another(tmp_path, rng):
    write_video(tmp_path / "a.mkv", _frames(rng, 20), 25)
    capture = open_capture(tmp_path / "a.mkv")
    assert [capture.readable_alone(number, within=0) for number in range(20)] == list(range(20))
    assert VideoReader(tmp_path / "a.mkv").index.key_frames == tuple(range(20))


def test_a_truncated_mp4_says_where_it_ends(tmp_path, rng):
    with av.open(str(tmp_path / "a.mp4"), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(25), options={"crf": "10"})
        stream.width, stream.height, stream.pix_fmt = 48, 36, "yuv444p"
        for picture in _frames(rng, 20):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
    assert len(list(open_capture(tmp_path / "a.mp4").frames())) == 20
    content = (tmp_path / "a.mp4").read_bytes()
    (tmp_path / "a.mp4").write_bytes(content[: int(len(content) * 0.6)])
    with pytest.raises(BadCapture, match=r"cut off: \d+ of 20 frames"):
        list(open_capture(tmp_path / "a.mp4").frames())


def test_what_is_no_video_is_refused_in_one_line(tmp_path, rng):
    (tmp_path / "empty.mkv").touch()
    (tmp_path / "noise.mkv").write_bytes(rng.bytes(5000))
    (tmp_path / "folder").mkdir()
    for name, line in {
        "none.mkv": "no such file",
        "empty.mkv": "is empty",
        "noise.mkv": "cannot be opened as a video",
        "folder": "holds no image",
        "f_%03d.png": "no file matches",
        "f_*.png": "no file matches",
    }.items():
        with pytest.raises(BadCapture, match=line) as caught:
            open_capture(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_sequences_sort_by_number_and_take_patterns(tmp_path, rng):
    for number in (10, 9, 12, 11):
        write_png(tmp_path / f"f{number}.png", np.full((3, 4, 3), number, np.uint8))
        write_png(tmp_path / f"g{number:04d}.png", np.full((3, 4, 3), number, np.uint8))
    (tmp_path / ".hidden.png").touch()
    (tmp_path / "notes.txt").write_text("no image")
    for pattern in ("f%d.png", "f*.png", "g%04d.png", "g*.png"):
        capture = open_capture(tmp_path / pattern)
        assert [int(frame.values[0, 0, 0]) for frame in capture.encoded_frames()] == [9, 10, 11, 12]
    with pytest.raises(BadCapture, match=r"holds 2 series of images, such as f9.png"):
        find_capture_files(tmp_path)
    assert [frame.number for frame in open_capture(tmp_path / "f%d.png").frames(1, None, 2)] == [1, 3]


def test_a_name_that_exists_is_no_pattern(tmp_path):
    write_png(tmp_path / "100%d[1].png", np.zeros((3, 4, 3), np.uint8))
    assert open_capture(tmp_path / "100%d[1].png").info.kind is CaptureKind.IMAGE


def test_a_frame_of_another_size_is_named_with_both_sizes(tmp_path):
    for number, width in enumerate((4, 4, 5)):
        write_png(tmp_path / f"f{number}.png", np.zeros((3, width, 3), np.uint8))
    with pytest.raises(BadCapture, match=r"f2.png: frame 2 is 5×3, the first one 4×3"):
        list(open_capture(tmp_path).frames())


@pytest.mark.parametrize("bits", [8, 12, 16])
@pytest.mark.parametrize("curve", list(TransferCurve))
def test_light_comes_back_through_curve_and_levels(tmp_path, rng, bits, curve):
    gamma = 2.2 if curve is TransferCurve.GAMMA else 1.0
    transfer = Transfer(curve=curve, gamma=gamma, black_level=0.05, white_level=0.9)
    light = rng.uniform(0.1, 0.8, (20, 30, 3))
    stored = np.rint(encoded_from_linear(light, transfer) * (2**bits - 1))
    write_png(tmp_path / "a.png", stored.astype(np.uint8 if bits == 8 else np.uint16))
    frame = open_capture(
        tmp_path / "a.png", CaptureOptions(transfer=transfer, sensor=SensorOptions(bits=bits))
    ).frame(0)
    # Half a stored level, times the curve's steepest slope; all grow steeper towards white.
    steepest = linear_from_encoded(np.array([0.999, 1.0]), transfer)
    steepest = (steepest[1] - steepest[0]) / 0.001
    assert np.abs(frame.rgb - light).max() < 0.5 / (2**bits - 1) * steepest + 1e-6
    assert not frame.clipped.any()


def test_clipped_is_where_any_channel_reaches_the_white_level(tmp_path):
    pixels = np.full((2, 3, 3), 100, np.uint8)
    pixels[0, 1, 2] = 255
    pixels[1, 2, 0] = 240
    write_png(tmp_path / "a.png", pixels)
    for white, expected in ((1.0, [[0, 1, 0], [0, 0, 0]]), (240 / 255, [[0, 1, 0], [0, 0, 1]])):
        options = CaptureOptions(transfer=Transfer(white_level=white))
        np.testing.assert_array_equal(open_capture(tmp_path / "a.png", options).frame(0).clipped, expected)


def test_the_background_is_removed_and_clipping_is_judged_before(tmp_path, rng):
    background = rng.integers(10, 40, (4, 5, 3), dtype=np.uint8)
    picture = background + np.uint8(60)
    picture[0, 0] = 255
    write_png(tmp_path / "b.png", background)
    write_png(tmp_path / "a.png", picture)
    frame = open_capture(tmp_path / "a.png", CaptureOptions(background=tmp_path / "b.png")).frame(0)
    np.testing.assert_allclose(frame.rgb[1:], 60 / 255, atol=1e-6)
    assert frame.clipped.sum() == 1
    write_png(tmp_path / "b.png", background[:3])
    with pytest.raises(BadCapture, match="the background is 5×3, the footage 5×4: film both"):
        open_capture(tmp_path / "a.png", CaptureOptions(background=tmp_path / "b.png"))


def test_float_images_are_linear_whatever_the_curve(tmp_path):
    channels = {
        name: np.full((2, 3), value, np.float32) for name, value in zip("RGB", (0.1, 0.5, 2.0), strict=True)
    }
    write_exr(tmp_path / "a.exr", channels)
    options = CaptureOptions(transfer=Transfer(curve=TransferCurve.SRGB))
    frame = open_capture(tmp_path / "a.exr", options).frame(0)
    np.testing.assert_allclose(frame.rgb[0, 0], [0.1, 0.5, 2.0], rtol=1e-6)
    assert not frame.clipped.any()  # beyond 1 there is no full scale
    options = CaptureOptions(transfer=Transfer(white_level=0.9))
    assert open_capture(tmp_path / "a.exr", options).frame(0).clipped.all()


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("2:8:3", [2, 5]),
        (":3", [0, 1, 2]),
        ("7:", [7, 8, 9]),
        ("::4", [0, 4, 8]),
        ("6", [6]),
        ("8:99", [8, 9]),
    ],
)
def test_frame_ranges_read_like_python(text, numbers):
    chosen = FrameRange.from_text(text)
    assert list(chosen.numbers(10)) == numbers
    assert FrameRange.from_text(chosen.to_text()) == chosen


@pytest.mark.parametrize("text", ["", "a:b", "1:2:3:4", "-3:", "5:5", "0:9:0", "1.5"])
def test_other_frame_ranges_are_refused(text):
    with pytest.raises(BadInput, match="frames: expected"):
        FrameRange.from_text(text)


def test_frames_beyond_the_end_are_refused(tmp_path, rng):
    write_video(tmp_path / "a.mkv", _frames(rng, 3), 25)
    with pytest.raises(BadInput, match="has only 3 frames"):
        list(open_capture(tmp_path / "a.mkv").frames(7))
