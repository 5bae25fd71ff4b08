"""A tactile gel as one object: from a raw frame to normals, depth in millimetres and contact."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from vntoolkit.arrays import Array, FloatArray, Mask, Normals, read_only
from vntoolkit.diagnosis.finding import Finding, judge
from vntoolkit.diagnosis.gel_checks import check_background, check_channels, check_light, check_raised
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.io.footage.captures import Capture, CaptureOptions, open_capture
from vntoolkit.io.footage.decoding import EncodedFrame, linear_frame_from_encoded, resampler_of
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.io.rigs import read_rig
from vntoolkit.options.reconstruction import Product, ReconstructOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.frame_processor import Carried, FrameProcessor
from vntoolkit.pipeline.outputs import FrameResult
from vntoolkit.pipeline.pressed_gel import membrane_of
from vntoolkit.tactile.motion import MembraneMotion
from vntoolkit.tactile.motion_maps import GelMotion, motion_over_picture
from vntoolkit.tactile.session import colours_by_place

_MM = 1000.0  # per metre
_FRAMES_COMPARED = 5
_BLACK, _CLIPPED_WHOLLY = 0.01, 0.98  # of full scale; of the pixels


@dataclass(frozen=True, kw_only=True, eq=False)
class Touch:
    """What touches the gel in one frame; arrays (h, w) of the rectified picture, camera frame.

    normals: (h, w, 3) unit vectors, n_z < 0. depth_mm: 0 at rest, negative in a dent, which is nearer to the
    camera. mask: where both hold. contact: what is touched. area_mm2: of the contact. deepest_mm: of the
    deepest point below the gel at rest, 0 where nothing touches; deepest_px: (u, v), None where nothing does.
    error_deg, error_mm: what nine of ten normals and depths stay within; None where the rig does not know.
    motion: of the gel's material since it was untouched.
    """

    normals: Normals
    depth_mm: FloatArray
    mask: Mask
    contact: Mask
    area_mm2: float
    deepest_mm: float
    deepest_px: tuple[int, int] | None
    error_deg: FloatArray | None
    error_mm: FloatArray | None
    motion: GelMotion


class Gel:
    """Turns the frames of one tactile sensor into touches; frames come in order.

    The first frame is checked against the background: size, exchanged channels, another session, and a
    background that is itself a press. What is surely wrong raises `FatalFinding`; the rest is logged.
    """

    def __init__(self, rig: Rig, background: Array, *, allow: Iterable[str] = ()) -> None:
        """rig: of `calibrate_presses`. background: the untouched gel, as a frame. allow: checks whose fatal
        findings do not raise."""
        if rig.gel is None:
            raise BadInput("gel: expected the rig of a tactile gel, of `vntoolkit calibrate presses`")
        self.rig, self._allow = rig, tuple(allow)
        self._background = self._linear(self._encoded(background, "background"))
        self._checked = False
        judge(check_background(rig, _colours(rig, self._background)), self._allow)
        options = ReconstructOptions(to=Product.DEPTH)
        self._processor = FrameProcessor(rig, options, background=self._background.rgb)
        self._membrane = membrane_of(rig, self._background.rgb)
        self._carried = Carried()
        self._moved: MembraneMotion | None = None

    @classmethod
    def read(cls, rig: Path | str, background: Path | str | Array, *, allow: Iterable[str] = ()) -> Self:
        """Read a rig.json, and the background: an image or video file, or a frame as the camera gives it."""
        known = read_rig(Path(rig))
        if isinstance(background, Path | str):
            opened = open_capture(background, CaptureOptions(transfer=known.transfer))
            background = next(opened.encoded_frames()).values
        return cls(known, background, allow=allow)

    @property
    def pixel_mm(self) -> float:
        """Side of a pixel of the rectified picture."""
        return _MM / float(self.rig.camera.matrix[0, 0])

    def __call__(self, frame: Array) -> Touch:
        """Measure a raw frame (h, w, 3), RGB as the camera gives it: uint8, uint16, or float32, linear.

        Raises `BadInput` for another shape, `BadCapture` for one that is black or clipped, `FatalFinding`.
        """
        encoded = self._encoded(frame, "frame")
        prepared = self._processor.prepared(encoded, None, self._carried)
        seen = replace(prepared.linear, rgb=prepared.linear.rgb + self._membrane.untouched)
        require_exposed(seen, encoded.name)
        result = self._processor.with_depth(self._processor.normals(prepared), self._carried)
        if not self._checked:
            found = findings_from_touches(self.rig, self._background, [self._linear(encoded)], [result])
            judge(found, self._allow)
            self._checked = True
        assert result.contact is not None
        self._moved = self._membrane.follow(self._membrane.picture(seen.rgb), self._moved)
        contact = result.contact.mask
        return _touch(result, motion_over_picture(self._membrane, self._moved, contact, self.pixel_mm))

    def _encoded(self, frame: Array, name: str) -> EncodedFrame:
        values = np.asarray(frame)
        width, height = self.rig.footage_size
        if values.shape != (height, width, 3):
            raise BadInput(f"gel: expected a {name} of shape ({height}, {width}, 3), got {values.shape}")
        if values.dtype not in (np.uint8, np.uint16, np.float32):
            raise BadInput(f"gel: expected a {name} of uint8, uint16 or float32, got {values.dtype}")
        bits = 32 if values.dtype == np.float32 else 8 * values.dtype.itemsize
        return EncodedFrame(values=values, bits=bits, number=0, name=name)

    def _linear(self, frame: EncodedFrame) -> LinearFrame:
        return linear_frame_from_encoded(frame, self.rig.transfer)


def require_exposed(frame: LinearFrame, name: str) -> None:
    """Raise `BadCapture` for a frame that is black or clipped all over."""
    brightest = float(frame.rgb.max(initial=0.0))
    if brightest < _BLACK:
        raise BadCapture(
            f"{name} is black: its brightest value is {brightest:.2%} of full scale; are the lights on and "
            "the lens open?"
        )
    share = float(frame.clipped.mean())
    if share > _CLIPPED_WHOLLY:
        raise BadCapture(f"{name} is clipped at {share:.0%} of its pixels: lower the exposure and film again")


def findings_from_footage(rig: Rig, capture: Capture, numbers: Sequence[int]) -> list[Finding]:
    """Check the untouched gel, and a few frames of a capture that was opened with it, against the rig."""
    if capture.background is None or (capture.info.width, capture.info.height) != rig.footage_size:
        return []
    nothing = np.zeros(capture.background.shape[:2], dtype=np.bool_)
    background = LinearFrame(rgb=capture.background, clipped=nothing)
    processor = FrameProcessor(rig, ReconstructOptions(to=Product.DEPTH), background=background.rgb)
    present = [number for number in capture.present if number in numbers]
    encoded = [capture.encoded(number) for number in sampled(present, _FRAMES_COMPARED)]
    frames = [linear_frame_from_encoded(frame, capture.transfer) for frame in encoded]
    results = [processor.process(frame) for frame in encoded]
    found = check_background(rig, _colours(rig, background))
    return found or findings_from_touches(rig, background, frames, results)


def findings_from_touches(
    rig: Rig, background: LinearFrame, frames: list[LinearFrame], results: list[FrameResult]
) -> list[Finding]:
    """Check a few frames, as filmed, and what became of them, against the untouched gel, as filmed."""
    reference = _colours(rig, background)
    light: list[Finding] = []
    for frame in frames:
        colours = _colours(rig, frame)
        if exchanged := check_channels(colours, reference, "the footage", "its background"):
            return exchanged
        light = light or check_light(rig, colours, reference, "the footage", "its background")
    maps = [result.depth_map for result in results if result.depth_map is not None]
    if not maps:
        return light
    known = np.logical_and.reduce([each.mask for each in maps])
    middle = DepthMap(depth=np.median([each.depth for each in maps], axis=0), mask=known)
    return light + check_raised(middle, rig)


def _colours(rig: Rig, frame: LinearFrame) -> FloatArray:
    rectified = resampler_of(rig).frame(frame)
    return colours_by_place(rectified.rgb, ~rectified.clipped)


def _touch(result: FrameResult, motion: GelMotion) -> Touch:
    depth, contact, normals = result.depth_map, result.contact, result.normal_map
    assert depth is not None
    assert contact is not None
    depth_mm = _MM * depth.depth
    deepest = None
    if contact.mask.any():
        v, u = np.unravel_index(int(np.argmin(np.where(contact.mask, depth_mm, np.inf))), depth_mm.shape)
        deepest = (int(u), int(v))
    error_mm = None
    if depth.error_percent is not None and depth.mask.any():
        error_mm = depth.error_percent * (0.01 * np.ptp(depth_mm[depth.mask]))
    return Touch(
        normals=normals.normals_in_camera,
        depth_mm=read_only(depth_mm),
        mask=depth.mask,
        contact=contact.mask,
        area_mm2=contact.area_mm2,
        deepest_mm=contact.depth_mm,
        deepest_px=deepest,
        error_deg=normals.error_deg,
        error_mm=error_mm,
        motion=motion,
    )
