"""Options of `reconstruct`, and their values for the manifest."""

import dataclasses
from collections.abc import Mapping
from enum import Enum
from typing import Any

from vntoolkit.errors import BadInput
from vntoolkit.options.footage import Bayer, Demosaic, SensorOptions

SENSOR_PREFIX = "sensor."  # of the manifest's options that say how the footage's samples are read


def sensor_from_values(values: Mapping[str, Any]) -> SensorOptions:
    """Return how the footage of a result was read, of its manifest's options; raise `BadInput`."""
    given = {
        field.name: values.get(SENSOR_PREFIX + field.name) for field in dataclasses.fields(SensorOptions)
    }
    try:
        return SensorOptions(
            bayer=None if given["bayer"] is None else Bayer(given["bayer"]),
            demosaic=Demosaic(given["demosaic"] or Demosaic.BILINEAR),
            bits=given["bits"],
        )
    except ValueError as problem:
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
