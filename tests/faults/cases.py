"""One case of the fault suite: a specimen, a mutation, and what the reader made of it."""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mutators import mutate
from specimens import KINDS, copy_of
from stated_change import fault_of
from stated_files import CHANGES

from vntoolkit.errors import VntError

logging.getLogger("vntoolkit").addHandler(logging.NullHandler())  # what is said of a file is no chatter
MEMORY_LIMIT_MB = 512  # beyond what the process held before; the specimens have a few kilobytes
LONGEST_LINE = 1000
STATED_SHARE = 0.2  # of the cases: sound files, changed in what they state


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """fault: empty where the case was handled as promised. refused: a VntError came, else it was read."""

    index: int
    what: str
    refused: bool
    fault: str
    seconds: float
    memory_mb: float
    message: str = ""


def run_case(specimens: list[tuple[str, Path]], seed: int, index: int, scratch: Path) -> Outcome:
    """Mutate a specimen, or change what a sound file states, and read it.

    The same seed and index always give the same bytes.
    """
    rng = np.random.default_rng([seed, index])
    if rng.random() < STATED_SHARE:
        return _run_stated_case(rng, index, scratch)
    kind, source = specimens[int(rng.integers(len(specimens)))]
    path = copy_of(source, scratch / "case")
    what = f"{kind} {source.name}: {_spoil(path, specimens, rng)}"
    started, before = time.perf_counter(), _memory_mb()
    refused, message = False, ""
    with _native_output(scratch / "native.txt") as native:
        try:
            result = KINDS[kind].read(path)
            fault = "" if KINDS[kind].judge(result) else "let in what is no sound object"
            del result
        except VntError as error:
            refused, message = True, str(error)
            fault = _fault_of_line(message)
        except Exception:
            fault = traceback.format_exc()
    seconds, memory = time.perf_counter() - started, _memory_mb() - before
    fault = fault or (f"printed {native[0][:300]!r}" if native[0] else "")
    fault = fault or (f"took {memory:.0f} MB" if memory > MEMORY_LIMIT_MB else "")
    return Outcome(
        index=index,
        what=what,
        refused=refused,
        fault=fault,
        seconds=seconds,
        memory_mb=memory,
        message=message,
    )


def _run_stated_case(rng: np.random.Generator, index: int, scratch: Path) -> Outcome:
    """Write a sound file that states what files of its kind may, and hold what is read against it."""
    folder = scratch / "case"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    kind = list(CHANGES)[int(rng.integers(len(CHANGES)))]
    with _native_output(scratch / "native.txt"):  # of FFmpeg's encoders
        change = CHANGES[kind](folder, rng)
    started = time.perf_counter()
    with _native_output(scratch / "native.txt") as native:
        try:
            fault = fault_of(change)
        except Exception:
            fault = traceback.format_exc()
    return Outcome(
        index=index,
        what=f"stated {kind}",
        refused=bool(change.refused),
        fault=fault or (f"printed {native[0][:300]!r}" if native[0] else ""),
        seconds=time.perf_counter() - started,
        memory_mb=0.0,
    )


def _spoil(path: Path, specimens: list[tuple[str, Path]], rng: np.random.Generator) -> str:
    """Damage the file, or one of a folder's, on disk; return what was done."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    if path.suffix == ".obj":
        files = sorted(path.parent.iterdir())
    target = files[int(rng.integers(len(files)))]
    chance = rng.random()
    if chance < 0.04:
        return f"{target.name} {_replace_in_file_system(target, rng)}"
    if chance < 0.08:
        _, other = specimens[int(rng.integers(len(specimens)))]
        if other.is_file():
            shutil.copy(other, target)
            return f"{target.name} has the content of {other.name}"
    name, content = mutate(target.read_bytes(), rng)
    target.write_bytes(content)
    return f"{target.name} {name}"


def _replace_in_file_system(target: Path, rng: np.random.Generator) -> str:
    content = target.read_bytes()
    target.unlink()
    match int(rng.integers(6)):
        case 0:
            return "missing"
        case 1:
            target.mkdir()
            return "is a folder"
        case 2:
            target.symlink_to(target.name)
            return "is a symlink to itself"
        case 3:
            target.symlink_to("nowhere")
            return "is a broken symlink"
        case 4:
            target.with_name("again" + target.name).write_bytes(content)
            target.write_bytes(content)
            return "is there twice"
        case _:
            target.with_name(os.fsdecode(b"\xff\xfe" + os.fsencode(target.name))).write_bytes(content)
            return "has a name that is not UTF-8"


def _fault_of_line(message: str) -> str:
    if not message.strip():
        return "an error without a message"
    if "\n" in message or len(message) > LONGEST_LINE:
        return f"an error that is not one line: {message[:300]!r}"
    return ""


def _memory_mb() -> float:
    """Return the peak of resident memory since the last call, and start to measure anew (Linux)."""
    with contextlib.suppress(OSError), Path("/proc/self/status").open() as status:
        peak = next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmHWM"))
        Path("/proc/self/clear_refs").write_text("5")
        return peak
    return 0.0


@contextlib.contextmanager
def _native_output(path: Path) -> Iterator[list[str]]:
    """Catch what C libraries print behind Python's back: with the one line promised, they must be silent."""
    caught = [""]
    saved = os.dup(1), os.dup(2)
    with path.open("w+b") as sink:
        os.dup2(sink.fileno(), 1)
        os.dup2(sink.fileno(), 2)
        try:
            yield caught
        finally:
            for descriptor, number in zip(saved, (1, 2), strict=True):
                os.dup2(descriptor, number)
                os.close(descriptor)
            sink.seek(0)
            caught[0] = sink.read(4000).decode("utf-8", "replace")
