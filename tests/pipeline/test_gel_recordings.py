"""A gel's recording from end to end: pictures come as messages, and depth and contact go out so."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import vntoolkit as vt
from tests.drawn_gel import picture
from tests.io.test_recordings import IMAGE, messages_of
from tests.pipeline.test_gel import rig_file, untouched
from vntoolkit.__main__ import main
from vntoolkit.io.recordings.mcap_messages import image_message
from vntoolkit.io.recordings.recorded import Stamp

__all__ = ["rig_file", "untouched"]
START_NS, STEPS_NS = 1_790_000_000_000_000_000, (0, 41_000_000, 79_000_000)


@pytest.fixture
def recording(tmp_path: Path, rng: np.random.Generator) -> Path:
    """Three touches of a gel at uneven times."""
    from mcap.writer import Writer

    with (tmp_path / "touch.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", IMAGE.encode())
        channel = writer.register_channel("/gel/image_raw", "cdr", schema)
        for step in STEPS_NS:
            stamp = Stamp(logged_ns=START_NS + step, filmed_ns=START_NS + step - 7, frame_id="gel")
            data = image_message(stamp, "rgb8", picture(rng, 60, 90, 18))
            writer.add_message(channel, log_time=stamp.logged_ns, publish_time=0, data=data)
        writer.finish()
    return tmp_path / "touch.mcap"


def test_depth_and_contact_stand_beside_a_recording_at_its_times(
    rig_file: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, touch = recording.parent / "out", f"{recording}:/gel/image_raw"
    files = f"{touch} --rig {rig_file} --background {rig_file.parent}/background.png"
    assert main(f"reconstruct {files} --to depth --out {out}".split()) == 0
    assert main(f"export {out} --to mcap --out {recording.parent}/depth.mcap".split()) == 0
    found = messages_of(recording.parent / "depth.mcap")
    areas = [(time, message.data) for topic, time, message in found if topic == "/vntoolkit/contact_mm2"]
    assert [time - START_NS for time, _ in areas] == list(STEPS_NS)
    gel = vt.Gel.read(rig_file, rig_file.parent / "background.png")
    touches = [gel(frame.values) for frame in vt.open_capture(touch).encoded_frames()]
    assert [area for _, area in areas] == pytest.approx([touch.area_mm2 for touch in touches], abs=1e-3)
    depths = [message for topic, _, message in found if topic == "/vntoolkit/depth"]
    first = depths[0].header
    assert (first.stamp.sec, first.stamp.nanosec, first.frame_id) == (1_789_999_999, 999_999_993, "gel")
    depth_mm = 1000 * np.frombuffer(depths[0].data, "<f4").reshape(touches[0].depth_mm.shape)
    known = np.isfinite(depth_mm)
    np.testing.assert_allclose(depth_mm[known], touches[0].depth_mm[known], atol=1e-3)
    assert main(f"export {out} --to rrd".split()) == 0
    assert f"next: rerun {out}/export/surface.rrd" in capsys.readouterr().out


def test_the_node_publishes_what_touches_the_gel(rig_file: Path, rng: np.random.Generator) -> None:
    path = Path(__file__).parents[2] / "examples" / "ros2_gel.py"
    spec = importlib.util.spec_from_file_location("ros2_gel", path)
    node = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(node)
    gel = vt.Gel.read(rig_file, rig_file.parent / "background.png")
    published: dict[str, SimpleNamespace] = {}
    warnings: list[str] = []
    topics = node.GelTopics(gel, published.__setitem__, warnings.append)
    frame = picture(rng, 60, 90, 18)
    message = SimpleNamespace(
        header="the header", height=frame.shape[0], width=frame.shape[1], encoding="bgr8", is_bigendian=0,
        step=frame.strides[0], data=frame[..., ::-1].tobytes(),
    )  # fmt: skip
    topics.on_image(message)
    assert set(published) == set(node.TOPICS)
    touch = gel(frame)
    depth = published["depth"]
    assert (depth.header, depth.encoding, depth.step) == ("the header", "32FC1", 4 * depth.width)
    values = np.frombuffer(depth.data, "<f4").reshape(depth.height, depth.width)
    np.testing.assert_allclose(values[touch.mask], touch.depth_mm[touch.mask], atol=1e-6)
    contact = np.frombuffer(published["contact"].data, np.uint8).reshape(depth.height, depth.width)
    np.testing.assert_array_equal(contact == 255, touch.contact)
    assert published["contact_mm2"].data == pytest.approx(touch.area_mm2)
    assert published["contact_depth_mm"].data == pytest.approx(touch.deepest_mm)
    published.clear()
    message.encoding = "mono8"
    topics.on_image(message)
    assert not published
    assert "is encoded as mono8" in warnings[0]
