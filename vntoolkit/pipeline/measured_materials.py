"""The subject's materials, measured once on the first frames of a run that show it."""

import logging
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import Mask, MaterialLabels, Vector3
from vntoolkit.errors import BadInput
from vntoolkit.io.results.manifest import MaterialEntry
from vntoolkit.materials.grey_paint import CLEAR, nats_over_grey, weighed_against_grey
from vntoolkit.materials.labelling import FrameStatistics, LabelState, MaterialLabeller
from vntoolkit.materials.relighting import relit
from vntoolkit.materials.search import (
    WORST_ERROR_DEG,
    Material,
    SearchedFrames,
    find_materials,
    searched_frames,
)
from vntoolkit.options.reconstruction import MaterialSearch, ReconstructOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.pipeline.request import Footage
from vntoolkit.pipeline.rig_material import (
    JUDGED,
    LIT_SHARE,
    MOST_UNEXPLAINED,
    REMEDY,
    WRONG_LENGTH,
    share_of_wrong_lengths,
)
from vntoolkit.pipeline.threads import read_ahead

logger = logging.getLogger(__name__)
_LOOKED_AT = 3  # frames …
_APART = 8  # … this far from each other, where there are as many: the subject then shows other normals
_MOST_UNEXPLAINED_OF_ANY = 0.4  # more, and nothing that was found can be trusted


def first_frames(
    rig: Rig, options: ReconstructOptions, footage: Footage, numbers: Sequence[int]
) -> Iterator[tuple[LinearFrame, Mask]]:
    """Yield the first frame and some in which the subject has moved, each with the subject (h, w).

    Every lamp is as strong as at the centre.
    """
    there, capture = footage.usable(numbers), footage.capture
    step = max(1, min(_APART, (len(there) - 1) // (_LOOKED_AT - 1)))
    looked_at = there[::step][:_LOOKED_AT]
    for encoded in read_ahead(map(capture.encoded, looked_at), len(looked_at)):
        processor = FrameProcessor(rig, options, footage.mattes.of(encoded), capture.background)
        frame = processor.linear(encoded)
        yield processor.by_strength(frame), processor.lit_subject(frame)


def measured_materials(
    rig: Rig, options: ReconstructOptions, footage: Footage, numbers: Sequence[int]
) -> tuple[list[MaterialEntry], FrameStatistics | None]:
    """Measure the materials on the first frames; return them, and where not all is the rig's what the first
    told of noise and blur.

    Logs a warning where the footage cannot tell. Raises `BadInput` where a number of materials is asked for
    that cannot be told.
    """
    response, choice = rig.response, options.materials
    levelled, subjects = zip(*first_frames(rig, options, footage, numbers), strict=True)
    central = response.central
    count = None if isinstance(choice, MaterialSearch) else choice
    searched = searched_frames(levelled, subjects, central)
    found = _better_than_grey(find_materials(searched, count), searched, count)
    if found:
        values = np.array([each.reflectance.values for each in found])
        labeller = MaterialLabeller(response=central, reflectances=values)
        labels, state = labeller.labels(levelled[0], subjects[0], LabelState())
        seen = LabelledFrame(
            frame=levelled[0], mask=subjects[0], labeller=labeller, labels=labels, state=state
        )
        if found := _known_apart(found, choice):
            found, pigments = _with_pigments(found, seen)
            if found := _explaining(found, pigments, seen, choice):
                weighed = weighed_against_grey(found, searched)
                return list(map(_entry, weighed, pigments)), seen.state.statistics
    return [], None


def _better_than_grey(found: list[Material], searched: SearchedFrames, count: int | None) -> list[Material]:
    """Return the materials, or one, or none where one paint of the rig's hue describes frames as well.

    count: the number that was asked for; None for any. Several that were asked for are kept.
    """
    if count is not None and count > 1:
        return found
    for each in (found, find_materials(searched, 1)):
        if nats_over_grey(each, searched) >= CLEAR:
            return each
    if count == 1:
        logger.warning(
            "materials: another colour explains the subject no better than gloss and light between folds do; "
            "the rig's material is taken; %s", REMEDY,
        )  # fmt: skip
    return []


def _known_apart(found: list[Material], choice: MaterialSearch | int) -> list[Material]:
    """Return the materials, none where nothing can be told; say which are uncertain."""
    worst = max(material.reflectance.error_deg for material in found)
    if worst <= WORST_ERROR_DEG:
        return found
    spread = "the normals spread too little, or two lamps are too alike in colour"
    if len(found) == 1:
        turn = f"{worst:.0f} degrees" if worst < 90.0 else "more than 90 degrees"
        message = (
            f"materials: the subject's reflectance cannot be told (its error turns normals by {turn}): "
            f"{spread}; {REMEDY}"
        )
        if choice is not MaterialSearch.AUTO:
            raise BadInput(message)
        logger.warning("%s; the rig's material is taken", message)
        return []
    for number, material in enumerate(found):
        if material.reflectance.error_deg > WORST_ERROR_DEG:
            logger.warning(
                "materials: the reflectance of material %d (%.0f %% of the subject) may turn normals by %.0f "
                "degrees: %s; %s",
                number, 100 * material.share, material.reflectance.error_deg, spread, REMEDY,
            )  # fmt: skip
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class LabelledFrame:
    """A frame whose pixels are labelled, (h, w), by the materials of its labeller.

    state: what the frame told of noise and blur.
    """

    frame: LinearFrame
    mask: Mask
    labeller: MaterialLabeller
    labels: MaterialLabels
    state: LabelState


def _with_pigments(found: list[Material], seen: LabelledFrame) -> tuple[list[Material], list[Vector3 | None]]:
    """Return the materials, and the line (3,) along which each changes, None where it hardly does."""
    materials, pigments = [], []
    told = seen.labeller.pigments_of(seen.frame, seen.mask, seen.labels, seen.state)
    for each, pigment in zip(found, told, strict=True):
        values = each.reflectance.values if pigment is None else np.exp(pigment[1])
        materials.append(replace(each, reflectance=replace(each.reflectance, values=values)))
        pigments.append(None if pigment is None else pigment[0])
    return materials, pigments


def _explaining(
    found: list[Material],
    pigments: list[Vector3 | None],
    seen: LabelledFrame,
    choice: MaterialSearch | int,
) -> list[Material]:
    """Return the materials; warn where they leave much of a frame unexplained, and return none where most."""
    response = seen.labeller.response
    values = np.array([each.reflectance.values for each in found])
    along = np.array([np.zeros(3) if each is None else each for each in pigments])
    alike = relit(seen.frame, response, seen.labels, values, along, seen.state.seams, seen.mask)
    sound = np.flatnonzero(seen.mask & ~seen.frame.clipped)
    rgb = alike.rgb.reshape(-1, 3)[sound[:: max(1, len(sound) // JUDGED)]].astype(np.float64)
    lamps = rgb @ response.contributions_from_rgb.T
    lit = (lamps > LIT_SHARE * lamps.max(axis=1, keepdims=True)).all(axis=1)
    length = np.linalg.norm((rgb[lit] - response.ambient) @ response.inverse.T, axis=1)
    wrong = share_of_wrong_lengths(length) if length.size else 0.0
    if wrong <= MOST_UNEXPLAINED:
        return found
    kept = wrong <= _MOST_UNEXPLAINED_OF_ANY
    logger.warning(
        "materials: %.0f %% of the subject is not explained by the %d found: the lengths of its normals are "
        "off by more than %.0f %% (expected in at most %.0f %%). Colours were not found, or the surface is "
        "glossy; the normals there are wrong%s; film closer, so that every patch of one colour is large, or "
        "calibrate on the subject's main material",
        100 * wrong, len(found), 100 * WRONG_LENGTH, 100 * MOST_UNEXPLAINED,
        "" if kept else "; the rig's material is taken",
    )  # fmt: skip
    return found if kept or choice is not MaterialSearch.AUTO else []


def _entry(material: Material, pigment: Vector3 | None) -> MaterialEntry:
    fitted = material.reflectance
    first, second, third = (_short(value) for value in fitted.values)
    return MaterialEntry(
        reflectance=(first, second, third),
        error_deg=round(math.hypot(fitted.error_deg, fitted.lamps_deg, material.alternative_deg), 2),
        residual=round(fitted.residual, 4),
        share=round(material.share, 4),
        pigment=None if pigment is None else (_short(pigment[0]), _short(pigment[1]), _short(pigment[2])),
    )


def _short(value: float) -> float:
    return float(f"{value:.4g}")
