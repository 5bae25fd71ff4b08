"""A camera's topic of an MCAP recording, read as the frames of a capture.

The messages are sensor_msgs/msg/Image and CompressedImage of ROS 2. They are counted in the order of their
log times, which are kept.
"""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

from vntoolkit.arrays import Array
from vntoolkit.errors import BadCapture
from vntoolkit.io.files import require_file
from vntoolkit.io.footage.captures import CaptureInfo, CaptureOptions
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.sequence import CaptureKind
from vntoolkit.io.footage.stated import require_as_first
from vntoolkit.io.recordings.recorded import Stamp
from vntoolkit.io.recordings.ros_pictures import rgb_from_message
from vntoolkit.libraries import require_installed

_SCHEMAS = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_NS = 1_000_000_000


class RecordingReader:
    """Frames of one topic of a recording, uint8 or uint16. Raises `BadCapture`."""

    def __init__(self, path: Path, topic: str, options: CaptureOptions) -> None:
        require_installed("mcap_ros2", "'vntoolkit[mcap]'", "MCAP recordings are read by mcap-ros2-support")
        self.path = require_file(path, BadCapture)
        self._options = options
        self.topic = self._camera_topic(topic)
        first = next(self._messages(0), None)
        if first is None:
            raise BadCapture(f"{path}: topic {self.topic} holds no message")
        self._first = first[1]

    @cached_property
    def info(self) -> CaptureInfo:
        """What the topic holds."""
        picture, count, rate_hz = self._rgb(self._first, 0), len(self.stamps), self._options.frame_rate_hz
        stored = str(getattr(self._first, "format", ""))  # of a compressed picture
        encoding = stored or str(self._first.encoding)
        times = tuple((stamp.logged_ns - self.stamps[0].logged_ns) / _NS for stamp in self.stamps)
        are_apart = len(set(times)) == count
        measured_hz = (count - 1) / times[-1] if are_apart and count > 1 else None
        return CaptureInfo(
            kind=CaptureKind.VIDEO,
            width=picture.shape[1],
            height=picture.shape[0],
            frame_count=count,
            frame_rate_hz=rate_hz or measured_hz,
            pixel_format=encoding,
            bits=8 * picture.dtype.itemsize,
            codec=("PNG" if "png" in stored.lower() else "JPEG") if stored else "rawvideo",
            chroma="Bayer" if encoding.startswith("bayer") else "4:4:4",
            files=(self.path,),
            promised_frame_count=count,
            times_s=times if are_apart and rate_hz is None else (),
            unusable_times="" if are_apart else "two of its pictures were logged at one time",
        )

    @cached_property
    def stamps(self) -> tuple[Stamp, ...]:
        """When each frame was filmed."""
        return tuple(stamp for stamp, _ in self._messages(0))

    def nearest_key_frame(self, number: int) -> int:
        """Return the frame itself: each is stored whole."""
        return number

    def frames(self, start: int = 0, stop: int | None = None, step: int = 1) -> Iterator[EncodedFrame]:
        """Yield the frames start, start + step, … below stop."""
        wanted = range(start, stop if stop is not None else 1 << 62, step)
        for number, (_, message) in enumerate(self._messages(start), start):
            if number >= wanted.stop:
                return
            if number in wanted:
                values, name = self._rgb(message, number), f"{self.path}, frame {number}"
                yield EncodedFrame(values=values, bits=self.info.bits, number=number, name=name)

    def _messages(self, start: int) -> Iterator[tuple[Stamp, Any]]:
        """The messages of the frames from `start` on, read from their time on."""
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory

        since = self.stamps[start].logged_ns if start else None
        same = sum(stamp.logged_ns == since for stamp in self.stamps[:start]) if start else 0
        try:
            with self.path.open("rb") as stream:
                reader = make_reader(stream, decoder_factories=[DecoderFactory()])
                found = reader.iter_decoded_messages(topics=self.topic, starting_at=since)
                for k, (_, _, raw, message) in enumerate(found):
                    if k >= same:
                        filmed = message.header.stamp
                        filmed_ns = filmed.sec * _NS + filmed.nanosec
                        frame_id = message.header.frame_id
                        yield Stamp(logged_ns=raw.log_time, filmed_ns=filmed_ns, frame_id=frame_id), message
        except Exception as error:  # whatever the parsers meet in a damaged file
            raise self._damaged(error) from error

    def _camera_topic(self, asked: str) -> str:
        from mcap.reader import make_reader

        try:
            with self.path.open("rb") as stream:
                summary = make_reader(stream).get_summary()
            assert summary is not None
            schemas = summary.schemas
            kinds = {c.topic: schemas[c.schema_id].name for c in summary.channels.values() if c.schema_id}
        except Exception as error:  # whatever the parsers meet in a damaged file
            raise self._damaged(error) from error
        cameras = sorted(topic for topic, kind in kinds.items() if kind in _SCHEMAS)
        if asked:
            if asked not in cameras:
                held = f"of {kinds[asked]}" if asked in kinds else "not there"
                raise BadCapture(
                    f"{self.path}: topic {asked} is {held}, expected one of {_SCHEMAS[0]} or CompressedImage"
                    f"{': ' + ', '.join(cameras) if cameras else ''}"
                )
            return asked
        if len(cameras) != 1:
            why = f"holds {len(cameras)} topics of pictures: {', '.join(cameras)}; name one"
            if not cameras:
                why = f"holds no topic of {_SCHEMAS[0]} or CompressedImage; name a recording with one"
            raise BadCapture(f"{self.path}: {why}, as {self.path.name}:{(cameras or ['/image_raw'])[0]}")
        return cameras[0]

    def _rgb(self, message: Any, number: int) -> Array:
        name = f"{self.path}, message {number} of {self.topic}"
        try:
            image = rgb_from_message(
                message, name, max_megapixels=self._options.max_megapixels, sensor=self._options.sensor
            )
        except AttributeError as error:  # a schema without a field of pictures
            raise self._damaged(error) from error
        if number:
            size, first = f"{image.shape[1]}×{image.shape[0]}", f"{self.info.width}×{self.info.height}"
            require_as_first(f"{name}: is", size, first, "size")
        return image

    def _damaged(self, reason: object) -> BadCapture:
        why = " ".join(str(reason).split()) or type(reason).__name__
        return BadCapture(
            f"{self.path}: expected a whole MCAP recording, got a damaged one or another file ({why:.80}); "
            "copy it again, or run `mcap recover FILE -o WHOLE.mcap` and give what it writes"
        )
