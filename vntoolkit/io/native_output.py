"""Keeps C libraries quiet while they decode: what is wrong with a file is said once, by the error raised."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator

_lock = threading.Lock()


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
