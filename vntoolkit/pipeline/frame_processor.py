"""One frame: from stored samples to normals, depth and a mesh (brostow2011, Section III-B)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import BoolArray, Colours, FloatArray, LinearImage, Mask, VisibilityLabels
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.integration.cast_shadows import steps_from_shadows
from vntoolkit.integration.expected_error import with_expected_depth_error
from vntoolkit.integration.integrate import DepthAnchor, DepthIntegrator
from vntoolkit.integration.slopes import rays_from_camera
from vntoolkit.io.footage.decoding import EncodedFrame, linear_frame_from_encoded, resampler_of
from vntoolkit.io.footage.gel_dots import DotFilter
from vntoolkit.materials.labelling import FrameStatistics, LabelState, MaterialLabeller
from vntoolkit.materials.mixtures import MaterialLabels
from vntoolkit.materials.relighting import colours_of
from vntoolkit.materials.split_frame import box_of
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.native import keep_freed_memory
from vntoolkit.normals import expected_error
from vntoolkit.normals.gel import GelInverter, drift_of_change
from vntoolkit.normals.inversion import normals_from_encoded, normals_from_frame, relative_albedo_from_frame
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import Product, ReconstructOptions
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.levelling import Box, leveller_of
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, TransferCurve, encoded_from_linear
from vntoolkit.pipeline.contact import contact_from_depth, rested
from vntoolkit.pipeline.outputs import FrameResult
from vntoolkit.shadows.contributions import brighter_than
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.shadows.lamp_directions import LampDirections, directions_from_shadows, unlit_by_lamp
from vntoolkit.shadows.recovery import recover_normals

_SAMPLES = (slice(None, None, 4),) * 2  # these pixels tell how bright a subject is


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenFrame:
    """A frame in linear light and, where the subject's materials are known, as if all were the rig's.

    mask: (h, w), pixels of interest. linear: None where one loop decodes and inverts the frame. materials:
    (h, w), their numbers; None where all is the rig's. turned_deg: (h, w), root mean square angles by which
    what is not known of the materials turns normals; None for 0.
    """

    frame: EncodedFrame
    mask: Mask
    linear: LinearFrame | None = None
    materials: MaterialLabels | None = None
    turned_deg: npt.NDArray[np.float32] | None = None


class FrameProcessor:
    """Turns the frames of one capture into results; keeps operators and warm starts between frames.

    rig: its transfer is taken as the capture's. mask: (h, w) pixels of interest in the footage as filmed, or
    None for all. background: linear (h, w, 3) as filmed, subtracted, or None; a gel's rig needs it, the
    untouched gel. Results belong to `camera`, the rig's without distortion.
    """

    def __init__(
        self,
        rig: Rig,
        options: ReconstructOptions,
        mask: Mask | None = None,
        background: LinearImage | None = None,
        *,
        with_errors: bool = True,
        reflectances: Sequence[Sequence[float]] = (),
        pigments: Sequence[Sequence[float]] = (),
        errors_deg: Sequence[float] = (),
        blur_px: float = 0.0,
    ) -> None:
        """reflectances: (m, 3), of the subject's materials relative to the rig's; empty for the rig's alone.
        pigments: (m, 3), along which log reflectances change, 0 for none. errors_deg: (m,), root mean square
        angles by which errors of the reflectances turn normals. blur_px: standard deviation of the picture's
        blur, 0 for unknown.

        with_errors: whether normals and depth carry their expected errors; a live view has no time."""
        keep_freed_memory()
        self._rig = rig
        self._with_errors = with_errors
        self._blur_px = blur_px
        self._options = options
        self._background = background
        self._resampler = resampler_of(rig)
        self.camera = rig.camera.without_distortion()
        shape = (rig.camera.height, rig.camera.width)
        filmed = rig.footage_size[::-1]
        if mask is not None:
            require_shape(mask, filmed, "mask")
        self._mask = self._whole_mask = self._resampler.mask(
            np.ones(filmed, dtype=np.bool_) if mask is None else mask
        )
        self._gel = None if rig.gel is None else GelInverter(rig.response, rig.gel)
        self._dots: DotFilter | None = None
        rig.require_background(background is not None)
        if self._gel is not None and background is not None:
            nothing: Mask = np.zeros(filmed, dtype=np.bool_)
            self._dots = DotFilter(self._resampler.frame(LinearFrame(rgb=background, clipped=nothing)).rgb)
        self._integrator = DepthIntegrator(self.camera, options.integration)
        self._rays = rays_from_camera(self.camera)
        self._anchor: DepthAnchor | None = None
        self._central = rig.response.central
        fitted = rig.quality is not None and rig.quality.samples
        self._residual_deg = rig.quality.residual_deg if rig.quality is not None and fitted else 0.0
        # a board's colours are means over its hole, a ball's are its pixels'
        self._residual_of_pixels = rig.quality is not None and rig.quality.method == "sphere"
        self._leveller = None
        if rig.response.variation is not None:
            self._leveller = leveller_of(rig.response, shape)
        self._detector = ShadowDetector(self._central, options.shadows)
        self._reflectances = np.array(reflectances, dtype=np.float64).reshape(-1, 3)
        self._labeller: MaterialLabeller | None = None
        self._labelled_before = LabelState()
        self._statistics: FrameStatistics | None = None  # of materials, as the reference frame told them
        if len(self._reflectances):
            self._labeller = MaterialLabeller(
                response=self._central,
                reflectances=self._reflectances,
                pigments=np.array(pigments, dtype=np.float64).reshape(-1, 3),
                camera=self.camera,
                leveller=self._leveller,
            )
            self._bounds_deg = (expected_error.OF_ANGLE * np.array(errors_deg or [0.0])).astype(np.float32)
            self._paints = encoded_from_linear(
                colours_of(self._reflectances, self._central), Transfer(curve=TransferCurve.SRGB)
            )

    @property
    def finds_shadows(self) -> bool:
        """True where `normals_of` takes long. Then it owes nothing to the frame before."""
        return self._options.shadows is not ShadowMethod.NONE and self._gel is None

    def refer_to(self, frame: EncodedFrame, matte: Mask | None = None, *, ties_depth: bool = True) -> None:
        """Let a frame tell noise, blur, and how exact materials' lengths are, for all frames.

        ties_depth: the depth of later frames is tied to its own, too; see `DepthAnchor`. Raises as `process`
        does.
        """
        self.forget()
        if ties_depth:
            result = self._normals(self.seen(frame, matte))
            if result.normal_map.mask.any():
                self._anchor = DepthAnchor(self._integrated(result))
        else:
            self._labelled(frame, matte)
        self._statistics = self._labelled_before.statistics
        self.forget()

    def forget(self) -> None:
        """Drop everything that one frame hands to the next, so that a run may start at any block."""
        self._integrator = DepthIntegrator(self.camera, self._options.integration)
        self._labelled_before = LabelState(statistics=self._statistics)

    def process(self, frame: EncodedFrame, matte: Mask | None = None) -> FrameResult:
        """Invert, integrate and mesh one frame, as far as the options say.

        matte: (h, w) pixels of interest of this frame, as filmed; None for those of every frame. Raises
        `BadCapture` where the frame has no usable pixel.
        """
        return self.with_surface(self.normals(frame, matte), frame)

    def normals(self, frame: EncodedFrame, matte: Mask | None = None) -> FrameResult:
        """The first half of `process`: normals and labels."""
        return self.normals_of(self.seen(frame, matte))

    def normals_of(self, seen: SeenFrame) -> FrameResult:
        """The second step of `normals`, which frames may take in any order, several at a time.

        Each of them needs a processor of its own.
        """
        result, frame = self._normals(seen), seen.frame
        if not result.normal_map.mask.any():
            raise BadCapture(
                f"{frame.name}: no usable pixel: all are black, clipped or outside the mask; "
                "look at exposure, mask and rig"
            )
        return result

    def with_surface(self, result: FrameResult, frame: EncodedFrame) -> FrameResult:
        """The second half: depth and mesh, as far as the options say.

        Another thread may work on it while this one finds the next frame's normals; frames come in order.
        """
        normal_map = result.normal_map
        depth_map = None if self._options.to is Product.NORMALS else self._depth(result)
        contact = None
        if self._gel is not None and depth_map is not None:
            depth_map = rested(depth_map)
            contact = contact_from_depth(depth_map, self.camera)
        mesh = None
        if self._options.to is Product.MESH and depth_map is not None:
            mesh = mesh_from_depth(
                depth_map,
                self.camera,
                rgb=self._displayed(frame, result.materials),
                normal_map=normal_map,
                options=self._options.meshing,
            )
        return replace(result, depth_map=depth_map, mesh=mesh, contact=contact)

    def _look_inside(self, matte: Mask | None) -> None:
        self._mask = self._whole_mask
        if matte is not None:
            self._mask = self._whole_mask & self._resampler.mask(matte)

    def seen(self, frame: EncodedFrame, matte: Mask | None = None) -> SeenFrame:
        """The first step of `normals`: light, and materials, which go on from the frame before.

        Frames come in order.
        """
        linear, materials = self._labelled(frame, matte)
        if linear is None:
            return SeenFrame(frame=frame, mask=self._mask)
        turned_deg = None
        if self._labeller is not None and materials is not None:
            linear, turned_deg, self._labelled_before = self._labeller.relit(
                linear, materials, self._labelled_before, self._mask, box_of(self._mask)
            )
            if self._bounds_deg.any():
                turned_deg = expected_error.doubts_of_materials(materials, self._bounds_deg, turned_deg)
        return SeenFrame(
            frame=frame, mask=self._mask, linear=linear, materials=materials, turned_deg=turned_deg
        )

    def _labelled(
        self, frame: EncodedFrame, matte: Mask | None
    ) -> tuple[LinearFrame | None, MaterialLabels | None]:
        """Return a frame in linear light, None where one loop decodes and inverts it, and its materials."""
        require_shape(frame.values, (*self._rig.footage_size[::-1], 3), frame.name)
        self._look_inside(matte)
        if self._is_plain(frame):
            return None, None
        linear = self.linear(frame)
        if self._labeller is None:
            return linear, None
        self._mask = self.lit_subject(linear)
        labels, self._labelled_before = self._labeller.labels(linear, self._mask, self._labelled_before)
        return linear, labels

    def _normals(self, seen: SeenFrame) -> FrameResult:
        frame, mask, linear, residual_deg = seen.frame, seen.mask, seen.linear, self._residual_deg
        if linear is None:
            values, transfer, response = frame.values, self._rig.transfer, self._rig.response
            if self._with_errors:
                normal_map, clipped_share = expected_error.normals_and_errors_from_encoded(
                    values, response, transfer, mask, camera=self.camera,
                    options=self._options.inversion, bits=frame.bits, residual_deg=residual_deg,
                    blur_px=self._blur_px, residual_of_pixels=self._residual_of_pixels,
                )  # fmt: skip
                return _result(seen, normal_map, clipped_share)
            normal_map = normals_from_encoded(
                values, response, transfer, mask, self._options.inversion, frame.bits
            )
            return _result(seen, normal_map, 0.0)
        clipped_share = float(np.count_nonzero(linear.clipped)) / linear.clipped.size
        if self._gel is not None and self._dots is not None:
            change, filled = self._dots.filled(linear.rgb, linear.clipped)
            drift = drift_of_change(change, mask & ~filled)
            normal_map = self._gel.normals(change, drift, mask)
            if self._with_errors:
                normal_map = self._gel.with_expected_error(normal_map)
            return _result(seen, normal_map, clipped_share)
        labels, lamps, has_shadows = None, None, self._options.shadows is not ShadowMethod.NONE
        level = linear
        if self._leveller is not None and (has_shadows or self._with_errors):
            level = self._leveller.frame(linear, box_of(mask))
        if has_shadows:
            normal_map, labels, lamps = self._normals_under_shadow(linear, level, mask)
        else:
            normal_map = normals_from_frame(linear, self._rig.response, mask, options=self._options.inversion)
        if self._with_errors:
            response = self._central if lamps is None else lamps.separated
            normal_map = expected_error.with_expected_error(
                normal_map, level, response, None if lamps is None else labels, self.camera, residual_deg,
                self._blur_px, self._residual_of_pixels,
            )  # fmt: skip
            if seen.turned_deg is not None:
                normal_map = expected_error.with_doubt(normal_map, seen.turned_deg)
        return _result(seen, normal_map, clipped_share, labels, lamps)

    def unlit_by_lamp(self, frame: EncodedFrame, matte: Mask | None = None) -> list[FloatArray]:
        """Return for each lamp (n, 3), what tells its direction: see `shadows/lamp_directions.py`."""
        self._look_inside(matte)
        linear = self.linear(frame)
        level = linear if self._leveller is None else self._leveller.frame(linear)
        labels, mask, _ = self._shadows(linear, level, self._mask)
        return unlit_by_lamp(level, labels, self._central, mask)

    def _shadows(
        self, linear: LinearFrame, frame: LinearFrame, mask: Mask
    ) -> tuple[VisibilityLabels, Mask, LinearFrame]:
        """Return labels, where they hold, and what they were found in. frame: as the central M forms it."""
        inversion, seen = self._options.inversion, self.by_strength(linear, box_of(mask))
        darkest = inversion.darkest * inversion.relative_albedo
        mask = brighter_than(frame, self._central, darkest, mask)
        if inversion.clipped_factor == 0.0:
            mask &= ~frame.clipped
        return self._detector.labels(seen, mask), mask, seen

    def _normals_under_shadow(
        self, linear: LinearFrame, frame: LinearFrame, mask: Mask
    ) -> tuple[NormalMap, VisibilityLabels, LampDirections | None]:
        """Find shadows, then normals, and lamps where there is a shadow. frame: as the central M forms it."""
        response, inversion = self._central, self._options.inversion
        labels, mask, _ = self._shadows(linear, frame, mask)
        if not np.any(labels != ALL_LIT):
            return normals_from_frame(frame, response, mask, options=inversion), labels, None
        lamps = directions_from_shadows(frame, labels, self._rig.response, mask)
        return recover_normals(frame, labels, lamps.separated, mask), labels, lamps

    def by_strength(self, linear: LinearFrame, box: Box | None = None) -> LinearFrame:
        """Return a linear frame with every lamp as strong as at the image's centre.

        box: rows and columns that count; beyond them all is 0. None for all.
        """
        return linear if self._leveller is None else self._leveller.frame_by_strength(linear, box)

    def lit_subject(self, linear: LinearFrame) -> Mask:
        """Return (h, w), the pixels of interest without the backdrop, whose noise is like dark paint."""
        sampled = LinearFrame(rgb=linear.rgb[_SAMPLES], clipped=linear.clipped[_SAMPLES])
        try:
            albedo = relative_albedo_from_frame(sampled, self._central, self._mask[_SAMPLES])
        except BadInput:  # all is black
            return np.zeros_like(self._mask)
        return brighter_than(linear, self._central, self._options.inversion.darkest * albedo, self._mask)

    @property
    def mask(self) -> Mask:
        """(h, w), pixels of interest of the last frame."""
        return self._mask

    def linear(self, frame: EncodedFrame) -> LinearFrame:
        """Decode a frame to linear light, background removed, lens distortion taken out."""
        decoded = linear_frame_from_encoded(frame, self._rig.transfer, self._background)
        return self._resampler.frame(decoded)

    def _is_plain(self, frame: EncodedFrame) -> bool:
        """True where the kernel that decodes and inverts in one pass may be used."""
        integers = frame.values.dtype in (np.uint8, np.uint16)
        plain = self._options.shadows is ShadowMethod.NONE and self._background is None
        plain = plain and self._labeller is None
        return integers and plain and not self._resampler.changes_frames

    def _integrated(self, result: FrameResult) -> DepthMap:
        steps, lamps = None, result.lamps
        if lamps is not None and result.labels is not None:
            steps = steps_from_shadows(result.normal_map, result.labels, lamps.at, lamps.doubts, self._rays)
        return self._integrator.integrate(result.normal_map, steps)

    def _depth(self, result: FrameResult) -> DepthMap:
        normal_map, depth_map = result.normal_map, self._integrated(result)
        if self._anchor is not None and self._gel is None:  # a gel rests at 0 in every frame
            depth_map = self._anchor.align(depth_map, self._integrator.parts)
        if self._with_errors and normal_map.error_deg is not None:
            depth_map = with_expected_depth_error(depth_map, normal_map, self.camera)
        if depth_map.unit is LengthUnit.FREE and self._options.distance_m is not None:
            scaled = depth_map.depth * self._options.distance_m
            return replace(depth_map, depth=scaled, unit=LengthUnit.METRE)
        return depth_map

    def _displayed(self, frame: EncodedFrame, materials: MaterialLabels | None) -> Colours:
        """The mesh's colour, 0 to 1: of its materials where known, else the frame as a person sees it."""
        if materials is not None:
            return np.asarray(self._paints[materials], dtype=np.float32)
        shown = np.asarray(frame.values, dtype=np.float32)
        if frame.values.dtype in (np.uint8, np.uint16):
            shown = shown / np.float32(2**frame.bits - 1)
        if not self._resampler.changes_frames:
            return shown
        nothing: BoolArray = np.zeros(shown.shape[:2], dtype=np.bool_)
        return self._resampler.frame(LinearFrame(rgb=shown, clipped=nothing)).rgb


def _result(
    seen: SeenFrame,
    normal_map: NormalMap,
    clipped_share: float,
    labels: VisibilityLabels | None = None,
    lamps: LampDirections | None = None,
) -> FrameResult:
    return FrameResult(
        number=seen.frame.number,
        normal_map=normal_map,
        depth_map=None,
        labels=labels,
        mesh=None,
        clipped_share=clipped_share,
        materials=seen.materials,
        lamps=lamps,
    )
