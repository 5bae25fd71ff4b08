"""Fixtures that every test folder shares."""

import os
from pathlib import Path

from vntoolkit.threads import set_thread_policy

set_thread_policy()  # before numpy is loaded: as the workers do, which must round alike

# isort: split
import numpy as np  # noqa: E402
import pytest  # noqa: E402

from tests.dome_result import dome_result  # noqa: E402
from tests.studio import footage, studio  # noqa: E402

__all__ = ["dome_result", "footage", "studio"]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20111)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real photographs, or a skip that says how to run the test."""
    folder = os.environ.get("VNTOOLKIT_REAL_DATA")
    if not folder:
        pytest.skip("VNTOOLKIT_REAL_DATA is not set: tests on real photographs need that folder")
    path = Path(folder)
    if not path.is_dir():
        pytest.fail(f"VNTOOLKIT_REAL_DATA={folder} is not a folder")
    return path
