"""Which frames of a capture: `a:b:c`, as in Python, and what is done about missing ones."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vntoolkit.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class FrameRange:
    """Frames start, start + step, … below stop (None: to the end), counted from 0."""

    start: int = 0
    stop: int | None = None
    step: int = 1

    def __post_init__(self) -> None:
        if self.start < 0 or self.step < 1 or (self.stop is not None and self.stop <= self.start):
            raise BadInput(f"frames: expected 0 <= start < stop and step >= 1, got {self.to_text()}")

    @classmethod
    def from_text(cls, text: str) -> "FrameRange":
        """Parse `a:b:c` (frames a, a + c, … below b), any part left out, or a single frame number."""
        parts = text.strip().split(":")
        try:
            numbers = [int(part) if part.strip() else None for part in parts]
        except ValueError:
            numbers = []
        if len(numbers) == 1 and numbers[0] is not None:
            return cls(start=numbers[0], stop=numbers[0] + 1)
        if len(numbers) not in (2, 3):
            raise BadInput(f"frames: expected a:b:c as in 0:100:2, or one number, got '{text}'")
        start, stop, step = (*numbers, None)[:3]
        return cls(start=start or 0, stop=stop, step=1 if step is None else step)

    def to_text(self) -> str:
        """Return the form that `from_text` reads."""
        return f"{self.start}:{'' if self.stop is None else self.stop}:{self.step}"

    def numbers(self, frame_count: int) -> range:
        """Return the frame numbers of a capture of `frame_count` frames; raise if there are none."""
        stop = frame_count if self.stop is None else min(self.stop, frame_count)
        numbers = range(self.start, stop, self.step)
        if not numbers:
            raise BadInput(
                f"frames {self.to_text()}: the capture has only {frame_count} frames (0 to {frame_count - 1})"
            )
        return numbers


def sampled(numbers: Sequence[int], most: int) -> tuple[int, ...]:
    """Return at most so many of the numbers, evenly spread, the first and the last among them."""
    places = np.linspace(0, len(numbers) - 1, min(most, len(numbers))).round().astype(int)
    return tuple(numbers[place] for place in places.tolist())
