"""How libraries share the cores while a verb runs; the caller's process is left as it was.

The threads of a BLAS spin for milliseconds after a product of two matrices: they take the cores from the
steps of other frames. What the user has set stays.
"""

from __future__ import annotations

import _thread
import contextlib
import ctypes
import functools
import os

TYPE_CHECKING = False  # importing typing takes time, and a Ctrl-C before `main` leaves a traceback
if TYPE_CHECKING:
    from collections.abc import Iterator

_THREADS = "OPENBLAS_NUM_THREADS"
_lock = _thread.allocate_lock()
_limits: list[int] = []  # an entry for each block within `one_blas_thread`
_before: list[tuple[ctypes.CDLL, str, int]] = []  # what the first of them found
_OPENBLAS = ("scipy_openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads", "openblas_{}_num_threads")


def set_thread_policy() -> None:
    """Set this process's environment, before libraries are loaded: for processes that are our own."""
    os.environ.setdefault(_THREADS, "1")


@contextlib.contextmanager
def thread_policy() -> Iterator[None]:
    """Let libraries that are loaded, and processes that are started, within the block keep the policy.

    The environment is put back, and so is the number of threads of a BLAS that was loaded before.
    """
    if _THREADS in os.environ:
        yield
        return
    set_thread_policy()
    _openblas.cache_clear()
    try:
        with one_blas_thread():
            yield
    finally:
        os.environ.pop(_THREADS, None)


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let the products of matrices within the block take one thread, of every OpenBLAS that is loaded."""
    with _lock:  # blocks may overlap, in several threads: the first limits, the last puts back
        if not _limits:
            _before[:] = [(library, name, library[name.format("get")]()) for library, name in _openblas()]
            for library, name, _ in _before:
                library[name.format("set")](1)
        _limits.append(1)
    try:
        yield
    finally:
        with _lock:
            _limits.pop()
            for library, name, count in () if _limits else _before:
                library[name.format("set")](count)


@functools.cache
def _openblas() -> list[tuple[ctypes.CDLL, str]]:
    """Return every OpenBLAS of the process, with the pattern of its functions' names."""
    with contextlib.suppress(OSError), open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:  # noqa: PTH123 - pathlib takes time
        paths = {line.split(maxsplit=5)[-1].rstrip("\n") for line in maps if "openblas" in line}
        found = []
        for library in map(ctypes.CDLL, sorted(paths)):
            name = next((name for name in _OPENBLAS if hasattr(library, name.format("set"))), None)
            if name is not None:
                found.append((library, name))
        return found
    return []
