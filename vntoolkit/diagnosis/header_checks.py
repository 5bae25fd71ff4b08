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


def findings_from_header(capture: Capture) -> Iterator[Finding]:
    """Check what a capture says of itself: frames, chroma, codec, bits, and the curve it is read with."""
    info, transfer = capture.info, capture.transfer
    if info.promised_frame_count > info.frame_count:
        yield Finding.of("cut-off", promised=info.promised_frame_count, came=info.frame_count)
    if info.missing:
        names = text_of_names(list(info.missing.values()))
        missing, count = len(info.missing), info.frame_count
        yield Finding.of("gaps", missing=missing, count=count, present=count - missing, names=names)
    if info.unusable_times:
        yield Finding.of("times", why=info.unusable_times, rate_hz=info.frame_rate_hz)
    if info.left_out:
        names = text_of_names([path.name for path in info.left_out])
        yield Finding.of("stray", names=names, count=len(info.left_out))
    if info.chroma in CHROMA_COST_DEG:
        yield Finding.of("chroma", chroma=info.chroma, cost_deg=CHROMA_COST_DEG[info.chroma])
    if info.codec not in LOSSLESS_CODECS and info.codec not in _LOSSLESS_IMAGES:
        yield Finding.of("codec", codec=info.codec)
    if info.bits == 8:
        yield Finding.of("bits")
    read_as_linear = transfer.curve is TransferCurve.LINEAR and not info.stated_transfer
    if read_as_linear and info.codec in _CAMERA_CODECS:
        yield Finding.of("transfer/codec", codec=info.codec)


def findings_from_channels(info: CaptureInfo) -> Iterator[Finding]:
    """Find footage without colour."""
    if info.chroma == "grey":
        yield Finding.of("grey")


def findings_from_tag(info: CaptureInfo, transfer: Transfer, level: Level) -> Iterator[Finding]:
    """Find a stated transfer curve other than the one read with; no tag states a camera's own logarithm."""
    stated, used = info.stated_transfer, transfer.to_text()
    if stated and stated != used and not transfer.is_camera_log:
        yield Finding.of("tag/rig" if level is Level.FATAL else "tag", stated=stated, used=used)
