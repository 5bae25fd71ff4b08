"""What a file states is used, or refused by name: every kind of `stated_files`, by several seeds."""

import numpy as np
import pytest

from tests.faults.stated_change import fault_of
from tests.faults.stated_files import CHANGES


@pytest.mark.parametrize("kind", list(CHANGES))
def test_what_a_file_states_is_used_or_refused(tmp_path, kind):
    for seed in range(8):
        folder = tmp_path / str(seed)
        folder.mkdir()
        assert not fault_of(CHANGES[kind](folder, np.random.default_rng(seed))), f"seed {seed}"
