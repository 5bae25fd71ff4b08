"""A process that keeps what it frees asks the system for no fresh pages frame after frame."""

import os
import subprocess
import sys

import pytest

_SCRIPT = """
import resource, sys
import numpy as np
from vntoolkit.native import keep_freed_memory
if sys.argv[1] == "keep":
    keep_freed_memory()
for count in (2, 20):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(count):
        arrays = [np.ones(3_000_000, np.uint8) for _ in range(4)]
        del arrays
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def _page_faults(what: str) -> int:
    """Return how many pages 20 frames of 12 MB took afresh, where malloc is told to give memory back."""
    environment = os.environ | {"MALLOC_TRIM_THRESHOLD_": "65536"}
    command = [sys.executable, "-c", _SCRIPT, what]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="malloc is told so on Linux with glibc")
def test_freed_memory_is_used_again():
    assert _page_faults("keep") < 100
    assert _page_faults("give back") > 10_000
