"""Options of `reconstruct`, and their values for the manifest."""

import dataclasses
from collections.abc import Mapping
from enum import Enum
from typing import Any, TypeVar, get_args, get_type_hints

from vntoolkit.errors import BadInput
from vntoolkit.options.footage import Bayer, Demosaic, SensorOptions
from vntoolkit.options.reconstruction import ReconstructOptions

_Options = TypeVar("_Options")


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


def options_from_values(values: Mapping[str, Any]) -> ReconstructOptions:
    """Return the options that a manifest states, the defaults of those that it does not; raise `BadInput`."""
    try:
        return _dataclass_from_values(ReconstructOptions, values, "")
    except (TypeError, ValueError) as problem:
        raise BadInput(f"reconstruction.json: {problem}") from problem


def _dataclass_from_values(kind: type[_Options], values: Mapping[str, Any], prefix: str) -> _Options:
    given: dict[str, Any] = {}
    for name, stated in get_type_hints(kind).items():
        if isinstance(stated, type) and dataclasses.is_dataclass(stated):
            given[name] = _dataclass_from_values(stated, values, f"{prefix}{name}.")
        elif prefix + name in values:
            given[name] = _value_of(stated, values[prefix + name])
    return kind(**given)


def _value_of(stated: Any, value: Any) -> Any:
    """Return a JSON value as the type that is stated for it."""
    choices = [
        each for each in (stated, *get_args(stated)) if isinstance(each, type) and issubclass(each, Enum)
    ]
    return choices[0](value) if choices and isinstance(value, str) else value


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
