"""Checks on arrays and numbers that callers pass in; each raises `BadInput` with one line."""

import contextlib
import functools
import inspect
import math
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec, TypeVar

import numpy as np

from vntoolkit.arrays import Array, BoolArray, DTypeLike, read_only
from vntoolkit.errors import BadInput

_PACKAGE = "vntoolkit."
_HOW_TO_GET = {  # class -> what makes one
    "LinearFrame": "open_capture(...).frame(number) gives one",
    "LightResponse": "read_rig(...).response is one",
    "Camera": "read_rig(...).camera is one",
    "NormalMap": "normals_from_frame(...) gives one, or NormalMap(normals_in_camera=..., mask=...)",
    "DepthMap": "DepthIntegrator(camera).integrate(...) gives one, or DepthMap(depth=..., mask=...)",
    "Mesh": "mesh_from_depth(...) or read_mesh(...) gives one",
}
P = ParamSpec("P")
R = TypeVar("R")


def require_shape(
    array: Array, shape: tuple[int | None, ...], name: str, error: type[BadInput] = BadInput
) -> None:
    """Raise unless `array` has `shape`; None stands for any length."""
    matches = array.ndim == len(shape) and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    if not matches:
        want = " × ".join("any" if n is None else str(n) for n in shape)
        have = " × ".join(map(str, array.shape)) or "a scalar"
        raise error(f"{name}: expected shape {want}, got {have}")


def set_arrays(
    holder: object,
    shapes: Mapping[str, tuple[int | None, ...]],
    *,
    called: str = "{}",
    dtype: DTypeLike | None = None,
    error: type[BadInput] = BadInput,
) -> None:
    """Check that arrays of a frozen object are finite and of their shape, and make its fields read-only.

    shapes: by field; one that is None stays. called: what a message calls a field. dtype: of the copies that
    are kept; None for the arrays themselves.
    """
    for name, shape in shapes.items():
        given = getattr(holder, name)
        if given is not None:
            array = np.asarray(given) if dtype is None else np.array(given, dtype)
            require_shape(array, shape, called.format(name), error)
            require_finite(array, called.format(name), error)
            object.__setattr__(holder, name, read_only(array))


def require_mask(mask: Array, shape: tuple[int, ...]) -> None:
    """Raise unless `mask` has `shape` and holds booleans: integers 0 and 255 would index differently."""
    if mask.dtype != np.bool_:
        raise BadInput(f"mask: expected booleans, got {mask.dtype}")
    require_shape(mask, shape, "mask")


def checks_kinds(function: Callable[P, R]) -> Callable[P, R]:
    """Have a public function refuse, by `BadInput`, an argument of another kind than its annotation says.

    Checked are the package's own classes, which the message says how to come by, and arrays: None, or an
    object of the package, is none. numpy converts the rest.
    """
    signature = inspect.signature(function)
    called = function.__qualname__.removesuffix(".__init__").rpartition(".")[2]  # as a caller writes it

    @functools.wraps(function)
    def checked(*given: P.args, **named: P.kwargs) -> R:
        with contextlib.suppress(TypeError):  # an argument too many or too few: the call tells
            for name, value in signature.bind(*given, **named).arguments.items():
                kind, may_be_none = _kinds_of(function).get(name, (object, True))
                if not (value is None and may_be_none) and not _is_of_kind(value, kind):
                    raise BadInput(_wrong_kind(f"{called}: {name}", kind, value))
        return function(*given, **named)

    return checked


@functools.cache
def _kinds_of(function: Callable[..., Any]) -> dict[str, tuple[type, bool]]:
    found: dict[str, tuple[type, bool]] = {}
    hints = typing.get_type_hints(function)
    hints.pop("return", None)
    for name, hint in hints.items():
        members = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
        wanted = [member for member in members if member is not type(None)]
        kind = _origin(wanted[0])
        is_ours = isinstance(kind, type) and kind.__module__.startswith(_PACKAGE)
        if len(wanted) == 1 and (is_ours or kind is np.ndarray):
            found[name] = (kind, len(wanted) < len(members))
    return found


def _origin(hint: Any) -> Any:
    """Return the class of an annotation; a named alias, as newer numpy's NDArray is, stands for another."""
    origin = typing.get_origin(hint) or hint
    alias_of = getattr(origin, "__value__", None)
    return origin if alias_of is None else _origin(alias_of)


def _is_of_kind(value: object, kind: type) -> bool:
    if kind is np.ndarray:
        return value is not None and not type(value).__module__.startswith(_PACKAGE)
    return isinstance(value, kind)


def _wrong_kind(name: str, kind: type, value: object) -> str:
    got = f"an array {value.shape}" if isinstance(value, np.ndarray) else f"{type(value).__name__}"
    if kind is np.ndarray:
        return f"{name}: expected an array, got {'None' if value is None else got}"
    remedy = _HOW_TO_GET.get(kind.__name__, f"{kind.__module__}.{kind.__name__} says what it holds")
    parts = [n for n in dir(value) if not n.startswith("_") and type(getattr(value, n, None)) is kind]
    if parts:
        remedy = f"pass its .{parts[0]}"
    return f"{name}: expected a {kind.__name__}, got {'None' if value is None else got}; {remedy}"


def require_same_size(first: Array, first_name: str, second: Array, second_name: str) -> None:
    """Raise unless the two images have the same height and width."""
    if first.shape[:2] != second.shape[:2]:
        (h1, w1), (h2, w2) = first.shape[:2], second.shape[:2]
        raise BadInput(f"{first_name} is {w1}×{h1} but {second_name} is {w2}×{h2}: they must have one size")


def require_finite(array: Array, name: str, error: type[BadInput] = BadInput) -> None:
    """Raise if `array` holds NaN or infinity."""
    if sum_is_finite(array):  # a quarter of the time
        return
    bad = int(np.count_nonzero(~np.isfinite(array)))
    if bad:
        raise error(f"{name}: {bad} of {array.size} values are NaN or infinite")


def sum_is_finite(array: Array) -> bool:
    """Return whether the sum is finite: a quick look, True wherever all values are finite and not vast."""
    with np.errstate(invalid="ignore", over="ignore"):  # infinity less infinity is what is looked for
        return bool(np.isfinite(array.sum()))


def require_some(mask: BoolArray, name: str) -> None:
    """Raise if no pixel of `mask` is True."""
    if not mask.any():
        raise BadInput(f"{name}: no valid pixel (the mask is empty)")


def require_positive(value: float, name: str) -> None:
    """Raise unless value is a finite number above 0."""
    if not 0 < value < math.inf:
        raise BadInput(f"{name}: expected a positive number, got {value:g}")
