"""docs/measured.md is what `make measure` wrote: every row is a number that a command printed."""

import json
import re
from pathlib import Path

import pytest

from benchmarks.measure import JOBS, PAGE, STORE, command_of, measured, page_of

MOST_WORDS = 3_500


def test_the_page_is_the_template_filled_with_the_numbers_measured() -> None:
    store = json.loads(STORE.read_text())
    assert set(store) == set(JOBS)
    page = PAGE.read_text()
    assert page == page_of(store), "run `python -m benchmarks.measure --page`"
    assert len(page.split()) < MOST_WORDS
    for job in JOBS:
        if job != "ratios":  # `make ratios`, as the page says
            assert command_of(job) in page, f"{job}: measured, and not on the page"


def test_every_number_of_the_readme_stands_on_the_page() -> None:
    page, readme = PAGE.read_text(), (PAGE.parents[1] / "README.md").read_text()
    table = readme.split("<!-- measured:", 1)[1].split("Limits:", 1)[0]
    rows = [line.split("|")[4:6] for line in table.splitlines() if line.startswith("| ")][2:]
    assert len(rows) > 4
    for number in re.findall(r"\d+\.\d+", " ".join(map(" ".join, rows))):
        assert number in page, f"{number}: in the README, and not measured"


@pytest.mark.slow
def test_the_stored_numbers_are_those_that_the_command_prints_today(tmp_path: Path) -> None:
    fresh = measured("figure04", tmp_path, None)
    stored = json.loads(STORE.read_text())["figure04"]
    assert fresh is not None
    assert fresh["numbers"].keys() == stored["numbers"].keys()
    for what, (value, _) in fresh["numbers"].items():
        assert value == pytest.approx(stored["numbers"][what][0], abs=0.005), what
