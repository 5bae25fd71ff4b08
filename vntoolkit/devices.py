"""Where arrays live: in this computer's memory, or on a graphics card through CuPy or PyTorch.

The per-pixel and Fourier stages have a form that is written against the functions that the Python array API
standard gives all three libraries; a `Backend` hands them the library and takes arrays there and back.
"""

from __future__ import annotations

import importlib
import logging
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

logger = logging.getLogger(__name__)


class Device(Enum):
    """Which processor the per-pixel and Fourier stages run on."""

    CPU = "cpu"
    CUDA = "cuda"  # the processor of this computer where there is no such card, silently


@dataclass(frozen=True, kw_only=True, eq=False)
class Backend:
    """An array library on one device.

    xp: its namespace. to_device: takes a numpy array there. to_host: brings an array back as numpy's.
    """

    name: str
    xp: Any
    to_device: Callable[[npt.NDArray[Any]], Any]
    to_host: Callable[[Any], npt.NDArray[Any]]


def find_backend(device: Device) -> Backend | None:
    """CuPy, else PyTorch, where it is installed and sees a card; None for the ordinary path."""
    if device is Device.CPU:
        return None
    for find in (_cupy, _torch_with_card):
        backend = find()
        if backend is not None:
            logger.info("using %s", backend.name)
            return backend
    return None


def numpy_backend() -> Backend:
    """Numpy itself, to compare with."""
    return Backend(name="numpy", xp=np, to_device=np.asarray, to_host=np.asarray)


def torch_backend(where: str) -> Backend:
    """PyTorch on `cpu` or `cuda`. Raises `ImportError` where it is not installed."""
    torch = importlib.import_module("torch")

    def to_device(array: npt.NDArray[Any]) -> Any:
        return torch.from_numpy(np.array(array)).to(where)

    return Backend(
        name=f"PyTorch on {where}", xp=torch, to_device=to_device, to_host=lambda array: array.cpu().numpy()
    )


def _cupy() -> Backend | None:
    try:
        cupy: Any = importlib.import_module("cupy")
        if cupy.cuda.runtime.getDeviceCount() < 1:
            return None
    except Exception as error:  # a missing driver raises the library's own kinds
        logger.debug("CuPy: %s", error)
        return None
    return Backend(name="CuPy", xp=cupy, to_device=cupy.asarray, to_host=cupy.asnumpy)


def _torch_with_card() -> Backend | None:
    try:
        torch: Any = importlib.import_module("torch")
        return torch_backend("cuda") if torch.cuda.is_available() else None
    except Exception as error:
        logger.debug("PyTorch: %s", error)
        return None
