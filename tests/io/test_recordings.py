"""Recordings: a topic comes in as it was filmed, and what is written reads back with its own library."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer as PlainWriter
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer
from rerun.chunk import RrdReader

import vntoolkit as vt
from vntoolkit.errors import BadCapture
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.io.footage.mosaics import rgb_from_mosaic
from vntoolkit.io.recordings.mcap_messages import _DEFINITIONS, write_mcap
from vntoolkit.io.recordings.recorded import RecordedFrame, Stamp
from vntoolkit.io.recordings.rerun_file import write_rrd
from vntoolkit.options.footage import Bayer

IMAGE = _DEFINITIONS["sensor_msgs/msg/Image"]
COMPRESSED = "std_msgs/Header header\nstring format\nuint8[] data\n" + IMAGE[IMAGE.index("=") :]
TIMES_NS = [1_790_000_000_000_000_123, 1_790_000_000_040_000_000, 1_790_000_000_100_000_000]


def fields(values: np.ndarray, encoding: str, filmed_ns: int = 5, padding: int = 0, **changed) -> dict:
    rows = values.reshape(len(values), -1).view(np.uint8)
    rows = np.pad(rows, [(0, 0), (0, padding)], constant_values=99)
    header = {"stamp": {"sec": filmed_ns // 10**9, "nanosec": filmed_ns % 10**9}, "frame_id": "gel"}
    image = {"header": header, "height": values.shape[0], "width": values.shape[1], "encoding": encoding}
    image |= {"is_bigendian": int(values.dtype.byteorder == ">"), "step": rows.shape[1]}
    return image | {"data": rows.ravel().tolist()} | changed


def recorded(path: Path, *messages: dict, topics: tuple[str, ...] = ("/gel/image_raw",)) -> Path:
    """The messages one after another, on all topics, each a picture later by ten levels."""
    with path.open("wb") as stream, Writer(stream) as writer:
        for topic in topics:
            for k, message in enumerate(messages):
                compressed = "format" in message
                schema = writer.register_msgdef(
                    f"sensor_msgs/msg/{'CompressedImage' if compressed else 'Image'}",
                    COMPRESSED if compressed else IMAGE,
                )
                writer.write_message(topic, schema, message, log_time=TIMES_NS[k], sequence=k)
    return path


def messages_of(path: Path) -> list:
    """Topic, log time and message of all that a recording holds, in order, by its own library."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [(c.topic, raw.log_time, message) for _, c, raw, message in reader.iter_decoded_messages()]


def test_every_encoding_comes_in_as_rgb(tmp_path: Path, rng: np.random.Generator) -> None:
    rgb = rng.integers(0, 256, (6, 8, 3)).astype(np.uint8)
    alpha = np.full((6, 8, 1), 255, np.uint8)
    deep = rgb.astype(np.uint16) * 257
    mosaic = rng.integers(0, 256, (6, 8)).astype(np.uint8)
    png = cv2.imencode(".png", rgb[..., ::-1])[1]
    header = fields(rgb, "rgb8")["header"]
    for k, (message, expected) in enumerate(
        [
            (fields(rgb, "rgb8", padding=5), rgb),
            (fields(rgb[..., ::-1].copy(), "bgr8"), rgb),
            (fields(np.concatenate([rgb[..., ::-1], alpha], axis=2), "bgra8"), rgb),
            (fields(deep, "rgb16"), deep),
            (fields(deep.astype(">u2"), "rgb16"), deep),
            (fields(mosaic, "bayer_grbg8"), rgb_from_mosaic(mosaic, Bayer.GRBG)),
            ({"header": header, "format": "rgb8; png compressed bgr8", "data": png.tolist()}, rgb),
        ]
    ):
        capture = vt.open_capture(recorded(tmp_path / f"{k}.mcap", message))
        np.testing.assert_array_equal(capture.encoded(0).values, expected)
        assert capture.info.bits == 8 * expected.dtype.itemsize


def test_the_times_of_a_topic_are_kept_and_any_frame_is_reached(tmp_path: Path) -> None:
    levels = [np.full((2, 3, 3), 10 * k, np.uint8) for k in range(3)]
    messages = [fields(level, "rgb8", filmed_ns=10**9 + k) for k, level in enumerate(levels)]
    path = recorded(tmp_path / "two.mcap", *messages, topics=("/left", "/right"))
    with pytest.raises(
        BadCapture, match=r"2 topics of pictures: /left, /right; name one, as two\.mcap:/left"
    ):
        vt.open_capture(path)
    capture = vt.open_capture(f"{path}:/right")
    assert capture.info.times_s == pytest.approx((0, 0.04 - 1.23e-7, 0.1 - 1.23e-7), abs=1e-9)
    assert [stamp.logged_ns for stamp in capture.stamps] == TIMES_NS
    assert capture.stamps[2] == Stamp(logged_ns=TIMES_NS[2], filmed_ns=10**9 + 2, frame_id="gel")
    for number in (2, 0, 1):
        assert capture.encoded(number).values.max() == 10 * number
    assert [frame.number for frame in capture.encoded_frames(0, None, 2)] == [0, 2]


@pytest.mark.parametrize(
    ("changed", "line"),
    [
        ({"encoding": "mono8"}, "is encoded as mono8, expected rgb8"),
        ({"data": [1, 2, 3]}, "holds 3 bytes in rows of 9, expected 2 rows of 9 or more"),
        ({"width": 0}, "states a size of 0×2"),
        ({"width": 10**5, "height": 10**5}, "more than the limit"),
        ({"format": "jpeg", "data": [1, 2]}, "its picture, jpeg, cannot be decoded; expected JPEG or PNG"),
    ],
)
def test_a_picture_that_is_not_read_is_one_line(tmp_path: Path, changed: dict, line: str) -> None:
    message = fields(np.zeros((2, 3, 3), np.uint8), "rgb8") | changed
    with pytest.raises(BadCapture, match=line):
        vt.open_capture(recorded(tmp_path / "a.mcap", message))


def test_a_recording_that_is_not_read_is_one_line(tmp_path: Path) -> None:
    whole = recorded(tmp_path / "a.mcap", *[fields(np.zeros((2, 3, 3), np.uint8), "rgb8")] * 2)
    content = whole.read_bytes()
    for name, wrong, line in (
        (
            "cut",
            content[:-40],
            "expected a whole MCAP recording, got .* run `mcap recover FILE",
        ),
        ("mark", content[:8], "expected a whole MCAP recording"),
        (
            "text",
            b"hello",
            "expected a whole MCAP recording, got a damaged one or another file",
        ),
        ("hole", content[:8] + bytes(len(content) - 60) + content[-52:], "expected a whole MCAP recording"),
    ):
        (tmp_path / f"{name}.mcap").write_bytes(wrong)
        with pytest.raises(BadCapture, match=line):
            vt.open_capture(tmp_path / f"{name}.mcap")
    with pytest.raises(BadCapture, match=r"topic /nope is not there, .*: /gel/image_raw"):
        vt.open_capture(f"{whole}:/nope")
    with (tmp_path / "none.mcap").open("wb") as stream:
        writer = PlainWriter(stream)
        writer.start()
        writer.finish()
    with pytest.raises(BadCapture, match="holds no topic of sensor_msgs/msg/Image"):
        vt.open_capture(tmp_path / "none.mcap")
    uneven = [fields(np.zeros(shape, np.uint8), "rgb8") for shape in ((2, 3, 3), (3, 2, 3))]
    with pytest.raises(BadCapture, match="is 2×3, the first one 3×2: a capture has one size"):
        list(vt.open_capture(recorded(tmp_path / "b.mcap", *uneven)).frames())


def frame_of(rng: np.random.Generator, number: int = 4) -> RecordedFrame:
    mask = rng.random((5, 7)) > 0.3
    return RecordedFrame(
        number=number,
        time_s=number / 16,
        stamp=Stamp(logged_ns=TIMES_NS[0], filmed_ns=TIMES_NS[1], frame_id="é"),
        picture=rng.integers(0, 256, (5, 7, 3)).astype(np.uint8),
        normals=NormalMap(
            normals_in_camera=np.tile(np.float32([0, 0, -1]), (5, 7, 1)),
            mask=mask,
            error_deg=np.full((5, 7), 2, np.float32),
        ),
        depth=DepthMap(depth=rng.normal(size=(5, 7)).astype(np.float32), mask=mask, unit=LengthUnit.METRE),
        contact=mask,
        contact_mm2=1.5,
        contact_depth_mm=0.25,
        moved_px=np.full((20, 7, 2), (0.5, -1.5), np.float32),
        mesh=Mesh(vertices=rng.normal(size=(3, 3)), faces=np.array([[0, 1, 2]], np.int32)),
        object_from_first=RigidTransform.from_rotation_vector((0.1, 0.2, 0.3), (1, 2, 3)),
    )


def test_messages_read_back_as_they_were_written(tmp_path: Path, rng: np.random.Generator) -> None:
    frame = frame_of(rng)
    assert write_mcap(tmp_path / "a.mcap", [frame]) == 1
    found = messages_of(tmp_path / "a.mcap")
    assert {time for _, time, _ in found} == {TIMES_NS[0]}
    read = {topic: message for topic, _, message in found}
    message = read["/vntoolkit/depth"]
    assert (message.height, message.width, message.encoding, message.step) == (5, 7, "32FC1", 28)
    assert (message.header.frame_id, message.header.stamp.sec) == ("é", TIMES_NS[1] // 10**9)
    values = np.frombuffer(message.data, "<f4").reshape(5, 7)
    np.testing.assert_array_equal(values, np.where(frame.depth.mask, frame.depth.depth, np.nan))
    contact = np.frombuffer(read["/vntoolkit/contact"].data, np.uint8).reshape(5, 7)
    np.testing.assert_array_equal(contact == 255, frame.contact)
    assert read["/vntoolkit/contact_mm2"].data == 1.5
    assert read["/vntoolkit/contact_depth_mm"].data == 0.25
    normals = np.frombuffer(read["/vntoolkit/normals"].data, "<f4").reshape(5, 7, 3)
    np.testing.assert_array_equal(normals, frame.normals.normals_in_camera)


def test_a_recording_for_rerun_holds_all_of_a_frame_on_one_timeline(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    frames = [frame_of(rng, number) for number in (4, 6)]
    assert write_rrd(tmp_path / "a.rrd", frames) == 2
    rows: dict[str, dict[int, dict]] = {}
    for chunk in RrdReader(tmp_path / "a.rrd").stream():
        columns = chunk.to_record_batch().to_pydict()
        for k, number in enumerate(columns.get("frame", [])):
            row = {name: values[k] for name, values in columns.items() if values[k] is not None}
            rows.setdefault(chunk.entity_path, {})[number] = row
    assert set(rows) == {
        "/picture", "/picture/motion", "/normals", "/error_deg", "/depth", "/contact", "/contact_mm2",
        "/contact_depth_mm", "/surface", "/object",
    }  # fmt: skip
    for frame in frames:
        mine = {name[1:]: row[frame.number] for name, row in rows.items()}
        assert all(row["time"].total_seconds() == frame.time_s for row in mine.values())
        depth = np.frombuffer(bytes(mine["depth"]["DepthImage:buffer"][0]), np.float32).reshape(5, 7)
        np.testing.assert_array_equal(depth, np.where(frame.depth.mask, frame.depth.depth, np.nan))
        assert mine["depth"]["DepthImage:meter"] == [1.0]
        contact = np.array(mine["contact"]["SegmentationImage:buffer"][0], np.uint8).reshape(5, 7)
        np.testing.assert_array_equal(contact, frame.contact)
        vertices = np.array(mine["surface"]["Mesh3D:vertex_positions"], np.float32)
        np.testing.assert_allclose(vertices, frame.mesh.vertices, rtol=1e-6)
        assert mine["object"]["Transform3D:translation"] == [[1, 2, 3]]
        columnwise = np.array(mine["object"]["Transform3D:mat3x3"][0]).reshape(3, 3).T
        np.testing.assert_allclose(columnwise, frame.object_from_first.rotation, atol=1e-6)
        assert mine["picture/motion"]["Arrows2D:vectors"] == [[0.5, -1.5]] * 2
        assert mine["contact_mm2"]["Scalars:scalars"] == [1.5]
        normals = np.array(mine["normals"]["Image:buffer"][0], np.uint8).reshape(5, 7, 3)
        assert {tuple(n) for n in normals[frame.normals.mask].tolist()} == {(128, 128, 255)}
    assert "Mesh3D:triangle_indices" in rows["/surface"][4]
    assert "Mesh3D:triangle_indices" not in rows["/surface"][6]  # they stay
