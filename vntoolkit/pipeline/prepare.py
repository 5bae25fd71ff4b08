"""What holds for a whole capture, found once on a few of its frames: before the first frame is reconstructed.

Lamps, materials, near lamps, blur, and what is wrong with footage and rig: each is found by a part of its own
that is imported where it is used.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vntoolkit.arrays import Mask
from vntoolkit.diagnosis.finding import Finding, Level, judge
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.results.manifest import Known, MaterialEntry
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import MaterialSearch
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.pipeline.request import Footage, Request, seeks_materials

if TYPE_CHECKING:
    from vntoolkit.diagnosis.inspection import Examination
    from vntoolkit.materials.labelling import FrameStatistics

logger = logging.getLogger(__name__)
_OF_LAMPS = ("light_colours", "light_doubts_deg")  # what shadows tell
_DIGITS_OF_NEARNESS = 4
_DIGITS_OF_BLUR = 2
_SEAM_PX = 2  # to either side of a seam, where pixels are not judged: blur mixes two materials in them


def prepare(request: Request, footage: Footage, numbers: Sequence[int]) -> Known:
    """Find what holds for the frames `numbers`; log what is wrong.

    Raises `FatalFinding` for what ruins normals, `BadInput` for a reference frame that is not there and for
    materials that cannot be told, `BadCapture` where no frame shows a subject.
    """
    numbers, steps = _surveyed(request, footage, numbers)
    found: dict[str, object] = {"reference_frame": _reference_frame(request, footage, numbers)}
    options, rig = request.effective_options, request.rig
    examined = _examined(request, rig, footage, numbers)
    # What is less than fatal is judged once materials are known. No material excuses what is fatal.
    fatal_alone = seeks_materials(rig, options)
    judged = [each for each in examined.findings if each.level is Level.FATAL or not fatal_alone]
    judge(judged, request.allow)
    if request.is_of_gel:
        return _known(found, steps, examined)
    from vntoolkit.pipeline.rig_material import measured_brightness

    rig, lamps_in_words = _with_found_lamps(request, footage, numbers)
    if rig is not request.rig:
        found |= {name: np.asarray(getattr(rig.response, name)).tolist() for name in _OF_LAMPS}
    found["relative_albedo"], warn_of_other = measured_brightness(rig, options, footage, numbers)
    seeks, seen = seeks_materials(rig, options), None
    if seeks:
        from vntoolkit.pipeline.measured_materials import measured_materials

        materials, seen = measured_materials(rig, options, footage, numbers)
        found["materials"] = materials
    if seen is None:
        warn_of_other(lamps_in_words)
    else:
        examined = _examined(request, rig, footage, numbers, materials, seen)
    if seeks:
        judge(examined.findings, request.allow)
    if rig.response.variation is None:
        found["nearness"] = round(examined.nearness, _DIGITS_OF_NEARNESS)
    return _known(found, steps, examined)


def _known(found: dict[str, object], steps: Sequence[Finding], examined: "Examination") -> Known:
    blur_px = round(examined.blur_px, _DIGITS_OF_BLUR)
    findings = [finding.entry for finding in (*steps, *examined.findings)]
    return Known.model_validate(found | {"blur_px": blur_px, "findings": findings})


def _surveyed(
    request: Request, footage: Footage, numbers: Sequence[int]
) -> tuple[Sequence[int], list[Finding]]:
    """Return frames that show the subject and were filmed alike, and what changes between frames at once."""
    there = footage.usable(numbers)
    if request.is_of_gel or not there:
        return numbers, []
    from vntoolkit.diagnosis.steps import steps_of
    from vntoolkit.diagnosis.subject import survey_of

    try:
        survey = survey_of(footage.capture, footage.mattes, there)
    except BadCapture as problem:  # a bad frame is reported when its turn comes
        logger.debug("frames not surveyed: %s", problem)
        return numbers, []
    if not survey.shown:
        raise BadCapture(
            f"{footage.capture.name}: no frame shows a subject: all that was looked at is black; are the "
            "lamps on, the lens open and the mask on the subject?"
        )
    steps = steps_of(survey, request.rig.response)
    judge(steps.findings, request.allow)
    alike = survey.frames_like(steps.alike, there)
    return numbers if len(alike) == len(there) else alike, steps.findings


def _reference_frame(request: Request, footage: Footage, numbers: Sequence[int]) -> int:
    there = footage.usable(numbers)
    if not there:
        raise BadInput(
            f"{request.source}: the files or mattes of all frames {numbers[0]} to {numbers[-1]} are missing"
        )
    asked, count = request.options.reference_frame, footage.capture.info.frame_count
    if asked is None:
        return there[0]
    if asked >= count:
        raise BadInput(f"reference frame: the capture has only {count} frames")
    return asked


def _with_found_lamps(request: Request, footage: Footage, numbers: Sequence[int]) -> tuple[Rig, str]:
    """Return the rig, with the lamps' colours where shadows tell them, and what they do not tell."""
    options, rig = request.effective_options, request.rig
    is_plain = options.shadows is not ShadowMethod.ROBUST or options.materials is MaterialSearch.CALIBRATED
    if rig.response.light_colours is not None or is_plain:
        return rig, ""
    from vntoolkit.pipeline.found_lamps import find_lamps

    return find_lamps(rig, options, footage, numbers)


def _examined(
    request: Request,
    rig: Rig,
    footage: Footage,
    numbers: Sequence[int],
    materials: Sequence[MaterialEntry] = (),
    told: "FrameStatistics | None" = None,
) -> "Examination":
    """Return what the footage tells of mistakes, with each of the materials taken for the rig's.

    told: of the first frame, as materials were measured on it.
    """
    from vntoolkit.diagnosis.inspection import Examination, examine_capture

    calibrated = rig if request.calibrated is None else replace(rig, transfer=request.calibrated)
    try:
        mask, judged = footage.mattes.judged(footage.capture, numbers)
        alike = None
        if materials:
            alike = in_one_material(FrameProcessor(rig, request.options, mask), rig, materials, told)
        examined = examine_capture(footage.capture, calibrated, mask, judged, alike)
        if rig.gel is not None:
            from vntoolkit.pipeline.gel import findings_from_footage

            of_gel = findings_from_footage(calibrated, footage.capture, judged)
            examined = replace(examined, findings=[*examined.findings, *of_gel])
    except BadCapture as problem:  # a bad frame is reported when its turn comes
        logger.debug("plausibility not checked: %s", problem)
        return Examination(findings=[])
    return examined


def in_one_material(
    processor: FrameProcessor,
    rig: Rig,
    materials: Sequence[MaterialEntry],
    told: "FrameStatistics | None" = None,
) -> Callable[[LinearFrame], LinearFrame]:
    """Return what makes a frame look as if its subject were of the rig's material."""
    from vntoolkit.materials.labelling import LabelState, MaterialLabeller
    from vntoolkit.materials.mixtures import near_seams
    from vntoolkit.materials.relighting import relit

    central = rig.response.central
    reflectances = np.array([each.reflectance for each in materials])
    pigments = np.array([each.pigment or (0.0, 0.0, 0.0) for each in materials])
    labeller = MaterialLabeller(response=central, reflectances=reflectances)

    def judged(frame: LinearFrame) -> LinearFrame:
        # A backdrop's noise looks like dark paint. It would give the subject's rim a wrong label.
        subject: Mask = processor.lit_subject(frame)
        labels, _ = labeller.labels(processor.by_strength(frame), subject, LabelState(statistics=told))
        # lengths alone tell paint here: a surface without paint would fit any M; none is thought to be 1
        seen = relit(frame, central, labels, reflectances, pigments, mask=subject)
        return replace(seen, clipped=seen.clipped | near_seams(labels, _SEAM_PX))

    return judged
