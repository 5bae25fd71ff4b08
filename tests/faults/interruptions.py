"""Runs of the program that are ended by a signal at a random moment, and what they leave."""

from __future__ import annotations

import hashlib
import json
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from programs import Hang, Patience, end_session, start

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
_TIMES = ("started", "finished", "timings")  # of the manifest: they tell of the run, not of the result


@dataclass(frozen=True, kw_only=True)
class Verb:
    """arguments: of the command line, for an output. done: how much of the work lies there already."""

    arguments: Callable[[Path], list[str]]
    done: Callable[[Path], int]


@dataclass(frozen=True, kw_only=True)
class Ended:
    """status: as `subprocess` has it, negative for a signal. by: the signal sent, or None."""

    status: int
    by: signal.Signals | None
    error: str


def run_until(verb: Verb, out: Path, stop_at: int | None, sent: signal.Signals, delay_s: float) -> Ended:
    """Run the verb; once `stop_at` units are done (None: never), wait `delay_s` and send the signal."""
    process, by = start(verb.arguments(out)), None
    patience = Patience(process.pid)
    while process.poll() is None:
        if stop_at is not None and by is None and verb.done(out) >= stop_at:
            time.sleep(delay_s)
            process.send_signal(sent)
            by = sent
        time.sleep(0.002)
        if patience.is_over():
            end_session(process)
            raise Hang(f"{verb.arguments(out)[0]} {patience.text}")
    return Ended(status=process.returncode, by=by, error=process.communicate()[1])


def interrupt_often(
    verb: Verb, outs: Callable[[int], Path], kills: int, rng: np.random.Generator, stride: int
) -> tuple[list[Path], list[Ended]]:
    """Interrupt and resume, into a new output whenever one is whole, until so many signals have struck.

    stride: units of work between two signals, at most. Returns the outputs, all of them whole, and each end.
    """
    ends: list[Ended] = []
    folders: list[Path] = []
    while sum(end.by is not None for end in ends) < kills or not folders:
        out = outs(len(folders))
        while True:
            struck = sum(end.by is not None for end in ends)
            stop_at = verb.done(out) + int(rng.integers(0, stride + 1)) if struck < kills else None
            sent = SIGNALS[int(rng.integers(len(SIGNALS)))]
            end = run_until(verb, out, stop_at, sent, float(rng.uniform(0, 0.05)))
            ends.append(end)
            if end.status == 0:
                folders.append(out)
                break
            assert end.by is not None, end.error
    return folders, ends


def content_of(folder: Path) -> dict[str, str]:
    """Return {path: hash} of every file, temporaries too; without what tells the time of the run."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            found[path.relative_to(folder).as_posix()] = hashlib.sha256(_timeless(path)).hexdigest()
    return found


def _timeless(path: Path) -> bytes:
    if path.name == "reconstruction.json":
        content = json.loads(path.read_text())
        return json.dumps({k: v for k, v in content.items() if k not in _TIMES}).encode()
    if path.name == "frames.log":  # number seconds shares…, in any order
        lines = {tuple(line.split()[:1] + line.split()[2:]) for line in path.read_text().splitlines() if line}
        return repr(sorted(lines)).encode()
    return path.read_bytes()


def lines_of(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0
