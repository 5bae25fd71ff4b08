"""Pictures of ROS 2 messages as arrays: sensor_msgs/msg/Image and CompressedImage."""

import re
from typing import Any

import cv2
import numpy as np

from vntoolkit.arrays import Array
from vntoolkit.errors import BadCapture
from vntoolkit.io.files import require_pixels
from vntoolkit.io.footage.mosaics import rgb_from_mosaic
from vntoolkit.options.footage import Bayer, SensorOptions

_ENCODING = re.compile(r"(rgba?|bgra?|bayer_(rggb|bggr|gbrg|grbg))(8|16)")


def rgb_from_message(
    message: Any, name: str, *, max_megapixels: float | None = None, sensor: SensorOptions | None = None
) -> Array:
    """Return (h, w, 3) RGB, uint8 or uint16, of an object with the fields of the message.

    name: of the message, for errors. The other parameters: as for `CaptureOptions`. Raises `BadCapture`.
    """
    if hasattr(message, "format"):
        coded = np.frombuffer(message.data, np.uint8)
        image = cv2.imdecode(coded, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH) if coded.size else None
        if image is None or image.dtype not in (np.uint8, np.uint16):
            raise BadCapture(
                f"{name}: its picture, {message.format}, cannot be decoded; expected JPEG or PNG"
            )
        return np.ascontiguousarray(image[..., ::-1])
    width, height = int(message.width), int(message.height)
    require_pixels(width, height, max_megapixels, name)
    encoding = _ENCODING.fullmatch(message.encoding)
    if encoding is None:
        raise BadCapture(
            f"{name}: is encoded as {message.encoding}, expected rgb8, bgr8, rgba8, bgra8, the same of 16 "
            "bits, or a Bayer mosaic"
        )
    colours, bayer, bits = encoding.groups()
    kind = np.dtype("u1" if bits == "8" else ">u2" if message.is_bigendian else "<u2")
    row = (1 if bayer else len(colours)) * width * kind.itemsize
    if message.step < row or len(message.data) < height * message.step:
        raise BadCapture(
            f"{name}: holds {len(message.data)} bytes in rows of {message.step}, expected {height} rows of "
            f"{row} or more"
        )
    rows = np.frombuffer(message.data, np.uint8, height * message.step).reshape(height, message.step)
    values = np.ascontiguousarray(rows[:, :row]).view(kind).astype(kind.newbyteorder("="))
    if bayer:
        known = sensor or SensorOptions()
        return rgb_from_mosaic(values, known.bayer or Bayer(bayer), known.demosaic, name)
    rgb = values.reshape(height, width, len(colours))[..., :3]
    return np.ascontiguousarray(rgb[..., ::-1] if colours.startswith("bgr") else rgb)
