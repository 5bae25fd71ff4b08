"""Many machines: the same bytes from Dask's workers, a worker that dies in mid-run, a run that goes on."""

import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest

from tests.each_step import EachStep
from tests.pipeline.conftest import DomeCapture, write_dome_capture
from tests.pipeline.test_reconstruct import digest, footage_with_specks
from tests.pipeline.test_reconstruct import job_of as reconstruct_job_of
from vntoolkit.errors import BadInput, BadMesh, MissingDependency, VntError
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.results.frame_log import FrameLog
from vntoolkit.options.reconstruction import Product
from vntoolkit.pipeline import cluster
from vntoolkit.pipeline.cluster import connected
from vntoolkit.pipeline.reconstruct import reconstruct
from vntoolkit.pipeline.request import Request
from vntoolkit.progress import heard_by


def job_of(capture: DomeCapture, out: Path) -> Request:
    return reconstruct_job_of(capture, out, to=Product.DEPTH)


def test_without_dask_one_line_says_what_to_install(dome_capture, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependency, match=r"pip install vntoolkit\[cluster\]"):
        reconstruct(job_of(dome_capture, tmp_path / "out"), scheduler="local")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_worker_that_dies_costs_nothing_but_time(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    (tmp_path / "footage").mkdir()
    capture = write_dome_capture(tmp_path / "footage", count=96)
    alone, many = tmp_path / "alone", tmp_path / "many"
    reconstruct(job_of(capture, alone))
    struck: list[int] = []
    with connected("local", 2) as client:
        processes = client.run(os.getpid)
        assert len(processes) == 2

        def strike() -> None:
            if not struck:
                struck.append(next(iter(processes.values())))
                os.kill(struck[0], signal.SIGKILL)
                (many / "normals" / f".000033.{struck[0]}.part.exr").touch()  # as if it had been writing

        address = client.scheduler.address
        job = job_of(capture, many)
        with heard_by(EachStep(strike)):
            summary = reconstruct(job, scheduler=address)
        survivors = set(client.run(os.getpid).values())
    assert struck
    assert struck[0] not in survivors
    assert summary.done == 96
    assert len(digest(alone)) == 2 * 96
    assert digest(many) == digest(alone)
    assert sorted(FrameLog(many).done()) == list(range(96))


@pytest.fixture
def small_cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """The address of a scheduler of its own, its process, and those of two workers without nannies."""
    pytest.importorskip("distributed")
    for name, seconds in (
        ("_SECONDS_TO_CONNECT", 5),
        ("_SECONDS_BETWEEN_LOOKS", 1),
        ("_SECONDS_OF_SILENCE", 6),
    ):
        monkeypatch.setattr(cluster, name, seconds)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"

    def start(kind: str, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *words, "--no-dashboard"]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    processes = [start("scheduler", "--port", str(port), "--host", "127.0.0.1")]
    processes += [start("worker", address, "--no-nanny", "--nthreads", "1") for _ in range(2)]
    try:
        distributed = pytest.importorskip("distributed")
        with distributed.Client(address, timeout=60) as client:
            client.wait_for_workers(2, timeout=60)
        yield address, processes
    finally:
        for process in processes:
            process.send_signal(signal.SIGCONT)
            process.kill()
            process.wait()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("struck", "how", "line"),
    [
        ((0,), signal.SIGKILL, "the Dask scheduler"),
        ((0,), signal.SIGSTOP, "the Dask scheduler does not answer any more"),
        ((1, 2), signal.SIGKILL, "no worker of the Dask scheduler|workers have ended, with what they held"),
        ((1, 2), signal.SIGSTOP, "the Dask worker tcp://.* does not answer any more"),
        ((1,), signal.SIGSTOP, "the Dask worker tcp://.* does not answer any more"),
        ((1,), signal.SIGKILL, ""),
    ],
    ids=[
        "scheduler killed",
        "scheduler stopped",
        "workers killed",
        "workers stopped",
        "one worker stopped",
        "one worker killed",
    ],
)
def test_what_happens_to_a_cluster_is_one_line_or_nothing(tmp_path, small_cluster, struck, how, line):
    """The run ends by one line, or goes on with the worker that is left; given again, it is completed."""
    address, processes = small_cluster
    (tmp_path / "footage").mkdir()
    capture = write_dome_capture(tmp_path / "footage", count=64)
    job, pending = job_of(capture, tmp_path / "out"), list(struck)

    def strike() -> None:
        while pending:
            processes[pending.pop()].send_signal(how)

    expected = (
        pytest.raises(VntError, match=f"({line}).*run the same command again") if line else nullcontext()
    )
    with expected, heard_by(EachStep(strike)):
        reconstruct(job, scheduler=address)
    done = len(FrameLog(tmp_path / "out").done())
    assert done == 64 if not line else 0 < done < 64
    assert reconstruct(job).resumed == done
    assert len(FrameLog(tmp_path / "out").done()) == 64


def test_what_dask_logs_of_a_lost_cluster_is_not_shown_beside_our_line() -> None:
    """Their tracebacks come when a client closes, from loggers with outputs of their own."""
    pytest.importorskip("distributed")
    with pytest.raises(BadInput), connected("no-such-way://here:1", 0):
        pass
    for name in ("distributed.client", "distributed.utils", "tornado.application", "asyncio"):
        assert not logging.getLogger(name).isEnabledFor(logging.ERROR), name


@pytest.mark.slow
def test_a_run_on_a_cluster_goes_on_where_another_stopped(dome_capture: DomeCapture, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    alone, many = tmp_path / "alone", tmp_path / "many"
    reconstruct(job_of(dome_capture, alone))
    reconstruct(job_of(dome_capture, many), frames=FrameRange.from_text("0:5"))
    summary = reconstruct(job_of(dome_capture, many), scheduler="local", jobs=2)
    assert (summary.resumed, summary.done) == (5, 15)
    assert digest(many) == digest(alone)


@pytest.mark.slow
def test_a_frame_that_fails_on_a_worker_is_named_here(dome_capture: DomeCapture, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    job = job_of(footage_with_specks(dome_capture, tmp_path), tmp_path / "out")
    job = replace(job, options=replace(job.options, to=Product.MESH))
    with pytest.raises(BadMesh, match="no three neighbouring"):
        reconstruct(job, scheduler="local", jobs=1)


@pytest.mark.slow
def test_a_scheduler_out_of_reach_costs_no_result(dome_capture: DomeCapture, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    job = job_of(dome_capture, tmp_path / "out")
    reconstruct(job, frames=FrameRange(stop=2))
    before = digest(tmp_path)
    with pytest.raises(BadInput, match="no Dask scheduler answers there"):
        reconstruct(job, scheduler="tcp://127.0.0.1:1", overwrite=True)
    assert digest(tmp_path) == before
