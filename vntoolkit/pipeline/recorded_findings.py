"""What a run warns of, kept beside being said: nothing goes to the terminal alone."""

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from vntoolkit.diagnosis.finding import Finding
from vntoolkit.io.results.manifest import FindingEntry


@contextmanager
def recorded_warnings() -> Iterator[list[FindingEntry]]:
    """Yield the list of what the package warns of in the block, each once; its check is the file's name."""
    recorder = _Recorder()
    package = logging.getLogger("vntoolkit")
    package.addHandler(recorder)
    try:
        yield recorder.found
    finally:
        package.removeHandler(recorder)


class _Recorder(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.found: list[FindingEntry] = []

    def emit(self, record: logging.LogRecord) -> None:
        text = " ".join(record.getMessage().split())
        if text not in {finding.text for finding in self.found}:
            check = record.name.rpartition(".")[2].replace("_", "-")
            self.found.append(FindingEntry(check=check, level="warning", text=text))


def entries_of(findings: Iterable[Finding]) -> list[FindingEntry]:
    """Return findings as the manifest holds them."""
    return [FindingEntry(check=f.check, level=f.level.value, text=f.text) for f in findings]


def without_repeats(*groups: list[FindingEntry]) -> list[FindingEntry]:
    """Return the findings of all groups, each text once."""
    by_text: dict[str, FindingEntry] = {}
    for finding in (finding for group in groups for finding in group):
        by_text.setdefault(finding.text, finding)
    return list(by_text.values())
