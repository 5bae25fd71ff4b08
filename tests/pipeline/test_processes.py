"""Work shared out to processes: the same results, and a process that dies is named."""

import os
import time
from collections.abc import Callable, Iterator

import pytest

from vntoolkit.errors import BadInput, VntError
from vntoolkit.pipeline.processes import map_in_processes

Work = Callable[[int], list[int]]


def _begin(threads: int | None) -> Work:
    def work(item: int) -> list[int]:
        if item == 9:
            os._exit(1)
        if item < 0:
            raise BadInput(f"item {item}: expected a positive one")
        return [item, 10 * item]

    return work


def _begin_slowly(threads: int | None) -> Work:
    def work(item: int) -> list[int]:
        time.sleep(0.01)
        return [item]

    return work


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_do_not_depend_on_the_processes(jobs: int) -> None:
    assert sorted(map_in_processes(_begin, [1, 2, 3], jobs)) == [1, 2, 3, 10, 20, 30]


def test_items_are_made_while_earlier_ones_are_worked_on() -> None:
    made = []

    def items() -> Iterator[int]:
        for item in range(40):
            made.append(item)
            yield item

    results = map_in_processes(_begin_slowly, items(), 2)
    first = next(results)
    assert len(made) < 10
    assert sorted([first, *results]) == list(range(40))


def test_what_the_work_raises_is_raised() -> None:
    with pytest.raises(BadInput, match="item -1"):
        list(map_in_processes(_begin, [1, -1, 2], 2))


def test_a_worker_that_dies_is_named() -> None:
    with pytest.raises(VntError, match=r"ended abruptly .* run the same command again, with fewer --jobs"):
        list(map_in_processes(_begin, [1, 9], 2))
