"""Videos that are none, or change on the way, are refused by one line."""

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from vntoolkit.errors import BadCapture
from vntoolkit.io.footage.captures import CaptureOptions, open_capture


def _video(path: Path, sizes, codec="mjpeg") -> Path:
    """Motion JPEG whose frames have these sizes: each is a picture of its own."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = *sizes[0], "yuvj420p"
        for number, (width, height) in enumerate(sizes):
            ok, jpeg = cv2.imencode(".jpg", np.full((height, width, 3), 90 + number, np.uint8))
            assert ok
            packet = av.Packet(jpeg.tobytes())
            packet.stream, packet.pts, packet.dts, packet.is_keyframe = stream, number, number, True
            packet.time_base = Fraction(1, 30)
            container.mux(packet)
    return path


def test_a_video_whose_frames_change_their_size(tmp_path):
    capture = open_capture(_video(tmp_path / "a.mov", [(32, 24), (32, 24), (48, 32)]), CaptureOptions())
    with pytest.raises(BadCapture, match="frame 2 is 48×32, the first one 32×24: a capture has one size"):
        list(capture.frames())


def test_a_file_of_sound_alone_is_no_capture(tmp_path):
    import av

    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
    with pytest.raises(BadCapture, match="holds no video stream"):
        open_capture(tmp_path / "a.mkv")


def test_a_video_without_frames(tmp_path):
    import av

    with av.open(str(tmp_path / "a.avi"), "w") as container:
        stream = container.add_stream("rawvideo", rate=30)
        stream.width, stream.height, stream.pix_fmt = 32, 24, "rgb24"
        container.start_encoding()
    with pytest.raises(BadCapture, match=r"holds no frame|no frame can be decoded|cannot be opened"):
        open_capture(tmp_path / "a.avi")


@pytest.mark.parametrize("named", ["film.ts", "../film.ts", "/{folder}/film.ts"])
@pytest.mark.parametrize("suffix", [".m3u8", ".ffconcat", ".mkv"])
@pytest.mark.parametrize("kind", ["hls", "concat"])
def test_a_list_of_other_files_is_no_capture(tmp_path, kind, suffix, named):
    import av

    folder = tmp_path / "in"
    folder.mkdir()
    for place in (folder, tmp_path):
        with av.open(str(place / "film.ts"), "w", format="mpegts") as container:
            stream = container.add_stream("mpeg2video", rate=25)
            stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
            for frame in (av.VideoFrame(64, 48, "yuv420p"), None):
                container.mux(stream.encode(frame))
    film = named.format(folder=tmp_path)
    texts = {
        "hls": f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:0.04,\n{film}\n#EXT-X-ENDLIST\n",
        "concat": f"ffconcat version 1.0\nfile {film}\n",
    }
    (folder / f"list{suffix}").write_text(texts[kind])
    assert open_capture(folder / "film.ts").info.frame_count == 1
    with pytest.raises(BadCapture, match="a list of other files, of which each is to be given itself"):
        open_capture(folder / f"list{suffix}")
