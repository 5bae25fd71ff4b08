"""Images as the frames of a capture: PNG, TIFF and the like, or camera raw files."""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Array
from vntoolkit.errors import BadCapture
from vntoolkit.io.footage.captures import CaptureInfo, CaptureOptions
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.images import read_opaque_image
from vntoolkit.io.footage.mosaics import DecodedImage
from vntoolkit.io.footage.sequence import CaptureFiles
from vntoolkit.io.footage.stated import require_as_first


class ImageReader:
    """Frames of a capture of which each is a file of its own. Raises `BadCapture`."""

    def __init__(self, found: CaptureFiles, options: CaptureOptions) -> None:
        self._found, self._options = found, options

    @cached_property
    def info(self) -> CaptureInfo:
        """What the images hold, by the first of them."""
        found, options = self._found, self._options
        first = self._read(found.files[0])
        header = first.header
        height, width = first.colours.shape[:2]
        grey = "Bayer" if options.sensor.bayer or header.bayer else "grey"
        return CaptureInfo(
            **vars(found),
            width=width,
            height=height,
            frame_count=found.numbers[-1] + 1,
            frame_rate_hz=options.frame_rate_hz,
            pixel_format=header.text,
            bits=self._bits(first.colours, found.files[0]),
            codec=header.format if header.saturation is None else "raw",
            chroma=grey if header.channels < 3 else header.chroma,
            promised_frame_count=found.numbers[-1] + 1,
            stated_transfer=header.stated.transfer,
            stated_focal_px=header.stated.focal_px,
            orientation=header.stated.orientation.text,
        )

    def nearest_key_frame(self, number: int) -> int:
        """Return the nearest frame that is there."""
        return min(self._found.numbers, key=lambda there: abs(there - number))

    def frames(self, start: int = 0, stop: int | None = None, step: int = 1) -> Iterator[EncodedFrame]:
        """Yield the frames start, start + step, … below stop that are there."""
        info = self.info
        wanted = range(info.frame_count)[start:stop:step]
        for number, path in zip(info.numbers, info.files, strict=True):
            if number not in wanted:
                continue
            image = self._read(path)
            values, name = image.rgb, f"{path}: frame {number}"
            size, first_size = f"{values.shape[1]}×{values.shape[0]}", f"{info.width}×{info.height}"
            require_as_first(f"{name} is", size, first_size, "size")
            own, first = (curve or "none" for curve in (image.header.stated.transfer, info.stated_transfer))
            require_as_first(f"{name} states the transfer curve", own, first, "curve")
            yield EncodedFrame(values=values, bits=self._bits(values, path), number=number, name=str(path))

    def _read(self, path: Path) -> DecodedImage:
        options = self._options
        return read_opaque_image(path, max_megapixels=options.max_megapixels, sensor=options.sensor)

    def _bits(self, values: Array, path: Path) -> int:
        if values.dtype == np.float32:
            return 32
        stored = values.dtype.itemsize * 8
        bits = self._options.sensor.bits
        if bits is not None and bits > stored:
            raise BadCapture(f"{path}: samples of {stored} bits cannot hold {bits}; give bits up to {stored}")
        return bits or stored
