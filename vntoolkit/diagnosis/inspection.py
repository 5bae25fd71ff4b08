"""Faults of footage that spoil normals: the findings of `vntoolkit doctor`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Mask
from vntoolkit.checks import require_positive
from vntoolkit.diagnosis.exposure_drift import drift_of_static_part
from vntoolkit.diagnosis.rig_match import findings_from_rig
from vntoolkit.errors import BadCapture
from vntoolkit.io.footage.captures import Capture, CaptureInfo, CaptureOptions, open_capture
from vntoolkit.io.footage.decoding import linear_frame_from_encoded
from vntoolkit.io.footage.pixel_formats import LOSSLESS_CODECS
from vntoolkit.io.footage.sequence import text_of_names
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, TransferCurve

_LOSSLESS_IMAGES = frozenset({"PNG", "TIFF", "BMP", "EXR"})
_CAMERA_CODECS = frozenset({"JPEG", "h264", "hevc", "mjpeg", "prores", "av1", "vp9"})
_BLACK = 0.01  # of full scale: a frame in which nothing is brighter shows nothing
_CLIPPED_WHOLLY = 0.98
_CLIPPED_TOO_MUCH = 0.001
_DIM = 0.25  # a brightest percentile below it wastes two bits
# Degrees that subsampled chroma costs on fine detail, measured on rendered captures.
_CHROMA_COST_DEG = {"4:2:0": 7, "4:2:2": 5, "4:4:0": 5, "4:1:1": 7}
_FRAMES_COMPARED = 6
_NARROW_CONE_DEG = 20.0  # as calibration warns


class Severity(Enum):
    """How much a finding matters."""

    NOTE = "note"
    WARNING = "warning"
    FATAL = "fatal"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One fault of the footage, with its remedy."""

    severity: Severity
    text: str


@dataclass(frozen=True, kw_only=True)
class CaptureReport:
    """What was found in a capture.

    examined: the numbers of the frames looked at. clipped_share, dark_share: of all pixels of these frames,
    the share with a channel at the white level, and with no channel above 1 % of full scale. brightest: the
    99th percentile of the largest channel, linear, full scale = 1.
    """

    info: CaptureInfo
    examined: tuple[int, ...]
    clipped_share: float
    dark_share: float
    brightest: float
    findings: tuple[Finding, ...]


def inspect_capture(
    source: Path | str,
    options: CaptureOptions | None = None,
    *,
    rig: Rig | None = None,
    mask: Mask | None = None,
    samples: int = 7,
) -> CaptureReport:
    """Look at `samples` frames, evenly spaced, and at what the headers say.

    With a rig its transfer curve is used, and the order of the channels and the curve are checked against it,
    inside `mask` (h, w) where given: a background of another material would hide what the surface shows.
    """
    require_positive(samples, "samples")
    if options is None:
        options = CaptureOptions() if rig is None else CaptureOptions(transfer=rig.transfer)
    capture = open_capture(source, options)
    info = capture.info
    there = capture.present
    numbers = sorted({there[round(k)] for k in np.linspace(0, len(there) - 1, samples)})
    findings = [*_findings_from_info(info), *_findings_from_transfer(info, options.transfer)]
    clipped, dark, bright = [], [], []
    for number in numbers:
        encoded = next(capture.encoded_frames(number, number + 1))
        frame = linear_frame_from_encoded(encoded, options.transfer)
        largest = frame.rgb.max(axis=2)
        clipped.append(float(frame.clipped.mean()))
        dark.append(float((largest < _BLACK).mean()))
        bright.append(float(np.percentile(largest, 99)))
        try:
            require_exposed(frame, f"frame {number}")
        except BadCapture as problem:
            findings.append(Finding(severity=Severity.FATAL, text=str(problem)))
    findings += _findings_from_exposure(float(np.mean(clipped)), max(bright))
    if rig is not None:
        texts = findings_from_capture(capture, rig, mask)
        findings += [Finding(severity=Severity.WARNING, text=text) for text in texts]
    return CaptureReport(
        info=info,
        examined=tuple(numbers),
        clipped_share=float(np.mean(clipped)),
        dark_share=float(np.mean(dark)),
        brightest=max(bright),
        findings=tuple(findings),
    )


def require_exposed(frame: LinearFrame, name: str) -> None:
    """Raise `BadCapture` for a frame that is black or clipped all over."""
    brightest = float(frame.rgb.max(initial=0.0))
    if brightest < _BLACK:
        raise BadCapture(
            f"{name} is black: its brightest value is {brightest:.2%} of full scale; are the lights on and "
            "the lens open?"
        )
    share = float(frame.clipped.mean())
    if share > _CLIPPED_WHOLLY:
        raise BadCapture(f"{name} is clipped at {share:.0%} of its pixels: lower the exposure and film again")


def _findings_from_info(info: CaptureInfo) -> list[Finding]:
    findings = []

    def add(severity: Severity, text: str) -> None:
        findings.append(Finding(severity=severity, text=text))

    if info.promised_frame_count > info.frame_count:
        add(
            Severity.FATAL,
            f"the video is cut off: it declares {info.promised_frame_count} frames, {info.frame_count} came; "
            f"copy the file again, or use what came with --frames 0:{info.frame_count}",
        )
    if info.missing:
        names = text_of_names(list(info.missing.values()))
        add(
            Severity.FATAL,
            f"{len(info.missing)} of {info.frame_count} files of the sequence are missing: {names}; copy "
            "them too, or leave these frames out with --gaps skip",
        )
    if info.left_out:
        names = text_of_names([path.name for path in info.left_out])
        add(Severity.WARNING, f"left out, since the frames are named otherwise: {names}")
    if info.chroma == "grey":
        add(Severity.FATAL, "the footage is grey: three coloured lights need a colour camera")
    elif info.chroma in _CHROMA_COST_DEG:
        add(
            Severity.WARNING,
            f"chroma subsampling {info.chroma} costs about {_CHROMA_COST_DEG[info.chroma]} degrees on fine "
            "detail; record RGB or 4:4:4 (8-bit RGB costs 0.3), or halve the picture size",
        )
    if info.codec not in LOSSLESS_CODECS and info.codec not in _LOSSLESS_IMAGES:
        add(
            Severity.WARNING,
            f"{info.codec} is a lossy codec at most settings: its blocks show up as relief; record "
            "losslessly, or with the highest bit rate",
        )
    if info.bits == 8:
        add(Severity.NOTE, "8 bits per channel cost about 0.3 degrees; 10 or more would not")
    return findings


def _findings_from_transfer(info: CaptureInfo, transfer: Transfer) -> list[Finding]:
    if transfer.curve is not TransferCurve.LINEAR:
        return []
    if info.stated_transfer not in ("", "linear"):
        text = f"the file states the transfer curve {info.stated_transfer} but is read as linear"
        return [Finding(severity=Severity.WARNING, text=f"{text}; give --transfer {info.stated_transfer}")]
    if info.codec in _CAMERA_CODECS:
        text = f"{info.codec} files of cameras and telephones are rarely linear; if this one is not, give"
        return [Finding(severity=Severity.NOTE, text=f"{text} --transfer bt709 (video) or srgb (JPEG)")]
    return []


def _findings_from_exposure(clipped_share: float, brightest: float) -> list[Finding]:
    findings = []
    if clipped_share > _CLIPPED_TOO_MUCH:
        text = f"{clipped_share:.1%} of the pixels are clipped: no normal there; lower the exposure"
        findings.append(Finding(severity=Severity.WARNING, text=text))
    if _BLACK <= brightest < _DIM:
        text = f"the picture uses {brightest:.0%} of the range: open the lens, more light means less noise"
        findings.append(Finding(severity=Severity.NOTE, text=text))
    return findings


# Mistakes of the user that the footage shows. A finding is one line with the remedy.


def findings_from_capture(
    capture: Capture, rig: Rig, mask: Mask | None = None, numbers: range | None = None
) -> list[str]:
    """Check a capture against its rig: calibrated cone, channel order, curve, white balance, drift.

    mask: (h, w) where the surface is. numbers: the frames that matter, default all; a few of them are read.
    """
    numbers = numbers or range(len(capture))
    findings = findings_from_quality(rig)
    transfer = capture.options.transfer
    chosen = frames_to_compare(capture, numbers)
    middle = chosen[len(chosen) // 2]
    compared = []
    for number in chosen:
        for encoded in capture.encoded_frames(number, number + 1):
            compared.append(linear_frame_from_encoded(encoded, transfer))
            if number == middle:
                findings += findings_from_rig(encoded, rig, transfer, mask, capture.background)
    if len(compared) > 1:
        drift = drift_of_static_part(compared)
        findings += [] if drift is None else [drift.to_text()]
    return findings


def frames_to_compare(capture: Capture, numbers: range) -> list[int]:
    """Return a few numbers, evenly spread, moved to key frames nearby, which are quick to reach."""
    first, last = numbers[0], numbers[-1]
    within = (last - first) // (2 * (_FRAMES_COMPARED - 1))
    chosen = set()
    for place in np.linspace(0, len(numbers) - 1, _FRAMES_COMPARED).round().astype(int):
        quick = capture.readable_alone(numbers[place], within)
        chosen.add(quick if first <= quick <= last else numbers[place])
    return sorted(chosen)


def findings_from_quality(rig: Rig) -> list[str]:
    """Return a line where the rig was fitted on normals that lean too little."""
    quality = rig.quality
    if quality is None or quality.samples == 0 or quality.cone_deg >= _NARROW_CONE_DEG:
        return []
    return [
        f"the rig was fitted on normals within {quality.cone_deg:.0f} degrees of their mean: steeper are "
        f"a guess; calibrate again with the target tilted by {_NARROW_CONE_DEG:.0f} degrees and more"
    ]
