"""Faults of footage that spoil normals: the findings of `vntoolkit doctor`."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Mask
from vntoolkit.checks import require_positive
from vntoolkit.diagnosis import evidence as evidences
from vntoolkit.diagnosis import flicker
from vntoolkit.diagnosis import sharpness as sharp
from vntoolkit.diagnosis.added_light import check_black_level, check_gloss
from vntoolkit.diagnosis.finding import Finding, Level
from vntoolkit.diagnosis.header_checks import (
    CHROMA_COST_DEG,
    findings_from_channels,
    findings_from_header,
    findings_from_tag,
)
from vntoolkit.diagnosis.lamp_nearness import Nearness, finding_from_nearness, fit_nearness
from vntoolkit.diagnosis.outline import check_outline
from vntoolkit.diagnosis.rig_checks import check_stated_focal, check_zoom, findings_from_rig
from vntoolkit.diagnosis.surface_match import (
    check_mistakes,
    check_structure,
    note_of_levelled_paint,
    paint_may_hide_surface,
)
from vntoolkit.diagnosis.transfer_match import check_calibrated_transfer, check_transfer
from vntoolkit.diagnosis.white_balance import check_changing_gains, check_white_balance
from vntoolkit.io.footage.captures import Capture, CaptureInfo, CaptureOptions, open_capture
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.io.footage.mattes import Mattes, open_mattes
from vntoolkit.options.footage import MatteOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer

_BLACK = 0.01  # of full scale
_CLIPPED_TOO_MUCH = 0.001
_CLIPPED_FATALLY = 0.1
_FULL = 0.995  # of full scale
_TOP_VALUES = 3  # stored values that a plateau has, for a codec's noise, and as many just below it
_STEEP = 4.0  # times as many pixels: what is lit evenly, such as a wall, thins out as its noise does
_DIM = 0.25  # a brightest percentile below it wastes two bits
_FRAMES_COMPARED = 6


@dataclass(frozen=True, kw_only=True)
class CaptureReport:
    """What was found in a capture.

    transfer: curve that the stored values were read with. examined: the numbers of the frames looked at.
    clipped_share, dark_share: of all pixels of these frames, the share with a channel at the white level, and
    with no channel above 1 % of full scale. brightest: the 99th percentile of the largest channel, linear,
    full scale = 1.
    """

    info: CaptureInfo
    transfer: Transfer
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
    mask: Mask | Path | str | None = None,
    matting: MatteOptions | None = None,
    plate: Path | None = None,
    samples: int = 7,
) -> CaptureReport:
    """Look at `samples` frames, evenly spaced, and at what the headers say.

    With a rig its transfer curve is the default, and the footage is checked against it, inside `mask` where
    given: (h, w), or as `open_mattes` takes it, with `matting` and the clean `plate` that its key needs. A
    background of another material would hide what the surface shows.
    """
    require_positive(samples, "samples")
    options = options or CaptureOptions()
    if rig is not None:  # read as `reconstruct` does
        options = replace(options, transfer=options.transfer or rig.transfer, response=rig.response)
    capture = open_capture(source, options)
    info = capture.info
    if isinstance(mask, np.ndarray):
        mattes = Mattes(still=mask)
    else:
        mattes = open_mattes(capture, mask, matting, plate)
    numbers = sampled(capture.present, samples)
    findings = list(findings_from_header(capture))
    if rig is None:
        findings += findings_from_tag(info, capture.transfer, Level.WARNING)
    white = capture.transfer.diffuse_white
    clipped, dark, bright = [], [], []
    for number in numbers:
        frame = capture.frame(number)
        largest = frame.rgb.max(axis=2)
        clipped.append(float(frame.clipped.mean()))
        dark.append(float((largest < _BLACK * white).mean()))
        bright.append(float(np.percentile(largest, 99)))
    if _BLACK <= max(bright) / white < _DIM:
        findings.append(Finding.of("dim", brightest=max(bright) / white))
    shown: Sequence[int] = capture.present
    if rig is None or rig.gel is None or capture.background is None:
        from vntoolkit.diagnosis.steps import steps_of
        from vntoolkit.diagnosis.subject import finding_from_empty_frames, survey_of

        survey = survey_of(capture, mattes, capture.present)
        shown = survey.frames_like(survey.shown, capture.present)
        if empty := sorted(set(capture.present) - set(shown)):
            findings.append(finding_from_empty_frames(empty, len(capture.present)))
        steps = steps_of(survey, None if rig is None else rig.response)
        findings += steps.findings
        shown = survey.frames_like(steps.alike, shown)
    findings += examine_capture(capture, rig, *mattes.judged(capture, shown or capture.present)).findings
    return CaptureReport(
        info=info,
        transfer=capture.transfer,
        examined=tuple(numbers),
        clipped_share=float(np.mean(clipped)),
        dark_share=float(np.mean(dark)),
        brightest=max(bright),
        findings=tuple(findings),
    )


def findings_from_clipping(frames: Sequence[LinearFrame], mask: Mask | None) -> list[Finding]:
    """Find how much of the subject, or of the picture without a mask, is clipped."""
    if not frames:
        return []
    share = float(np.mean([(f.clipped if mask is None else f.clipped[mask]).mean() for f in frames]))
    if not round(share, 3) > _CLIPPED_TOO_MUCH:  # as it is printed beside the limit
        return _findings_from_plateau(frames, mask)
    return [Finding.of("clipping", level=_level_of_clipping(share), share=share)]


def _level_of_clipping(share: float) -> Level:
    return Level.FATAL if share > _CLIPPED_FATALLY else Level.WARNING


def _findings_from_plateau(frames: Sequence[LinearFrame], mask: Mask | None) -> list[Finding]:
    """Find a channel that ends below full scale: far more pixels at its largest value than just below it.

    Light that is not clipped thins out towards its largest values.
    """
    for channel, name in enumerate(evidences.CHANNELS):
        shown = [frame.rgb[..., channel] if mask is None else frame.rgb[mask, channel] for frame in frames]
        values = np.concatenate([each.ravel() for each in shown])
        top = float(values.max(initial=0.0))
        if not _BLACK < top < _FULL:
            continue
        counts = np.unique(values, return_counts=True)[1][-2 * _TOP_VALUES :]
        if len(counts) < 2 * _TOP_VALUES:
            continue
        below, at_top = counts[:_TOP_VALUES].sum(), counts[_TOP_VALUES:].sum()
        if at_top > _CLIPPED_TOO_MUCH * len(values) and at_top > _STEEP * below:
            share = at_top / len(values)
            level, times = _level_of_clipping(share), at_top / below
            return [
                Finding.of("clipping/plateau", level=level, share=share, channel=name, top=top, times=times),
            ]
    return []


# What a user may have got wrong, told by the footage itself.


@dataclass(frozen=True, kw_only=True)
class Examination:
    """findings: what a capture tells. nearness: of the lamps, as far as established; see `Nearness`.

    blur_px: standard deviation of the blur of colours, 0 where nothing tells it; see `Sharpness`.
    """

    findings: list[Finding]
    nearness: float = 0.0
    blur_px: float = 0.0


def examine_capture(
    capture: Capture,
    rig: Rig | None,
    mask: Mask | None = None,
    numbers: Sequence[int] | None = None,
    in_one_material: Callable[[LinearFrame], LinearFrame] | None = None,
) -> Examination:
    """Check a capture: clipping, and with a rig all that `checks` lists, and how near lamps are.

    rig: its transfer is the one it was calibrated with; the capture's own options say how it is read. mask:
    (h, w) where the surface is. numbers: the frames that matter, default all; a few of them are read.
    in_one_material: makes a frame of several materials look as if it were of the rig's alone. Raises
    `BadCapture` for a frame that cannot be read.
    """
    frames, in_a_row = _frames_to_judge(capture, numbers, flicker.FRAMES_IN_A_ROW)
    findings = [*findings_from_channels(capture.info), *findings_from_clipping(frames, mask)]
    if capture.info.chroma == "grey" or not frames:
        return Examination(findings=findings)
    small = [evidences.averaged_down(frame) for frame in frames]
    near: Nearness | None = None
    places = sorted({0, len(frames) // 2, len(frames) - 1})
    if rig is not None:
        findings += findings_from_tag(capture.info, capture.transfer, Level.FATAL)
        findings += check_stated_focal(rig, capture.info.stated_focal_px)
        height, width = frames[0].shape
        if (width, height) != rig.footage_size:
            camera = "×".join(map(str, rig.footage_size))
            findings += findings_from_rig(rig)
            findings.append(Finding.of("size", width=width, height=height, camera=camera))
            return Examination(findings=findings)
        few, most = [small[k] for k in places], evidences.FEW_PIXELS
        if in_one_material is not None and rig.gel is None:
            apart = sorted({places[0], places[-1]})  # labels take a quarter of a second a frame
            few, most = [in_one_material(frames[k]) for k in apart], evidences.PIXELS_BETWEEN_SEAMS
        evidence = evidences.evidence_from_frames(few, rig, capture.transfer, mask, most)
        with_rig = _findings_with_rig(
            evidence,
            lambda: evidences.evidence_from_frames(
                [frames[k] for k in places], rig, capture.transfer, mask, evidences.PIXELS_BETWEEN_SEAMS
            ),
        )
        findings += with_rig
        if rig.gel is not None:
            return Examination(findings=findings)
        # drift is the same all over a picture, and the fit has a level for each picture
        trusted = all(finding.level is Level.NOTE or finding.check == "drift" for finding in with_rig)
        if trusted and _is_wide(evidence):
            near = fit_nearness(evidence)
    if any(finding.level is Level.FATAL for finding in findings):
        return Examination(findings=findings)
    findings += _findings_over_time(in_a_row, rig, capture.transfer, mask)
    sharpness = sharp.fit_sharpness([frames[k] for k in places], mask)
    if sharpness is not None:
        findings += sharp.findings_from_sharpness(sharpness)
    if near is not None and near.established:
        findings.append(finding_from_nearness(near))
    return Examination(
        findings=findings,
        nearness=0.0 if near is None else near.established,
        blur_px=blur_of_colours(sharpness, capture.info.chroma, frames[places[0]]),
    )


def blur_of_colours(sharpness: sharp.Sharpness | None, chroma: str, frame: LinearFrame) -> float:
    """Return the blur of a frame's colours in pixels: the lens's, and that of what was interpolated."""
    blur_px = 0.0 if sharpness is None else sharpness.over_all_px
    if chroma in CHROMA_COST_DEG or sharp.colour_is_interpolated(frame):
        return math.hypot(blur_px, sharp.OF_INTERPOLATION_PX)
    return blur_px


def findings_from_frames(
    frames: Sequence[LinearFrame],
    rig: Rig,
    transfer: Transfer,
    mask: Mask | None = None,
    most_pixels: int = evidences.FEW_PIXELS,
) -> list[Finding]:
    """Check a rig and a few frames of its size, read with `transfer`, by all that `checks` lists.

    most_pixels: that frames are averaged down to.
    """
    return _findings_with_rig(
        evidences.evidence_from_frames(frames, rig, transfer, mask, most_pixels),
        lambda: evidences.evidence_from_frames(frames, rig, transfer, mask, evidences.PIXELS_BETWEEN_SEAMS),
    )


def _findings_with_rig(
    evidence: evidences.Evidence, closer: Callable[[], evidences.Evidence]
) -> list[Finding]:
    findings = findings_from_rig(evidence.rig)
    # the response of a gel is to changes, which the checks do not look at
    if evidence.rig.gel is None and _is_wide(evidence):
        findings += findings_from_evidence(evidence, closer)
    return findings


def _is_wide(evidence: evidences.Evidence) -> bool:
    return min(evidence.light.shape[1:3]) >= evidences.NARROWEST_PX


def _findings_over_time(
    in_a_row: Sequence[LinearFrame], rig: Rig | None, transfer: Transfer, mask: Mask | None
) -> list[Finding]:
    """Compare consecutive frames, averaged down, with each other."""
    if rig is None or len(in_a_row) < 3:
        return []
    evidence = evidences.evidence_from_frames(in_a_row, rig, transfer, mask)
    return flicker.check_flicker(evidence) if _is_wide(evidence) else []


def findings_from_calibration_footage(
    capture: Capture, mask: Mask | None = None, numbers: range | None = None
) -> list[Finding]:
    """Check footage to calibrate on: channels, clipping inside `mask` (h, w), and the curve it states."""
    clipping = findings_from_clipping(_frames_to_judge(capture, numbers)[0], mask)
    tag = findings_from_tag(capture.info, capture.transfer, Level.WARNING)
    return [*findings_from_channels(capture.info), *clipping, *tag]


def _frames_to_judge(
    capture: Capture, numbers: Sequence[int] | None, in_a_row: int = 0
) -> tuple[list[LinearFrame], list[LinearFrame]]:
    """Read a few frames from all over, and the first ones in a row, averaged down, in one pass."""
    numbers = numbers or range(len(capture))
    first = numbers[:in_a_row]
    if not set(capture.present).issuperset(first):
        first = first[:0]
    spread = set(frames_to_compare(capture, numbers)).difference(capture.info.missing)
    over_all, consecutive = [], []
    for number in sorted(spread.union(first)):
        frame = capture.frame(number)
        if number in spread:
            over_all.append(frame)
        if number in first:
            consecutive.append(evidences.averaged_down(frame))
    return over_all, consecutive


def frames_to_compare(capture: Capture, numbers: Sequence[int]) -> list[int]:
    """Return a few numbers, evenly spread, moved to key frames nearby, which are quick to reach."""
    first, last = numbers[0], numbers[-1]
    within = (last - first) // (2 * (_FRAMES_COMPARED - 1))
    chosen = set()
    for number in sampled(numbers, _FRAMES_COMPARED):
        quick = capture.readable_alone(number, within)
        chosen.add(quick if first <= quick <= last else number)
    return sorted(chosen)


# What a few frames tell of the rig, the mask and the transfer curve.

_LIT_OF_MASK = 0.15  # of the brightest hundredth of the picture
_LEAST_LIT = 0.3
_FEWEST_OF_MASK = 50


def check_mask(evidence: evidences.Evidence) -> list[Finding]:
    """Find a mask that covers the dark and leaves out what is lit."""
    if not evidence.masked:
        return []
    brightest = evidences.brightest_channel(evidence.light)
    lit = brightest > _LIT_OF_MASK * np.percentile(brightest, 99)
    inside, outside = evidence.inside, ~evidence.inside
    if min(int(inside.sum()), int(outside.sum())) < _FEWEST_OF_MASK:
        return []
    within, without = float(lit[inside].mean()), float(lit[outside].mean())
    if within >= _LEAST_LIT or without <= 2 * within:
        return []
    return [Finding.of("mask", within=within, without=without)]


# Each group is asked only where no check of a group before it found more than a note: a mask on the backdrop
# explains noise, noise explains a surface that cannot be, exchanged channels explain lengths that vary, and
# highlights explain contrast that is too high.
CAPTURE_CHECKS: tuple[tuple[Callable[[evidences.Evidence], list[Finding]], ...], ...] = (
    (check_mask,),
    (check_structure,),
    (check_mistakes,),
    (check_zoom,),
    (check_outline, check_calibrated_transfer, check_transfer),
    (check_gloss,),
    (check_black_level,),
    (check_white_balance, check_changing_gains),
)

# They compare lengths of M⁻¹(r − a), which clipping cuts, and of which levelled paint leaves little.
_OF_LENGTHS = (
    check_zoom, check_transfer, check_black_level, check_gloss, check_white_balance, check_changing_gains,
)  # fmt: skip
_MOST_CLIPPED = 0.05  # of the subject


def findings_from_evidence(
    evidence: evidences.Evidence, closer: Callable[[], evidences.Evidence] | None = None
) -> list[Finding]:
    """Return what a few frames tell of the rig, the mask and the transfer curve.

    closer: gives the same frames averaged less, which are judged as if of one paint where that makes more of
    a surface.
    """
    noted: list[Finding] = []
    for group in CAPTURE_CHECKS:
        if check_mistakes in group and closer is not None and paint_may_hide_surface(evidence):
            levelled = closer().levelled
            if note := note_of_levelled_paint(levelled, evidence):
                evidence = levelled
                noted.append(note)
        asks_lengths = evidence.painted is None and evidence.clipped_share < _MOST_CLIPPED
        asked = [check for check in group if asks_lengths or check not in _OF_LENGTHS]
        found = [finding for check in asked for finding in check(evidence)]
        if any(finding.level is not Level.NOTE for finding in found):
            return noted + found
        noted += found
    return noted
