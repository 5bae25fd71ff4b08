"""One pass over the packets of a video, undecoded: when each frame is shown, how many, which are damaged."""

from __future__ import annotations

import logging
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Any

from vntoolkit.errors import BadCapture
from vntoolkit.io.ffmpeg import av_errors
from vntoolkit.io.ffv1 import SliceCheck, check_slices

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class VideoIndex:
    """When each frame is shown, in time base ticks, ascending; and how many the file promises.

    damaged: numbers of the frames whose checksum is wrong, and of those that build on one. key_frames:
    numbers of the frames from which decoding can start, ascending.
    """

    times: tuple[int, ...]
    promised: int
    damaged: frozenset[int] = frozenset()
    key_frames: tuple[int, ...] = (0,)

    def key_frame_before(self, number: int) -> int:
        """Return the last key frame that is not after frame `number`; 0 where there is none."""
        at = bisect_right(self.key_frames, number)
        return self.key_frames[at - 1] if at else 0

    def nearest_key_frame(self, number: int) -> int:
        """Return the key frame closest to frame `number`, the earlier of two; 0 where there is none."""
        return min(self.key_frames, key=lambda key: abs(key - number), default=0)


@dataclass(kw_only=True)
class _Packets:
    """What was met on the way: (time, key frame, check or None) of each, and how many were unreadable."""

    frames: list[tuple[int, bool, SliceCheck | None]] = field(default_factory=list)
    broken: int = 0


def index_of_stream(container: Any, stream: Any, name: str, *, has_checksums: bool) -> VideoIndex:
    """Index an opened video. has_checksums: the codec is FFV1, whose slices may carry them."""
    packets = _Packets()
    try:
        for packet in container.demux(stream):
            if packet.pts is not None and not packet.is_corrupt and not packet.is_discard:
                check = check_slices(packet) if has_checksums else None
                packets.frames.append((packet.pts, packet.is_keyframe, check))
            packets.broken += packet.is_corrupt
    except av_errors() as error:
        _logger.debug("%s: demuxing ended early: %s", name, error)
        packets.broken += 1
    packets.frames.sort(key=lambda frame: frame[0])
    times = [time for time, _, _ in packets.frames]
    if not times:
        raise BadCapture(f"{name}: the video holds no frame")
    missing = _missing_frames(container, stream, times)
    # that a file carries checksums at all is read off the first right one: by chance there is none
    is_checked = any(check is not None and check.sound for _, _, check in packets.frames)
    return VideoIndex(
        times=tuple(times),
        promised=len(times) + max(missing, packets.broken),
        damaged=_damaged_frames(packets) if is_checked else frozenset(),
        key_frames=tuple(number for number, (_, is_key, _) in enumerate(packets.frames) if is_key),
    )


def _damaged_frames(packets: _Packets) -> frozenset[int]:
    """Return the damaged frames and, up to the next key frame, those after them."""
    damaged: set[int] = set()
    spoilt = False
    for number, (_, is_key, check) in enumerate(packets.frames):
        bad = check is not None and check.is_damaged
        spoilt = bad or (spoilt and not is_key)
        if spoilt:
            damaged.add(number)
    return frozenset(damaged)


def _missing_frames(container: Any, stream: Any, times: list[int]) -> int:
    """Return how many frames the header promises beyond those in `times`; 0 where it says nothing.

    Matroska gives no count but a duration; the container's is the longest of its streams', so it counts only
    for a file with one stream. Time is compared, not rate × duration: the rate may vary.
    """
    if stream.frames:
        return max(0, int(stream.frames) - len(times))
    rate = stream.average_rate or stream.guessed_rate
    if not (container.duration and rate and times and len(container.streams) == 1):
        return 0
    start_s = max(0, container.start_time or 0) / 1e6
    last_end_s = float(times[-1] * stream.time_base) + 1 / float(rate)
    return max(0, round((start_s + container.duration / 1e6 - last_end_s) * float(rate)))
