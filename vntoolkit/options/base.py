"""The base of all option classes: a method may be given by its name.

A field `shadows: Named[ShadowMethod, ShadowMethodName] = named(ShadowMethod.ROBUST)` takes a member or its
name, and holds the member. Type checkers know both sides, and refuse a name that no member has.
"""

import functools
import typing
from dataclasses import fields
from enum import Enum
from typing import TYPE_CHECKING, Any, Generic, TypeVar, Union

from vntoolkit.errors import BadInput

E = TypeVar("E", bound=Enum)
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


class Options:
    """Takes the name of an enum's member, as the command line writes it, for the member."""

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for name, choices in _choices_of(kind).items():
            given = getattr(self, name)
            if isinstance(given, str):
                object.__setattr__(self, name, member_named(choices, given, name))


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


@functools.cache
def _choices_of(kind: Any) -> dict[str, type[Enum]]:
    """Return the enum of each field that has one."""
    hints = typing.get_type_hints(kind)
    found = {}
    for field in fields(kind):
        for hint in (hints[field.name], *typing.get_args(hints[field.name])):
            if isinstance(hint, type) and issubclass(hint, Enum):
                found[field.name] = hint
    return found
