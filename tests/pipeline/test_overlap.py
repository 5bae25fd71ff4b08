"""Steps in threads keep order and surface errors; with none waiting neither needs a thread."""

import threading

import pytest

from vntoolkit.errors import BadCapture
from vntoolkit.pipeline.threads import read_ahead, side_by_side, stepped


@pytest.mark.parametrize("depth", [0, 1, 3])
def test_items_come_in_order_and_an_error_in_its_place(depth):
    def items():
        yield from range(5)
        raise ValueError("the sixth")

    got = []
    with pytest.raises(ValueError, match="the sixth"):  # noqa: PT012 - what came before it counts
        for item in read_ahead(items(), depth):
            got.append(item)
    assert got == list(range(5))


@pytest.mark.parametrize("waiting", [0, 1, 2])
def test_writes_keep_order_and_a_failed_one_is_raised(waiting):
    written = []

    def write(item):
        if item == 3:
            raise OSError("disk full")
        written.append(item)

    with pytest.raises(OSError, match="disk full"):
        list(stepped(range(10), write, waiting=waiting))
    assert written[:3] == [0, 1, 2]
    assert len(written) <= 3 + waiting  # what was waiting already may still be written
    assert 3 not in written


@pytest.mark.parametrize(("waiting", "here"), [(0, True), (2, False)])
def test_with_none_waiting_the_calling_thread_reads_and_writes(waiting, here):
    def items():
        yield threading.get_ident()

    assert (list(read_ahead(items(), waiting)) == [threading.get_ident()]) is here
    writers = list(stepped(["frame"], lambda _: threading.get_ident(), waiting=waiting))
    assert (writers == [threading.get_ident()]) is here


def test_a_chain_that_is_left_ends_its_threads_and_joins_none(monkeypatch):
    """Python may close an abandoned chain inside the start of a thread, where a join never ends."""
    before = set(threading.enumerate())
    chain = stepped(stepped(read_ahead(iter(range(100)), 1), str, waiting=1), len, waiting=1)
    assert next(chain) == 1
    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "join", lambda *_: pytest.fail("joined"))
        chain.close()
    for thread in set(threading.enumerate()) - before:
        thread.join(timeout=30)
    assert set(threading.enumerate()) <= before


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_results_come_in_order_and_a_failure_in_its_place(threads):
    def work(item):
        if item == 3:
            raise BadCapture("frame 3 is dark")
        return item * item

    found = []
    for item, done in side_by_side(range(7), work, threads):
        if item == 3:
            with pytest.raises(BadCapture, match="frame 3"):
                done.result()
        else:
            found.append((item, done.result()))
    assert found == [(k, k * k) for k in range(7) if k != 3]


def test_two_threads_work_at_the_same_time():
    meet = threading.Barrier(2, timeout=20)  # breaks unless both are at work at once

    def work(item):
        meet.wait()
        return item

    assert list(stepped(range(6), work, threads=2)) == list(range(6))
