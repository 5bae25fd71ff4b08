"""A verb is one typed function of one argument class; its command and its Python call are made of that class.

The fields of the class, most of them inherited from the option classes, are the flags and the keywords. The
docstring beneath a field is its help.
"""

import ast
import contextlib
import dataclasses
import difflib
import functools
import inspect
import os
import textwrap
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

from cyclopts import CoercionError, Group, Parameter, Token, convert

import vntoolkit
from vntoolkit.cli.output import ProgressBars, silent
from vntoolkit.cli.removed import require_no_removed
from vntoolkit.errors import BadInput
from vntoolkit.options.base import hints_of, members_of
from vntoolkit.progress import heard_by
from vntoolkit.threads import thread_policy

P = ParamSpec("P")
Asked = TypeVar("Asked")
R = TypeVar("R")

_OUTPUTS = ("out", "figure", "mesh", "report", "html", "overlay", "record_to")
_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".exr")
# Panel of `--help` -> the flags in it, of every verb; those that none names are of the method. What has no
# flag is input.
_PANELS: dict[str, tuple[str, ...]] = {
    "Input": (
        "rig", "camera", "video", "like", "frames", "gaps", "background", "transfer", "bayer", "demosaic",
        "bits", "footage", "motion", "skeleton", "fit", "truth", "single_light", "focal_px", "data",
        "labels", "label_size", "lights", "measured_convention", "reference_convention", "allow", "width",
        "height", "rate", "realtime", "size", "seconds", "crop", "frame_rate_hz",
    ),
    "Subject": (
        "mask", "mask_level", "key", "distance", "corners", "size_mm", "pixel_mm", "ball_radius_mm",
        "columns", "rows", "square_mm", "marker_share", "hole_squares", "seams", "garment", "fullness",
    ),
    "Method": (),
    "Output": (
        "out", "to", "overwrite", "figure", "overlay", "report", "html", "mesh", "preview", "page",
        "record_to", "vertices", "most_frames", "units", "up", "scale",
    ),
    "Machine": ("jobs", "scheduler", "host", "port", "max_megapixels", "max_vertices"),
    "Expert": ("darkest", "clipped", "largest_step", "radial_terms", "threshold", "neighbours"),
}  # fmt: skip
_PANEL_OF = {name: panel for panel, names in _PANELS.items() for name in names}
_GROUPS = {panel: Group(panel, sort_key=place) for place, panel in enumerate(_PANELS)}


def verb(
    arguments: Callable[P, Asked],
    *,
    show: Callable[[Asked, Callable[[Asked], R]], object] | None = None,
    prints: bool = False,
) -> Callable[[Callable[[Asked], R]], Callable[P, R]]:
    """Make a function of an argument class one that takes the fields of the class.

    show: what the command does with the function, where it does more than call it; it may return the exit
    status.
    prints: whether a call from Python prints what the command does.
    """

    def give(run: Callable[[Asked], R]) -> Callable[P, R]:
        @functools.wraps(run)
        def call(*given: P.args, **named: P.kwargs) -> R:
            _require_known(run.__name__, arguments, named)
            asked = arguments(*given, **named)
            with _prepared(asked), contextlib.nullcontext() if prints else silent():
                return run(asked)

        shown: Any = call
        shown.arguments, shown.show = arguments, (lambda asked: show(asked, run)) if show else run
        returned = inspect.signature(run).return_annotation
        shown.__signature__ = inspect.Signature(_parameters(arguments), return_annotation=returned)
        return call

    return give


def __getattr__(name: str) -> Any:
    """Return the command of a public verb: cyclopts asks for it when the verb is typed."""
    if name.startswith("_"):
        raise AttributeError(name)
    return command(getattr(vntoolkit, name))


def command(verb: Any) -> Any:
    """Return the command of a verb: the verb itself, which then prints what came of it."""
    arguments = verb.arguments

    def run(*given: Any, **named: Any) -> Any:
        asked = asked_from(arguments, given, named)
        with _prepared(asked):
            return verb.show(asked)

    shown: Any = run
    shown.__doc__, shown.__name__ = verb.__doc__, verb.__name__
    parameters = _flags(arguments)
    shown.__signature__ = inspect.Signature(parameters)
    shown.__annotations__ = {each.name: each.annotation for each in parameters}
    return run


def asked_from(arguments: Any, given: tuple[Any, ...], named: dict[str, Any]) -> Any:
    """Return the arguments of a typed command: words without a flag in order, the last of them many."""
    ordered = [field.name for field in dataclasses.fields(arguments) if not field.kw_only]
    if ordered and get_origin(hints_of(arguments)[ordered[-1]]) is tuple:
        *ordered, many = ordered
        named = {**named, many: given[len(ordered) :]}
    return arguments(**dict(zip(ordered, given, strict=False)), **named)


@contextlib.contextmanager
def _prepared(asked: Any) -> Iterator[None]:
    """Let what the verb reads keep to its limits, and libraries to our threads; show how far it is."""
    from vntoolkit.io.files import limited_to
    from vntoolkit.options.footage import ReadingLimits

    _require_new_outputs(asked)
    limits = {name: getattr(asked, name) for name in hints_of(ReadingLimits) if hasattr(asked, name)}
    with limited_to(ReadingLimits(**limits)), thread_policy(), heard_by(ProgressBars()):
        yield


def _require_known(name: str, arguments: Any, named: dict[str, Any]) -> None:
    """Raise `BadInput` for a keyword that the verb does not have, with the one that may be meant."""
    known = [field.name for field in _fields(arguments)]
    for given in named:
        if given not in known:
            require_no_removed(name.partition("_")[0], f"--{given.replace('_', '-')}")
            close = difflib.get_close_matches(given, known, n=1)
            hint = f"; did you mean {close[0]}?" if close else ""
            raise BadInput(f"{name}: unknown option {given}{hint}")


def _parameters(arguments: Any) -> list[inspect.Parameter]:
    """Return the parameters of the call from Python."""
    empty, hints = inspect.Parameter.empty, hints_of(arguments)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY if field.kw_only else inspect.Parameter.POSITIONAL_OR_KEYWORD,
            default=empty if field.default is dataclasses.MISSING else field.default,
            annotation=hints[field.name],
        )
        for field in _fields(arguments)
    ]


def _fields(arguments: Any) -> list[Any]:
    """Return the fields that a verb takes: those without a flag first, then its own, then the inherited."""
    hints, kinds = hints_of(arguments), arguments.__mro__
    taken = [
        field
        for field in dataclasses.fields(arguments)
        if field.name not in arguments.WITHOUT and not dataclasses.is_dataclass(hints[field.name])
    ]

    def place(field: Any) -> tuple[bool, int]:
        return field.kw_only, next(
            i for i, kind in enumerate(kinds) if field.name in vars(kind).get("__annotations__", {})
        )

    return sorted(taken, key=place)


def _flags(arguments: Any) -> list[inspect.Parameter]:
    """Return the parameters from which cyclopts makes the flags of a verb."""
    docs, flags = meanings_of_fields(arguments), []
    for given in _parameters(arguments):
        hint, is_flag = given.annotation, given.kind is inspect.Parameter.KEYWORD_ONLY
        many = get_origin(hint) is tuple and not is_flag
        hint = _type_of_flag(get_args(hint)[0] if many else hint)
        is_tuple = any(get_origin(member) is tuple for member in members_of(hint))
        parameter = Parameter(
            help=docs[given.name],
            group=_GROUPS[_PANEL_OF.get(given.name, "Method") if is_flag else "Input"],
            negative=None if given.default is True else (),
            negative_iterable=(),  # --exclude A B, and no --empty-exclude
            consume_multiple=True if is_tuple else None,
            converter=_whole_numbers if _counts(hint) else None,
        )
        flag = given.replace(annotation=Annotated[hint, parameter])
        if many:
            flag = flag.replace(kind=inspect.Parameter.VAR_POSITIONAL, default=inspect.Parameter.empty)
        flags.append(flag)
    return sorted(flags, key=lambda flag: flag.kind)


def _counts(hint: Any) -> bool:
    """True where every number that a flag takes is a whole one."""
    members = [inner for member in members_of(hint) for inner in get_args(member) or (member,)]
    return int in members and float not in members


def _whole_numbers(hint: Any, tokens: Sequence[Token]) -> Any:
    """Return the values of a flag that counts; cyclopts alone would round 2.9 to 3."""
    for token in tokens:
        if "." in token.value:
            raise CoercionError(token=token, target_type=int)
    return convert(hint, tokens)


def _type_of_flag(hint: Any) -> Any:
    """Return what a flag takes: an enum without the names, a path without the texts that stand for it."""
    members = [member for member in members_of(hint) if get_origin(member) is not Literal]
    if os.PathLike[str] in members:
        dropped = (str, os.PathLike[str]) if Path in members else (os.PathLike[str],)
        members = [member for member in members if member not in dropped]
    return Union[tuple(members)]  # noqa: UP007


@functools.cache
def meanings_of_fields(arguments: Any) -> dict[str, str]:
    """Return the docstring beneath each field of a class and of those it inherits from."""
    meanings: dict[str, str] = {}
    kinds: tuple[type, ...] = arguments.__mro__[::-1]
    for kind in kinds:
        if not hasattr(kind, "__dataclass_fields__"):
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
        assert isinstance(body, ast.ClassDef)
        for field, below in pairwise(body.body):
            if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                meanings[ast.unparse(field.target)] = " ".join(ast.literal_eval(below.value).split())
    missing = [field.name for field in _fields(arguments) if field.name not in meanings]
    if missing:
        raise KeyError(f"{arguments.__name__}: no docstring beneath {', '.join(missing)}")
    return meanings


def _require_new_outputs(asked: Any) -> None:
    """Raise `BadInput` where a verb would write over what it reads, or under a name that cannot be.

    In a folder of footage, only a picture would be taken for one of its frames.
    """
    given = {field.name: getattr(asked, field.name) for field in dataclasses.fields(asked)}
    flags = {field.name for field in dataclasses.fields(asked) if field.kw_only}
    written = {
        name: path
        for name, path in given.items()
        if name in _OUTPUTS and name in flags and isinstance(path, Path)
    }
    kind: Any = type(asked)
    read = [
        (name, str(path))
        for name, hint in hints_of(kind).items()
        if name not in written and (name == "footage" or "PathLike" in str(hint))
        for path in (given[name] if isinstance(given[name], tuple) else (given[name],))
        if path is not None and str(path)
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
