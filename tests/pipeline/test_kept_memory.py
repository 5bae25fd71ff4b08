"""A process that keeps what it frees asks the system for no fresh pages frame after frame."""

import os
import subprocess
import sys

import pytest

_SCRIPT = """
import resource, sys, threading
import numpy as np
from vntoolkit.native import keep_freed_memory

def work():
    if sys.argv[1] == "keep":
        keep_freed_memory()
    for count in (2, 20):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        for _ in range(count):
            arrays = [np.ones(3_000_000, np.uint8) for _ in range(30)]
            del arrays
    print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)

if sys.argv[2] == "first thread":
    work()
else:
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
"""


def _page_faults(what: str, thread: str) -> int:
    """Return how many pages 20 frames of 90 MB took afresh, where malloc is told to give memory back."""
    environment = os.environ | {"MALLOC_TRIM_THRESHOLD_": "65536"}
    command = [sys.executable, "-c", _SCRIPT, what, thread]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="malloc is told so on Linux with glibc")
@pytest.mark.parametrize("thread", ["first thread", "later thread"])  # whose heaps follow other rules
def test_freed_memory_is_used_again(thread):
    assert _page_faults("keep", thread) < 100
    assert _page_faults("give back", thread) > 10_000
