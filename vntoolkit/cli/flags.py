"""Command line flags, made from the option dataclasses of the stages.

A dataclass is the only source of a flag's name, default and help. Its docstring documents each field as
`name: meaning.`; the help is that text up to the next field or the end of the paragraph.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeAlias, TypeVar, get_type_hints

from cyclopts import Parameter

from vntoolkit.errors import BadInput
from vntoolkit.io.footage.frame_range import Gaps
from vntoolkit.io.limits import ReadingLimits, limited_to
from vntoolkit.photometry.transfer import Transfer

Frames: TypeAlias = Annotated[
    str,
    Parameter(
        help="Frames to use: a:b:c for every c-th frame from a to b - 1, or one number.",
        show_default=lambda text: "all" if text == "::" else text,
    ),
]
Jobs: TypeAlias = Annotated[
    int, Parameter(help="Worker processes on this machine. The results do not depend on their number.")
]
Scheduler: TypeAlias = Annotated[
    str | None,
    Parameter(
        help='Address of a Dask scheduler, tcp://host:8786, or "local". Workers must see the same folders.'
    ),
]
Overwrite: TypeAlias = Annotated[bool, Parameter(negative=())]
Missing: TypeAlias = Annotated[
    Gaps,
    Parameter(
        help="What to do where numbers of an image sequence are missing: refuse the sequence, or skip these "
        "frames. The other frames keep their numbers."
    ),
]
Footage: TypeAlias = Annotated[
    str, Parameter(help="Where the footage is now, if it was moved after the reconstruction.")
]
Curve: TypeAlias = Annotated[
    str | None,
    Parameter(
        help="Transfer curve of the footage: linear, srgb, bt709, gamma:G, pq, hlg, slog3, vlog, clog3 or "
        "logc3. Default: the curve that the file states, else linear."
    ),
]
AmbientImage: TypeAlias = Annotated[
    Path | None,
    Parameter(help="Image of the scene under ambient light only. It is subtracted from every frame."),
]
Allow: TypeAlias = Annotated[
    tuple[str, ...],
    Parameter(
        consume_multiple=True,
        negative=(),
        help="Checks whose fatal findings do not stop the run, by the name that ends the finding's line.",
    ),
]
FocalPx: TypeAlias = Annotated[
    float | None,
    Parameter(help="Focal length in pixels. Gives a pinhole camera; use it instead of --camera."),
]
SingleLight: TypeAlias = Annotated[
    tuple[Path, Path, Path] | None,
    Parameter(
        consume_multiple=True,
        negative=(),
        help="Three photographs, each under one light alone: red, green, blue. They split M into its lights.",
    ),
]
P = ParamSpec("P")
R = TypeVar("R")
_PARAMETER = "reading_limits"
_OUTPUTS = ("out", "figure", "mesh", "report", "plot", "html", "record_to")  # where they are keywords
_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".exr")


def curve_from_text(text: str | None) -> Transfer | None:
    """Return the curve of --transfer, None where it is not given."""
    return None if text is None else Transfer.from_text(text)


def flags_from(options: type[Any], *, without: tuple[str, ...] = (), **renamed: str) -> Any:
    """Return the annotation of a verb's parameter, default None, that gives every field of `options` a flag.

    without: fields that get no flag and keep their default. renamed: maps a field to its flag's name, where
    the field's own name would be unclear among the other flags.
    """
    hints = get_type_hints(options)
    meanings = meanings_of_fields(options)
    fields: list[tuple[str, Any, Any]] = []
    for field in dataclasses.fields(options):
        hidden = field.name in without or dataclasses.is_dataclass(hints[field.name])
        flag = Parameter(
            name=f"--{renamed.get(field.name, field.name).replace('_', '-')}",
            help=None if hidden else _capitalised(meanings[field.name]),
            parse=not hidden,
            negative_iterable=(),  # --exclude A B, and no --empty-exclude
            validator=require_finite,
        )
        default = (
            dataclasses.field(default_factory=field.default_factory)
            if field.default_factory is not dataclasses.MISSING
            else dataclasses.field(default=field.default)
        )
        fields.append((field.name, Annotated[hints[field.name], flag], default))
    spread = dataclasses.make_dataclass(
        options.__name__,
        fields,
        bases=(options,),
        namespace={"__reduce__": lambda given: (_made, (options, _values_of(given)))},
        frozen=True,
        kw_only=True,
        eq=False,
    )
    spread.__module__ = (
        options.__module__
    )  # cyclopts takes a class of the standard library for a single value
    return Annotated[spread | None, Parameter(name="*")]


def require_finite(_kind: Any, value: Any) -> None:
    """Refuse NaN and infinity in every flag."""
    numbers = value if isinstance(value, tuple | list) else (value,)
    if any(isinstance(number, float) and not math.isfinite(number) for number in numbers):
        raise ValueError("Expected a finite number.")


def require_new_outputs(bound: inspect.BoundArguments) -> None:
    """Raise `BadInput` where a verb would write over what it reads, or under a name that cannot be.

    In a folder of footage, only a picture would be taken for one of its frames.
    """
    kinds = bound.signature.parameters
    written = {
        name: path
        for name, path in bound.arguments.items()
        if name in _OUTPUTS and kinds[name].kind is inspect.Parameter.KEYWORD_ONLY and isinstance(path, Path)
    }
    read = [
        (name, str(path))
        for name, value in bound.arguments.items()
        for path in (value if isinstance(value, tuple | list) else (value,))
        if name not in written and isinstance(path, str | Path) and str(path)
    ]
    for name, out in written.items():
        if any("\udc80" <= letter <= "\udcff" for letter in str(out)):
            raise BadInput(f"{out}: expected a name in UTF-8, which other programs can open")
        for flag, path in read if os.path.isfile(out) else ():  # noqa: PTH113 - never raises
            folder = path if os.path.exists(path) else os.path.dirname(path)  # noqa: PTH110, PTH120 - a pattern
            is_frame = out.suffix.lower() in _PICTURES and _is_same(out.parent, folder)
            if is_frame or _is_same(out, path):
                raise BadInput(
                    f"{out}: would be written over, but {flag} reads it; choose another "
                    f"--{name.replace('_', '-')}"
                )


def _is_same(one: Path | str, other: Path | str) -> bool:
    with contextlib.suppress(OSError, ValueError):
        return os.path.samefile(one, other or ".")  # noqa: PTH121
    return False


def meanings_of_fields(options: type[Any]) -> dict[str, str]:
    """Return the documentation of each field of an option class; raise `KeyError` where one is missing."""
    paragraphs = re.split(r"\n\s*\n", inspect.cleandoc(options.__doc__ or ""))
    names = [field.name for field in dataclasses.fields(options)]
    # `name:` or `first, second:` starts a field's sentence
    start = re.compile(rf"(?<![\w`])((?:{'|'.join(names)})(?:, (?:{'|'.join(names)}))*): ")
    meanings: dict[str, str] = {}
    for text in (" ".join(paragraph.split()) for paragraph in paragraphs):
        marks = list(start.finditer(text))
        for mark, following in zip(marks, [*marks, None][1:], strict=True):
            sentence = text[mark.end() : following.start() if following else len(text)].strip()
            for name in mark[1].split(", "):
                meanings.setdefault(name, sentence.rstrip("."))
    missing = [
        name
        for name, hint in get_type_hints(options).items()
        if name in names and name not in meanings and not dataclasses.is_dataclass(hint)
    ]
    if missing:
        raise KeyError(f"{options.__name__}: the docstring does not document {', '.join(missing)}")
    return meanings


def _made(options: type[Any], values: dict[str, Any]) -> Any:
    """Make the stage's own options in another process, which does not have the derived class."""
    return options(**values)


def _values_of(given: Any) -> dict[str, Any]:
    return {field.name: getattr(given, field.name) for field in dataclasses.fields(given) if field.init}


def _capitalised(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:] + "."


def limits_on(*fields: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Give a verb the flags of these fields of `ReadingLimits`; all readers obey them while it runs."""
    others = tuple(field.name for field in dataclasses.fields(ReadingLimits) if field.name not in fields)
    flags = flags_from(ReadingLimits, without=others)

    def give(verb: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(verb)
        def run(*arguments: Any, **options: Any) -> R:
            limits = options.pop(_PARAMETER, None) or ReadingLimits()
            with limited_to(limits):
                return verb(*arguments, **options)

        signature = inspect.signature(verb)
        extra = inspect.Parameter(_PARAMETER, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=flags)
        run.__annotations__ = {**verb.__annotations__, _PARAMETER: flags}
        run.__signature__ = signature.replace(  # type: ignore[attr-defined]
            parameters=[*signature.parameters.values(), extra]
        )
        return run

    return give
