"""Import of open3d and pymeshlab, with a check of the system libraries that they need.

Without libGL open3d ends in a traceback, and without libOpenGL pymeshlab imports but cannot save a
.ply file. Each is turned into one line that names the library and the package that holds it.
"""

import contextlib
import ctypes
import importlib
import re
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType
from typing import Any

from vntoolkit.errors import MissingDependency, VntError

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
# Open3D is published twice: without CUDA, for Linux on x86-64 only, and with it, for every system.
OPEN3D_DISTRIBUTIONS = ("open3d-cpu", "open3d")
# What the loader of glibc says, of any library and of those that it needs in turn.
_NOT_LOADED = re.compile(r"([\w+.-]+\.so[.\d]*): cannot open shared object file")


def import_open3d() -> Any:
    """Import open3d, or raise `MissingDependency` with the line that installs what it lacks.

    Its plots, which import a web server, come when they are first called: that is half of the time.
    """
    if "open3d" in sys.modules:
        return _import("open3d", OPEN3D_LIBRARIES)
    with _put_off("open3d.visualization", "draw_plotly"):
        return _import("open3d", OPEN3D_LIBRARIES)


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
    known = {**OPEN3D_LIBRARIES, **PYMESHLAB_LIBRARIES}
    return {library: known.get(library, "") for library in _NOT_LOADED.findall(text)}


def open3d_distribution() -> tuple[str, str]:
    """Return the name and version of the installed Open3D distribution; `absent` where there is none."""
    for name in OPEN3D_DISTRIBUTIONS:
        with contextlib.suppress(PackageNotFoundError):
            return name, version(name)
    return OPEN3D_DISTRIBUTIONS[0], "absent"


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


def _import(module: str, libraries: dict[str, str]) -> Any:
    missing = {} if module in sys.modules else missing_libraries(libraries)
    try:
        if not missing:
            return importlib.import_module(module)
    except ImportError as error:
        missing = libraries_named_in(str(error))
        if not missing:
            name = open3d_distribution()[0] if module == "open3d" else module
            reinstall = f"pip install --force-reinstall {name}"
            raise MissingDependency(f"cannot import {module} ({error}): {reinstall}") from error
    raise MissingDependency(
        f"{module} needs {', '.join(missing)}, which this system lacks: {remedy(missing)}"
    )
