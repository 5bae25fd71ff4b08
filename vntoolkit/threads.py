"""How libraries share the cores while a verb runs; the caller's process is left as it was.

Thread pools that spin while they wait take the cores from the pool that works: a frame then takes 17 to 22 ms
instead of 7. numba would try TBB first and warn of an old one. What the user has set stays.
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

NUMBA_LAYERS = "NUMBA_THREADING_LAYER_PRIORITY"
_POLICY = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "PASSIVE",
    "GOMP_SPINCOUNT": "0",
    "KMP_BLOCKTIME": "0",
    NUMBA_LAYERS: "omp tbb workqueue",
}
_lock = _thread.allocate_lock()
_limits: list[int] = []  # an entry for each block within `one_blas_thread`
_before: list[tuple[ctypes.CDLL, str, int]] = []  # what the first of them found
_OPENBLAS = ("scipy_openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads", "openblas_{}_num_threads")


def set_thread_policy() -> None:
    """Set this process's environment, before libraries are loaded: for processes that are our own."""
    for name, value in _POLICY.items():
        os.environ.setdefault(name, value)


@contextlib.contextmanager
def thread_policy() -> Iterator[None]:
    """Let libraries that are loaded, and processes that are started, within the block keep the policy.

    The environment is put back, and so is the number of threads of a BLAS that was loaded before.
    """
    before = {name: os.environ.get(name) for name in _POLICY}
    set_thread_policy()
    _openblas.cache_clear()
    limit = one_blas_thread() if before["OPENBLAS_NUM_THREADS"] is None else contextlib.nullcontext()
    try:
        with limit:
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let the products of matrices within the block take one thread, of every OpenBLAS that is loaded.

    Its other threads spin for milliseconds after a product of two, beside the compiled loops of the frame.
    """
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
