"""Depth and contact as messages of ROS 2 in an MCAP file, at the times of the pictures that they are of.

Topics: `/vntoolkit/depth` (sensor_msgs/msg/Image, 32FC1, NaN where nothing is known), `/vntoolkit/normals`
(32FC3, camera frame), and of a gel `/vntoolkit/contact` (mono8, 255 in contact), `/vntoolkit/contact_mm2`
and `/vntoolkit/contact_depth_mm` (std_msgs/msg/Float64). The fields of a message follow each other in
little-endian CDR, each aligned to its own size after the four bytes of the encapsulation.
"""

import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Array
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.recordings.recorded import RecordedFrame, Stamp
from vntoolkit.libraries import require_installed

_NS = 1_000_000_000
_ENCAPSULATION = b"\0\x01\0\0"  # little-endian CDR
_BAR = "=" * 80
_IMAGE = f"""std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
{_BAR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_BAR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_DEFINITIONS = {"sensor_msgs/msg/Image": _IMAGE, "std_msgs/msg/Float64": "float64 data\n"}


def write_mcap(path: Path | str, frames: Iterable[RecordedFrame]) -> int:
    """Write the depth, normals and contact of frames, in order; atomically. Returns their number."""
    require_installed("mcap", "'vntoolkit[mcap]'", "MCAP recordings are written by mcap")
    from mcap.writer import Writer

    count = 0
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="vntoolkit")
        schemas = {
            name: writer.register_schema(name, "ros2msg", text.encode())
            for name, text in _DEFINITIONS.items()
        }
        channels: dict[str, int] = {}
        for frame in frames:
            for topic, schema, data in _messages(frame):
                if topic not in channels:
                    channels[topic] = writer.register_channel(topic, "cdr", schemas[schema])
                writer.add_message(
                    channel_id=channels[topic],
                    log_time=frame.stamp.logged_ns,
                    publish_time=frame.stamp.logged_ns,
                    sequence=frame.number,
                    data=data,
                )
            count += 1
        writer.finish()
    return count


def _messages(frame: RecordedFrame) -> Iterable[tuple[str, str, bytes]]:
    """Topic, schema and bytes of each message of a frame."""
    image, number = "sensor_msgs/msg/Image", "std_msgs/msg/Float64"
    normals = frame.normals.normals_in_camera.astype("<f4")
    yield "/vntoolkit/normals", image, image_message(frame.stamp, "32FC3", normals)
    if frame.depth is not None:
        depth = np.where(frame.depth.mask, frame.depth.depth, np.nan).astype("<f4")
        yield "/vntoolkit/depth", image, image_message(frame.stamp, "32FC1", depth)
    if frame.contact is not None:
        contact = frame.contact.astype(np.uint8) * np.uint8(255)
        yield "/vntoolkit/contact", image, image_message(frame.stamp, "mono8", contact)
    for name in ("contact_mm2", "contact_depth_mm"):
        if (value := getattr(frame, name)) is not None:
            yield f"/vntoolkit/{name}", number, _ENCAPSULATION + struct.pack("<d", value)


def image_message(stamp: Stamp, encoding: str, values: Array) -> bytes:
    """Return sensor_msgs/msg/Image of values (h, w, …), already in the encoding's type."""
    height, width = values.shape[:2]
    body = bytearray(struct.pack("<iI", *divmod(stamp.filmed_ns, _NS)))
    _put_string(body, stamp.frame_id)
    _put_number(body, height)
    _put_number(body, width)
    _put_string(body, encoding)
    body += b"\0"  # little-endian
    _put_number(body, values.strides[0])
    _put_number(body, values.nbytes)
    return _ENCAPSULATION + bytes(body) + values.tobytes()


def _put_number(body: bytearray, value: int) -> None:
    body += bytes(-len(body) % 4) + struct.pack("<I", value)


def _put_string(body: bytearray, text: str) -> None:
    encoded = text.encode() + b"\0"
    _put_number(body, len(encoded))
    body += encoded
