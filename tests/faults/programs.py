"""Runs of the program: started so that a signal reaches it, and ended where it hangs.

A hang is told by the processor time of a run, not by the clock: beside other work a sound run takes many
times as long.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

CHECKOUT = Path(__file__).parents[2]
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_IDLE_S = 60.0  # in which a run that waits for its turn comes by more than the next
_LEAST_S = 0.3
_LOOK_S = 0.5


class Hang(Exception):
    """A run that did not end; its process and all that it started are ended."""


def start(
    arguments: list[str],
    *,
    environment: Mapping[str, str] | None = None,
    prepare: Callable[[], None] | None = None,
) -> subprocess.Popen[str]:
    """Start `vntoolkit` in a session of its own. prepare: called in the new process before it begins."""

    def begin() -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
        if prepare is not None:
            prepare()

    return subprocess.Popen(
        [sys.executable, "-m", "vntoolkit", *arguments],
        env={**os.environ, **(environment or {})},
        preexec_fn=begin,  # noqa: PLW1509 - no thread runs here
        start_new_session=True, cwd=CHECKOUT,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace",
    )  # fmt: skip


def end_of(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Return what a run wrote to both outputs, once it has ended. Raises `Hang`."""
    patience = Patience(process.pid)
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.communicate(timeout=0.5)
        if patience.is_over():
            end_session(process)
            raise Hang(patience.text)


def end_session(process: subprocess.Popen[str]) -> None:
    """End a run with all that it started."""
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


class Patience:
    """Tells when all processes of a session have taken too long, or do nothing."""

    def __init__(self, session: int, most_s: float = 300.0) -> None:
        self._session, self._most_s = session, most_s
        self._since = self._looked = time.monotonic()
        self._first_s: float | None = None
        self._last_s = 0.0
        self.text = ""

    def is_over(self) -> bool:
        """True once for good; `text` tells why."""
        now = time.monotonic()
        if now - self._looked < _LOOK_S:
            return bool(self.text)
        self._looked, spent_s = now, _processor_s(self._session)
        if self._first_s is None:  # most runs and cases end before they are looked at
            self._first_s = self._last_s = spent_s
        if spent_s - self._first_s > self._most_s:
            self.text = f"took more than {self._most_s:g} s of processor time"
        elif now - self._since > _IDLE_S:
            if spent_s - self._last_s < _LEAST_S:
                self.text = f"did nothing for {_IDLE_S:g} s"
            self._last_s, self._since = spent_s, now
        return bool(self.text)


def _processor_s(session: int) -> float:
    """Return the processor time of a session's processes, and of those that they have outlived (Linux)."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            values = path.read_text(errors="replace").rpartition(")")[2].split()
            if session in (int(path.parent.name), int(values[3])):  # the first may not lead it yet
                ticks += sum(map(int, values[11:15]))
    return ticks / _TICKS_PER_S
