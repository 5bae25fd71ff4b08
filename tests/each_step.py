"""What a test does after each step of a run."""

from collections.abc import Callable

from vntoolkit.progress import Listener


class EachStep(Listener):
    """Calls what it was given: to interrupt a run, or to strike its workers."""

    def __init__(self, call: Callable[[], None]) -> None:
        self._call = call

    def step(self, count: int) -> None:
        self._call()
