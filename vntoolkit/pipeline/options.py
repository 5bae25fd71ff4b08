"""Options of `reconstruct`, and their values for the manifest."""

import dataclasses
from collections.abc import Mapping
from enum import Enum
from typing import Any

from vntoolkit.errors import BadInput
from vntoolkit.options.footage import SensorOptions

SENSOR_PREFIX = "sensor."  # of the manifest's options that say how the footage's samples are read


def sensor_from_values(values: Mapping[str, Any]) -> SensorOptions:
    """Return how the footage of a result was read, of its manifest's options; raise `BadInput`."""
    own = {name: value for name, value in values.items() if name.startswith(SENSOR_PREFIX)}
    try:
        return SensorOptions(**{name.removeprefix(SENSOR_PREFIX): value for name, value in own.items()})
    except (BadInput, TypeError) as problem:
        raise BadInput(f"reconstruction.json: {problem}") from problem


def option_values(options: Any, prefix: str = "", without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return {dotted field name: JSON value} of a frozen option dataclass and those within, but for some."""
    values: dict[str, Any] = {}
    for option in dataclasses.fields(options):
        if option.name in without:
            continue
        value = getattr(options, option.name)
        name = f"{prefix}{option.name}"
        if dataclasses.is_dataclass(value):
            values.update(option_values(value, f"{name}."))
        elif isinstance(value, Enum):
            values[name] = value.value
        else:
            values[name] = value
    return values
