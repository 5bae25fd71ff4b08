"""Where tracking lost the surface."""

from collections.abc import Sequence

import numpy as np

from vntoolkit.diagnosis.finding import Finding

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
    lost = {"low": low, "count": len(shares), "worst": numbers[worst], "share": shares[worst]}
    if not rise.max(initial=0.0) > np.log(_JUMP):
        return [Finding.of("lost", **lost)]
    where = int(np.argmax(rise))
    return [Finding.of("jump", **lost, first=numbers[where], second=numbers[where + 1])]
