"""`--max-megapixels` and `--max-vertices`: one decorator gives them to every verb that reads such files."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from vntoolkit.cli.flags import flags_from
from vntoolkit.io.limits import ReadingLimits, limited_to

P = ParamSpec("P")
R = TypeVar("R")
_PARAMETER = "reading_limits"


def limits_on(*fields: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Give a verb the flags of these fields of `ReadingLimits`; while it runs, every reader keeps to them."""
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
