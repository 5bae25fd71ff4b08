"""Mattes: where the subject is, for the whole capture or frame by frame, from files or from a clean plate."""

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from vntoolkit.arrays import LinearImage, Mask
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadCapture, NoSubject
from vntoolkit.io.files import reading_limits
from vntoolkit.io.footage.captures import (
    Capture,
    CaptureInfo,
    CaptureOptions,
    open_capture,
    require_size_of,
)
from vntoolkit.io.footage.decoding import EncodedFrame, linear_frame_from_encoded
from vntoolkit.io.footage.sequence import CaptureKind, find_capture_files, text_of_names
from vntoolkit.options.footage import MatteOptions
from vntoolkit.photometry.transfer import Transfer

logger = logging.getLogger(__name__)
_KEY_WINDOW_PX = 3  # differences are averaged over it, so that one noisy pixel is no subject


@dataclass(frozen=True, kw_only=True, eq=False)
class Mattes:
    """The masks of a capture's frames.

    still: (h, w) mask of all frames, None for all pixels. files: that mattes were read from. numbers: of the
    frames that have a matte; None for all.
    """

    still: Mask | None = None
    files: tuple[Path, ...] = ()
    numbers: frozenset[int] | None = None
    _of_frame: Callable[[EncodedFrame], Mask] | None = None

    @property
    def changes(self) -> bool:
        """True where each frame has a mask of its own."""
        return self._of_frame is not None

    def of(self, frame: EncodedFrame) -> Mask | None:
        """Return the (h, w) mask of a frame, None for all pixels; raise `NoSubject` where it is empty."""
        if self._of_frame is None:
            return self.still
        mask = self._of_frame(frame)
        if self.still is not None:
            mask = mask & self.still
        if not mask.any():
            raise NoSubject(
                f"{frame.name}: its matte holds no pixel of the subject; lower --mask-level or --key"
            )
        return mask

    def judged(self, capture: Capture, numbers: Sequence[int]) -> tuple[Mask | None, Sequence[int]]:
        """Return a mask to judge footage inside of, and the frames that it is of.

        Where each frame has a mask of its own, that is one frame from the middle.
        """
        if not self.changes:
            return self.still, numbers
        there = [n for n in capture.present if n in numbers and not self.missing([n])]
        if not there:
            raise BadCapture(f"{capture.name}: none of its frames has a matte")
        number = there[len(there) // 2]
        return self.of(capture.encoded(number)), range(number, number + 1)

    def missing(self, numbers: Iterable[int]) -> list[int]:
        """Return those of the frames that have no matte."""
        return [] if self.numbers is None else [number for number in numbers if number not in self.numbers]


def open_mattes(
    capture: Capture,
    mask: Path | str | None,
    options: MatteOptions | None = None,
    background: Path | str | None = None,
) -> Mattes:
    """Open the mattes of a capture.

    mask: an image for all frames, or a video, a folder or a pattern with one for each; None for none. Files
    and frames that are both numbered belong together by these numbers, else by their order. background: the
    clean plate that `options.key` needs. Raises `BadCapture`.
    """
    options = options or MatteOptions()
    made = Mattes() if mask is None else _from_files(capture, mask, options.mask_level)
    if options.key is None:
        return made
    if background is None:
        raise BadCapture("--key needs --background: an image of the set without the subject, equally lit")
    if made.changes:
        raise BadCapture("--key: expected no matte a frame beside it; leave out --mask, or give one image")
    how = CaptureOptions(transfer=capture.transfer, sensor=capture.options.sensor)
    plate = open_capture(background, how)
    require_size_of(capture.info, (plate.info.width, plate.info.height), str(background))
    key = PlateKey(plate.frame(0).rgb, capture.transfer, options.key)
    return Mattes(still=made.still, files=made.files, _of_frame=key)


def _from_files(capture: Capture, source: Path | str, level: float) -> Mattes:
    size = (capture.info.width, capture.info.height)
    limit = capture.options.max_megapixels or reading_limits().max_megapixels
    found = find_capture_files(source)
    if found.kind is CaptureKind.IMAGE:
        from vntoolkit.io.maps_and_meshes.masks import read_mask

        still = read_mask(found.files[0], size=size, max_megapixels=limit, level=level)
        return Mattes(still=still, files=found.files)
    if found.kind is CaptureKind.VIDEO:
        # a matte's curve shifts its soft edge less than the level does
        video = open_capture(source, CaptureOptions(transfer=Transfer(), max_megapixels=limit))
        files, numbers = video.info.files, tuple(video.present)

        def matte(place: int) -> Mask:
            stored = video.encoded(place)
            return np.asarray(stored.values.max(axis=2) > level * (2**stored.bits - 1))
    else:
        files, numbers = found.files, found.numbers
        by_number = dict(zip(numbers, files, strict=True))

        from vntoolkit.io.maps_and_meshes.masks import read_matte

        def matte(place: int) -> Mask:
            return read_matte(by_number[place], max_megapixels=limit, level=level)

    first = matte(numbers[0]).shape[::-1]
    if first != size:
        raise BadCapture(f"{source}: the mattes are {first[0]}×{first[1]}, the capture {size[0]}×{size[1]}")
    place = _places(capture.info, numbers, found.stated, str(source))

    def of_frame(frame: EncodedFrame) -> Mask:
        if frame.number not in place:
            raise BadCapture(f"{frame.name}: has no matte in {source}")
        mask = matte(place[frame.number])
        require_shape(mask, frame.values.shape[:2], f"{source}: matte of frame {frame.number}", BadCapture)
        return mask

    there = set(numbers)
    return Mattes(
        files=files, numbers=frozenset(n for n, k in place.items() if k in there), _of_frame=of_frame
    )


def _places(footage: CaptureInfo, numbers: Sequence[int], stated: Sequence[int], name: str) -> dict[int, int]:
    """Return which matte, counted from 0, belongs to each frame of the footage.

    numbers: of the mattes. stated: the numbers in their names; empty where these count nothing.
    """
    frames = range(footage.frame_count)
    count = numbers[-1] + 1
    if not stated:
        return {number: number for number in frames if number < count}
    by_stated = dict(zip(stated, numbers, strict=True))
    if footage.stated:
        own = dict(zip(footage.numbers, footage.stated, strict=True))
        found = {n: by_stated[own[n]] for n in own if own[n] in by_stated}
        if found:
            return found
        raise BadCapture(
            f"{name}: no matte has the number of a frame: the frames are {footage.stated[0]} to "
            f"{footage.stated[-1]}, the mattes {stated[0]} to {stated[-1]}; name them alike"
        )
    # The frames of a video are numbered by whoever made the mattes: from 0, or as FFmpeg does from 1.
    first = stated[0] if count == footage.frame_count else min(stated[0], 1)
    logger.info("%s: the matte of number %d is that of the first frame", name, first)
    return {number: by_stated[number + first] for number in frames if number + first in by_stated}


class PlateKey:
    """A pixel is the subject where it differs from the clean plate."""

    def __init__(self, plate: LinearImage, transfer: Transfer, key: float) -> None:
        """plate: linear (h, w, 3). transfer: of the frames. key: as in `MatteOptions`."""
        self._plate = plate
        self._transfer = transfer
        self._least = key * transfer.diffuse_white

    def __call__(self, frame: EncodedFrame) -> Mask:
        """Return the (h, w) mask of the subject."""
        difference = linear_frame_from_encoded(frame, self._transfer).rgb - self._plate
        calm = cv2.blur(difference, (_KEY_WINDOW_PX, _KEY_WINDOW_PX))
        return np.asarray(np.abs(calm).max(axis=2) > self._least)


def require_mattes(mattes: Mattes, numbers: Iterable[int], source: Path | str | None) -> None:
    """Raise `BadCapture` that names the frames without a matte."""
    missing = mattes.missing(numbers)
    if missing:
        raise BadCapture(
            f"{source}: {len(missing)} frames have no matte: {text_of_names([str(n) for n in missing])}; add "
            "them, or leave these frames out with --gaps skip"
        )
