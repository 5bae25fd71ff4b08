"""Checks on arrays and numbers that callers pass in; each raises `BadInput` with one line."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.errors import BadInput

_UNIT_LENGTH_TOLERANCE = 1e-3  # half-float normal maps on disk are exact to 5e-4


def require_shape(
    array: npt.NDArray[Any], shape: tuple[int | None, ...], name: str, error: type[BadInput] = BadInput
) -> None:
    """Raise unless `array` has `shape`; None stands for any length."""
    matches = array.ndim == len(shape) and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    if not matches:
        want = " × ".join("any" if n is None else str(n) for n in shape)
        have = " × ".join(map(str, array.shape)) or "a scalar"
        raise error(f"{name}: expected shape {want}, got {have}")


def require_mask(mask: npt.NDArray[Any], shape: tuple[int, ...], name: str = "mask") -> None:
    """Raise unless `mask` has `shape` and holds booleans: integers 0 and 255 would index differently."""
    if mask.dtype != np.bool_:
        raise BadInput(f"{name}: expected booleans, got {mask.dtype}")
    require_shape(mask, shape, name)


def require_same_size(
    first: npt.NDArray[Any], first_name: str, second: npt.NDArray[Any], second_name: str
) -> None:
    """Raise unless the two images have the same height and width."""
    if first.shape[:2] != second.shape[:2]:
        (h1, w1), (h2, w2) = first.shape[:2], second.shape[:2]
        raise BadInput(f"{first_name} is {w1}×{h1} but {second_name} is {w2}×{h2}: they must have one size")


def require_finite(array: npt.NDArray[Any], name: str, error: type[BadInput] = BadInput) -> None:
    """Raise if `array` holds NaN or infinity."""
    bad = int(np.count_nonzero(~np.isfinite(array)))
    if bad:
        raise error(f"{name}: {bad} of {array.size} values are NaN or infinite")


def require_some(mask: npt.NDArray[np.bool_], name: str, error: type[BadInput] = BadInput) -> None:
    """Raise if no pixel of `mask` is True."""
    if not mask.any():
        raise error(f"{name}: no valid pixel (the mask is empty)")


def require_positive(value: float, name: str) -> None:
    """Raise unless value is a finite number above 0."""
    if not 0 < value < math.inf:
        raise BadInput(f"{name}: expected a positive number, got {value:g}")


def require_in_range(value: float, low: float, high: float, name: str) -> None:
    """Raise unless low <= value <= high."""
    if not low <= value <= high:
        raise BadInput(f"{name}: expected a value from {low:g} to {high:g}, got {value:g}")
