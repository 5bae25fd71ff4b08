"""`make fuzz`: thousands of damaged files, each read in a process of its own kind under a watchdog.

A case is repeated by `python tests/faults/fuzz.py --seed SEED --only INDEX`.
"""

from __future__ import annotations

import argparse
import faulthandler
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]

from programs import Patience  # noqa: E402

HANG_S = 10.0  # of processor time
_ADDRESS_SPACE = 6 << 30
_START_S = 120.0  # a process imports OpenCV, OpenEXR, PyAV and numba before its first case


@dataclass
class Report:
    """counts: (kind, refused) -> cases. faults: one text each."""

    counts: Counter[tuple[str, bool]] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    slowest_s: float = 0.0
    largest_mb: float = 0.0

    @property
    def cases(self) -> int:
        return sum(self.counts.values())

    def add(self, outcome: Any) -> None:
        self.counts[outcome.what.split()[0], outcome.refused] += 1
        self.slowest_s = max(self.slowest_s, outcome.seconds)
        self.largest_mb = max(self.largest_mb, outcome.memory_mb)
        if outcome.fault:
            self.faults.append(f"case {outcome.index}: {outcome.what}: {outcome.fault}")


@dataclass
class _Worker:
    process: Any
    pipe: Connection
    patience: Patience
    index: int | None = None
    is_ready: bool = False


def fuzz(seed: int, indices: list[int], processes: int = 2) -> Report:
    """Run the cases; a process that hangs or dies counts against its case and is replaced."""
    from specimens import write_specimens

    report = Report()
    waiting = list(reversed(indices))
    with tempfile.TemporaryDirectory(prefix="vntoolkit-faults-") as folder:
        (Path(folder) / "good").mkdir()
        specimens = write_specimens(Path(folder) / "good")
        workers = [_start(seed, specimens, Path(folder)) for _ in range(min(processes, len(indices)))]
        while workers:
            ready = wait([worker.pipe for worker in workers], timeout=0.5)
            for worker in list(workers):
                _serve(worker, worker.pipe in ready, waiting, report)
                if not worker.process.is_alive() and worker.index is None:
                    workers.remove(worker)
                    if waiting:
                        workers.append(_start(seed, specimens, Path(folder)))
    return report


def _serve(worker: _Worker, has_word: bool, waiting: list[int], report: Report) -> None:
    if has_word:
        try:
            outcome = worker.pipe.recv()
        except EOFError:
            worker.process.join()
            _require_ready(worker)
            if worker.index is not None:
                report.counts["ended", False] += 1
                report.faults.append(
                    f"case {worker.index}: the process died, status {worker.process.exitcode}"
                )
            worker.index = None
            return
        if worker.is_ready:
            report.add(outcome)
        worker.is_ready = True
        worker.index = waiting.pop() if waiting else None
        worker.patience = Patience(worker.process.pid, HANG_S)
        worker.pipe.send(worker.index)
        if worker.index is None:
            worker.process.join()
    elif worker.patience.is_over():
        worker.process.kill()
        worker.process.join()
        _require_ready(worker)
        report.counts["hung", False] += 1
        report.faults.append(f"case {worker.index}: {worker.patience.text}")
        worker.index = None


def _require_ready(worker: _Worker) -> None:
    """Raise for a process that ended before its first case: its successors would, for ever."""
    if not worker.is_ready:
        raise RuntimeError(f"a process ended before its first case, status {worker.process.exitcode}")


def _start(seed: int, specimens: list[tuple[str, Path]], folder: Path) -> _Worker:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    scratch = Path(tempfile.mkdtemp(dir=folder))
    process = context.Process(target=_work, args=(theirs, seed, specimens, scratch), daemon=True)
    process.start()
    theirs.close()
    return _Worker(process=process, pipe=ours, patience=Patience(process.pid, _START_S))


def _work(pipe: Connection, seed: int, specimens: list[tuple[str, Path]], scratch: Path) -> None:
    os.setsid()  # so that its time is told from that of others

    from cases import run_case
    from specimens import KINDS

    faulthandler.enable()
    for kind in {kind for kind, _ in specimens}:  # imports and compilation are not a case's time
        KINDS[kind].read(next(path for k, path in specimens if k == kind))
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    outcome: Any = None
    while True:
        pipe.send(outcome)
        index = pipe.recv()
        if index is None:
            os._exit(0)
        outcome = run_case(specimens, seed, index, scratch)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--only", type=int, help="repeat this case, and keep its file")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    if options.only is not None:
        return _repeat(options.seed, options.only)
    print(f"seed {options.seed}, {options.count} cases", flush=True)
    started = time.monotonic()
    report = fuzz(options.seed, list(range(options.count)), options.processes)
    for kind in sorted({kind for kind, _ in report.counts}):
        print(f"{kind:>10}  {report.counts[kind, True]:6d} refused  {report.counts[kind, False]:6d} read")
    for fault in report.faults:
        print(fault)
    print(
        f"{report.cases} cases in {time.monotonic() - started:.0f} s: {len(report.faults)} faults; the "
        f"slowest took {report.slowest_s:.1f} s, the largest {report.largest_mb:.0f} MB; seed {options.seed}"
    )
    return int(bool(report.faults))


def _repeat(seed: int, index: int) -> int:
    from cases import run_case
    from specimens import write_specimens

    folder = Path(tempfile.mkdtemp(prefix="vntoolkit-fault-"))
    (folder / "good").mkdir()
    faulthandler.enable()
    outcome = run_case(write_specimens(folder / "good"), seed, index, folder)
    shutil.rmtree(folder / "good")
    print(f"{outcome}\nthe file: {folder / 'case'}")
    return int(bool(outcome.fault))


if __name__ == "__main__":
    sys.exit(main())
