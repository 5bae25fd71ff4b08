"""Standard deviations: told by a median, and how many of them hold nine of ten errors.

All for normal distributions. A median keeps its value where up to half of the residuals are outliers.
"""

import numpy as np

from vntoolkit.arrays import ArrayLike

MEDIAN_TO_DEVIATION = 1.4826
# Standard deviations of one component that nine of ten numbers, vectors of a plane (√(2 ln 10)), vectors of
# space stay within.
NINE_OF_TEN, NINE_OF_TEN_IN_PLANE, NINE_OF_TEN_IN_SPACE = 1.645, 2.146, 2.5


def robust_deviation(residuals: ArrayLike) -> float:
    """Return the standard deviation of residuals about 0, of any shape, by their median size."""
    return MEDIAN_TO_DEVIATION * float(np.median(np.abs(residuals)))
