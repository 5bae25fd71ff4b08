"""Reading ahead and writing behind keep order and surface errors; at depth 0 neither needs a thread."""

import threading

import pytest

from vntoolkit.pipeline.threads import WriteBehind, read_ahead


@pytest.mark.parametrize("depth", [0, 1, 3])
def test_items_come_in_order_and_an_error_in_its_place(depth):
    def items():
        yield from range(5)
        raise ValueError("the sixth")

    got = []
    with pytest.raises(ValueError, match="the sixth"):
        got.extend(read_ahead(items(), depth))
    got = []
    with pytest.raises(ValueError, match="the sixth"):  # noqa: PT012 - what came before it counts
        for item in read_ahead(items(), depth):
            got.append(item)
    assert got == list(range(5))


@pytest.mark.parametrize("depth", [1, 2])
def test_writes_keep_order_and_a_failed_one_is_raised(depth):
    written = []

    def write(item):
        if item == 3:
            raise OSError("disk full")
        written.append(item)

    def run():
        with WriteBehind(write, depth) as writer:
            for item in range(10):
                writer.put(item)

    with pytest.raises(OSError, match="disk full"):
        run()
    assert written[:3] == [0, 1, 2]
    assert len(written) <= 3 + depth  # what was waiting already may still be written
    assert 3 not in written


@pytest.mark.parametrize(("depth", "here"), [(0, True), (2, False)])
def test_depth_0_reads_in_the_calling_thread(depth, here):
    def items():
        yield threading.get_ident()

    assert (list(read_ahead(items(), depth)) == [threading.get_ident()]) is here


@pytest.mark.parametrize(("depth", "here"), [(0, True), (2, False)])
def test_depth_0_writes_in_the_calling_thread(depth, here):
    writers = []
    with WriteBehind(lambda _: writers.append(threading.get_ident()), depth) as writer:
        writer.put("frame")
    assert (writers == [threading.get_ident()]) is here


def test_depth_0_raises_a_failed_write_at_once():
    def write(_):
        raise OSError("disk full")

    with WriteBehind(write, 0) as writer, pytest.raises(OSError, match="disk full"):
        writer.put("frame")
