"""All checks, one function each, and what they find in a capture read with a rig."""

from collections.abc import Callable

import numpy as np

from vntoolkit.diagnosis.added_light import check_black_level, check_gloss
from vntoolkit.diagnosis.evidence import Evidence, brightest_channel
from vntoolkit.diagnosis.finding import Finding, Level
from vntoolkit.diagnosis.outline import check_cast_shadows, check_outline
from vntoolkit.diagnosis.rig_checks import (
    check_camera,
    check_coverage,
    check_lamps,
    check_residual,
    check_zoom,
)
from vntoolkit.diagnosis.surface_match import (
    check_relatives,
    check_structure,
    note_of_levelled_paint,
    paint_may_hide_surface,
)
from vntoolkit.diagnosis.transfer_match import check_calibrated_transfer, check_transfer
from vntoolkit.diagnosis.white_balance import check_changing_gains, check_white_balance
from vntoolkit.photometry.rig import Rig

RIG_CHECKS: tuple[Callable[[Rig], list[Finding]], ...] = (
    check_camera,
    check_lamps,
    check_residual,
    check_coverage,
)


_LIT = 0.15  # of the brightest hundredth of the picture
_LEAST_LIT = 0.3
_FEWEST_PIXELS = 50


def check_mask(evidence: Evidence) -> list[Finding]:
    """Find a mask that covers the dark and leaves out what is lit."""
    if not evidence.masked:
        return []
    brightest = brightest_channel(evidence.light)
    lit = brightest > _LIT * np.percentile(brightest, 99)
    inside, outside = evidence.inside, ~evidence.inside
    if min(int(inside.sum()), int(outside.sum())) < _FEWEST_PIXELS:
        return []
    within, without = float(lit[inside].mean()), float(lit[outside].mean())
    if within >= _LEAST_LIT or without <= 2 * within:
        return []
    return [
        Finding(
            check="mask",
            level=Level.FATAL,
            problem="the mask covers the dark and leaves out what is lit",
            measured=f"{within:.0%} lit inside the mask, {without:.0%} outside",
            expected=f"{_LEAST_LIT:.0%} or more inside",
            remedy="the mask is inverted or of other footage: white is the subject; invert it",
        )
    ]


# Each group is asked only where no check of a group before it found more than a note: a mask on the backdrop
# explains noise, noise explains a surface that cannot be, exchanged channels explain lengths that vary, and
# highlights explain contrast that is too high.
CAPTURE_CHECKS: tuple[tuple[Callable[[Evidence], list[Finding]], ...], ...] = (
    (check_mask,),
    (check_structure,),
    (check_relatives,),
    (check_zoom,),
    (check_outline, check_calibrated_transfer, check_transfer),
    (check_gloss,),
    (check_black_level,),
    (check_cast_shadows,),
    (check_white_balance, check_changing_gains),
)

# They compare lengths of M⁻¹(r − a), which clipping cuts, and of which levelled paint leaves little.
_OF_LENGTHS = (
    check_zoom, check_transfer, check_black_level, check_gloss, check_white_balance, check_changing_gains,
)  # fmt: skip
_MOST_CLIPPED = 0.05  # of the subject

# What `--allow` takes: every name that a finding of these checks, or one about the footage, can have.
CHECK_NAMES: dict[str, str] = {
    "backdrop": "a backdrop that counts as subject",
    "background": "a picture of the untouched gel that is none, or of another session",
    "black": "frames without a subject",
    "blur": "a picture out of focus, or of something that moved too fast",
    "black-level": "light on every pixel that is none of the lamps', or another range than the file's",
    "bits": "few bits per sample",
    "camera": "a camera that no lens can be",
    "chroma": "colour at a lower resolution than brightness",
    "clipping": "pixels at the white level",
    "codec": "a lossy codec",
    "condition": "M multiplies noise",
    "cone": "a calibration that saw few directions",
    "contacts": "contacts of a ball that are no circles",
    "corners": "a gel seen aslant, without its corners",
    "cut-off": "a file that ends early",
    "drift": "exposure or white balance that changes while filming",
    "dim": "footage that uses little of the range",
    "flat": "a subject without shape",
    "flicker": "light that goes up and down from frame to frame",
    "gaps": "files of a sequence that are missing",
    "gloss": "a surface that reflects the lamps",
    "grey": "footage without colour",
    "jump": "a subject that moves too far between two frames",
    "labels": "labels of presses that do not lie on the dents",
    "lamps": "lamps behind the surface",
    "lost": "a surface that tracking has lost",
    "mask": "a mask off the subject",
    "near-lamps": "lamps that stand near, where M is one for the whole picture",
    "noise": "footage of no surface",
    "outline": "a surface turned inside out",
    "relatives": "M mirrored, turned, transposed or with exchanged channels",
    "residual": "a calibration that contradicts its samples",
    "sharpening": "a picture that was sharpened",
    "size": "frames of another size than the rig's",
    "steps": "a lamp, a channel or the picture that changes at once",
    "stray": "files that are no frames",
    "tag": "a transfer curve that the file states against the one it is read with",
    "times": "times of frames that cannot be",
    "transfer": "a transfer curve that is not the footage's",
    "white-balance": "other gains of the channels than at calibration",
    "zoom": "another focal length than at calibration",
}


def findings_from_rig(rig: Rig) -> list[Finding]:
    """Return what a rig tells by itself."""
    return [finding for check in RIG_CHECKS for finding in check(rig)]


def findings_from_evidence(evidence: Evidence, closer: Callable[[], Evidence] | None = None) -> list[Finding]:
    """Return what a few frames tell of the rig, the mask and the transfer curve.

    closer: gives the same frames averaged less, which are judged as if of one paint where that makes more of
    a surface.
    """
    noted: list[Finding] = []
    for group in CAPTURE_CHECKS:
        if check_relatives in group and closer is not None and paint_may_hide_surface(evidence):
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
