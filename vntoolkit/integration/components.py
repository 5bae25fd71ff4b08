"""The free offset of a depth map: one per connected component of its domain."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from vntoolkit.arrays import Mask


class Components:
    """Connected components (over shared pixel sides) of a domain, (h, w) bool."""

    def __init__(self, domain: Mask) -> None:
        self.labels, self.count = ndimage.label(domain)
        self._domain = domain
        self._flat = self.labels.ravel()
        self._sizes = np.bincount(self._flat, minlength=self.count + 1)

    def remove_means(self, values: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float64]:
        """Shift `values` (h, w) to mean 0 over each component; 0 outside the domain."""
        return np.where(self._domain, values - self._means(values), 0.0)

    def scale_means(self, values: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float64]:
        """Scale `values` (h, w) to mean 1 over each component; 0 outside the domain."""
        return np.where(self._domain, values / self._means(values), 0.0)

    def _means(self, values: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float64]:
        """Mean over the component of each pixel, (h, w) or a scalar."""
        if self.count == 1:
            return np.asarray(values[self._domain].mean(dtype=np.float64))
        sums = np.bincount(self._flat, weights=values.ravel(), minlength=self.count + 1)
        means = sums / np.maximum(self._sizes, 1)
        return np.where(self._domain, means[self.labels], 1.0)
