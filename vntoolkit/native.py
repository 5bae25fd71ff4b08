"""Import of numba, open3d and pymeshlab, with a check of system libraries; threads and output of C libraries.

Without libGL open3d ends in a traceback, and without libOpenGL pymeshlab imports but cannot save a
.ply file. Each is turned into one line that names the library and the package that holds it.
"""

import atexit
import contextlib
import ctypes
import functools
import importlib
import logging
import os
import re
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType
from typing import Any

from vntoolkit.errors import MissingDependency, VntError
from vntoolkit.threads import NUMBA_LAYERS, set_thread_policy, thread_policy

# Shared object -> Debian and Ubuntu package. What a wheel brings along, or every system has, is not here.
OPEN3D_LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libidn2.so.0": "libidn2-0",
}
PYMESHLAB_LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libOpenGL.so.0": "libopengl0",
    "libcom_err.so.2": "libcom-err2",
    "libp11-kit.so.0": "libp11-kit0",
}
# Without OpenMP numba falls back to a layer whose parallel loops only one thread of a process may run.
NUMBA_LIBRARIES = {"libgomp.so.1": "libgomp1"}
# Open3D is published twice: without CUDA, for Linux on x86-64 only, and with it, for every system.
OPEN3D_DISTRIBUTIONS = ("open3d-cpu", "open3d")

# What the loader of glibc says, of any library and of those that it needs in turn.
_NOT_LOADED = re.compile(r"([\w+.-]+\.so[.\d]*): cannot open shared object file")

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3  # of mallopt(3)
_KEPT_BYTES = 1 << 30
_MORE_THAN_A_HEAP = 1 << 27  # bytes; threads other than the first have heaps of half of that
_lock = threading.Lock()
_LOGGER = logging.getLogger(__name__)


def missing_libraries(libraries: dict[str, str]) -> dict[str, str]:
    """Return those of the shared libraries that cannot be loaded, with their Debian and Ubuntu packages."""
    if not sys.platform.startswith("linux"):
        return {}
    missing = {}
    for library, package in libraries.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            missing[library] = package
    return missing


def remedy(libraries: dict[str, str]) -> str:
    """Return the line that installs shared libraries; an empty package is one that we do not know."""
    packages = sorted({package for package in libraries.values() if package})
    unknown = [library for library, package in libraries.items() if not package]
    steps = [f"sudo apt-get install {' '.join(packages)}"] if packages else []
    if unknown:
        steps.append(f"install the package that holds {', '.join(unknown)} (apt-file search NAME finds it)")
    return ", then ".join(steps)


def libraries_named_in(text: str) -> dict[str, str]:
    """Return the shared libraries that a loader's message says are missing, with their packages."""
    known = {**OPEN3D_LIBRARIES, **PYMESHLAB_LIBRARIES, **NUMBA_LIBRARIES}
    return {library: known.get(library, "") for library in _NOT_LOADED.findall(text)}


def open3d_distribution() -> tuple[str, str]:
    """Return the name and version of the installed Open3D distribution; `absent` where there is none."""
    for name in OPEN3D_DISTRIBUTIONS:
        with contextlib.suppress(PackageNotFoundError):
            return name, version(name)
    return OPEN3D_DISTRIBUTIONS[0], "absent"


def import_open3d() -> Any:
    """Import open3d, or raise `MissingDependency` with the line that installs what it lacks.

    Its plots, which import a web server, come when they are first called: that is half of the time.
    """
    if "open3d" in sys.modules:
        return _import("open3d", OPEN3D_LIBRARIES)
    with _put_off("open3d.visualization", "draw_plotly"):
        return _import("open3d", OPEN3D_LIBRARIES)


@contextlib.contextmanager
def _put_off(package: str, module: str) -> Iterator[None]:
    """Import a package without one of its modules, whose functions import it when they are called."""
    name, functions = f"{package}.{module}", []

    def function(called: str) -> Callable[..., Any]:
        if called.startswith("__"):
            raise AttributeError(called)
        functions.append(called)

        def call(*given: Any, **named: Any) -> Any:
            found = importlib.import_module(name)
            for each in functions:  # importing puts the module itself where a function of its name was
                setattr(sys.modules[package], each, getattr(found, each))
            return getattr(found, called)(*given, **named)

        return call

    stand_in = ModuleType(name)
    stand_in.__getattr__ = function  # type: ignore[method-assign]
    sys.modules[name] = stand_in
    try:
        yield
    finally:
        if sys.modules.get(name) is stand_in:
            del sys.modules[name]


def import_pymeshlab() -> Any:
    """Import pymeshlab, or raise `MissingDependency` with the line that installs what it lacks."""
    return _import("pymeshlab", PYMESHLAB_LIBRARIES)


def require_installed(module: str, distribution: str, use: str) -> None:
    """Raise `MissingDependency` where a Python library cannot be imported that only this use needs."""
    try:
        importlib.import_module(module)
    except ImportError as error:
        line = f"pip install {distribution}"
        raise MissingDependency(f"{use}, and {distribution} is missing: {line}") from error


def limit_threads(count: int) -> None:
    """Limit OpenCV and numba in this process to so many threads, so that worker processes share the cores."""
    set_thread_policy()
    import cv2
    import numba

    cv2.setNumThreads(count)
    numba.set_num_threads(min(count, numba.get_num_threads()))


def loops_may_overlap() -> bool:
    """True where two threads of this process may run parallel loops at once.

    Where there is neither OpenMP nor TBB, numba's own layer ends a process that does.
    """
    import numba

    numba.get_num_threads()  # which starts the layer
    layer: str = numba.threading_layer()  # type: ignore[attr-defined]
    return layer != "workqueue"


def require_address_space(size: int, name: str) -> None:
    """Raise `VntError` where `ulimit -v` leaves a library less than it takes: it would end the process."""
    if not sys.platform.startswith("linux"):
        return
    import resource

    most = resource.getrlimit(resource.RLIMIT_AS)[0]
    if most == resource.RLIM_INFINITY:
        return
    with open("/proc/self/statm") as file:  # noqa: PTH123
        left = most - int(file.read().split()[0]) * resource.getpagesize()
    if left < size:
        raise VntError(
            f"{name} needs {size / 2**30:.0f} GiB of address space, {max(0, left) / 2**30:.1f} are left: "
            "raise `ulimit -v`"
        )


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


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with options, without Python's lock, and what goes wrong with its cache stops no kernel.

    With the lock, the threads that read and write files would wait for every kernel that a frame takes.
    Where neither the package's own folder nor the user's may be written to (another user, no home), machine
    code is kept in a private temporary folder. A cache that is full or damaged is passed over, and repaired
    where it can be.
    """
    numba = _numba()
    is_kept = options.pop("cache", False)

    def compiled(function: Callable[..., Any]) -> Any:
        kernel = numba.njit(nogil=True, **options)(function)
        if is_kept:
            with contextlib.suppress(Exception):
                kernel._cache = _ForgivingCache(_cache_of(function), function)  # as `cache=True` sets it
        return kernel

    return compiled


@functools.cache
def _numba() -> Any:
    """Import numba, whose OpenMP threads wait without spinning; what the user has set stays."""
    with thread_policy():
        import numba

        with contextlib.suppress(OSError):
            ctypes.CDLL("libgomp.so.1")  # which reads the environment once, now
        numba.config.THREADING_LAYER_PRIORITY = os.environ[NUMBA_LAYERS].split()  # type: ignore[attr-defined]
    return numba


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
    """numba's cache of one kernel, every failure of which means that there is nothing in it.

    A kernel of this package that is not in it is compiled by another process, and read: the process that
    compiles a parallel loop runs its first machine code, all others a copy that was optimised once more and
    rounds otherwise. The first run of an installation would differ from the second in the last bit.
    """

    def __init__(self, cache: Any, function: Callable[..., Any]) -> None:
        self._cache, self._function = cache, function

    def load_overload(self, signature: Any, context: Any) -> Any:
        found = self._read(signature, context)
        if found is None and _compiler.compiles(self._function, signature):
            found = self._read(signature, context)
            _compiler.is_off = found is None  # the cache keeps nothing
        return found

    def _read(self, *asked: Any) -> Any:
        try:
            return self._cache.load_overload(*asked)
        except Exception:  # truncated, or not to be read
            with contextlib.suppress(Exception):
                self._cache.flush()
            return None

    def save_overload(self, *made: Any) -> None:
        with contextlib.suppress(Exception):  # a full disk, or a folder that was locked since
            self._cache.save_overload(*made)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)


class _Compiler:
    """A process that compiles kernels of this package into the cache; it ends with the one that asks."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Any = None
        self._asked_by = 0  # process id: a fork has the pipe, but not the right to use it
        self.is_off = False  # in the process that compiles, and where asking is of no use
        self._told: set[str] = set()

    def compiles(self, function: Callable[..., Any], signature: Any) -> bool:
        """True where the other process has compiled a kernel; numba lets one thread ask at a time."""
        name = function.__qualname__
        if self.is_off or not function.__module__.startswith("vntoolkit.") or not name.isidentifier():
            return False
        self._tell(function.__module__.split(".")[1])
        try:
            if self._asked_by != os.getpid():
                self._start()
            self._pipe.send((function.__module__, name, signature))
            return bool(self._pipe.recv())
        except Exception:  # it could not be started or asked
            self.is_off = True
            return False

    def _tell(self, part: str) -> None:
        """Say what is waited for, a line for each part of the package: some are met in some footage only."""
        if part not in self._told:
            self._told.add(part)
            _LOGGER.info("compiling the loops of %s, once per installation ...", part)

    def _start(self) -> None:
        from multiprocessing import Pipe

        self._pipe, theirs = Pipe()
        ask = f"from vntoolkit.native import serve_compiler; serve_compiler({theirs.fileno()})"
        path = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONSAFEPATH": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-c", ask],
            env=os.environ | path,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(theirs.fileno(),),
        )
        theirs.close()
        self._asked_by = os.getpid()
        atexit.register(self._end)

    def _end(self) -> None:
        if self._process is not None and self._asked_by == os.getpid():
            self._pipe.close()
            self._process.wait()


_compiler = _Compiler()


def serve_compiler(pipe: int) -> None:
    """Compile the kernels that another process names, and tell it of each, until that has ended."""
    from multiprocessing.connection import Connection

    _compiler.is_off = True
    asked = Connection(pipe)
    with contextlib.suppress(EOFError):
        while True:
            module, name, signature = asked.recv()
            try:
                getattr(importlib.import_module(module), name).compile(signature)
                asked.send(True)
            except Exception:
                asked.send(False)


def _import(module: str, libraries: dict[str, str]) -> Any:
    if module not in sys.modules:
        missing = missing_libraries(libraries)
        if missing:
            raise MissingDependency(
                f"{module} needs {', '.join(missing)}, which this system lacks: {remedy(missing)}"
            )
    try:
        return importlib.import_module(module)
    except ImportError as error:
        named = libraries_named_in(str(error))
        if named:
            raise MissingDependency(
                f"{module} needs {', '.join(named)}, which this system lacks: {remedy(named)}"
            ) from error
        raise MissingDependency(f"cannot import {module} ({error}): {_reinstalling(module)}") from error


def _reinstalling(module: str) -> str:
    name = open3d_distribution()[0] if module == "open3d" else module
    return f"pip install --force-reinstall {name}"


@contextlib.contextmanager
def silenced_native_output() -> Iterator[None]:
    """Discard what libpng, libtiff and OpenEXR write to standard error while the block runs.

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
