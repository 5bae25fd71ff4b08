"""What a check found, and the decision, the same for every verb, whether a run goes on."""

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Self

from vntoolkit.errors import BadInput, VntError

if TYPE_CHECKING:
    from vntoolkit.io.results.manifest import FindingEntry

logger = logging.getLogger(__name__)
CLEAR_Z = 4.0  # standard errors from chance, from which most checks say something


class Level(Enum):
    """What a finding does to a run."""

    NOTE = "note"  # nothing has to change
    WARNING = "warning"  # results are worse than they need be, or may be wrong
    FATAL = "fatal"  # results are wrong: the run stops, unless it is allowed by name


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that was found wrong, with the number behind it.

    check: name of the check, which `--allow` takes. level: what it does to a run. problem: what is wrong.
    measured, expected: the number that says so, and what it is on sound footage, both as text with unit.
    remedy: what to do.
    """

    check: str
    level: Level
    problem: str
    measured: str
    expected: str
    remedy: str

    @classmethod
    def of(cls, name: str, *, level: Level | None = None, **values: object) -> Self:
        """Return the finding `name` of the table, with what was measured; level: another than its usual."""
        from vntoolkit.diagnosis.table import TABLE  # only a run that finds something loads it

        usual, *texts = TABLE[name]
        problem, measured, expected, remedy = (text.format(**values) for text in texts)
        return cls(
            check=name.partition("/")[0],
            level=level or Level(usual),
            problem=problem,
            measured=measured,
            expected=expected,
            remedy=remedy,
        )

    @property
    def text(self) -> str:
        """The finding on one line."""
        return (
            f"{self.problem}: measured {self.measured}, expected {self.expected}; {self.remedy} "
            f"[{self.check}], see {self.page}"
        )

    @property
    def entry(self) -> "FindingEntry":
        """The finding as a manifest holds it."""
        from vntoolkit.io.results.manifest import FindingEntry

        return FindingEntry(check=self.check, level=self.level.value, text=self.text)

    @property
    def page(self) -> str:
        """Where the guide tells its cause and its remedy."""
        return f"docs/wrong.md#{self.check}"


class FatalFinding(VntError):
    """Footage, rig or calibration would give wrong results; the message says how to go on all the same."""


def judge(findings: Iterable[Finding], allowed: Iterable[str] = ()) -> None:
    """Log every finding; raise `FatalFinding` for the first fatal one whose check is not allowed."""
    permitted = frozenset(allowed)
    fatal = []
    for finding in findings:
        if finding.level is Level.FATAL and finding.check not in permitted:
            fatal.append(finding)
        elif finding.level is Level.NOTE:
            logger.info("note: %s", finding.text)
        else:
            logger.warning("%s", finding.text)
    for finding in fatal[1:]:
        logger.error("%s", finding.text)
    if fatal:
        raise FatalFinding(f"{fatal[0].text}; to go on all the same: --allow {fatal[0].check}")


def require_known_checks(allowed: Iterable[str]) -> None:
    """Raise `BadInput` for a name that is no check's."""
    from vntoolkit.diagnosis.table import CHECK_NAMES

    for name in allowed:
        if name not in CHECK_NAMES:
            raise BadInput(
                f"--allow {name}: expected a check's name, one of {', '.join(sorted(CHECK_NAMES))}"
            )
