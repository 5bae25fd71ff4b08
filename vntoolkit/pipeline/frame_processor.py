"""One frame: from stored samples to normals, depth and a mesh (brostow2011, Section III-B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import BoolArray, Colours, FloatArray, LinearImage, Mask, MaterialLabels, box_of
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput, NoSubject
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.io.footage.decoding import EncodedFrame, linear_frame_from_encoded, resampler_of
from vntoolkit.io.results.manifest import MaterialEntry
from vntoolkit.native import keep_freed_memory
from vntoolkit.normals import expected_error
from vntoolkit.normals.inversion import normals_from_frame, relative_albedo_from_frame
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import Product, ReconstructOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.levelling import leveller_of
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, TransferCurve, encoded_from_linear
from vntoolkit.pipeline.outputs import FrameResult

if TYPE_CHECKING:
    from vntoolkit.integration.integrate import DepthAnchor, DepthIntegrator
    from vntoolkit.materials.labelling import FrameStatistics, LabelState, MaterialLabeller

_SAMPLES = (slice(None, None, 4),) * 2  # these pixels tell how bright a subject is


@dataclass(kw_only=True, eq=False)
class Carried:
    """What one frame of a sequence hands to the next; all else of a frame is its own.

    albedo: typical length of the subject's M⁻¹(r − a) in the frames that show it; None where each frame tells
    its own, and none is empty. labels: of materials. integrator: has the solution that the next depth starts
    from. Of the reference frame, for all others, None for none: statistics, what it told of materials' noise,
    blur and lengths; anchor, the depth that they are tied to.
    """

    albedo: float | None = None
    labels: LabelState | None = None
    statistics: FrameStatistics | None = None
    integrator: DepthIntegrator | None = None
    anchor: DepthAnchor | None = None

    def reset(self) -> None:
        """Drop what came from the frame before, so that a sequence may start at any frame."""
        self.integrator = self.labels = None


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedFrame:
    """A frame in linear light and, where the subject's materials are known, as if all were the rig's.

    mask: (h, w), pixels of interest. materials: (h, w), their numbers; None where all is the rig's.
    turned_deg: (h, w), root mean square angles by which what is not known of the materials turns normals;
    None for 0.
    """

    frame: EncodedFrame
    mask: Mask
    linear: LinearFrame
    materials: MaterialLabels | None = None
    turned_deg: npt.NDArray[np.float32] | None = None


class FrameProcessor:
    """Turns frames of one capture into results. It never changes: what frames hand on is a `Carried`.

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
        materials: Sequence[MaterialEntry] = (),
        blur_px: float = 0.0,
    ) -> None:
        """with_errors: whether normals and depth carry their expected errors; a live view has no time.
        materials: of the subject; empty for the rig's alone. blur_px: standard deviation of the picture's
        blur, 0 for unknown."""
        keep_freed_memory()
        self._rig, self._options, self._background = rig, options, background
        self._with_errors, self._blur_px = with_errors, blur_px
        self._resampler = resampler_of(rig)
        self.camera = rig.camera.without_distortion()
        filmed = rig.footage_size[::-1]
        self._filmed_mask = mask
        if mask is not None:
            require_shape(mask, filmed, "mask")
        self.whole_mask = self._resampler.mask(np.ones(filmed, dtype=np.bool_) if mask is None else mask)
        rig.require_background(background is not None)
        self._central = rig.response.central
        fitted = rig.quality is not None and rig.quality.samples
        self._residual_deg = rig.quality.residual_deg if rig.quality is not None and fitted else 0.0
        # a board's colours are means over its hole, a ball's are its pixels'
        self._residual_of_pixels = rig.quality is not None and rig.quality.method == "sphere"
        self._leveller = None
        if rig.response.variation is not None:
            self._leveller = leveller_of(rig.response, (rig.camera.height, rig.camera.width))
        self._gel = None
        if rig.gel is not None and background is not None:
            from vntoolkit.pipeline.pressed_gel import PressedGel

            nothing: Mask = np.zeros(filmed, dtype=np.bool_)
            untouched = self._resampler.frame(LinearFrame(rgb=background, clipped=nothing)).rgb
            self._gel = PressedGel(rig.response, rig.gel, untouched, with_errors=with_errors)
        self._shadows = None
        if options.shadows is not ShadowMethod.NONE:
            from vntoolkit.pipeline.shadowed_normals import ShadowedNormals

            self._shadows = ShadowedNormals(rig.response, options.shadows, self.camera, options.inversion)
        self._materials = materials
        self._labeller: MaterialLabeller | None = None
        if materials:
            from vntoolkit.materials.labelling import MaterialLabeller

            pigments = [each.pigment or (0.0, 0.0, 0.0) for each in materials]
            self._labeller = MaterialLabeller(
                response=self._central,
                reflectances=np.array([each.reflectance for each in materials], dtype=np.float64),
                pigments=np.array(pigments, dtype=np.float64),
                camera=self.camera,
                leveller=self._leveller,
            )

    @property
    def finds_shadows(self) -> bool:
        """True where `normals` takes long."""
        return self._shadows is not None and self._gel is None

    def process(
        self, frame: EncodedFrame, matte: Mask | None = None, carried: Carried | None = None
    ) -> FrameResult:
        """Take one frame from stored samples to linear RGB, normals, depth and a mesh, as the options say.

        matte: (h, w) pixels of interest of this frame, as filmed; None for those of every frame. carried:
        from the frame before; None for a frame alone. Raises `NoSubject` where it has no usable pixel.
        """
        carried = carried or Carried()
        prepared = self.prepared(frame, matte, carried)
        result = self.normals(prepared)
        result = self.with_depth(result, carried)
        return self.with_mesh(result, frame)

    def set_reference(self, carried: Carried, frame: EncodedFrame, matte: Mask | None = None) -> None:
        """Let a frame tell noise, blur, and how exact materials' lengths are, for all frames.

        Depth, if asked for, is tied to its own; see `DepthAnchor`. Raises as `process` does.
        """
        carried.reset()
        if self._options.to is not Product.NORMALS:
            from vntoolkit.integration.integrate import DepthAnchor

            result = self._normals(self.prepared(frame, matte, carried))
            if result.normal_map.mask.any():
                carried.anchor = DepthAnchor(self._integrated(result, carried))
        else:
            self._labelled(frame, matte, carried)
        if carried.labels is not None:
            carried.statistics = carried.labels.statistics
        carried.reset()

    # Video → linear RGB, and all in one material. Frames come in order.

    def prepared(self, frame: EncodedFrame, matte: Mask | None, carried: Carried) -> PreparedFrame:
        """Return a frame in linear light, and of one material; labels go on from the frame before."""
        mask, linear, materials = self._labelled(frame, matte, carried)
        if materials is None or self._labeller is None or carried.labels is None:
            return PreparedFrame(frame=frame, mask=mask, linear=linear)
        linear, turned_deg, carried.labels = self._labeller.relit(
            linear, materials, carried.labels, mask, box_of(mask)
        )
        errors_deg = np.array([each.error_deg for each in self._materials])
        bounds_deg = (expected_error.OF_ANGLE * errors_deg).astype(np.float32)
        if bounds_deg.any():
            turned_deg = expected_error.errors_of_materials(materials, bounds_deg, turned_deg)
        return PreparedFrame(
            frame=frame, mask=mask, linear=linear, materials=materials, turned_deg=turned_deg
        )

    def _labelled(
        self, frame: EncodedFrame, matte: Mask | None, carried: Carried
    ) -> tuple[Mask, LinearFrame, MaterialLabels | None]:
        """Return pixels of interest, linear light and materials."""
        require_shape(frame.values, (*self._rig.footage_size[::-1], 3), frame.name)
        mask = self._mask_of(matte)
        if carried.albedo is not None and self.albedo_in(frame, matte, carried.albedo) is None:
            raise _no_subject(frame.name)
        linear = self.linear(frame)
        if self._labeller is None:
            return mask, linear, None
        from vntoolkit.materials.labelling import LabelState

        mask = self.lit_subject(linear, mask, carried.albedo)
        before = carried.labels or LabelState(statistics=carried.statistics)
        labels, carried.labels = self._labeller.labels(linear, mask, before)
        return mask, linear, labels

    def _mask_of(self, matte: Mask | None) -> Mask:
        return self.whole_mask if matte is None else self.whole_mask & self._resampler.mask(matte)

    def linear(self, frame: EncodedFrame) -> LinearFrame:
        """Decode a frame to linear light, background removed, lens distortion taken out."""
        decoded = linear_frame_from_encoded(frame, self._rig.transfer, self._background)
        return self._resampler.frame(decoded)

    def albedo_in(self, frame: EncodedFrame, matte: Mask | None, usual: float) -> float | None:
        """Return the typical length of the subject's M⁻¹(r − a) in a frame; None where it shows none.

        usual: in the frames that show it.
        """
        from vntoolkit.diagnosis.subject import albedo_in_blocks

        mask = self._filmed_mask if matte is None else matte
        least = self._options.inversion.darkest * usual
        return albedo_in_blocks(frame, self._rig.transfer, self._central, least, self._background, mask)

    def by_strength(self, linear: LinearFrame, mask: Mask | None = None) -> LinearFrame:
        """Return a linear frame with every lamp as strong as at the image's centre.

        mask: (h, w), beyond whose box all is 0; None for all.
        """
        if self._leveller is None:
            return linear
        return self._leveller.frame_by_strength(linear, None if mask is None else box_of(mask))

    def lit_subject(self, linear: LinearFrame, mask: Mask | None = None, albedo: float | None = None) -> Mask:
        """Return (h, w), the pixels of interest without the backdrop, whose noise is like dark paint.

        albedo: of the subject in the frames that show it; None for what this one tells.
        """
        from vntoolkit.shadows.contributions import brighter_than

        mask = self.whole_mask if mask is None else mask
        sampled = LinearFrame(rgb=linear.rgb[_SAMPLES], clipped=linear.clipped[_SAMPLES])
        try:
            albedo = albedo or relative_albedo_from_frame(sampled, self._central, mask[_SAMPLES])
        except BadInput:  # all is black
            return np.zeros_like(mask)
        return brighter_than(linear, self._central, self._options.inversion.darkest * albedo, mask)

    # Linear RGB → normals. Frames come in any order, several at a time.

    def normals(self, prepared: PreparedFrame) -> FrameResult:
        """Return normals, and visibility labels where shadows are looked for."""
        result = self._normals(prepared)
        if not result.normal_map.mask.any():
            raise _no_subject(prepared.frame.name)
        return result

    def _normals(self, prepared: PreparedFrame) -> FrameResult:
        linear, mask = prepared.linear, prepared.mask
        clipped_share = float(np.count_nonzero(linear.clipped)) / linear.clipped.size
        if self._gel is not None:
            return _result(prepared, self._gel.normals(linear, mask), clipped_share)
        labels, lamps, level = None, None, linear
        if self._leveller is not None and (self._shadows is not None or self._with_errors):
            level = self._leveller.frame(linear, box_of(mask))
        if self._shadows is not None:
            by_strength = self.by_strength(linear, mask)
            normal_map, labels, lamps = self._shadows.normals(level, by_strength, mask)
        else:
            normal_map = normals_from_frame(linear, self._rig.response, mask, options=self._options.inversion)
        if self._with_errors:
            response = self._central if lamps is None else lamps.separated
            normal_map = expected_error.with_expected_error(
                normal_map, level, response, None if lamps is None else labels, self.camera,
                self._residual_deg, self._blur_px, self._residual_of_pixels,
            )  # fmt: skip
            if prepared.turned_deg is not None:
                normal_map = expected_error.with_added_error(normal_map, prepared.turned_deg)
        result = _result(prepared, normal_map, clipped_share)
        return replace(result, labels=labels, lamps=lamps)

    def unlit_by_lamp(self, frame: EncodedFrame, matte: Mask | None = None) -> list[FloatArray]:
        """Return for each lamp (n, 3), what shadows tell of its direction."""
        assert self._shadows is not None
        linear, mask = self.linear(frame), self._mask_of(matte)
        level = linear if self._leveller is None else self._leveller.frame(linear)
        return self._shadows.unlit_by_lamp(level, self.by_strength(linear, mask), mask)

    # Normals → depth → mesh. Frames come in order.

    # Another thread may work on them while this one finds the next frame's normals.

    def with_depth(self, result: FrameResult, carried: Carried) -> FrameResult:
        """Return the result with depth, and of a gel with what touches it, if the options say so."""
        if self._options.to is Product.NORMALS:
            return result
        depth_map, contact = self._depth(result, carried), None
        if self._gel is not None:
            depth_map, contact = self._gel.contact(depth_map, self.camera)
        return replace(result, depth_map=depth_map, contact=contact)

    def with_mesh(self, result: FrameResult, frame: EncodedFrame) -> FrameResult:
        """Return the result with a mesh, if the options say so."""
        if self._options.to is not Product.MESH or result.depth_map is None:
            return result
        from vntoolkit.meshing.surface import mesh_from_depth

        mesh = mesh_from_depth(
            result.depth_map,
            self.camera,
            rgb=self._displayed(frame, result.materials),
            normal_map=result.normal_map,
            options=self._options.meshing,
        )
        return replace(result, mesh=mesh)

    def _integrated(self, result: FrameResult, carried: Carried) -> DepthMap:
        from vntoolkit.integration.integrate import DepthIntegrator

        carried.integrator = carried.integrator or DepthIntegrator(
            self.camera, self._options.integration, may_jump=self._rig.gel is None
        )
        steps, lamps = None, result.lamps
        if lamps is not None and result.labels is not None:
            from vntoolkit.integration.cast_shadows import steps_from_shadows
            from vntoolkit.integration.slopes import rays_from_camera

            rays = rays_from_camera(self.camera)
            steps = steps_from_shadows(result.normal_map, result.labels, lamps.at, lamps.deviations, rays)
        return carried.integrator.integrate(result.normal_map, steps)

    def _depth(self, result: FrameResult, carried: Carried) -> DepthMap:
        from vntoolkit.integration.expected_error import with_expected_depth_error

        normal_map, depth_map = result.normal_map, self._integrated(result, carried)
        if carried.anchor is not None and carried.integrator is not None and self._gel is None:
            depth_map = carried.anchor.align(depth_map, carried.integrator.parts)  # a gel rests at 0
        if self._with_errors and normal_map.error_deg is not None:
            depth_map = with_expected_depth_error(depth_map, normal_map, self.camera)
        if depth_map.unit is LengthUnit.FREE and self._options.distance_m is not None:
            scaled = depth_map.depth * self._options.distance_m
            return replace(depth_map, depth=scaled, unit=LengthUnit.METRE)
        return depth_map

    def _displayed(self, frame: EncodedFrame, materials: MaterialLabels | None) -> Colours:
        """The mesh's colour, 0 to 1: of its materials where known, else the frame as a person sees it."""
        if materials is not None:
            from vntoolkit.materials.relighting import colours_of

            reflectances = np.array([each.reflectance for each in self._materials], dtype=np.float64)
            linear = colours_of(reflectances, self._central)
            paints = encoded_from_linear(linear, Transfer(curve=TransferCurve.SRGB))
            return np.asarray(paints[materials], dtype=np.float32)
        shown = np.asarray(frame.values, dtype=np.float32)
        if frame.values.dtype in (np.uint8, np.uint16):
            shown = shown / np.float32(2**frame.bits - 1)
        if not self._resampler.changes_frames:
            return shown
        nothing: BoolArray = np.zeros(shown.shape[:2], dtype=np.bool_)
        return self._resampler.frame(LinearFrame(rgb=shown, clipped=nothing)).rgb


def _no_subject(name: str) -> NoSubject:
    return NoSubject(
        f"{name}: no subject in sight: all pixels are black, clipped or outside the mask; look at exposure, "
        "mask and rig"
    )


def _result(prepared: PreparedFrame, normal_map: NormalMap, clipped_share: float) -> FrameResult:
    return FrameResult(
        number=prepared.frame.number,
        normal_map=normal_map,
        clipped_share=clipped_share,
        materials=prepared.materials,
    )
