"""Command line flags, made from the option dataclasses of the stages.

A dataclass is the only source of a flag's name, default and help. Its docstring documents each field as
`name: meaning.`; the help is that text up to the next field or the end of the paragraph.
"""

import contextlib
import dataclasses
import functools
import inspect
import math
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeAlias, TypeVar, get_args, get_type_hints

from cyclopts import Parameter

from vntoolkit.errors import BadInput
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.io.files import ReadingLimits, limited_to
from vntoolkit.io.footage.frame_range import Gaps
from vntoolkit.io.footage.mosaics import SensorOptions
from vntoolkit.photometry.rig import Rig
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
    Parameter(
        help="Image, or first frame of footage, of the scene under ambient light only. It is subtracted from "
        "every frame."
    ),
]
Allow: TypeAlias = Annotated[
    tuple[str, ...],
    Parameter(
        consume_multiple=True,
        negative=(),
        help="Checks whose fatal findings do not stop the run, by the name that ends the finding's line.",
    ),
]
Corners: TypeAlias = Annotated[
    tuple[float, float, float, float, float, float, float, float] | None,
    Parameter(
        consume_multiple=True,
        negative=(),
        help="u v of the top left, top right, bottom left and bottom right corner of the gel (or of another "
        "rectangle) in the picture, of `live` in the crop. The picture is rectified to them. Default: those "
        "of the rig, if there is one; give them where the sensor or its camera has moved since.",
    ),
]
SizeMm: TypeAlias = Annotated[
    tuple[float, float] | None,
    Parameter(
        consume_multiple=True,
        negative=(),
        help="Width and height of the rectangle between these corners in millimetres. Default: as --corners.",
    ),
]
FocalPx: TypeAlias = Annotated[
    float | None,
    Parameter(help="Focal length in pixels. Gives a pinhole camera; use it instead of --camera."),
]
SingleLight: TypeAlias = Annotated[
    tuple[str, ...] | None,
    Parameter(
        consume_multiple=True,
        negative=(),
        help="Three photographs, each under one light alone: red, green, blue. Or one video, folder or "
        "pattern in which each light is on alone for a while. They split M into its lights.",
    ),
]
P = ParamSpec("P")
R = TypeVar("R")
_PARAMETER = "reading_limits"
_OUTPUTS = ("out", "figure", "mesh", "report", "html", "overlay", "record_to")  # where they are keywords
_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".exr")


def curve_from_text(text: str | None) -> Transfer | None:
    """Return the curve of --transfer, None where it is not given."""
    return None if text is None else Transfer.from_text(text)


@dataclasses.dataclass(frozen=True)
class Flags:
    """Marks a verb's parameter, a dataclass of options, whose fields become flags.

    It is written as `Annotated[Options | None, Flags()]`.

    without: fields that get no flag and keep their default. renamed: maps a field to its flag's name, where
    the field's own name would be unclear among the other flags. Both hold for the dataclasses within too.
    """

    without: tuple[str, ...] = ()
    renamed: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def spread(self, options: type[Any]) -> type[Any]:
        """Return a dataclass like `options` whose fields tell cyclopts their flag, default and help."""
        hints = get_type_hints(options, include_extras=True)
        meanings = meanings_of_fields(options)
        fields: list[tuple[str, Any, Any]] = []
        for field in dataclasses.fields(options):
            kind, hidden = hints[field.name], field.name in self.without
            within = dataclasses.is_dataclass(kind) and not hidden
            meaning = None if hidden else meanings.get(field.name)
            own_help: dict[str, Any] = {"help": _capitalised(meaning)} if meaning else {}  # or the type's
            flag = Parameter(
                name="*" if within else f"--{self.renamed.get(field.name, field.name).replace('_', '-')}",
                **own_help,
                parse=not hidden,
                negative_iterable=(),  # --exclude A B, and no --empty-exclude
                validator=None if within else require_finite,
            )
            kind = self.spread(kind) if within else kind
            if field.default_factory is dataclasses.MISSING:
                default = dataclasses.field(default=field.default)
            else:  # that of options within is their class, which must be the spread one
                default = dataclasses.field(default_factory=kind if within else field.default_factory)
            fields.append((field.name, Annotated[kind, flag], default))
        spread = dataclasses.make_dataclass(
            options.__name__,
            fields,
            bases=(options,),
            namespace={"__reduce__": lambda given: (_made, (options, _values_of(given)))},
            frozen=True,
            kw_only=True,
            eq=False,
        )
        spread.__module__ = options.__module__  # cyclopts takes a class of the standard library for one value
        return spread


Sensor: TypeAlias = Annotated[SensorOptions | None, Flags()]


def _with_flags(hint: Any) -> Any:
    """Return a parameter's type, its options spread into flags where it is marked with `Flags`."""
    mark = next((each for each in getattr(hint, "__metadata__", ()) if isinstance(each, Flags)), None)
    if mark is None:
        return hint
    kinds = [kind for kind in (get_args(hint.__origin__) or (hint.__origin__,)) if kind is not type(None)]
    return Annotated[mark.spread(kinds[0]) | None, Parameter(name="*")]


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
    given = dict(bound.arguments)
    for value in bound.arguments.values():
        given |= vars(value) if dataclasses.is_dataclass(value) else {}
    read = [
        (name, str(path))
        for name, value in given.items()
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
        for name, hint in get_type_hints(options, include_extras=True).items()
        if name in names and name not in meanings
        if not (dataclasses.is_dataclass(hint) or hasattr(hint, "__metadata__"))  # with a help of its own
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


def verb(*limits: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Turn a function into a verb: options that are marked with `Flags` become flags.

    limits: fields of `ReadingLimits` that get flags too; all readers obey them while the verb runs.
    """
    others = tuple(field.name for field in dataclasses.fields(ReadingLimits) if field.name not in limits)

    def give(run: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(run)
        def limited(*arguments: Any, **options: Any) -> R:
            with limited_to(options.pop(_PARAMETER, None) or ReadingLimits()):
                return run(*arguments, **options)

        signature = inspect.signature(run)
        hints = {name: _with_flags(hint) for name, hint in get_type_hints(run, include_extras=True).items()}
        parameters = [p.replace(annotation=hints[name]) for name, p in signature.parameters.items()]
        if limits:
            hints[_PARAMETER] = _with_flags(Annotated[ReadingLimits | None, Flags(without=others)])
            kind = inspect.Parameter.KEYWORD_ONLY
            flags = inspect.Parameter(_PARAMETER, kind, default=None, annotation=hints[_PARAMETER])
            parameters.append(flags)
        limited.__annotations__ = hints
        limited.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        return limited

    return give


def rig_with_corners(
    rig: Rig,
    corners: tuple[float, ...] | None,
    size_mm: tuple[float, float] | None,
    filmed_px: tuple[int, int],
) -> Rig:
    """Return a gel's rig with the corners of --corners in footage of this size, in place of its own."""
    if corners is None and size_mm is None:
        return rig
    if rig.gel is None:
        raise BadInput("--corners: expected the rig of a tactile gel, of `vntoolkit calibrate presses`")
    own, pixel_mm = rig.gel.rectification, 1000.0 / float(rig.camera.matrix[0, 0])
    if size_mm is None and own is not None:
        size_mm = (own.width_mm, own.height_mm)
    view = rectification_from_flags(corners, size_mm, pixel_mm)
    assert view is not None
    if view.size != (rig.camera.width, rig.camera.height):
        wanted = f"{rig.camera.width * pixel_mm:g} {rig.camera.height * pixel_mm:g}"
        raise BadInput(f"--size-mm: expected {wanted}, the part of the gel that the rig was calibrated on")
    return dataclasses.replace(rig, gel=dataclasses.replace(rig.gel, rectification=view, filmed_px=filmed_px))


def rectification_from_flags(
    corners: tuple[float, ...] | None, size_mm: tuple[float, float] | None, pixel_mm: float
) -> Rectification | None:
    """Return the rectification of --corners, --size-mm and --pixel-mm, or None without them."""
    if corners is None and size_mm is None:
        return None
    if corners is None or size_mm is None:
        raise BadInput("rectification: expected both --corners and --size-mm, got one of them")
    return Rectification(
        corners_px=tuple(corners), width_mm=size_mm[0], height_mm=size_mm[1], pixel_mm=pixel_mm
    )
