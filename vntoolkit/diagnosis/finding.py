"""What a check found, and the decision, the same for every verb, whether a run goes on."""

import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Self

from vntoolkit.errors import BadInput, VntError

logger = logging.getLogger(__name__)
_SUREST = 0.999  # a certainty is capped here: the model behind it is no surer
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
    remedy: what to do. certainty: probability, 0.5 to 1, that the measured number is no accident of noise; 1
    for what was counted or read and not estimated.
    """

    check: str
    level: Level
    problem: str
    measured: str
    expected: str
    remedy: str
    certainty: float = 1.0

    @classmethod
    def of(cls, name: str, *, level: Level | None = None, certainty: float = 1.0, **values: object) -> Self:
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
            certainty=certainty,
        )

    @property
    def text(self) -> str:
        """The finding on one line."""
        sure = "" if self.certainty >= 1.0 else f", {self._percent()} sure"
        return (
            f"{self.problem}: measured {self.measured}, expected {self.expected}{sure}; {self.remedy} "
            f"[{self.check}], see {self.page}"
        )

    @property
    def page(self) -> str:
        """Where the guide tells its cause and its remedy."""
        return f"docs/wrong.md#{self.check}"

    def _percent(self) -> str:
        return f"over {_SUREST:.1%}" if self.certainty >= _SUREST else f"{self.certainty:.0%}"


class FatalFinding(VntError):
    """Footage, rig or calibration would give wrong results; the message says how to go on all the same."""


def certainty_from_z(z: float) -> float:
    """Return the probability that a number `z` standard errors away from chance is not chance."""
    return min(_SUREST, 0.5 * (1.0 + math.erf(abs(z) / math.sqrt(2.0))))


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
