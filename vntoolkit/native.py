"""Compiled loops, their cache and their threads; memory and workers of this process."""

import contextlib
import ctypes
import functools
import logging
import os
import stat
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from vntoolkit.threads import set_thread_policy

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3  # of mallopt(3)
_KEPT_BYTES = 1 << 30
_MORE_THAN_A_HEAP = 1 << 27  # bytes; threads other than the first have heaps of half of that
_LOGGER = logging.getLogger(__name__)


def limit_threads(count: int) -> None:
    """Limit OpenCV in this process to so many threads, so that worker processes share the cores."""
    set_thread_policy()
    import cv2

    cv2.setNumThreads(count)


def end_with_parent() -> None:
    """End this worker process when the one that started it is gone, however that ended."""
    import multiprocessing
    from multiprocessing.connection import wait

    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)  # nobody is left to hear of it

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


def keep_freed_memory() -> None:
    """Keep freed memory in this process, because the next frame needs arrays of the same sizes.

    Dask has its workers give memory back at once (MALLOC_TRIM_THRESHOLD_), which at 1280×720 costs more time
    in the kernel, for fresh pages, than normals and depth together. The heaps of threads, and Dask works in
    one, are given back by another rule, which only the padding of their tops holds off. Does nothing where
    malloc is not glibc's.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for setting in (_TRIM_THRESHOLD, _MMAP_THRESHOLD):
            mallopt(setting, _KEPT_BYTES)
        mallopt(_TOP_PAD, _MORE_THAN_A_HEAP)


@contextlib.contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Run OpenCV in one thread while the block runs."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


# Kernels, whose machine code is kept on disk where that can be, and made again where it cannot.

_Function = TypeVar("_Function", bound=Callable[..., Any])


def njit(function: _Function | None = None, **options: Any) -> Any:
    """`numba.njit` as this package uses it; what goes wrong with its cache stops no kernel.

    A kernel runs in one thread and without Python's lock: several frames, or steps of a frame, are at work at
    a time instead. Division by 0 gives infinity or NaN, as in numpy, so that loops are done several pixels at
    a time. Where neither the package's own folder nor the user's may be written to (another user, no home),
    machine code is kept in a private temporary folder. A cache that is full or damaged is passed over, and
    repaired where it can be.
    """
    import numba

    if function is None:
        return functools.partial(njit, **options)
    kernel = numba.njit(nogil=True, error_model="numpy", **options)(function)
    with contextlib.suppress(Exception):
        kernel._cache = _ForgivingCache(_cache_of(function), function)  # as `cache=True` sets it
    return kernel


def _cache_of(function: Callable[..., Any]) -> Any:
    import numba
    from numba.core.caching import FunctionCache

    try:
        return FunctionCache(function)
    except RuntimeError:  # no place that may be written to
        numba.config.CACHE_DIR = _private_folder()  # type: ignore[attr-defined]
        return FunctionCache(function)


def _private_folder() -> str:
    """Return this user's temporary folder for machine code; raise `OSError` where others may write to it."""
    import tempfile

    user = os.getuid() if hasattr(os, "getuid") else 0
    path = os.path.join(tempfile.gettempdir(), f"vntoolkit-numba-{user}")  # noqa: PTH118 - numba wants text
    with contextlib.suppress(FileExistsError):
        os.mkdir(path, 0o700)  # noqa: PTH102
    found = os.lstat(path)
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != user or found.st_mode & 0o077:
        raise PermissionError(f"{path}: other users can write there, so compiled code is not loaded from it")
    return path


class _ForgivingCache:
    """numba's cache of one kernel, every failure of which means that there is nothing in it."""

    def __init__(self, cache: Any, function: Callable[..., Any]) -> None:
        self._cache, self._module = cache, function.__module__

    def load_overload(self, *asked: Any) -> Any:
        found = None
        try:
            found = self._cache.load_overload(*asked)
        except Exception:  # truncated, or not to be read
            with contextlib.suppress(Exception):
                self._cache.flush()
        if found is None and self._module.startswith("vntoolkit."):
            _tell(self._module.split(".")[1])
        return found

    def save_overload(self, *made: Any) -> None:
        with contextlib.suppress(Exception):  # a full disk, or a folder that was locked since
            self._cache.save_overload(*made)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)


@functools.cache
def _tell(part: str) -> None:
    """Say what is waited for, a line for each part of the package: some are met in some footage only."""
    _LOGGER.info("compiling the loops of %s, once per installation ...", part)
