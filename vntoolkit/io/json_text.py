"""JSON that a person or a program wrote, parsed with every failure on one line."""

from __future__ import annotations

import json
from typing import Any

from vntoolkit.errors import BadInput


def parse_json(text: str, name: str, error: type[BadInput] = BadInput, expected: str = "a JSON file") -> Any:
    """Return what a JSON text holds; raise `error` where it is none, as `expected`, or is nested too deeply.

    NaN and infinity pass, as Python has it: the schema, which can name the key, refuses them.
    """
    try:
        return json.loads(text)
    except json.JSONDecodeError as problem:
        raise error(
            f"{name}: expected {expected}, but this is not JSON: {problem.msg} at line {problem.lineno}, "
            f"column {problem.colno}"
        ) from problem
    except RecursionError as problem:
        raise error(f"{name}: its brackets are nested too deeply for any file of this program") from problem
    except ValueError as problem:  # an integer of thousands of digits
        raise error(
            f"{name}: expected {expected}, but this is not JSON: {str(problem).split(';')[0][:200]}"
        ) from problem
