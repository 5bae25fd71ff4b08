"""What is said of frames that show no subject."""

from collections.abc import Sequence

from vntoolkit.diagnosis.finding import Finding
from vntoolkit.io.results.numbered_files import numbers_in_words


def finding_from_empty_frames(empty: Sequence[int], count: int) -> Finding:
    """Return what is said of frames that show no subject, of so many."""
    name = "black" if len(empty) < count else "black/all"
    show = f"{numbers_in_words(empty)} {'shows' if len(empty) == 1 else 'show'}"
    return Finding.of(name, frames_show=show, empty=len(empty), count=count)
