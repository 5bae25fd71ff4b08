"""What a capture says of itself: frames, chroma, codec, bits, and the transfer curve that it states."""

from collections.abc import Iterator

from vntoolkit.diagnosis.finding import Finding, Level
from vntoolkit.io.footage.captures import Capture, CaptureInfo
from vntoolkit.io.footage.pixel_formats import LOSSLESS_CODECS
from vntoolkit.io.footage.sequence import text_of_names
from vntoolkit.photometry.transfer import Transfer, TransferCurve

_LOSSLESS_IMAGES = frozenset({"PNG", "TIFF", "BMP", "EXR", "raw"})
_CAMERA_CODECS = frozenset({"JPEG", "h264", "hevc", "mjpeg", "prores", "av1", "vp9"})
# Degrees that subsampled chroma costs on relief of two pixels, measured on rendered captures.
CHROMA_COST_DEG = {"4:2:0": 7, "4:2:2": 5, "4:4:0": 5, "4:1:1": 7}


def findings_from_header(capture: Capture) -> list[Finding]:
    """Check what a capture says of itself: frames, chroma, codec, bits, and the curve it is read with."""
    return [*_findings_from_info(capture.info), *_findings_from_transfer(capture.info, capture.transfer)]


def _findings_from_info(info: CaptureInfo) -> Iterator[Finding]:
    if info.promised_frame_count > info.frame_count:
        yield Finding(
            check="cut-off",
            level=Level.FATAL,
            problem=f"the video is cut off: it declares {info.promised_frame_count} frames, "
            f"{info.frame_count} came",
            measured=f"{info.frame_count} frames",
            expected=f"{info.promised_frame_count}",
            remedy=f"copy the file again, or use what came with --frames 0:{info.frame_count}",
        )
    if info.missing:
        names = text_of_names(list(info.missing.values()))
        yield Finding(
            check="gaps",
            level=Level.FATAL,
            problem=f"{len(info.missing)} of {info.frame_count} files of the sequence are missing: {names}",
            measured=f"{info.frame_count - len(info.missing)} files",
            expected=f"{info.frame_count}",
            remedy="copy them too, or leave these frames out with --gaps skip",
        )
    if info.unusable_times:
        yield Finding(
            check="times",
            level=Level.WARNING,
            problem=f"{info.unusable_times}; the frames are played at {info.frame_rate_hz:g} per second",
            measured="times that do not tell when a frame was filmed",
            expected="times that rise",
            remedy="give --frame-rate-hz with the rate that they were filmed at",
        )
    if info.left_out:
        names = text_of_names([path.name for path in info.left_out])
        yield Finding(
            check="stray",
            level=Level.WARNING,
            problem=f"left out, since the frames are named otherwise: {names}",
            measured=f"{len(info.left_out)} files",
            expected="none",
            remedy="keep masks and thumbnails in another folder",
        )
    if info.chroma in CHROMA_COST_DEG:
        cost = CHROMA_COST_DEG[info.chroma]
        yield Finding(
            check="chroma",
            level=Level.WARNING,
            problem=f"chroma subsampling {info.chroma} costs nothing on smooth surfaces, and up to "
            f"{cost} degrees on relief as fine as two pixels, such as a knit; `reconstruct` takes part "
            "of it back, `live` does not",
            measured=f"chroma {info.chroma}",
            expected="RGB or 4:4:4",
            remedy="for such relief record RGB, raw or 4:4:4, or halve the picture size",
        )
    if info.codec not in LOSSLESS_CODECS and info.codec not in _LOSSLESS_IMAGES:
        yield Finding(
            check="codec",
            level=Level.WARNING,
            problem=f"{info.codec} is a lossy codec at most settings: its blocks show up as relief",
            measured=f"codec {info.codec}",
            expected="a lossless one",
            remedy="record losslessly, or with the highest bit rate",
        )
    if info.bits == 8:
        yield Finding(
            check="bits",
            level=Level.NOTE,
            problem="8 bits per channel cost about 0.3 degrees",
            measured="8 bits",
            expected="10 or more",
            remedy="record 10 or more bits where you can",
        )


def findings_from_channels(info: CaptureInfo) -> Iterator[Finding]:
    """Find footage without colour."""
    if info.chroma != "grey":
        return
    yield Finding(
        check="grey",
        level=Level.FATAL,
        problem="the footage is grey",
        measured="one channel",
        expected="three",
        remedy="three coloured lights need a colour camera",
    )


def findings_from_tag(info: CaptureInfo, transfer: Transfer, level: Level) -> Iterator[Finding]:
    """Find a stated transfer curve other than the one read with; no tag states a camera's own logarithm."""
    stated, used = info.stated_transfer, transfer.to_text()
    if not stated or stated == used or transfer.is_camera_log:
        return
    yield Finding(
        check="tag",
        level=level,
        problem=f"the file states the transfer curve {stated}, the rig's is {used}"
        if level is Level.FATAL
        else f"the file states the transfer curve {stated} but is read as {used}",
        measured=stated,
        expected=used,
        remedy="film as the rig was calibrated, or calibrate as it was filmed"
        if level is Level.FATAL
        else "leave --transfer out, unless the tag is known to be wrong",
    )


def _findings_from_transfer(info: CaptureInfo, transfer: Transfer) -> Iterator[Finding]:
    if transfer.curve is not TransferCurve.LINEAR or info.stated_transfer:
        return
    if info.codec in _CAMERA_CODECS:
        yield Finding(
            check="transfer",
            level=Level.NOTE,
            problem=f"{info.codec} files of cameras and telephones are rarely linear",
            measured="linear",
            expected="bt709 (video) or srgb (JPEG)",
            remedy="if this one is not linear, give --transfer bt709 or srgb",
        )
