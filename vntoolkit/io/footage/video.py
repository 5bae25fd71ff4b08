"""Video by PyAV: 8 to 16 bit in, RGB with its bit depth kept; lossless FFV1 out."""

import contextlib
import shlex
import struct
import sys
import zlib
from collections import deque
from collections.abc import Iterable, Iterator
from collections.abc import Set as AbstractSet
from dataclasses import replace
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vntoolkit.arrays import Array
from vntoolkit.errors import BadCapture, BadInput, CannotWrite
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.files import require_file, require_pixels
from vntoolkit.io.footage import pixel_formats
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.luma_detail import LumaDetail
from vntoolkit.io.footage.orientation import Orientation
from vntoolkit.io.footage.stated import (
    TRANSFER_NAMES,
    Stated,
    require_as_first,
    require_heeded,
    require_opaque,
)
from vntoolkit.io.footage.video_index import VideoIndex, av_errors, index_of_stream
from vntoolkit.options.footage import Bayer, Demosaic

if TYPE_CHECKING:
    from vntoolkit.io.footage.captures import CaptureInfo, CaptureOptions

_HD_HEIGHT = 720
_WITHOUT_INDEX = ("mpegts", "mpeg")  # of camcorders: FFmpeg finds a time in them, but no key frame
# They open other files, which no manifest names and which may lie outside the footage's folder.
_LISTS_OF_FILES = {"concat", "dash", "hls", "image2", "imf", "lavfi", "rtp", "rtsp", "sap", "sdp", "vobsub"}
_PICTURES = ("_pipe", "image2pipe")  # pictures in no container, whose curve and orientation FFmpeg drops
_SIDE_DATA = ("DISPLAYMATRIX", "ICC_PROFILE", "SPHERICAL", "STEREO3D")
_LONGEST_PROFILE = 1 << 24  # bytes
_EARLY_S = 1  # more than a key frame is decoded ahead of its time
_FIRST_INTERLACED = 2  # AVFieldOrder: 0 unknown, 1 progressive, then four orders of fields
_UNEVEN_S = 0.002  # a clock of milliseconds rounds by less
_LONGEST_STEP_S = 3600.0  # between frames of one film, a time lapse too: more comes from a broken clock


class VideoReader:
    """Frames of one video file, from any frame on.

    8-bit sources give uint8; deeper ones uint16, whose full scale is `2**bits - 1`. Frames are counted by
    their packets, so the number of a frame does not depend on a frame rate in the header. A decoder that came
    to the end of what it was asked for waits there, so that going on costs no seek: cameras write a key frame
    every few seconds, and all frames since then would be decoded again. Frames come upright, whatever way the
    camera was held. With a response and a transfer, luma sharpens subsampled chroma. Raises `BadCapture` for
    interlaced video.
    """

    def __init__(self, path: Path | str, options: "CaptureOptions | None" = None) -> None:
        self.path = require_file(path, BadCapture)
        from vntoolkit.io.footage.captures import CaptureOptions  # here: writing needs none of it

        self._options = options = options or CaptureOptions()
        # (number of its next frame, decoder); a deque, whose pop gives it to one thread alone
        self._waiting: deque[tuple[int, Iterator[tuple[int | None, Any]]]] = deque(maxlen=1)
        container, stream = open_video(self.path)
        with container:
            context = stream.codec_context
            if context is None:
                raise BadCapture(f"{self.path}: is in a codec that FFmpeg does not know, or is damaged")
            require_pixels(context.width, context.height, options.max_megapixels, str(self.path))
            if not context.pix_fmt:
                raise BadCapture(f"{self.path}: no frame can be decoded; the file is damaged or cut off")
            self._stored_size = (int(context.width), int(context.height))
            self._codec = str(context.codec.name)
            self._format = pixel_formats.PixelFormat.from_av(context.format)
            hd = int(context.height) >= _HD_HEIGHT
            self._stated_yuv, self._taken_yuv = pixel_formats.yuv_conversion(context, self._format, hd=hd)
            self._bayer = self._pattern(options.sensor.bayer)
            takes_codes = options.transfer is not None and options.transfer.takes_codes
            self._takes_codes = takes_codes and not (self._format.is_rgb or self._format.is_grey)
            self._detail = None
            if self._format.has_coarse_chroma and options.response and options.transfer:
                self._detail = LumaDetail(options.response, options.transfer)
            # AVI's times tell when a frame is decoded, not when it is shown
            self._times_are_of_decoding = bool(context.has_b_frames) and container.format.name == "avi"
            self._stated_rate_hz = float(stream.average_rate or stream.guessed_rate or 30)
            self._time_base_s = float(stream.time_base)
            self._require_progressive(int(context.field_order or 0) >= _FIRST_INTERLACED)
            self._stated = self._stated_by(container, stream)
            require_heeded(self._stated, str(self.path), "views a frame (stereo)")

    @cached_property
    def info(self) -> "CaptureInfo":
        """What the video holds."""
        from vntoolkit.io.footage.captures import CaptureInfo
        from vntoolkit.io.footage.sequence import CaptureKind

        width, height = self._stored_size[:: -1 if self._stated.orientation.transposed else 1]
        is_halved = self._bayer is not None and self._options.sensor.demosaic is Demosaic.HALF
        bits = self._format.decoded_bits
        if self._bayer is not None:
            bits = self._format.bits
        elif self._takes_codes or self._detail is not None:
            bits = 16
        rate_hz, uneven_s, unusable = self._timing()
        return CaptureInfo(
            kind=CaptureKind.VIDEO,
            width=width // 2 if is_halved else width,
            height=height // 2 if is_halved else height,
            frame_count=len(self.index.times),
            frame_rate_hz=rate_hz,
            pixel_format=self._format.name,
            bits=bits,
            codec=self._codec,
            chroma="Bayer" if self._bayer is not None else self._format.chroma,
            files=(self.path,),
            promised_frame_count=self.index.promised,
            stated_transfer=self._stated.transfer,
            stated_yuv=self._stated_yuv,
            taken_yuv=self._taken_yuv,
            orientation=self._stated.orientation.text,
            times_s=uneven_s,
            unusable_times=unusable,
        )

    def _pattern(self, given: Bayer | None) -> Bayer | None:
        """Return the pattern of the mosaic that the video is, None for none."""
        if given is not None and not self._format.is_grey:
            raise BadCapture(
                f"{self.path}: --bayer needs one sample a pixel, got {self._format.name}; leave it out"
            )
        return given or self._format.bayer

    def _timing(self) -> tuple[float, tuple[float, ...], str]:
        """Return frame rate, uneven times and unusable ones, as `CaptureInfo` has them."""
        if self._options.frame_rate_hz is not None:
            return self._options.frame_rate_hz, (), ""
        if self.index.unusable_times:
            return self._stated_rate_hz, (), self.index.unusable_times
        times = (np.array(self.index.times, np.float64) - self.index.times[0]) * self._time_base_s
        longest = np.diff(times).max(initial=0.0)
        if longest > _LONGEST_STEP_S:
            apart = f"the file puts two of its frames {longest / 3600:,.0f} hours apart"
            return self._stated_rate_hz, (), apart
        mean_hz = (len(times) - 1) / times[-1] if len(times) > 1 else self._stated_rate_hz
        for rate_hz in (self._stated_rate_hz, mean_hz):
            deviation = np.abs(times - np.arange(len(times)) / rate_hz).max()
            if deviation <= max(_UNEVEN_S, 1.5 * self._time_base_s):
                return rate_hz, (), ""
        return self._stated_rate_hz, tuple(np.round(times, 6).tolist()), ""

    def _require_progressive(self, is_interlaced: bool) -> None:
        if is_interlaced:
            raise BadCapture(
                f"{self.path}: is interlaced: odd and even lines were filmed at different moments; "
                f"deinterlace it first: ffmpeg -i {shlex.quote(str(self.path))} -vf bwdif -c:v ffv1 "
                f"{shlex.quote(self.path.stem + '_progressive.mkv')}"
            )

    def _stated_by(self, container: Any, stream: Any) -> Stated:
        """Gather it from the stream and its first frame; a damaged one is reported in its turn."""
        context, said = stream.codec_context, {}
        with contextlib.suppress(StopIteration, *av_errors()):
            packets = container.demux(stream)
            first = next(packets)
            frame = next(frame for packet in chain([first], packets) for frame in packet.decode())
            is_png = self._codec in ("png", "apng")
            said = _said_beside_png(frame, context, first) if is_png else _said_beside(frame)
        turn = (
            Orientation.from_display_matrix(said["DISPLAYMATRIX"])
            if "DISPLAYMATRIX" in said
            else Orientation.UPRIGHT
        )
        if turn is None:
            raise BadCapture(
                f"{self.path}: is to be shown turned by {frame.rotation}°, expected 0, 90, 180 or 270; turn "
                "it in a video editor first"
            )
        colours = pixel_formats.unread_colours(context, self._format)
        if stream.metadata.get("alpha_mode", "0") != "0":
            colours = "colours with an alpha channel apart from them"
        if "SPHERICAL" in said:
            colours = "a picture all around (spherical)"
        transfer = TRANSFER_NAMES.get(int(context.color_trc or 0), "")
        if not transfer and "ICC_PROFILE" in said:
            from vntoolkit.io.footage.colour_profiles import curve_of_profile

            transfer = curve_of_profile(said["ICC_PROFILE"])
        is_flat = int.from_bytes(said.get("STEREO3D", b"")[:4], sys.byteorder) == 0  # AV_STEREO3D_2D
        return Stated(
            transfer=transfer,
            orientation=turn,
            pixel_aspect=float(stream.sample_aspect_ratio or 1),
            colours=colours,
            pictures=1 if is_flat and stream.metadata.get("stereo_mode", "mono") == "mono" else 2,
        )

    @cached_property
    def index(self) -> VideoIndex:
        """Read all packets once, without decoding; a file that did not change since is not read again."""
        state = self.path.stat()
        known = (self.path, self.path.absolute(), state.st_size, state.st_mtime_ns)
        index = _index_of_file(*known, has_checksums=self._codec == "ffv1")
        return replace(index, key_frames=(0,), is_in_order=True) if self._times_are_of_decoding else index

    def nearest_key_frame(self, number: int) -> int:
        """Return the nearest frame that needs no other to be decoded, the earlier of two; 0 where none is."""
        return min(self.index.key_frames, key=lambda key: abs(key - number), default=0)

    def frames(self, start: int = 0, stop: int | None = None, step: int = 1) -> Iterator[EncodedFrame]:
        """Yield the frames start, start + step, … below stop.

        Decoding goes on where the call before it ended, if that is no farther than the key frame before
        `start`, or starts there. Where every frame is a key frame, those left out are not decoded. Raises
        `BadCapture` where the file ends early or a frame is damaged.
        """
        times = self.index.times
        last = len(times) if stop is None else min(stop, len(times))
        if (stop is None or stop > len(times)) and self.index.promised > len(times):
            raise self._breaks_off(len(times))
        if start >= last:
            return
        numbers = range(start, last, step)
        left_out: set[int] = set()
        alone = False
        if len(self.index.key_frames) == len(times):
            left_out = set(times[start:last]).difference(times[start:last:step])
            alone = len(numbers) == 1
        decoded = self._decoded(times[start], left_out) if left_out else self._decoded_to(start, alone=alone)
        for number in numbers:
            if number in self.index.damaged:
                raise self._damaged(number, "its checksum is wrong, or that of a frame it builds on")
            rgb = self._rgb(self._frame_shown_at(times[number], number, decoded), number)
            name = f"{self.path}, frame {number}"
            yield EncodedFrame(values=rgb, bits=self.info.bits, number=number, name=name)
        if not left_out:
            self._waiting.append((numbers[-1] + 1, decoded))

    def _decoded_to(self, start: int, *, alone: bool) -> Iterator[tuple[int | None, Any]]:
        """Return a decoder that will come to frame `start`. alone: none is asked for after it."""
        with contextlib.suppress(IndexError):
            next_number, decoded = self._waiting.pop()
            if self.index.key_frame_before(start) <= next_number <= start:
                return decoded
        if self.index.is_in_order:
            return zip(self.index.times, (frame for _, frame in self._decoded(None)), strict=False)
        from_time = self.index.times[self.index.key_frame_before(start)] if start else None
        return self._decoded(from_time, threads_work_on="SLICE" if alone else "AUTO")

    def _frame_shown_at(self, time: int, number: int, decoded: Iterator[tuple[int | None, Any]]) -> Any:
        """Take frames until the one of that time; a frame that the decoder left out shifts no other."""
        for shown, frame in decoded:
            if shown is None or shown == time:
                return frame
            if shown > time:
                raise self._damaged(number, "it cannot be decoded")
        raise self._breaks_off(number)

    def _decoded(
        self, from_time: int | None, left_out: AbstractSet[int] = frozenset(), threads_work_on: str = "AUTO"
    ) -> Iterator[tuple[int | None, Any]]:
        """Yield (time, frame) from a key frame's time on. threads_work_on: FFmpeg's "SLICE" or "AUTO"."""
        damaged = () if self.index.is_in_order else self.index.damaged
        damaged_times = {self.index.times[number] for number in damaged}
        errors = av_errors()  # here, since a decoder may be closed when nothing can be imported any more
        container, stream = open_video(self.path)
        with container:
            stream.thread_type = threads_work_on
            stream.codec_context.thread_count = self._options.threads
            try:
                if from_time is not None:
                    early = _EARLY_S / stream.time_base if container.format.name in _WITHOUT_INDEX else 0
                    container.seek(from_time - round(early), stream=stream, backward=True)
                for packet in container.demux(stream):
                    # A decoder that works ahead would fail on a damaged frame before its turn has come.
                    if packet.pts not in damaged_times and packet.pts not in left_out:
                        for frame in packet.decode():
                            yield frame.pts, frame
            except errors as error:
                raise BadCapture(f"{self.path}: a frame cannot be decoded ({reason_of(error)})") from error

    def _rgb(self, frame: Any, number: int) -> Array:
        if frame.is_corrupt:
            raise self._damaged(number, "the decoder calls it corrupt")
        name, size = f"{self.path}: frame {number}", "{}×{}".format(*self._stored_size)
        require_as_first(f"{name} is", f"{frame.width}×{frame.height}", size, "size")
        first = self._stated.transfer or "none"
        curve = TRANSFER_NAMES.get(int(frame.color_trc), first)
        require_as_first(f"{name} states the transfer curve", curve, first, "curve")
        self._require_progressive(frame.interlaced_frame)
        try:
            if self._bayer is not None:
                from vntoolkit.io.footage.mosaics import rgb_from_mosaic

                mosaic = pixel_formats.mosaic_from_video_frame(frame, self._format)
                return self._stated.orientation.upright(
                    rgb_from_mosaic(mosaic, self._bayer, self._options.sensor.demosaic)
                )
            if self._format.has_alpha:
                alpha = frame.reformat(format="rgba").to_ndarray()[..., 3]
                require_opaque(alpha, f"{self.path}, frame {number}")
            rgb = pixel_formats.rgb_from_video_frame(
                frame,
                self._format,
                hd=frame.height >= _HD_HEIGHT,
                takes_codes=self._takes_codes,
                detail=self._detail,
            )
            return self._stated.orientation.upright(rgb)
        except av_errors() as error:
            raise self._damaged(number, f"its colours cannot be converted ({reason_of(error)})") from error

    def _breaks_off(self, number: int) -> BadCapture:
        promised = max(self.index.promised, number + 1)
        return BadCapture(
            f"{self.path}: the video is cut off: {number} of {promised} frames can be read (0 to "
            f"{number - 1}); copy the file again, or use what is there with --frames 0:{number}"
        )

    def _damaged(self, number: int, reason: str) -> BadCapture:
        return BadCapture(
            f"{self.path}: frame {number} of {len(self.index.times)} is damaged: {reason}; copy the file "
            f"again, or leave the frame out, as with --frames {f'0:{number}' if number else '1:'}"
        )


@lru_cache(maxsize=8)
def _index_of_file(path: Path, *state: Path | int, has_checksums: bool) -> VideoIndex:
    """Index a video. state: its absolute path, size and time of change, by which it is known again."""
    container, stream = open_video(path)
    with container:
        return index_of_stream(container, stream, str(path), has_checksums=has_checksums)


def write_video(path: Path | str, frames: Iterable[Array], frame_rate_hz: float) -> int:
    """Write (h, w, 3) RGB frames, all uint8 or all uint16, losslessly as FFV1 in Matroska; atomically.

    frame_rate_hz: 0.001 to a million. Returns the number of frames. Frames are taken one at a time, so memory
    stays constant. Raises `BadInput` where a frame is of another size or depth than the first.
    """
    import av

    path = Path(path)
    if path.suffix.lower() != ".mkv":
        raise CannotWrite(f"{path}: video is written as FFV1 in Matroska; give a name that ends in .mkv")
    if not 1e-3 <= frame_rate_hz <= 1e6:
        raise BadInput(f"{path}: frame rate: expected a value from 0.001 to 1e+06, got {frame_rate_hz:g}")
    count, first = 0, ""
    try:
        # Without "bitexact" Matroska gets a random identifier, and equal frames unequal files.
        exact = {"fflags": "+bitexact"}
        with (
            atomic_path(path) as temporary,
            av.open(file_name(temporary), "w", format="matroska", options=exact) as container,
        ):
            stream = None
            for count, frame in enumerate(frames, start=1):
                kind = f"{frame.shape} {frame.dtype}"
                if kind != (first := first or kind):  # the encoder would scale and round it without a word
                    raise BadCapture(f"{path}: frame {count - 1} is {kind}, the first one {first}")
                stream = stream or _ffv1_stream(container, frame, frame_rate_hz)
                picture = av.VideoFrame.from_ndarray(
                    np.ascontiguousarray(frame), format="rgb24" if frame.dtype == np.uint8 else "rgb48le"
                )
                picture.pts = count - 1
                picture.time_base = 1 / _rational(frame_rate_hz)
                container.mux(stream.encode(picture))
            if stream is None:
                raise BadCapture(f"{path}: no frame to write")
            container.mux(stream.encode(None))
    except av.error.FFmpegError as error:
        raise CannotWrite(f"cannot write {path}: {reason_of(error)}") from error
    return count


def _ffv1_stream(container: Any, frame: Array, frame_rate_hz: float) -> Any:
    if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype not in (np.uint8, np.uint16):
        raise BadCapture(f"video: expected (h, w, 3) uint8 or uint16 frames, got {frame.shape} {frame.dtype}")
    # 16 slices let two threads work on a frame; Rice coding decodes twice as fast as range coding.
    options = {"level": "3", "slicecrc": "1"}
    # four rows of four slices, of a pixel at least; FFmpeg's own two columns do not go into every picture
    options["slices"] = "16" if min(frame.shape[:2]) >= 4 else "1"
    if frame.dtype == np.uint8:
        options["coder"] = "rice"
    stream = container.add_stream("ffv1", rate=_rational(frame_rate_hz), options=options)
    stream.height, stream.width = frame.shape[:2]
    stream.pix_fmt = "bgr0" if frame.dtype == np.uint8 else "gbrp16le"
    stream.codec_context.thread_count = 2
    stream.codec_context.gop_size = 1  # for 1 % more bytes any frame is read alone and damage stays in it
    return stream


def _rational(frame_rate_hz: float) -> Fraction:
    return Fraction(frame_rate_hz).limit_denominator(1001)


def _said_beside(frame: Any) -> dict[str, bytes]:
    """Return a frame's display matrix (36 bytes), profile and kind of view, by FFmpeg's names."""
    try:
        # by name: PyAV 18 lists the data themselves, PyAV 19 their kinds
        found = {name: frame.side_data.get(name) for name in _SIDE_DATA}
    except ValueError:  # PyAV 18 lists none where one is of a kind it does not know, as FFmpeg's EXIF is
        return _said_by_rotation(frame)
    return {name: bytes(data) for name, data in found.items() if data is not None}


def _said_beside_png(frame: Any, context: Any, packet: Any) -> dict[str, bytes]:
    """Return the same of a video whose frames are PNG.

    The profile in it has a name, which PyAV 18 frees twice, and so ends the process, as soon as it lists what
    is beside a frame.
    """
    said, head = _said_by_rotation(frame), bytes(context.extradata or b"") + bytes(packet)
    at = head.find(b"iCCP")
    if at >= 4:
        content = head[at + 4 : at + 4 + int.from_bytes(head[at - 4 : at], "big")]
        with contextlib.suppress(zlib.error):
            packed = content.partition(b"\0")[2][1:]
            said["ICC_PROFILE"] = zlib.decompressobj().decompress(packed, _LONGEST_PROFILE)
    return said


def _said_by_rotation(frame: Any) -> dict[str, bytes]:
    turn = np.deg2rad(frame.rotation)
    cosine, sine = (round(65536 * float(value)) for value in (np.cos(turn), np.sin(turn)))
    return {"DISPLAYMATRIX": struct.pack("<9i", cosine, -sine, 0, sine, cosine, 0, 0, 0, 1 << 30)}


def open_video(path: Path) -> tuple[Any, Any]:
    """Return the container of a video file, which the caller closes, and its video stream.

    Raises `BadCapture` where FFmpeg cannot open it, or it holds no video, or several.
    """
    import av

    # Errors arrive as exceptions, in one line. PyAV's own log callback waits, in FFmpeg's threads, for
    # Python's lock, and does so for ever where Python holds it and waits for these threads to end.
    av.logging.restore_default_callback()
    av.logging.set_libav_level(av.logging.PANIC)
    try:
        container = _opened(file_name(path))
    except av_errors() as error:
        raise BadCapture(
            f"{path}: cannot be opened as a video ({reason_of(error)}); it is damaged, cut off, in an "
            "unknown format, a picture, which is to be saved as PNG or TIFF, or a list of other files, of "
            "which each is to be given itself"
        ) from error
    beside = av.stream.Disposition.attached_pic | av.stream.Disposition.timed_thumbnails
    streams = [stream for stream in container.streams.video if not stream.disposition & beside]
    if len(streams) != 1:
        container.close()
        one = f"ffmpeg -i {shlex.quote(path.name)} -map 0:v:0 -c copy {shlex.quote(path.stem + '_one.mkv')}"
        remedy = f"s, expected one; keep the one that is meant: {one}" if streams else ""
        raise BadCapture(f"{path}: holds {len(streams) or 'no'} video stream{remedy}")
    return container, streams[0]


def _opened(name: str) -> Any:
    """Open a container that holds its own frames; its title or other tags may be no UTF-8: none is read.

    PyAV up to 18 raises `UnicodeDecodeError` unless told otherwise; from 19 on it hands such bytes on as lone
    surrogates, and has no option for it.
    """
    import av

    formats = {name for name in av.formats_available - _LISTS_OF_FILES if not name.endswith(_PICTURES)}
    alone = {"format_whitelist": ",".join(sorted(formats))}
    try:
        return av.open(name, options=alone)
    except UnicodeDecodeError:
        return av.open(name, options=alone, metadata_errors="replace")


def file_name(path: Path) -> str:
    """Return what FFmpeg takes for a file: `take:1.mkv`, unlike `/home/take:1.mkv`, were a protocol."""
    return str(path.absolute())


def reason_of(error: Exception) -> str:
    """Return FFmpeg's reason on one line."""
    return " ".join(str(getattr(error, "strerror", None) or error).split()).lower()
