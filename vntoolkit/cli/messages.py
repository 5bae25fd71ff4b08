"""The error lines of the command line: a command typed wrongly, and an unexpected exception."""

import contextlib
import difflib
import logging
import os
import re
import tempfile
import traceback
from enum import Enum
from pathlib import Path

from cyclopts import Argument, CycloptsError
from cyclopts.exceptions import ConsumeMultipleError, MissingArgumentError, UnusedCliTokensError

from vntoolkit.errors import printable_line
from vntoolkit.shipped import with_guide

_TYPES = {
    "int": "a whole number", "float": "a number", "bool": "true or false",
    "MaterialSearch|int": "auto, calibrated or a whole number",
}  # fmt: skip


def line_from_usage_error(error: CycloptsError) -> str:
    """Return one line: what was expected, what was typed, and the `--help` that explains it."""
    verb = " ".join(error.command_chain or ())
    if isinstance(error, MissingArgumentError) and not isinstance(error, ConsumeMultipleError):
        text = f"{verb}: {_missing(error)}."
    elif isinstance(error, UnusedCliTokensError):
        text = f"{verb}: one file or folder too many: '{' '.join(error.unused_tokens or ())}'."
    else:
        text = " ".join(str(error).split())
        if short := re.match(r'Unknown (?:option: |command ")(-\w+)', text):
            where = f"{verb}: " if verb else ""
            text = f"{where}unknown option {short[1]}: options have no short form, such as --out and --help."
    for name, meaning in _TYPES.items():
        refused = rf': unable to convert "(.*)" into {re.escape(name)}\.'
        text = re.sub(refused, rf': expected {meaning}, got "\1".', text)
    return f"{text} `{' '.join(['vntoolkit', *verb.split(), '--help'])}` explains it"


def _missing(error: MissingArgumentError) -> str:
    argument = error.argument
    assert argument is not None
    if error.keyword or argument.tokens:
        name = error.keyword or next((t.keyword for t in argument.tokens if t.keyword), argument.name)
        count, _ = argument.token_count()
        got = len(error.tokens_so_far)
        return f"{name}: expected {count} value{'s' if count > 1 else ''}, got {got or 'none'}"
    typed = [token for token in error.unused_tokens or () if token.startswith("-")]
    close = [token for token in typed if re.fullmatch(r"-\w", token) and token[1] == argument.name[2:3]]
    close = close or difflib.get_close_matches(argument.name, typed, n=1, cutoff=0.6)
    if close:
        return f"unknown option {close[0]}, perhaps for {argument.name}"
    meaning = _meaning(argument)
    return f"{_shown_name(argument)} is missing{f' ({meaning})' if meaning else ''}"


def _shown_name(argument: Argument) -> str:
    name = argument.name
    return name.lstrip("-").upper() if argument.field_info.is_positional else name


def _meaning(argument: Argument) -> str:
    """Return the flag's choices, or the first sentence of its help."""
    if isinstance(argument.hint, type) and issubclass(argument.hint, Enum):
        return "one of " + ", ".join(member.name.lower().replace("_", "-") for member in argument.hint)
    sentence = re.split(r"[.;:](?:\s|$)", argument.parameter.help or "")[0]
    return sentence[:1].lower() + sentence[1:]


def line_from_unforeseen(error: Exception) -> str:
    """Write the traceback to a new file in the temporary folder; return one line that names the file.

    If that folder cannot be written, the line names the function that failed instead.
    """
    if isinstance(error, MemoryError):
        return printable_line(
            f"out of memory ({error}): use fewer --jobs or --frames, or smaller footage; finished frames "
            "are on disk"
        )
    what = printable_line(f"{type(error).__name__}: {error}"[:300])
    last = traceback.extract_tb(error.__traceback__)[-1:]
    where = f"raised in {last[0].name}, line {last[0].lineno} of {last[0].filename}" if last else ""
    with contextlib.suppress(OSError):
        where = f"the traceback is in {_written(error)}"
    return f"internal error, not a fault of your input ({what}); {where}; please report it"


class OneLineFormatter(logging.Formatter):
    """Shows a record on one line of limited length, whatever names it holds; a traceback after it."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Return the line."""
        return printable_line(with_guide(super().formatMessage(record)))


def line_from_refusal(error: OSError) -> str:
    """Return the line for what the system refused: a folder that may not be looked into, a full disk."""
    reason = (error.strerror or str(error)).lower()
    if error.filename is None:
        return f"cannot write what is to be shown: {reason}; print to another place, or free some space"
    name = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else str(error.filename)
    return printable_line(f"{name}: {reason}; see that you may read and write there, and that there is room")


def _written(error: Exception) -> Path:
    with tempfile.NamedTemporaryFile(
        "w",
        prefix="vntoolkit-trace-",
        suffix=".txt",
        delete=False,
        encoding="utf-8",
        errors="backslashreplace",
    ) as file:
        file.writelines(traceback.format_exception(error))
    return Path(file.name)
