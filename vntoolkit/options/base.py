"""The base of all option classes: what a field takes, and what it holds.

A method may be given by its name, a file by a text. A field
`shadows: Named[ShadowMethod, ShadowMethodName] = named(ShadowMethod.ROBUST)` takes a member or its name, and
holds the member. Type checkers know both sides, and refuse a name that no member has.
"""

import functools
import math
import os
import typing
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from enum import Enum
from numbers import Integral, Real
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeAlias, TypeVar, Union

from vntoolkit.errors import BadInput

E = TypeVar("E", bound=Enum)
Part = TypeVar("Part")
Held = TypeVar("Held")
Given = TypeVar("Given")

if TYPE_CHECKING:

    class Named(Generic[Held, Given]):
        """What a field holds, and what it takes beside that."""

        def __get__(self, options: object, kind: Any) -> Held: ...
        def __set__(self, options: Any, value: Held | Given) -> None: ...

    def named(default: Held) -> Named[Held, Any]:
        """Return the default of such a field."""
        ...

else:
    Named = Union

    def named(default):
        """Return the default of such a field."""
        return default


Source: TypeAlias = str | os.PathLike[str]
"""A video, an image, a folder or a pattern; held as text."""
File: TypeAlias = Path | str | os.PathLike[str]
"""A file or folder; held as a `Path`."""
OptionalFile: TypeAlias = Named[Path | None, str | os.PathLike[str] | None]


class Limit(NamedTuple):
    """What numbers a field takes: `rate: Annotated[float, positive()] = 30.0`; None passes."""

    words: str
    holds: Callable[[Any], bool]


def within(low: float, high: float = math.inf, words: str = "") -> Limit:
    """Return the limit of a finite number from low to high."""
    said = f"{low:g} or more" if high == math.inf else f"a value from {low:g} to {high:g}"
    return Limit(words or said, lambda value: math.isfinite(value) and low <= value <= high)


def positive(words: str = "a positive number") -> Limit:
    """Return the limit of a length, a rate and the like."""
    return Limit(words, lambda value: 0 < value < math.inf)


class Options:
    """Brings what it is given into the type that a field holds; refuses what has none, or is out of range.

    What a class refuses beside that is in its own `__post_init__`, after that of its bases.
    WITHOUT: fields that a verb neither takes nor shows.
    """

    WITHOUT: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for name, hint in hints_of(kind).items():
            given = getattr(self, name)
            held = _held(given, hint, name.replace("_", " "))
            if held is not given:
                object.__setattr__(self, name, held)
            for limit in _limits_of(kind)[name]:
                if held is not None and not limit.holds(held):
                    raise BadInput(f"{name.replace('_', ' ')}: expected {limit.words}, got {held:g}")
        getattr(super(), "__post_init__", lambda: None)()  # of a base that is no class of options

    def part(self, kind: type[Part]) -> Part:
        """Return the options of one stage, taken from the fields of these by their names."""
        asked: Any = kind
        values = {
            name: self.part(hint) if is_dataclass(hint) else getattr(self, name)  # type: ignore[arg-type]
            for name, hint in hints_of(asked).items()
            if is_dataclass(hint) or hasattr(self, name)
        }
        return kind(**values)


def as_path(given: File | None) -> Path | None:
    """Return a file name as a path: what a field of another class holds, as its type does not say."""
    return None if given is None else Path(given)


def members_of(hint: Any) -> tuple[Any, ...]:
    """Return the types of a union; of another type, that alone."""
    return typing.get_args(hint) if typing.get_origin(hint) in (Union, UnionType) else (hint,)


@functools.cache
def hints_of(kind: Any) -> dict[str, Any]:
    """Return the type of every field of an option class."""
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


@functools.cache
def _limits_of(kind: Any) -> dict[str, tuple[Limit, ...]]:
    hints = typing.get_type_hints(kind, include_extras=True)
    return {name: getattr(hints[name], "__metadata__", ()) for name in hints_of(kind)}


def _held(given: Any, hint: Any, name: str) -> Any:
    """Return what a field holds for what was given; raise `BadInput` for a value of another type."""
    members = members_of(hint)
    for member in members:
        if isinstance(member, type) and issubclass(member, Enum) and isinstance(given, str):
            return member_named(member, given, name)
        if typing.get_origin(member) is tuple and isinstance(given, list | tuple):
            return _held_values(tuple(given), typing.get_args(member), name)
    if isinstance(given, str | os.PathLike) and not isinstance(given, bytes):
        if Path in members:
            return Path(given)
        if str in members:
            return os.fspath(given)
    wanted = [_WORDS.get(typing.get_origin(member) or member, "") for member in members]
    wanted = [words for words in wanted if words]
    if not wanted or any(_is_of(given, member) for member in members):
        return given
    raise BadInput(f"{name}: expected {' or '.join(wanted)}, got {given!r}")


def _held_values(given: tuple[Any, ...], kinds: tuple[Any, ...], name: str) -> tuple[Any, ...]:
    if kinds[-1] is Ellipsis:
        return tuple(_held(value, kinds[0], name) for value in given)
    if len(given) != len(kinds):
        raise BadInput(f"{name}: expected {len(kinds)} values, got {len(given)}")
    return tuple(_held(value, kind, name) for value, kind in zip(given, kinds, strict=True))


_WORDS: dict[Any, str] = {
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    str: "a text",
    tuple: "several values",
}
_NUMBERS: dict[Any, Any] = {int: Integral, float: Real}


def _is_of(given: Any, kind: Any) -> bool:
    if kind in _NUMBERS:
        return isinstance(given, _NUMBERS[kind]) and not isinstance(given, bool)
    return isinstance(given, typing.get_origin(kind) or kind) if kind is not typing.Any else True


def member_named(choices: type[E], name: str, option: str) -> E:
    """Return the member of that name, dashes and underscores alike; raise `BadInput` that lists the names."""
    for member in choices:
        if name_of(member) == name.lower().replace("_", "-"):
            return member
    names = ", ".join(map(name_of, choices))
    raise BadInput(f"{option.replace('_', ' ')}: expected one of {names}, got '{name}'")


def name_of(member: Enum) -> str:
    """Return the member's name on the command line."""
    return member.name.lower().replace("_", "-")
