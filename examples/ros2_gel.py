"""A ROS 2 node around a tactile gel: pictures in, depth and contact out.

    python examples/ros2_gel.py gel.json gel.png --ros-args -r image_raw:=/gel/image_raw

gel.json is the rig of `vntoolkit calibrate presses`, gel.png the untouched gel. The node listens to
`image_raw` (sensor_msgs/Image) and publishes, with the picture's own header: `depth` (32FC1, millimetres, 0
at rest, negative in a dent, NaN where nothing is known), `contact` (mono8, 255 where something touches),
`contact_mm2` and `contact_depth_mm` (std_msgs/Float64). A picture that comes while the one before is
measured is dropped. Only `main` needs ROS.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

import vntoolkit as vt
from vntoolkit.io.recordings.ros_pictures import rgb_from_message

TOPICS = {"depth": "Image", "contact": "Image", "contact_mm2": "Float64", "contact_depth_mm": "Float64"}


class GelTopics:
    """What the node does with a message: any object with the fields of sensor_msgs/Image."""

    def __init__(self, gel: vt.Gel, publish: Callable[[str, Any], None], warn: Callable[[str], None]) -> None:
        """publish: takes a topic of `TOPICS` and the fields of its message. warn: takes a line."""
        self.gel, self.publish, self.warn = gel, publish, warn

    def on_image(self, message: Any) -> None:
        """Measure a picture and publish what touches the gel; a bad picture is one warning."""
        try:
            touch = self.gel(rgb_from_message(message, "image_raw"))
        except vt.VntError as problem:
            self.warn(str(problem))
            return
        depth = np.where(touch.mask, touch.depth_mm, np.nan).astype("<f4")
        contact = np.where(touch.contact, 255, 0).astype(np.uint8)
        self.publish("depth", image_fields(message.header, "32FC1", depth))
        self.publish("contact", image_fields(message.header, "mono8", contact))
        self.publish("contact_mm2", SimpleNamespace(data=float(touch.area_mm2)))
        self.publish("contact_depth_mm", SimpleNamespace(data=float(touch.deepest_mm)))


def image_fields(header: Any, encoding: str, values: np.ndarray) -> SimpleNamespace:
    """Fields of sensor_msgs/Image for values (h, w), already in the encoding's type."""
    height, width = values.shape
    return SimpleNamespace(
        header=header,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=values.strides[0],
        data=values.tobytes(),
    )


def main() -> None:
    """Run the node until it is stopped."""
    import rclpy
    from rclpy.utilities import remove_ros_args
    from sensor_msgs.msg import Image
    from std_msgs.msg import Float64

    kinds = {"Image": Image, "Float64": Float64}
    rig, background = remove_ros_args(sys.argv)[1:]
    rclpy.init()
    node = rclpy.create_node("vntoolkit_gel")
    publishers = {topic: node.create_publisher(kinds[kind], topic, 1) for topic, kind in TOPICS.items()}

    def publish(topic: str, fields: Any) -> None:
        message = kinds[TOPICS[topic]]()
        for name, value in vars(fields).items():
            setattr(message, name, value)
        publishers[topic].publish(message)

    def warn(line: str) -> None:
        node.get_logger().warning(line)

    topics = GelTopics(vt.Gel.read(rig, background), publish, warn)
    node.create_subscription(Image, "image_raw", topics.on_image, 1)  # a queue of one: the newest
    try:
        rclpy.spin(node)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
