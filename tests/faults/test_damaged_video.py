"""A flipped bit anywhere in the frames of a video is found, and the frame that holds it is named."""

import re

import av
import numpy as np
import pytest

from tests.io.footage.test_stated_facts import film
from vntoolkit.errors import BadCapture
from vntoolkit.io.footage.video import VideoReader, write_video
from vntoolkit.io.footage.video_index import check_slices


@pytest.fixture
def frames(rng) -> list[np.ndarray]:
    return [rng.integers(0, 255, (24, 32, 3), dtype=np.uint8) for _ in range(30)]


def _write_in_groups(path, frames) -> None:
    """Write FFV1 with a key frame every twelve, as FFmpeg does unless it is told otherwise."""
    film(path, frames, context={"gop_size": 12}, level="3", slicecrc="1")


def _packets(path) -> list[tuple[int, int, bool]]:
    with av.open(str(path)) as container:
        packets = [p for p in container.demux(container.streams.video[0]) if p.size]
        return [(p.pos, p.size, p.is_keyframe) for p in packets]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_every_flipped_bit_in_the_frames_is_found(tmp_path, rng, frames, dtype):
    path = tmp_path / "a.mkv"
    write_video(path, [frame.astype(dtype) for frame in frames], 30)
    good = path.read_bytes()
    packets = _packets(path)
    for _ in range(40):
        number = int(rng.integers(len(packets)))
        position, size, _ = packets[number]
        at = position + 12 + int(rng.integers(size - 12))  # behind Matroska's own head of the block
        path.write_bytes(good[:at] + bytes([good[at] ^ 1 << int(rng.integers(8))]) + good[at + 1 :])
        with pytest.raises(BadCapture, match=f"frame {number} of 30 is damaged") as caught:
            list(VideoReader(path).frames())
        assert "--frames" in str(caught.value)


def test_frames_before_the_damage_and_after_the_next_key_frame_are_as_written(tmp_path, frames):
    path = tmp_path / "a.mkv"
    _write_in_groups(path, frames)
    packets = _packets(path)
    keys = [number for number, (_, _, is_key) in enumerate(packets) if is_key]
    assert keys == [0, 12, 24]
    content = bytearray(path.read_bytes())
    content[packets[14][0] + packets[14][1] // 2] ^= 16
    path.write_bytes(content)
    reader = VideoReader(path)
    assert reader.index.damaged == frozenset(range(14, 24))
    for start, stop in ((0, 14), (24, 30)):
        for frame in reader.frames(start, stop):
            assert np.array_equal(frame.values, frames[frame.number])
    with pytest.raises(BadCapture, match=re.escape("frame 20 of 30 is damaged: its checksum is wrong")):
        list(reader.frames(20, 21))


def test_damage_in_a_video_of_ours_costs_one_frame(tmp_path, frames):
    path = tmp_path / "a.mkv"
    write_video(path, frames, 30)
    position, size, _ = _packets(path)[14]
    content = bytearray(path.read_bytes())
    content[position + size // 2] ^= 16
    path.write_bytes(content)
    reader = VideoReader(path)
    assert reader.index.damaged == frozenset({14})
    for start, stop in ((0, 14), (15, 30)):
        for frame in reader.frames(start, stop):
            assert np.array_equal(frame.values, frames[frame.number])


def test_a_video_without_checksums_is_read(tmp_path, frames):
    """Level 1 of FFV1, and level 3 written without them, cannot be checked and are not refused."""
    for options in ({"level": "1"}, {"level": "3", "slices": "4", "slicecrc": "0"}):
        path = tmp_path / f"{options['level']}.mkv"
        film(path, frames, **options)
        read = [frame.values for frame in VideoReader(path).frames()]
        assert np.array_equal(read, frames)


def test_no_packet_of_noise_passes_for_a_sound_one(rng):
    for _ in range(200):
        noise = rng.integers(0, 256, int(rng.integers(0, 400)), dtype=np.uint8)
        assert check_slices(noise)[0] == 0
