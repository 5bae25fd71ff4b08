"""Flags that several verbs share, each said once; a verb's own docstring tells of the others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

from cyclopts import Parameter

Frames: TypeAlias = Annotated[
    str,
    Parameter(
        help="Which frames, a:b:c: from a, below b, every c-th; or one number.",
        show_default=lambda text: "all" if text == "::" else text,
    ),
]
Jobs: TypeAlias = Annotated[
    int, Parameter(help="Worker processes on this machine; the results do not depend on their number.")
]
Scheduler: TypeAlias = Annotated[
    str | None,
    Parameter(
        help='Address of a Dask scheduler, tcp://host:8786, whose workers see the same folders; or "local".'
    ),
]
Overwrite: TypeAlias = Annotated[bool, Parameter(negative=())]
Footage: TypeAlias = Annotated[
    str, Parameter(help="Where the footage is now, if not where it was when it was reconstructed.")
]
Curve: TypeAlias = Annotated[
    str, Parameter(help="Transfer curve of the footage: linear, srgb, bt709 or gamma:G.")
]
AmbientImage: TypeAlias = Annotated[
    Path | None, Parameter(help="Image of the scene under ambient light only, subtracted from every frame.")
]
FocalPx: TypeAlias = Annotated[
    float | None, Parameter(help="Focal length in pixels, for a pinhole camera instead of --camera.")
]
SingleLight: TypeAlias = Annotated[
    tuple[Path, Path, Path] | None,
    Parameter(
        consume_multiple=True,
        negative=(),
        help="Three photographs, under the red, the green and the blue light alone: takes M apart.",
    ),
]
