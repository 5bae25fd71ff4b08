"""A rig: camera, light response, transfer curve, and the quality of its calibration."""

from dataclasses import dataclass, field, replace

from vntoolkit.display import Displayed, Facts
from vntoolkit.errors import BadRig
from vntoolkit.geometry.camera import Camera
from vntoolkit.photometry.gel import GelResponse
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer


@dataclass(frozen=True, kw_only=True)
class FitQuality:
    """How a light response was fitted and how well.

    method: the verb that fitted it (`sphere`, `board`, `head`, `lights`, `simulation`). residual_deg: median
    angle in degrees between the normals used and those that the fitted M gives back. condition_number: of M.
    samples: number of (colour, normal) pairs used. cone_deg: half-angle in degrees (axis to side) of the
    narrowest cone about their mean direction that holds 95 % of the normals seen. With samples = 0 nothing
    was fitted (the lights were known) and residual and cone mean nothing.
    """

    method: str
    residual_deg: float
    condition_number: float
    samples: int
    cone_deg: float


@dataclass(frozen=True, kw_only=True)
class SourceFile:
    """A file that a rig was fitted from: its name and the SHA-256 of its bytes, in hexadecimal."""

    file: str
    sha256: str


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Rig(Displayed):
    """All calibrated data that normals and depth need.

    material: what M was measured on, in words, and holds for; empty where it is not known.
    gel: of a tactile sensor only. Then the response is to a pixel's change against the untouched gel, and
    camera and response belong to the rectified picture.
    """

    camera: Camera
    response: LightResponse
    transfer: Transfer = field(default_factory=Transfer)
    quality: FitQuality | None = None
    sources: tuple[SourceFile, ...] = ()
    gel: GelResponse | None = None
    material: str = ""

    @property
    def footage_size(self) -> tuple[int, int]:
        """(width, height) of frames as filmed."""
        if self.gel is not None and self.gel.filmed_px is not None:
            return self.gel.filmed_px
        return self.camera.width, self.camera.height

    def through(self, camera: Camera) -> "Rig":
        """Return the rig of another camera, or another zoom, at the same place and of the same subject.

        M is that of a place, and so is its change from place to place: it goes with the picture's scale.
        Raises `BadRig` where M changes over the picture and one of the two focal lengths is not known.
        """
        variation = self.response.variation
        if variation is None:
            return replace(self, camera=camera)
        if not (self.camera.is_perspective and camera.is_perspective):
            raise BadRig(
                "another camera: M varies over the picture, so both cameras must be perspective, and one is "
                "orthographic; calibrate with --focal-px or --camera"
            )
        scale = float(camera.matrix[0, 0] / self.camera.matrix[0, 0])
        middle, other = self.camera.matrix[:2, 2], camera.matrix[:2, 2]
        seen = replace(
            variation,
            centre_px=other + scale * (variation.centre_px - middle),
            scale_px=scale * variation.scale_px,
        )
        return replace(self, camera=camera, response=replace(self.response, variation=seen))

    def require_background(self, given: bool) -> None:
        """Raise `BadRig` where a tactile gel's rig is used without its untouched gel."""
        if self.gel is not None and not given:
            raise BadRig(
                "the rig is that of a tactile gel: expected a photograph of the untouched gel, got none; "
                "give it with --background"
            )

    def require_size(self, width: int, height: int, name: str) -> None:
        """Raise `BadRig` unless frames of this size belong to the rig's camera."""
        wanted = self.footage_size
        if (width, height) != wanted:
            whose = "rig's camera is" if self.gel is None or self.gel.filmed_px is None else "sensor films"
            raise BadRig(
                f"{name} is {width}×{height} but the {whose} {wanted[0]}×{wanted[1]}: calibrate with footage "
                "of the same size"
            )

    def _facts(self) -> Facts:
        quality = self.quality
        facts = {
            "camera": f"{self.camera.model.value} {self.camera.width}×{self.camera.height}",
            "condition": f"{self.response.condition_number:.1f}",
            "transfer": self.transfer.to_text(),
        }
        if self.response.variation is not None:
            facts["M"] = "varies over the image"
        if quality is not None:
            facts["by"] = quality.method
            if quality.samples:
                facts["residual"] = f"{quality.residual_deg:.1f}°"
        return facts
