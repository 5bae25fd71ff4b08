"""Frames whose normals are found two at a time."""

from __future__ import annotations

import threading

import pytest

from vntoolkit.errors import BadCapture
from vntoolkit.pipeline.threads import side_by_side


@pytest.mark.parametrize("lanes", [1, 2, 3])
def test_results_come_in_order_and_a_failure_in_its_place(lanes: int) -> None:
    def work(item: int) -> int:
        if item == 3:
            raise BadCapture("frame 3 is dark")
        return item * item

    found = []
    for item, done in side_by_side(range(7), [work] * lanes):
        if item == 3:
            with pytest.raises(BadCapture, match="frame 3"):
                done.result()
        else:
            found.append((item, done.result()))
    assert found == [(k, k * k) for k in range(7) if k != 3]


def test_two_lanes_work_at_the_same_time_and_none_on_two_items() -> None:
    meet = threading.Barrier(2, timeout=20)  # breaks unless both lanes are at work at once
    busy = [threading.Lock(), threading.Lock()]

    def lane(k: int):
        def work(item: int) -> int:
            assert busy[k].acquire(blocking=False)
            meet.wait()
            busy[k].release()
            return item

        return work

    assert [done.result() for _, done in side_by_side(range(6), [lane(0), lane(1)])] == list(range(6))
