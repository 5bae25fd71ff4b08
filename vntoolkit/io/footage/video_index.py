"""The frames of a video by its packets alone: when each is shown, how many are lost, which are damaged."""

import logging
import re
import zlib
from bisect import bisect_right
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from vntoolkit.arrays import ByteArray
from vntoolkit.errors import BadCapture

_MOST_REORDERED = 16  # frames that H.264 and HEVC may hold back
_FOOTER_BYTES = 8
_BITS_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class VideoIndex:
    """When each frame is shown, in time base ticks, ascending; and how many the file promises.

    damaged: numbers of the frames whose checksum is wrong, and of those that build on one. key_frames:
    numbers of the frames from which decoding can start, ascending. is_in_order: frames are stored as they are
    shown, and their times do not tell one from another. unusable_times: what is wrong with the stated times,
    in words; they are replaced by 0, 1, 2, …
    """

    times: tuple[int, ...]
    promised: int
    damaged: frozenset[int] = frozenset()
    key_frames: tuple[int, ...] = (0,)
    is_in_order: bool = False
    unusable_times: str = ""

    def key_frame_before(self, number: int) -> int:
        """Return the last key frame that is not after frame `number`; 0 where there is none."""
        at = bisect_right(self.key_frames, number)
        return self.key_frames[at - 1] if at else 0


# Of each packet: its time, whether it is a key frame, and what `check_slices` returns, None for no check.
_Packets: TypeAlias = "list[tuple[int, bool, tuple[int, bool] | None]]"


def index_of_stream(container: Any, stream: Any, name: str, *, has_checksums: bool) -> VideoIndex:
    """Index an opened video. has_checksums: the codec is FFV1, whose slices may carry them."""
    packets: _Packets = []
    broken = 0
    latest_s = 0.0  # that any stream reaches
    try:
        for packet in container.demux():
            if packet.pts is not None and packet.time_base:
                latest_s = max(latest_s, float((packet.pts + (packet.duration or 0)) * packet.time_base))
            if packet.stream_index != stream.index:
                continue
            if packet.pts is not None and not packet.is_corrupt and not packet.is_discard:
                check = check_slices(packet) if has_checksums else None
                packets.append((packet.pts, packet.is_keyframe, check))
            broken += packet.is_corrupt
    except av_errors() as error:
        _logger.debug("%s: demuxing ended early: %s", name, error)
        broken += 1
    if not packets:
        raise BadCapture(f"{name}: the video holds no frame")
    unusable = _wrong_with_times(packets)
    if unusable:
        times = list(range(len(packets)))
        missing = max(0, _declared_count(stream) - len(times))
    else:
        packets.sort(key=lambda frame: frame[0])
        times = [time for time, _, _ in packets]
        missing = _missing_frames(container, stream, times, latest_s)
    if (missing or broken) and not unusable and stream.codec_context.has_b_frames:
        whole = _frames_before_gap(times)
        del packets[whole:], times[whole:]
        missing = _missing_frames(container, stream, times, latest_s)
    # that a file carries checksums at all is read off the first right one: by chance there is none
    is_checked = any(check is not None and check[0] for _, _, check in packets)
    return VideoIndex(
        times=tuple(times),
        promised=len(times) + max(missing, broken),
        damaged=_damaged_frames(packets) if is_checked else frozenset(),
        key_frames=(0,) if unusable else tuple(k for k, (_, is_key, _) in enumerate(packets) if is_key),
        is_in_order=bool(unusable),
        unusable_times=unusable,
    )


def _wrong_with_times(packets: _Packets) -> str:
    """Return what keeps the stated times from telling the frames' order; empty for nothing.

    Frames that build on later ones are stored before these, so falling times count only where none does.
    """
    times = [time for time, _, _ in packets]
    if len(set(times)) == 1 < len(times):
        return f"the file gives all {len(times)} frames one time"
    if len(set(times)) < len(times):
        return f"the file gives {len(times) - len(set(times))} of {len(times)} frames the time of another"
    if times != sorted(times) and all(is_key for _, is_key, _ in packets):
        return "the file's times fall from one frame to the next"
    return ""


def _damaged_frames(packets: _Packets) -> frozenset[int]:
    """Return the damaged frames and, up to the next key frame, those after them."""
    damaged: set[int] = set()
    spoilt = False
    for number, (_, is_key, check) in enumerate(packets):
        bad = check is not None and check[1]
        spoilt = bad or (spoilt and not is_key)
        if spoilt:
            damaged.add(number)
    return frozenset(damaged)


def _missing_frames(container: Any, stream: Any, times: list[int], latest_s: float) -> int:
    """Return how many frames the header promises beyond those in `times`; 0 where it says nothing.

    Matroska gives no count but durations: the tags of mkvmerge and FFmpeg give the stream's; the container's
    is the longest of its streams', so it counts only where no stream reaches it. latest_s: the end of the
    last packet of any stream. Time is compared, not rate × duration: the rate may vary.
    """
    declared = _declared_count(stream)
    if declared:
        # frames that an edit list hides are counted, too, but not in the duration
        end = (stream.start_time or 0) + (stream.duration or np.inf)
        reaches = len(times) > 1 and times[-1] + 1.5 * np.median(np.diff(times)) >= end
        return 0 if reaches and _frames_before_gap(times) == len(times) else max(0, declared - len(times))
    rate = stream.average_rate or stream.guessed_rate
    if not (rate and times):
        return 0
    start_s, end_s = 0.0, _seconds_from_tag(stream.metadata.get("DURATION", ""))
    if end_s is None:
        if not container.duration:
            return 0
        start_s = max(0, container.start_time or 0) / 1e6
        end_s = start_s + container.duration / 1e6
        if len(container.streams) > 1 and latest_s > end_s - 0.5 / float(rate):
            return 0
    last_end_s = float(times[-1] * stream.time_base) + 1 / float(rate)
    return max(0, round((end_s - last_end_s) * float(rate)))


def _declared_count(stream: Any) -> int:
    """Return the number of frames that the header states; 0 for none."""
    stated = stream.metadata.get("NUMBER_OF_FRAMES", "")
    return int(stream.frames) or (int(stated) if stated.isdecimal() else 0)


def _seconds_from_tag(text: str) -> float | None:
    """Parse Matroska's `00:01:02.345000000`; None for any other text."""
    found = re.fullmatch(r"(\d+):(\d+):(\d+(?:\.\d+)?)", text.strip())
    return None if found is None else 3600 * int(found[1]) + 60 * int(found[2]) + float(found[3])


def _frames_before_gap(times: list[int]) -> int:
    """Return how many frames come before a gap in a cut-off tail: some are stored before earlier ones."""
    steps = np.diff(times)
    wide = np.flatnonzero(steps > 1.5 * np.median(steps)) if len(steps) else steps
    tail = wide[wide >= len(times) - _MOST_REORDERED]
    return int(tail[0]) + 1 if len(tail) else len(times)


# Damage in FFV1 video, found by the checksum that each slice of a frame carries (RFC 9043,
# niedermayer2021).


def check_slices(packet: bytes | ByteArray) -> tuple[int, bool]:
    """Return the slices with a right checksum, and whether a packet that carries them holds a changed byte.

    The slices of one frame are walked from the last to the first, as if each carried a checksum. A frame
    without checksums has no sound slice (but by one chance in 2**32).
    """
    data = bytes(packet)
    slices, sound, end = 0, 0, len(data)
    while end > _FOOTER_BYTES:
        size = int.from_bytes(data[end - 8 : end - 5], "big")
        start = end - _FOOTER_BYTES - size
        if start < 0:
            break
        slices += 1
        sound += zlib.crc32(data[start:end].translate(_BITS_REVERSED), 0xFFFFFFFF) == 0xFFFFFFFF
        end = start
    return sound, end > 0 or sound < slices


def av_errors() -> tuple[type[Exception], ...]:
    """Return what PyAV raises; it is imported only when asked for."""
    import av

    return (av.error.FFmpegError, OSError, EOFError)
