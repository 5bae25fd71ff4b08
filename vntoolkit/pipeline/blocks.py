"""The unit of work of a long run: a block of consecutive frames.

Within a block one frame hands its operators and warm starts to the next; between blocks nothing passes.
Blocks do not depend on the number of workers or on where an earlier run stopped, so neither does a byte
of the output.
"""

from __future__ import annotations

BLOCK_FRAMES = 16


def blocks_of(numbers: range, size: int = BLOCK_FRAMES) -> list[range]:
    """Cut the frame numbers of a run into blocks, in order."""
    return [numbers[start : start + size] for start in range(0, len(numbers), size)]
