"""What is said of frames that show no subject."""

from collections.abc import Sequence

from vntoolkit.diagnosis.finding import Finding, Level
from vntoolkit.io.results.folder import numbers_in_words


def finding_from_empty_frames(empty: Sequence[int], count: int) -> Finding:
    """Return what is said of frames that show no subject, of so many."""
    some = len(empty) < count
    return Finding(
        check="black",
        level=Level.WARNING if some else Level.FATAL,
        problem=f"{numbers_in_words(empty)} {'shows' if len(empty) == 1 else 'show'} no subject",
        measured=f"{len(empty)} of {count} frames that are black or show far less than the others",
        expected="none",
        remedy="they are kept as empty, and no other frame changes; --frames leaves them out"
        if some
        else "are the lamps on, the lens open and the mask on the subject?",
    )
