"""A survey of the frames: their light in blocks, and which of them show the subject.

A camera starts before the lamps do; a subject enters and leaves. The brightest of such a frame is noise or
backdrop, and what is learnt from it is wrong. So how bright a subject is, and how much of the picture it
covers, is decided over the sequence. Light is compared in blocks, whose means hide the noise of pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import Float32Array, Int64Array, LinearImage, Mask
from vntoolkit.diagnosis.evidence import SUBJECT, brightest_channel, lengths_of
from vntoolkit.diagnosis.finding import Finding
from vntoolkit.errors import NoSubject
from vntoolkit.io.footage.captures import Capture
from vntoolkit.io.footage.decoding import EncodedFrame, linear_frame_from_encoded
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.io.footage.mattes import Mattes
from vntoolkit.io.results.numbered_files import numbers_in_words
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer, linear_from_encoded

_SURVEYED = 256  # frames, of more evenly spread ones: reading takes a small part of the time of a run
_BLOCKS = 32  # along the picture's longer side
_SAMPLES = 8  # pixels read along each side of a block
_BLACK_LEVELS, _MOST_BITS = 2.5, 16  # as many are noise of what is stored
_MUCH = 0.5  # of the blocks that are usually lit: a subject that is entering tells less


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """The light of frames in blocks.

    numbers: of the frames, in order. light: (n, v, u, 3), linear mean colours of blocks, 0 where one does
    not count. lit: (n, v, u), where the subject may be. border: (n, b, 3), of the blocks at the picture's
    border, whatever the mask. shows: (n,), True for a frame that shows as much of a subject as is usual.
    """

    numbers: tuple[int, ...]
    light: Float32Array
    lit: Mask
    border: Float32Array
    shows: Mask

    @property
    def shown(self) -> tuple[int, ...]:
        """Numbers of the frames that show the subject."""
        return tuple(n for n, shows in zip(self.numbers, self.shows.tolist(), strict=True) if shows)

    def frames_like(self, chosen: Sequence[int], numbers: Sequence[int]) -> tuple[int, ...]:
        """Return which of numbers are like frames of the survey; one between two is as the one before."""
        at = np.clip(np.searchsorted(self.numbers, numbers, "right") - 1, 0, None)
        among = np.isin(self.numbers, chosen)[at]
        return tuple(n for n, wanted in zip(numbers, among.tolist(), strict=True) if wanted)


def survey_of(capture: Capture, mattes: Mattes, numbers: Sequence[int]) -> Survey:
    """Read frames, some of many. numbers: of frames that are there, with their mattes, one at least.

    Raises `BadCapture` for one that cannot be read.
    """
    seen = sampled(numbers, _SURVEYED)
    step = seen[1] - seen[0] if len(seen) > 1 else 1
    even = seen == tuple(range(seen[0], seen[-1] + 1, step))
    frames = capture.encoded_frames(seen[0], seen[-1] + 1, step) if even else map(capture.encoded, seen)
    light, border = (
        np.stack(each) for each in zip(*(_light(capture, mattes, f) for f in frames), strict=True)
    )
    brightest = brightest_channel(light)
    top = float(np.percentile(brightest, 99, axis=(1, 2)).max())
    transfer, levels = capture.transfer, 2.0 ** min(capture.info.bits, _MOST_BITS) - 1
    black = linear_from_encoded(np.array(transfer.black_level + _BLACK_LEVELS / levels), transfer)
    lit: Mask = brightest > max(SUBJECT * top, float(black))
    shares = lit.mean(axis=(1, 2))
    usual = float(np.median(shares[shares > 0])) if shares.any() else 1.0
    shows = (shares > 0) & (shares >= _MUCH * usual)
    return Survey(numbers=seen, light=light, lit=lit, border=border, shows=shows)


def finding_from_empty_frames(empty: Sequence[int], count: int) -> Finding:
    """Return what is said of frames that show no subject, of so many."""
    name = "black" if len(empty) < count else "black/all"
    show = f"{numbers_in_words(empty)} {'shows' if len(empty) == 1 else 'show'}"
    return Finding.of(name, frames_show=show, empty=len(empty), count=count)


def _light(capture: Capture, mattes: Mattes, frame: EncodedFrame) -> tuple[Float32Array, Float32Array]:
    """Return the light of blocks, (v, u, 3), and that of those at the border, masked or not, (b, 3)."""
    whole, _ = _sums_of_blocks(frame, capture.transfer, capture.background)
    everywhere = whole[..., :3] / whole[..., 3:]
    sides = (everywhere[0], everywhere[-1], everywhere[1:-1, 0], everywhere[1:-1, -1])
    try:
        mask = mattes.of(frame)
    except NoSubject:
        mask = np.zeros(frame.values.shape[:2], np.bool_)
    sums, covered = _sums_of_blocks(frame, capture.transfer, capture.background, mask)
    light = np.where(covered, sums[..., :3] / np.maximum(sums[..., 3:], 1.0), 0.0)
    return light.astype(np.float32), np.concatenate(sides)


def albedo_in_blocks(
    frame: EncodedFrame,
    transfer: Transfer,
    response: LightResponse,
    least: float,
    background: LinearImage | None = None,
    mask: Mask | None = None,
) -> float | None:
    """Return the median length of M⁻¹(r − a) over blocks that face the camera and are longer than `least`.

    None where there is no such block: no subject is in sight. mask: (h, w), pixels that count.
    """
    sums, covered = _sums_of_blocks(frame, transfer, background, mask)
    chosen = sums[covered[..., 0]]
    scaled = (chosen[:, :3] / np.maximum(chosen[:, 3:], 1.0) - response.ambient) @ response.inverse.T
    lengths = np.asarray(lengths_of(scaled))[scaled[:, 2] < 0]
    lengths = lengths[lengths > least]
    return float(np.median(lengths)) if lengths.size else None


def _sums_of_blocks(
    frame: EncodedFrame, transfer: Transfer, background: LinearImage | None, mask: Mask | None = None
) -> tuple[Float32Array, Mask]:
    """Return sums of linear colour and count over blocks (v, u, 4), and which blocks count (v, u, 1).

    Some of the frame's pixels are read. A block counts where half of it does, or as much as of any other.
    """
    longer = max(frame.values.shape[:2])
    step = max(1, -(-longer // (_BLOCKS * _SAMPLES)))
    side = max(1, longer // (step * _BLOCKS))
    few = (slice(None, None, step),) * 2
    encoded = replace(frame, values=frame.values[few])
    light = linear_frame_from_encoded(encoded, transfer, None if background is None else background[few])
    weight = np.ones((*light.shape, 1), np.float32)
    if mask is not None:
        weight[~mask[few]] = 0.0
    sums = np.concatenate([np.asarray(light.rgb) * weight, weight], axis=2)
    for axis in (0, 1):
        starts: Int64Array = np.arange(0, sums.shape[axis], side)
        sums = np.add.reduceat(sums, starts, axis=axis)
    counts = sums[..., 3:]
    return sums, counts >= min(side * side / 2, float(counts.max()))
