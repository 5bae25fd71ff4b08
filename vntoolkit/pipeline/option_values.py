"""Options as plain values, for a manifest: nested dataclasses become dotted names."""

from __future__ import annotations

import dataclasses
from enum import Enum
from typing import Any


def option_values(options: Any, prefix: str = "", without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return {dotted field name: JSON value} of a frozen option dataclass and those within, but for some."""
    values: dict[str, Any] = {}
    for field in dataclasses.fields(options):
        if field.name in without:
            continue
        value = getattr(options, field.name)
        name = f"{prefix}{field.name}"
        if dataclasses.is_dataclass(value):
            values.update(option_values(value, f"{name}."))
        elif isinstance(value, Enum):
            values[name] = value.value
        else:
            values[name] = value
    return values
