"""The commands of a README's code blocks, one by one, and how to run them as printed.

Blocks fenced as ```sh hold commands, a line each, longer ones continued with a backslash; ```python blocks
hold whole scripts. Both run in the order of the page, in one folder. Blocks fenced otherwise do not run.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
# They set a machine up, or run the test suite itself.
NOT_RUN = ("make", "git", "cd", "pip", "python3", "sudo", "source", ".")
_FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```\s*$", re.MULTILINE | re.DOTALL)
_LONGEST_S = 600
_ADDRESS = re.compile(r"http://\S+")


@dataclass(frozen=True)
class Step:
    """One command or script, and the line of the README that it begins on."""

    language: str
    text: str
    line: int

    @property
    def is_run(self) -> bool:
        """False for what sets a machine up, and for what needs a camera."""
        if self.language == "python":
            return True
        words = shlex.split(self.text, comments=True)
        return words[0] not in NOT_RUN and not (words[:2] == ["vntoolkit", "live"] and "--camera" in words)

    @property
    def serves(self) -> bool:
        """Whether it goes on until it is interrupted."""
        if self.language == "python":
            return False
        words = shlex.split(self.text, comments=True)
        return words[:2] == ["vntoolkit", "view"] and "--html" not in words


def steps_of(readme: str) -> list[Step]:
    """Return every command and script, in order."""
    steps = []
    for block in _FENCE.finditer(readme):
        language, body = block[1], block[2]
        first = readme.count("\n", 0, block.start(2)) + 1
        if language == "python":
            steps.append(Step("python", body, first))
        elif language == "sh":
            commands = [(k, text) for k, text in _commands(body) if not text.startswith("#")]
            steps += [Step("sh", text, first + offset) for offset, text in commands]
    return steps


def _commands(body: str) -> list[tuple[int, str]]:
    """Return (line within the block, command), continued lines joined."""
    commands: list[tuple[int, str]] = []
    pending = ""
    start = 0
    for offset, line in enumerate(body.splitlines()):
        if not pending:
            start = offset
        pending += line.strip()
        if pending.endswith("\\"):
            pending = pending[:-1]
            continue
        if pending:
            commands.append((start, pending))
        pending = ""
    return commands


def run_step(step: Step, folder: Path) -> str:
    """Run one step in `folder` as a user's shell would; return what it printed. Raises `AssertionError`."""
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "COLUMNS": "120",
    }
    if step.serves:
        return _run_server(step, folder, environment)
    shell = [sys.executable, "-c", step.text] if step.language == "python" else ["bash", "-c", step.text]
    done = subprocess.run(
        shell, cwd=folder, env=environment, capture_output=True, text=True, timeout=_LONGEST_S, check=False
    )
    assert done.returncode == 0, (
        f"README.md, line {step.line}: exit status {done.returncode}\n  {step.text}\n"
        f"{done.stdout}{done.stderr}"
    )
    return done.stdout


def next_of(printed: str) -> list[Step]:
    """Return the commands of this program that a text names as the next ones."""
    return [Step("sh", text, 0) for text in re.findall(r"(?m)^next: (vntoolkit .*)$", printed)]


def _run_server(step: Step, folder: Path, environment: dict[str, str]) -> str:
    """Start it, fetch the address that it prints, interrupt it: it must end well."""
    words = shlex.split(step.text, comments=True)
    log = folder / ".server.log"
    with log.open("w") as stream:
        server = subprocess.Popen(words, cwd=folder, env=environment, stdout=stream, stderr=stream)
        try:
            address = _wait_for_address(server, log, step)
            with urllib.request.urlopen(address, timeout=30) as answer:
                assert answer.status == 200, f"README.md, line {step.line}: {address} answers {answer.status}"
        finally:
            server.send_signal(signal.SIGINT)
            status = server.wait(timeout=60)
    printed = log.read_text()
    log.unlink()
    assert status in (0, 130), f"README.md, line {step.line}: exit status {status}\n{printed}"
    return printed


def _wait_for_address(server: subprocess.Popen[bytes], log: Path, step: Step) -> str:
    until = time.monotonic() + 120
    while time.monotonic() < until and server.poll() is None:
        found = _ADDRESS.search(log.read_text())
        if found:
            try:
                urllib.request.urlopen(found[0], timeout=30).close()
            except urllib.error.URLError:
                time.sleep(0.2)
                continue
            return found[0]
        time.sleep(0.2)
    raise AssertionError(f"README.md, line {step.line}: `{step.text}` served nothing\n{log.read_text()}")
