"""The doors to open3d, pymeshlab and OpenCV's threads: check system libraries first, import late.

Without libGL open3d ends in a traceback, and without libOpenGL pymeshlab imports but cannot save a
.ply file. Both are turned into one line that says what to install.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import sys
import threading
from collections.abc import Iterator
from typing import Any

from vntoolkit.errors import MissingDependency

# shared object -> Debian and Ubuntu package
OPEN3D_LIBRARIES = {"libGL.so.1": "libgl1", "libEGL.so.1": "libegl1", "libusb-1.0.so.0": "libusb-1.0-0"}
PYMESHLAB_LIBRARIES = {"libGL.so.1": "libgl1", "libOpenGL.so.0": "libopengl0"}
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3  # of mallopt(3)
_KEPT_BYTES = 1 << 30
_MORE_THAN_A_HEAP = 1 << 27  # bytes; threads other than the first have heaps of half of that
_lock = threading.Lock()


def missing_packages(libraries: dict[str, str]) -> list[str]:
    """Return the Debian/Ubuntu packages of those shared libraries that cannot be loaded."""
    if not sys.platform.startswith("linux"):
        return []
    missing = []
    for library, package in libraries.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            missing.append(package)
    return missing


def import_open3d() -> Any:
    """Import open3d, or raise `MissingDependency` with the line that installs what it lacks."""
    return _import("open3d", OPEN3D_LIBRARIES)


def import_pymeshlab() -> Any:
    """Import pymeshlab, or raise `MissingDependency` with the line that installs what it lacks."""
    return _import("pymeshlab", PYMESHLAB_LIBRARIES)


def limit_threads(count: int) -> None:
    """Keep OpenCV and numba in this process to so many threads, so that worker processes do not fight."""
    import cv2
    import numba

    cv2.setNumThreads(count)
    numba.set_num_threads(min(count, numba.get_num_threads()))


def keep_freed_memory() -> None:
    """Let this process keep what it frees, since the next frame needs the same arrays again.

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
    """Let OpenCV work in this thread alone while the block runs."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def _import(module: str, libraries: dict[str, str]) -> Any:
    if module not in sys.modules:
        missing = missing_packages(libraries)
        if missing:
            raise MissingDependency(
                f"{module} needs system libraries that are not installed: "
                f"sudo apt-get install {' '.join(missing)}"
            )
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingDependency(
            f"cannot import {module} ({error}): pip install --upgrade {module}"
        ) from error


# Keeps C libraries quiet while they decode: what is wrong with a file is said once, by the error raised.


@contextlib.contextmanager
def silenced_native_output() -> Iterator[None]:
    """Send file descriptor 2 of this process to nowhere; for libpng, libtiff and OpenEXR, which write to it.

    Takes 20 µs. Descriptors belong to the whole process, so a line that another thread writes in the meantime
    is lost too: keep the body short.
    """
    with _lock:
        saved = nowhere = None
        with contextlib.suppress(OSError):  # no descriptor left, or none open: then nothing is kept quiet
            saved = os.dup(2)
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 2)
        try:
            yield
        finally:
            if saved is not None:
                os.dup2(saved, 2)
                os.close(saved)
            if nowhere is not None:
                os.close(nowhere)
