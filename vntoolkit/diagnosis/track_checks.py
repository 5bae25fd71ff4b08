"""Where tracking lost the surface."""

from collections.abc import Sequence

import numpy as np

from vntoolkit.diagnosis.finding import Finding, Level

_JUMP = 10.0  # times the expected error of the frame before; a surface that fades is lost more slowly
_LEAST_ERROR_PX = 0.2
_LEAST_VISIBLE = 0.5  # of a tracked surface's vertices; of a head that turns away more stay in view


def findings_from_tracks(
    visible: Sequence[float], error_px: Sequence[float], numbers: Sequence[int]
) -> list[Finding]:
    """Find where tracking lost the surface.

    visible: share of the vertices that are reported visible, for every frame in the order of time. error_px:
    the median of their expected errors. numbers: of these frames.
    """
    shares = np.asarray(visible, dtype=np.float64)
    if not len(shares) or shares.min() >= _LEAST_VISIBLE:
        return []
    worst, low = int(np.argmin(shares)), int(np.count_nonzero(shares < _LEAST_VISIBLE))
    errors = np.asarray(error_px, dtype=np.float64)
    seen = shares >= _LEAST_VISIBLE
    rise = np.abs(np.diff(np.log(np.maximum(errors, _LEAST_ERROR_PX)))) * (seen[1:] != seen[:-1])
    rise[np.minimum(errors[:-1], errors[1:]) == 0] = 0.0  # beside the template
    problem = f"tracking lost most of the surface in {low} of {len(shares)} frames, most in {numbers[worst]}"
    remedy = "look at the checkerboard there, and give a template in the middle of the sequence (--template)"
    jumps = bool(rise.max(initial=0.0) > np.log(_JUMP))
    if jumps:
        where = int(np.argmax(rise))
        problem += f", at once between frames {numbers[where]} and {numbers[where + 1]}"
        remedy = (
            "the surface jumps there: film at a higher frame rate, or track the parts before and after by "
            "themselves"
        )
    return [
        Finding(
            check="jump" if jumps else "lost",
            level=Level.WARNING,
            problem=problem,
            measured=f"{shares[worst]:.0%} of the vertices reported visible",
            expected=f"{_LEAST_VISIBLE:.0%} and more",
            remedy=remedy,
        )
    ]
