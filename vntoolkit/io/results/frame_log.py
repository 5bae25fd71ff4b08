"""frames.log: the frames of a result folder that are complete on disk, with statistics of each."""

import contextlib
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vntoolkit.io.atomic import cannot_write
from vntoolkit.io.files import opened

FRAMES_NAME = "frames.log"
_SKIPPED, _EMPTY = "skipped", "empty"
_LONGEST_LINE = 1 << 16
_NUMBER = re.compile(r"[0-9]{1,9}")


@dataclass(frozen=True, kw_only=True)
class FrameEntry:
    """One finished or skipped frame.

    seconds: spent on it. valid_share: of all pixels, with a normal. clipped_share: of all pixels.
    shadowed_share: of the valid ones, not reached by all three lights. error_deg: expected error of the
    normals, the median over the valid pixels; None where it is not known. failure: one line that says why
    the frame was skipped, else empty. shows_nothing: it was because no subject is in sight. contact_mm2,
    contact_depth_mm: area in contact and depth of the deepest point, of a tactile gel; None of anything else.
    """

    number: int
    seconds: float = 0.0
    valid_share: float = 0.0
    clipped_share: float = 0.0
    shadowed_share: float = 0.0
    error_deg: float | None = None
    failure: str = ""
    shows_nothing: bool = False
    contact_mm2: float | None = None
    contact_depth_mm: float | None = None

    def to_line(self) -> str:
        """Return the line of frames.log, without its end."""
        if self.failure:
            why = _EMPTY if self.shows_nothing else _SKIPPED
            return f"{self.number} {why} {' '.join(self.failure.split())}"
        shares = (self.valid_share, self.clipped_share, self.shadowed_share)
        line = f"{self.number} {self.seconds:.4f} " + " ".join(f"{share:.5f}" for share in shares)
        if self.error_deg is not None:
            line += f" {self.error_deg:.3f}"
        if self.contact_mm2 is None or self.contact_depth_mm is None:
            return line
        return f"{line} {self.contact_mm2:.3f} {self.contact_depth_mm:.4f}"

    @classmethod
    def from_line(cls, line: str) -> "FrameEntry | None":
        """Parse a line, or return None for one that a crash cut short."""
        number, _, rest = line.partition(" ")
        if not _NUMBER.fullmatch(number):
            return None
        kind, _, failure = rest.partition(" ")
        if kind in (_SKIPPED, _EMPTY):
            return cls(number=int(number), failure=failure, shows_nothing=kind == _EMPTY)
        try:
            seconds, valid, clipped, shadowed, *more = map(float, rest.split())
        except ValueError:
            return None
        if len(more) > 3:
            return None
        contact = more[-2:] if len(more) > 1 else []
        return cls(
            number=int(number),
            seconds=seconds,
            valid_share=valid,
            clipped_share=clipped,
            shadowed_share=shadowed,
            error_deg=more[0] if len(more) % 2 else None,
            contact_mm2=contact[0] if contact else None,
            contact_depth_mm=contact[1] if contact else None,
        )


class FrameLog:
    """Appends a line a frame, `number seconds valid clipped shadowed` or `number skipped why`, and flushes.

    The word is `empty` for a frame that shows no subject.

    A line goes on with `error_deg` where it is known, and a tactile gel's with `contact_mm2
    contact_depth_mm`.

    A line that a crash cut short is not counted, and is closed off by the next append, so that its frame is
    simply done again.
    """

    def __init__(self, folder: Path | str) -> None:
        self.path = Path(folder) / FRAMES_NAME
        self._stream: Any = None

    def entries(self) -> dict[int, FrameEntry]:
        """Return the last entry of every frame, skipped ones too, in order of their numbers."""
        if not self.path.exists() or (self.path.is_file() and self.path.stat().st_size == 0):
            return {}
        found: dict[int, FrameEntry] = {}
        with opened(self.path) as stream:
            while line := stream.readline(_LONGEST_LINE):
                if line.endswith(b"\n") and (
                    entry := FrameEntry.from_line(line.decode("utf-8", "replace")[:-1])
                ):
                    found[entry.number] = entry
        return dict(sorted(found.items()))

    def done(self) -> dict[int, float]:
        """Return {frame number: seconds} of all finished frames."""
        return {number: entry.seconds for number, entry in self.entries().items() if not entry.failure}

    def append(self, entry: FrameEntry) -> None:
        """Record a frame whose files are all in place, or which was skipped."""
        try:
            if self._stream is None:
                torn = self.path.exists() and self._is_torn()
                self._stream = self.path.open("a", encoding="utf-8", errors="backslashreplace")
                if torn:
                    self._stream.write("\n")
            self._stream.write(entry.to_line() + "\n")
            self._stream.flush()
        except OSError as error:
            self.close()
            raise cannot_write(self.path, error) from error

    def _is_torn(self) -> bool:
        with self.path.open("rb") as stream:
            if stream.seek(0, os.SEEK_END) == 0:
                return False
            stream.seek(-1, os.SEEK_END)
            return stream.read() != b"\n"

    def close(self) -> None:
        """Close the file."""
        stream, self._stream = self._stream, None
        if stream is not None:
            with contextlib.suppress(OSError):  # of a line that could not be written: `append` has told
                stream.close()
