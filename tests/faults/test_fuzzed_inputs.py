"""Damaged files of every kind: one line or a sound object, never a traceback, a hang or a crash."""

import os

import pytest
from fuzz import fuzz


@pytest.mark.slow
def test_a_thousand_damaged_files_are_read_or_refused_in_one_line():
    """VNTOOLKIT_FUZZ_SEED and VNTOOLKIT_FUZZ_COUNT choose other files and more of them."""
    seed = int(os.environ.get("VNTOOLKIT_FUZZ_SEED", "20111"))
    count = int(os.environ.get("VNTOOLKIT_FUZZ_COUNT", "1000"))
    report = fuzz(seed, list(range(count)))
    assert report.faults == [], f"repeat with: python tests/faults/fuzz.py --seed {seed} --only CASE"
    assert report.cases == count
    refused = sum(number for (_, was_refused), number in report.counts.items() if was_refused)
    assert 0.5 * count < refused < count  # a suite that damages nothing, or only noise, would prove nothing


def test_a_few_damaged_files_of_every_kind_are_read_or_refused_in_one_line():
    report = fuzz(5, list(range(120)), processes=1)
    assert report.faults == []
    assert report.cases == 120
