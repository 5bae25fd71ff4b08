"""Videos at their edges: a pixel or three, names that look like protocols, frames left out, odd rates."""

from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest

from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.video import VideoReader, open_video, write_video


def _noise(rng, count, height, width, dtype=np.uint8):
    return list(rng.integers(0, np.iinfo(dtype).max, (count, height, width, 3), dtype=dtype, endpoint=True))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (5, 3), (1, 64), (40, 1), (7, 9)])
def test_small_and_odd_pictures_are_lossless(tmp_path, rng, size, dtype):
    frames = _noise(rng, 3, *size, dtype)
    write_video(tmp_path / "a.mkv", frames, 25)
    for frame in VideoReader(tmp_path / "a.mkv").frames():
        np.testing.assert_array_equal(frame.values, frames[frame.number])


@pytest.mark.parametrize(
    "second",
    [np.zeros((24, 32, 3), np.uint8), np.zeros((16, 24, 3), np.uint16), np.zeros((16, 24, 3), float)],
)
def test_frames_that_change_are_not_written(tmp_path, second):
    """The encoder would scale and round them to the first frame's kind without a word."""
    with pytest.raises(BadCapture, match=r"frame 1 is \(.*, the first one \(16, 24, 3\) uint8"):
        write_video(tmp_path / "a.mkv", [np.zeros((16, 24, 3), np.uint8), second], 25)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("rate", [0.0, -25.0, 1e-9, np.nan, np.inf])
def test_a_video_needs_a_rate(tmp_path, rate):
    with pytest.raises(BadInput, match="frame rate: expected"):
        write_video(tmp_path / "a.mkv", [np.zeros((16, 24, 3), np.uint8)], rate)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["take:1.mkv", "http:a.mkv", "ü 火 %03d.mkv"])
def test_a_name_is_no_protocol(tmp_path, rng, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    frames = _noise(rng, 2, 16, 24)
    write_video(name, frames, 25)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    np.testing.assert_array_equal(next(open_capture(name).encoded_frames(1)).values, frames[1])


def _write_video_with_broken_tags(path, frames):
    """A title of the file and one of the stream, both in Latin-1, where Matroska asks for UTF-8."""
    with av.open(str(path), "w", format="matroska") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "bgr0"
        container.metadata["title"] = stream.metadata["title"] = "TITLE OF A TAKE"
        for frame in [*(av.VideoFrame.from_ndarray(values, format="rgb24") for values in frames), None]:
            container.mux(stream.encode(frame))
    plain = path.read_bytes()
    assert plain.count(b"TITLE OF A TAKE") == 2
    path.write_bytes(plain.replace(b"TITLE OF A TAKE", "Rücken, Äpfel ß".encode("latin-1")))


def test_tags_that_are_no_utf8_keep_no_video_from_opening(tmp_path, rng):
    frames = _noise(rng, 2, 16, 24)
    _write_video_with_broken_tags(tmp_path / "a.mkv", frames)
    for frame in VideoReader(tmp_path / "a.mkv").frames():
        np.testing.assert_array_equal(frame.values, frames[frame.number])


def _open_as_18(name, *, options, metadata_errors="strict"):
    """PyAV 18 fails on such a tag unless told otherwise."""
    if metadata_errors == "strict":
        raise UnicodeDecodeError("utf-8", b"\xfc", 0, 1, "invalid start byte")
    return "opened"


def _open_as_19(name, *, options):
    """PyAV 19 opens it as it is; the option is gone, and naming it a TypeError."""
    return "opened"


@pytest.mark.parametrize("behaviour", [_open_as_18, _open_as_19])
def test_videos_open_with_every_pyav_that_the_lock_names(monkeypatch, behaviour):
    class Container:
        class streams:
            video = (SimpleNamespace(disposition=0),)

    monkeypatch.setattr(av, "open", lambda *given, **named: behaviour(*given, **named) and Container)
    assert open_video(Path("a.mkv")) == (Container, Container.streams.video[0])


@pytest.mark.parametrize("part", [(0, None, 4), (1, 11, 3), (2, 4, 5)])
def test_frames_left_out_are_not_decoded(tmp_path, rng, monkeypatch, part):
    frames = _noise(rng, 12, 16, 24)
    write_video(tmp_path / "a.mkv", frames, 25)
    reader, decoded = VideoReader(tmp_path / "a.mkv", CaptureOptions(threads=1)), []
    plain = reader._decoded

    def counted(*arguments, **how):
        for shown in plain(*arguments, **how):
            decoded.append(shown)
            yield shown

    monkeypatch.setattr(reader, "_decoded", counted)
    read = {frame.number: frame.values for frame in reader.frames(*part)}
    assert list(read) == list(range(12))[slice(*part)]
    assert len(decoded) == len(read)
    for number, values in read.items():
        np.testing.assert_array_equal(values, frames[number])
    np.testing.assert_array_equal(list(reader.frames(3, 5))[1].values, frames[4])


@pytest.mark.parametrize(
    ("name", "codec"),
    [("a.mts", "libx264"), ("a.mpg", "mpeg2video"), ("a.mp4", "libx264"), ("a.mkv", "libx264")],
)
def test_camcorder_files_are_read_from_any_frame(tmp_path, rng, name, codec):
    """Transport and program streams have no index: a seek lands between key frames."""
    still = rng.integers(0, 200, (48, 64, 3), dtype=np.uint8)
    options = {"g": "30", "keyint_min": "30", "sc_threshold": "0", "bf": "2"}
    container_format = {"a.mts": "mpegts", "a.mpg": "vob"}.get(name)
    with av.open(str(tmp_path / name), "w", format=container_format) as container:
        stream = container.add_stream(codec, rate=25, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for k in range(100):
            picture = np.roll(still, k, axis=1) + np.uint8(k // 2)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    whole = [frame.values for frame in open_capture(tmp_path / name).encoded_frames()]
    assert len(whole) == 100
    for start in (1, 28, 29, 30, 31, 61, 95):
        for frame in open_capture(tmp_path / name).encoded_frames(start, start + 3):
            np.testing.assert_array_equal(frame.values, whole[frame.number])
