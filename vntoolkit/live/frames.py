"""Processing of a live frame: crop, rectification, background, normals, depth."""

import contextlib
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import Float32Array, LinearImage, Mask
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput, NoSubject, VntError
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.integration.integrate import DepthAnchor, DepthIntegrator
from vntoolkit.io.footage.decoding import EncodedFrame, Rectifier, linear_frame_from_encoded
from vntoolkit.io.footage.mattes import PlateKey
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import MaterialSearch, Product, ReconstructOptions
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.pipeline.outputs import FrameResult
from vntoolkit.tactile.contact import Contact, contact_from_depth, rested

Begun = tuple[FrameResult, tuple[str, ...]]  # normals, and warnings of the exposure
_CLIPPED_SHARE = 0.01  # of all pixels: more ruins normals
_DARK_SHARE = 0.05  # of full scale: the 99th percentile of a picture that is too dark
_FEW = 0.02  # of all pixels: fewer normals than that mean that nothing is lit
_WARMING = 4  # the second frame starts from the first one's depth, and memory is then still fresh
_RECENT = 60  # frames that tell how bright a subject is
_EVERY = 7  # pixel and row looked at for the exposure


@dataclass(frozen=True, kw_only=True)
class FrameView:
    """What part of the camera's picture is worked on; the rig belongs to the result.

    crop: left, top, width and height in pixels, or None. rectification: then applied, or None; its corners
    count from the crop's.
    """

    crop: tuple[int, int, int, int] | None = None
    rectification: Rectification | None = None

    def require_inside(self, width: int, height: int) -> None:
        """Raise unless the crop lies within a picture of this size."""
        if self.crop is not None:
            u, v, w, h = self.crop
            if min(u, v) < 0 or min(w, h) < 1 or u + w > width or v + h > height:
                raise BadInput(f"crop: {u} {v} {w} {h} does not lie within the {width}×{height} picture")

    def size(self, width: int, height: int) -> tuple[int, int]:
        """(width, height) of the result."""
        if self.rectification is not None:
            return self.rectification.size
        return (width, height) if self.crop is None else self.crop[2:]

    def cut(self, frame: EncodedFrame) -> EncodedFrame:
        """Crop a frame."""
        if self.crop is None:
            return frame
        u, v, w, h = self.crop
        return replace(frame, values=np.ascontiguousarray(frame.values[v : v + h, u : u + w]))


@dataclass(frozen=True, kw_only=True, eq=False)
class LiveResult:
    """What a live frame became. depth_map: of `LiveProcessor.depth_camera`, smaller where that is.

    warnings: what a person should change about the exposure. contact: what touches a tactile gel; its mask is
    of `depth_map`'s size.
    """

    number: int
    normal_map: NormalMap
    depth_map: DepthMap | None
    warnings: tuple[str, ...]
    contact: Contact | None = None


class LiveProcessor:
    """Works on the frames of one source; the first one with a depth fixes the free offset of all."""

    def __init__(
        self,
        rig: Rig,
        view: FrameView | None = None,
        mask: Mask | None = None,
        background: EncodedFrame | None = None,
        *,
        key: float | None = None,
        depth_px: int = 320,
        shadows: ShadowMethod = ShadowMethod.NONE,
    ) -> None:
        """background: the scene under ambient light, or the untouched gel, as the camera sees it.

        key: as in `MatteOptions`; the background is then a clean plate and is not subtracted. depth_px:
        longest side at which normals are integrated; they themselves keep their full size. The masked
        integration of a whole frame would take longer than a frame lasts. shadows: how they are found; a gel
        throws none.
        """
        self.rig, self.view = rig, view or FrameView()
        self._background: LinearImage | None = None
        if background is not None:
            self._background = self._linear_values(background)
            require_shape(self._background, (*rig.footage_size[::-1], 3), "background")
        reconstruction = ReconstructOptions(
            to=Product.NORMALS,
            shadows=shadows,
            materials=MaterialSearch.CALIBRATED,
        )
        read = rig if self.view.rectification is None else _of_linear_values(rig)
        self._key: PlateKey | None = None
        if key is not None:
            if self._background is None or rig.gel is not None:
                raise BadInput("live: --key needs a --background without the subject, and no gel's rig")
            self._key = PlateKey(self._background, read.transfer, key)

        subtracted = self._background if key is None else None
        self._processor = FrameProcessor(read, reconstruction, mask, subtracted, with_errors=False)
        self._darkest = reconstruction.inversion.darkest
        self._recent: deque[float] = deque(maxlen=_RECENT)
        takes_long = self._processor.finds_shadows and self._key is None
        self.lanes = 2 if takes_long else 1  # frames that `begin` may work on at a time
        self._step = max(1, -(-max(self.camera.width, self.camera.height) // depth_px))
        height, width = (n // self._step * self._step for n in (self.camera.height, self.camera.width))
        self.depth_camera = self.camera.cropped(slice(0, height), slice(0, width)).scaled(1 / self._step)
        self._integrator = self._new_integrator()
        self._anchor: DepthAnchor | None = None

    @property
    def camera(self) -> Camera:
        """The camera that results belong to."""
        return self._processor.camera

    def warm_up(self, frame: EncodedFrame) -> None:
        """Process a frame and discard it, so that compilation does not delay the first live frame."""
        with contextlib.suppress(VntError):  # a dark one warms up too
            for _ in range(_WARMING):
                self.process(frame)
        self._integrator, self._anchor = self._new_integrator(), None

    def _new_integrator(self) -> DepthIntegrator:
        """Least squares: to find where depth jumps takes several times as long as a frame lasts."""
        return DepthIntegrator(self.depth_camera, may_jump=False)

    def process(self, frame: EncodedFrame) -> LiveResult:
        """Return normals and depth of one frame; raise as `FrameProcessor.process` does."""
        return self.finish(self.begin(frame))

    def begin(self, frame: EncodedFrame) -> Begun:
        """The first half of `process`, in `lanes` for as many frames at a time: normals, and warnings."""
        cut = self.view.cut(frame)
        warnings = exposure_warnings(cut)
        if self.view.rectification is not None:
            cut = replace(cut, values=self._linear_values(frame), bits=32)
        matte = None if self._key is None else self._key(cut)
        if self.rig.gel is None:
            self._require_subject(cut, matte)
        return self._processor.process(cut, matte), warnings

    def _require_subject(self, frame: EncodedFrame, matte: Mask | None) -> None:
        """Raise `NoSubject` for a frame that is far darker than recent ones, or than the rig's material."""
        albedo = self._processor.albedo_in(frame, matte, 1.0)
        usual = float(np.median(list(self._recent) or [0.0]))
        self._recent.extend([] if albedo is None else [albedo])
        if albedo is None or albedo < self._darkest * usual:
            raise NoSubject(f"{frame.name}: no subject in sight: it is black, or far darker than before")

    def finish(self, begun: Begun) -> LiveResult:
        """The second half, frame after frame: depth, tied to that of the first."""
        result, warnings = begun
        depth_map = self._integrator.integrate(reduced(result.normal_map, self._step))
        contact = None
        if self.rig.gel is not None:
            depth_map = rested(depth_map)
            contact = contact_from_depth(depth_map, self.depth_camera)
        else:
            self._anchor = self._anchor or DepthAnchor(depth_map)
            depth_map = self._anchor.align(depth_map)
        if result.normal_map.mask.mean() < _FEW:
            warnings = (*warnings, "hardly any pixel has a normal")
        return LiveResult(
            number=result.number,
            normal_map=result.normal_map,
            depth_map=depth_map,
            warnings=warnings,
            contact=contact,
        )

    def _linear_values(self, frame: EncodedFrame) -> Float32Array:
        linear = linear_frame_from_encoded(self.view.cut(frame), self.rig.transfer)
        if self.view.rectification is not None:
            linear = Rectifier(self.view.rectification).frame(linear)
        return linear.rgb


def reduced(normal_map: NormalMap, step: int) -> NormalMap:
    """Return means over blocks of step × step pixels, of unit length; valid where half a block is."""
    if step == 1:
        return normal_map
    import cv2

    height, width = (size // step for size in normal_map.shape)
    block = np.s_[: height * step, : width * step]
    mean, share = (
        cv2.resize(each[block], (width, height), interpolation=cv2.INTER_AREA)
        for each in (normal_map.normals_in_camera, normal_map.mask.astype(np.float32))
    )
    length = np.linalg.norm(mean, axis=2)  # 0 where invalid
    mask: Mask = (share >= 0.5) & (length > 0)
    unit = np.where(mask[..., None], mean / np.where(mask, length, 1.0)[..., None], np.float32(0.0))
    return NormalMap(normals_in_camera=unit, mask=mask)


def exposure_warnings(frame: EncodedFrame) -> tuple[str, ...]:
    """Say where the stored values are clipped or too dark."""
    values = frame.values[::_EVERY, ::_EVERY]
    top = 2**frame.bits - 1 if values.dtype in (np.uint8, np.uint16) else 1.0
    brightest = values.max(axis=2)
    clipped = float(np.mean(brightest >= top))
    if clipped > _CLIPPED_SHARE:
        return (f"clipped: {clipped:.0%} of the pixels; expose less",)
    if np.percentile(brightest, 99) < _DARK_SHARE * top:
        return ("dark: expose more, or open the lens",)
    return ()


def _of_linear_values(rig: Rig) -> Rig:
    """The rig for values that are linear already, their black level removed."""
    return replace(rig, transfer=replace(rig.transfer, black_level=0.0))
