"""The schema of rig.json: every key with its meaning and its unit; unknown keys are errors."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

RIG_VERSION = 2  # 2 added response.variation; a rig without it is still written as 1

_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
_Matrix = tuple[_Row, _Row, _Row]
_Fraction = Annotated[FiniteFloat, Field(ge=0, le=1)]


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)


class CameraEntry(_Entry):
    """The camera that filmed."""

    model: Literal["PINHOLE", "OPENCV", "ORTHOGRAPHIC"] = Field(
        description="How points become pixels; PINHOLE and OPENCV are COLMAP's names, OPENCV has distortion."
    )
    width: int = Field(gt=0, description="Image width in pixels.")
    height: int = Field(gt=0, description="Image height in pixels.")
    K: _Matrix = Field(
        description="Camera matrix in pixels, row by row; pixel centres are integers. For ORTHOGRAPHIC, "
        "K[0][0] is pixels per length unit."
    )
    distortion: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] = Field(
        default=(0.0, 0.0, 0.0, 0.0), description="Brown's k1, k2, p1, p2 (OPENCV only), no unit."
    )


class VariationTermEntry(_Entry):
    """One monomial x^i y^j of the pixel position and what it adds to the response."""

    powers: tuple[Annotated[int, Field(ge=0, le=3)], Annotated[int, Field(ge=0, le=3)]] = Field(
        description="i and j, together 1 to 3."
    )
    matrix: _Matrix = Field(description="What it adds to M, full scale.")
    ambient: _Row = Field(default=(0.0, 0.0, 0.0), description="What it adds to the ambient, full scale.")


class VariationEntry(_Entry):
    """How near lights change the response over the image; matrix and ambient hold at the centre.

    x = (u - centre_px[0]) / scale_px, y = (v - centre_px[1]) / scale_px, at pixel (u, v) of the image without
    lens distortion.
    """

    centre_px: tuple[FiniteFloat, FiniteFloat] = Field(description="Pixel (u, v) where x = y = 0.")
    scale_px: FiniteFloat = Field(gt=0, description="Pixels that x = 1 means.")
    terms: list[VariationTermEntry] = Field(min_length=1, description="The monomials.")


class ResponseEntry(_Entry):
    """The light response: linear colour = matrix · normal + ambient, 1 = full scale."""

    matrix: _Matrix = Field(
        description="M, full scale; rows are R, G, B, columns the normal's x, y, z; the calibration "
        "material's albedo is a factor of it."
    )
    ambient: _Row = Field(
        default=(0.0, 0.0, 0.0), description="Colour that does not depend on the normal: R, G, B, full scale."
    )
    light_colours: _Matrix | None = Field(
        default=None,
        description="Row k is the colour R, G, B of light k, full scale; left out where it is not known.",
    )
    variation: VariationEntry | None = Field(
        default=None, description="Left out where one response serves the whole image (version 2)."
    )
    frame: Literal["camera"] = Field(
        default="camera", description="Frame of the normals: camera, x right, y down, z forward."
    )


class ColourEntry(_Entry):
    """How stored values become light."""

    order: Literal["rgb"] = Field(default="rgb", description="Order of the channels in the matrix.")
    transfer: str = Field(default="linear", description="linear, srgb, bt709 or gamma:G.")
    black_level: _Fraction = Field(
        default=0.0, description="Linear value that means no light, 0 to 1 of full scale."
    )
    white_level: _Fraction = Field(
        default=1.0, description="Linear value from which a pixel counts as clipped, 0 to 1 of full scale."
    )


class QualityEntry(_Entry):
    """How the response was fitted, and how well."""

    method: str = Field(description="The verb that fitted it: sphere, board, head, lights or simulation.")
    residual_deg: FiniteFloat = Field(
        ge=0, description="Median angle, degrees, between the normals used and those the fit gives back."
    )
    condition_number: FiniteFloat = Field(ge=1, description="Of the matrix, no unit; 1 is best.")
    samples: int = Field(ge=0, description="Number of (colour, normal) pairs used.")
    cone_deg: FiniteFloat = Field(
        ge=0,
        description="Half-angle, degrees, of the narrowest cone about their mean with 95 % of the normals.",
    )


class SourceEntry(_Entry):
    """A file that the rig was fitted from."""

    file: str = Field(description="Name of the file.")
    sha256: str = Field(pattern="^[0-9a-f]{64}$", description="SHA-256 of its bytes, hexadecimal.")


class RigFile(_Entry):
    """A vntoolkit rig: the camera, how lights and surface become colour, and how far to trust it."""

    version: Literal[1, 2] = Field(default=1, description="Version of this schema.")
    camera: CameraEntry
    response: ResponseEntry
    colour: ColourEntry = Field(default_factory=ColourEntry)
    quality: QualityEntry | None = Field(default=None, description="Left out where M was not fitted.")
    sources: list[SourceEntry] = Field(default_factory=list, description="Files the rig was fitted from.")
