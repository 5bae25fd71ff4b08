"""Images as the frames of a capture: PNG, TIFF and the like, or camera raw files."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Array
from vntoolkit.errors import BadCapture
from vntoolkit.io.footage.captures import CaptureInfo, CaptureOptions
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.images import ImageHeader, read_opaque_image
from vntoolkit.io.footage.mosaics import is_raw, read_raw
from vntoolkit.io.footage.sequence import CaptureFiles


def info_of_images(found: CaptureFiles, options: CaptureOptions) -> CaptureInfo:
    """Return what images hold, by the first of them."""
    files = found.files
    info = partial(
        CaptureInfo,
        kind=found.kind,
        frame_count=found.numbers[-1] + 1,
        frame_rate_hz=options.frame_rate_hz,
        files=files,
        promised_frame_count=found.numbers[-1] + 1,
        numbers=found.numbers,
        missing=found.missing,
        left_out=found.left_out,
        stated=found.stated,
    )
    if is_raw(files[0]):
        _, raw = read_raw(files[0], options.sensor.demosaic, max_megapixels=options.max_megapixels)
        return info(
            width=raw.width,
            height=raw.height,
            pixel_format=f"{raw.kind}, saturation {raw.saturation}",
            bits=16,
            codec="raw",
            chroma="Bayer",
            stated_transfer="linear",
            orientation=raw.orientation,
        )
    first, header = _read_image(files[0], options)
    assert header is not None
    grey = "Bayer" if options.sensor.bayer or header.bayer else "grey"
    return info(
        width=first.shape[1],
        height=first.shape[0],
        pixel_format=f"{header.format} {header.bits}-bit{' float' if header.floating else ''}",
        bits=_bits(first, options, files[0]),
        codec=header.format,
        chroma=grey if header.channels < 3 else header.chroma,
        stated_transfer=header.stated.transfer,
        stated_focal_px=header.stated.focal_px,
        orientation=header.stated.orientation.text,
    )


def frames_of_images(
    info: CaptureInfo, options: CaptureOptions, start: int, stop: int | None, step: int
) -> Iterator[EncodedFrame]:
    """Yield the frames start, start + step, … below stop as stored; raise `BadCapture` on a bad one."""
    wanted = range(info.frame_count)[start:stop:step]
    for number, path in zip(info.numbers, info.files, strict=True):
        if number not in wanted:
            continue
        values, header = _read_image(path, options)
        height, width = values.shape[:2]
        if (width, height) != (info.width, info.height):
            raise BadCapture(
                f"{path}: frame {number} is {width}×{height}, the first one {info.width}×{info.height}: a "
                "capture has one size"
            )
        if header is not None and header.stated.transfer != info.stated_transfer:
            own, first = (curve or "none" for curve in (header.stated.transfer, info.stated_transfer))
            raise BadCapture(
                f"{path}: frame {number} states the transfer curve {own}, the first one {first}: a capture "
                "has one curve"
            )
        bits = _bits(values, options, path)
        yield EncodedFrame(values=values, bits=bits, number=number, name=str(path))


def _read_image(path: Path, options: CaptureOptions) -> tuple[Array, ImageHeader | None]:
    """Return pixels and header; None for that of a camera raw file, whose reader heeds it."""
    limit, sensor = options.max_megapixels, options.sensor
    if is_raw(path):
        return read_raw(path, sensor.demosaic, max_megapixels=limit)[0], None
    image = read_opaque_image(path, max_megapixels=limit, sensor=sensor)
    return image.rgb, image.header


def _bits(values: Array, options: CaptureOptions, path: Path | str) -> int:
    if values.dtype == np.float32:
        return 32
    stored = values.dtype.itemsize * 8
    bits = options.sensor.bits
    if bits is not None and bits > stored:
        raise BadCapture(f"{path}: samples of {stored} bits cannot hold {bits}; give bits up to {stored}")
    return bits or stored
