"""All checks, one function each, and what they find in a capture read with a rig."""

from collections.abc import Callable

import numpy as np

from vntoolkit.diagnosis.added_light import check_black_level, check_gloss
from vntoolkit.diagnosis.evidence import Evidence, brightest_channel
from vntoolkit.diagnosis.finding import Finding, Level
from vntoolkit.diagnosis.outline import check_outline
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
    return [Finding.of("mask", within=within, without=without)]


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
    (check_white_balance, check_changing_gains),
)

# They compare lengths of M⁻¹(r − a), which clipping cuts, and of which levelled paint leaves little.
_OF_LENGTHS = (
    check_zoom, check_transfer, check_black_level, check_gloss, check_white_balance, check_changing_gains,
)  # fmt: skip
_MOST_CLIPPED = 0.05  # of the subject


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
