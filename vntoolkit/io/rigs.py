"""Reading and writing rig.json, and its schema."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias, get_args, get_origin

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    ValidationError,
    field_validator,
)
from pydantic_core import to_jsonable_python

from vntoolkit.checks import checks_kinds
from vntoolkit.errors import BadInput, BadRig
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.io.atomic import write_text
from vntoolkit.io.files import parse_json, read_text
from vntoolkit.photometry.gel import EARLIER_TERMS, TERMS, GelResponse, completed_coefficients
from vntoolkit.photometry.response import LightResponse, ResponseVariation
from vntoolkit.photometry.rig import FitQuality, Rig, SourceFile
from vntoolkit.photometry.transfer import Transfer

_EXPECTED = "a rig.json of `vntoolkit calibrate`"
# 2 added response.variation, 3 gel, 4 response.material, 5 the gel's fourth degree, 6 the lamps' doubts,
# 7 gel.untouched, 8 more than 4 numbers of distortion; one without is as before
RIG_VERSION = 8
Version: TypeAlias = Literal[1, 2, 3, 4, 5, 6, 7, 8]
_Pair: TypeAlias = tuple[FiniteFloat, FiniteFloat]
_Row: TypeAlias = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
_SixRows = Annotated[list[_Row], Field(min_length=6, max_length=6)]
_Matrix: TypeAlias = tuple[_Row, _Row, _Row]
_Power = Annotated[int, Field(ge=0, le=3)]
_Doubt = Annotated[FiniteFloat, Field(ge=0, le=90)]
_Fraction = Annotated[FiniteFloat, Field(ge=0, le=1)]


def read_rig(path: Path | str) -> Rig:
    """Read rig.json; raise `BadRig` with one line that names the key that is unknown, missing or wrong."""
    return rig_from_text(read_text(path, BadRig, _EXPECTED), str(path))


@checks_kinds
def write_rig(path: Path | str, rig: Rig) -> None:
    """Write rig.json, atomically, with the short arrays on one line each."""
    write_text(path, text_from_rig(rig))


def rig_from_text(text: str, name: str = "rig") -> Rig:
    """Parse the text of a rig.json; `name` stands in the messages."""
    content = parse_json(text, name, BadRig, _EXPECTED)
    stated = content.get("version", 1) if isinstance(content, dict) else 1
    if not isinstance(stated, int) or isinstance(stated, bool):
        raise BadRig(f"{name}: version: expected a number, got {json.dumps(stated)}")
    if stated not in range(1, RIG_VERSION + 1):
        raise BadRig(f"{name}: is of version {stated}, this program reads 1 to {RIG_VERSION}")
    entry = RigFile.read(content, name, BadRig)
    try:
        return rig_from_entry(entry)
    except BadInput as problem:
        raise BadRig(f"{name}: {problem}") from problem


def text_from_rig(rig: Rig) -> str:
    """Return the text of rig.json."""
    return text_from_model(entry_from_rig(rig))


def text_from_model(model: BaseModel) -> str:
    """Return indented JSON in which an array of numbers stays on one line."""
    return _indented(model.model_dump(mode="json", exclude_none=True)) + "\n"


def _one_line_from_validation(problem: ValidationError, model: type[BaseModel]) -> str:
    """Return pydantic's first error as one line with the path of the key."""
    error = problem.errors(include_url=False)[0]
    key = _clipped(".".join(map(str, error["loc"])), 120) or "the whole file"
    match error["type"]:
        case "extra_forbidden":
            return f"unknown key '{key}'; known there: {', '.join(_known_keys(model, error['loc'][:-1]))}"
        case "missing":
            return f"the key '{key}' is missing"
        case "model_type":
            return (
                f"{key}: expected a JSON object with the keys {', '.join(_known_keys(model, error['loc']))}"
            )
        case _:
            got, message = _clipped(repr(error["input"]), 60), error["msg"]
            return f"{key}: {message[0].lower()}{message[1:]}, got {got}"


def _clipped(text: str, length: int) -> str:
    return text if len(text) < length else text[: length - 3] + "..."


def _known_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    is_key = False
    for step in location:
        if isinstance(step, int) or is_key:  # a place in a list or a mapping is no field
            is_key = False
            continue
        inner = model.model_fields[step].annotation
        is_key = get_origin(inner) is dict
        candidates = (inner, *getattr(inner, "__args__", ()))
        model = next(c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel))
    return list(model.model_fields)


def rig_from_entry(entry: RigFile) -> Rig:
    """Return the rig of a validated rig.json; raise `BadInput` for impossible numbers."""
    response, colour = entry.response, entry.colour
    transfer = Transfer.from_text(colour.transfer)
    return Rig(
        camera=camera_from_entry(entry.camera),
        response=LightResponse(
            **response.model_dump(exclude={"variation", "material", "frame"}),
            variation=None if response.variation is None else _variation_from_entry(response.variation),
        ),
        transfer=replace(transfer, black_level=colour.black_level, white_level=colour.white_level),
        quality=None if entry.quality is None else FitQuality(**entry.quality.model_dump()),
        sources=tuple(SourceFile(**source.model_dump()) for source in entry.sources),
        gel=None if entry.gel is None else _gel_from_entry(entry.gel),
        material=response.material or "",
    )


def entry_from_rig(rig: Rig) -> RigFile:
    """Return the rig as rig.json and the manifest store it."""
    content, transfer = _plain(rig), rig.transfer
    response, gel = content["response"], content["gel"]
    if variation := response["variation"]:
        terms = zip(*(variation.pop(name) for name in ("powers", "matrices", "ambients")), strict=True)
        names = ("powers", "matrix", "ambient")
        variation["terms"] = [dict(zip(names, term, strict=True)) for term in terms]
    if gel and (filmed_px := gel.pop("filmed_px")):
        gel["rectification"]["filmed_px"] = filmed_px
    return RigFile(
        version=_version_of(rig),
        camera=entry_from_camera(rig.camera),
        response=response | {"material": rig.material or None},
        colour=ColourEntry(
            transfer=transfer.to_text(),
            black_level=transfer.black_level,
            white_level=transfer.white_level,
        ),
        quality=content["quality"],
        sources=content["sources"],
        gel=gel,
    )


def _version_of(rig: Rig) -> Version:
    """The earliest version that holds what this rig has."""
    has: dict[Version, bool] = {
        8: len(rig.camera.distortion) > 4,
        7: rig.gel is not None and rig.gel.untouched is not None,
        6: rig.response.light_doubts_deg is not None,
        5: rig.gel is not None,
        4: bool(rig.material),
        2: rig.response.variation is not None,
    }
    return next((version for version, is_needed in has.items() if is_needed), 1)


def camera_from_entry(entry: CameraEntry) -> Camera:
    """Return the camera of a file; raise `BadInput` for impossible numbers."""
    content = entry.model_dump(exclude={"model", "K"})
    return Camera(model=CameraModel(entry.model), matrix=np.array(entry.K), **content)


def entry_from_camera(camera: Camera) -> CameraEntry:
    """Return the camera as rig.json, the manifest and track.json store it."""
    content = _plain(camera)
    return CameraEntry(K=content.pop("matrix"), **content)


def _plain(value: Any) -> Any:
    """Return a dataclass as JSON has it."""
    return to_jsonable_python(value, fallback=lambda array: array.tolist())


def _variation_from_entry(entry: VariationEntry) -> ResponseVariation:
    return ResponseVariation(
        powers=np.array([term.powers for term in entry.terms]),
        matrices=np.array([term.matrix for term in entry.terms]),
        ambients=np.array([term.ambient for term in entry.terms]),
        centre_px=np.array(entry.centre_px),
        scale_px=entry.scale_px,
    )


def _gel_from_entry(entry: GelEntry) -> GelResponse:
    view, coefficients = entry.rectification, np.array(entry.coefficients)
    if len(coefficients) == EARLIER_TERMS:
        coefficients = completed_coefficients(coefficients)
    return GelResponse(
        **entry.model_dump(exclude={"coefficients", "rectification"}),
        coefficients=coefficients,
        rectification=None if view is None else Rectification(**view.model_dump(exclude={"filmed_px"})),
        filmed_px=None if view is None else view.filmed_px,
    )


def _indented(value: Any, indent: str = "") -> str:
    deeper = indent + "  "
    if isinstance(value, dict) and value:
        rows = [f"{deeper}{json.dumps(k)}: {_indented(v, deeper)}" for k, v in value.items()]
        return "{\n" + ",\n".join(rows) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, (list, dict)) for item in value):
        rows = [deeper + _indented(item, deeper) for item in value]
        return "[\n" + ",\n".join(rows) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False)


class Entry(BaseModel):
    """A JSON object of known keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    @classmethod
    def read(cls, content: Any, name: str, error: type[BadInput] = BadInput) -> Self:
        """Return the object of parsed JSON; raise `error` with one line that names the wrong key."""
        try:
            return cls.model_validate(content)
        except ValidationError as problem:
            raise error(f"{name}: {_one_line_from_validation(problem, cls)}") from problem


class CameraEntry(Entry):
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
    distortion: list[FiniteFloat] = Field(
        default=[0.0, 0.0, 0.0, 0.0],
        description="k1, k2, p1, p2 and perhaps k3, or k3 to k6, in OpenCV's order (OPENCV only), no unit.",
    )

    @field_validator("model", mode="before")
    @classmethod
    def _known_model(cls, model: object) -> object:
        names = get_args(cls.model_fields["model"].annotation)
        if model in names:
            return model
        raise ValueError(
            f"expected {', '.join(names)}; of another lens undistort the footage, and name it PINHOLE"
        )


class VariationTermEntry(Entry):
    """One monomial x^i y^j of the pixel position and what it adds to the response."""

    powers: tuple[_Power, _Power] = Field(description="i and j, together 1 to 3.")
    matrix: _Matrix = Field(description="What it adds to M, full scale.")
    ambient: _Row = Field(default=(0.0, 0.0, 0.0), description="What it adds to the ambient, full scale.")


class VariationEntry(Entry):
    """How near lights change the response over the image; matrix and ambient hold at the centre.

    x = (u - centre_px[0]) / scale_px, y = (v - centre_px[1]) / scale_px, at pixel (u, v) of the image without
    lens distortion.
    """

    centre_px: _Pair = Field(description="Pixel (u, v) where x = y = 0.")
    scale_px: FiniteFloat = Field(gt=0, description="Pixels that x = 1 means.")
    terms: list[VariationTermEntry] = Field(min_length=1, description="The monomials.")


class ResponseEntry(Entry):
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
    light_doubts_deg: tuple[_Doubt, _Doubt, _Doubt] | None = Field(
        default=None,
        description="Standard deviations of the directions that light_colours leave to lights 0, 1, 2, where "
        "shadows on a subject told them; left out for exact (version 6).",
    )
    material: str | None = Field(
        default=None,
        max_length=200,
        description="What M was measured on. M holds for this material; with light_colours, others are told "
        "relative to it (version 4).",
    )
    variation: VariationEntry | None = Field(
        default=None, description="Left out where one response serves the whole image (version 2)."
    )
    frame: Literal["camera"] = Field(
        default="camera", description="Frame of the normals: camera, x right, y down, z forward."
    )


class ColourEntry(Entry):
    """How stored values are converted to linear light."""

    order: Literal["rgb"] = Field(default="rgb", description="Order of the channels in the matrix.")
    transfer: str = Field(
        default="linear",
        description="linear, srgb, bt709, gamma:G, pq, hlg, slog3, vlog, clog3 or logc3.",
    )
    black_level: _Fraction = Field(
        default=0.0, description="Linear value that means no light, 0 to 1 of full scale."
    )
    white_level: _Fraction = Field(
        default=1.0, description="Linear value from which a pixel counts as clipped, 0 to 1 of full scale."
    )


class QualityEntry(Entry):
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


class RectificationEntry(Entry):
    """Where the gel lies in the picture as filmed."""

    corners_px: Annotated[tuple[FiniteFloat, ...], Field(min_length=8, max_length=8)] = Field(
        description="u, v of the gel's top left, top right, bottom left and bottom right corner, as filmed."
    )
    width_mm: FiniteFloat = Field(gt=0, description="Between the left and the right corners, millimetres.")
    height_mm: FiniteFloat = Field(gt=0, description="Between the upper and the lower ones, millimetres.")
    pixel_mm: FiniteFloat = Field(
        gt=0, description="Side of a pixel of the rectified picture in both directions, millimetres."
    )
    filmed_px: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]] = Field(
        description="Width and height of the picture as filmed."
    )


class GelEntry(Entry):
    """How a tactile gel answers beyond M, which then is its response to a change against the untouched gel.

    m = inverse(matrix) · (colour - colour of the untouched gel). x = (u - centre_px[0]) / scale_px and y
    likewise. The normal in stereographic coordinates, n_xy / (1 - n_z), is that of (0, 0, -1) + m, plus the
    sum of the coefficients times the products of m's components, x and y.
    """

    centre_px: _Pair = Field(description="Pixel (u, v) where x = y = 0.")
    scale_px: FiniteFloat = Field(gt=0, description="Pixels that x = 1 means.")
    reach: FiniteFloat = Field(gt=0, description="Length to which a longer m is shortened in the products.")
    coefficients: list[_Pair] = Field(
        min_length=EARLIER_TERMS,
        max_length=TERMS,
        description="Two for every product of one to four factors, at least one of them of m (before version "
        "5 one to three). Order: the products of m (m1, m2, m3, m1 m1, m1 m2, …), and for each 1, x, y, x x, "
        "x y, y y, … up to the degree.",
    )
    errors_deg: list[_Pair] | None = Field(
        default=None,
        description="Tilts of the gel, growing, and the angle that nine of ten normals so tilted stay "
        "within, on presses held back from the fit, degrees; left out where it is not known.",
    )
    untouched: _SixRows | None = Field(
        default=None,
        description="Colour of the untouched gel: coefficients (red, green, blue) of 1, x, y, x x, x y, y y, "
        "where x and y run from -1 to 1 over the picture (version 7).",
    )
    rectification: RectificationEntry | None = Field(
        default=None, description="Left out where the footage shows the gel squarely already."
    )


class SourceEntry(Entry):
    """A file that the rig was fitted from."""

    file: str = Field(description="Name of the file.")
    sha256: str = Field(pattern="^[0-9a-f]{64}$", description="SHA-256 of its bytes, hexadecimal.")


class RigFile(Entry):
    """A vntoolkit rig: camera, light response, colour encoding, and quality of the calibration."""

    version: Version = Field(default=1, description="Version of this schema.")
    camera: CameraEntry
    response: ResponseEntry
    colour: ColourEntry = Field(default_factory=ColourEntry)
    quality: QualityEntry | None = Field(default=None, description="Left out where M was not fitted.")
    sources: list[SourceEntry] = Field(default_factory=list, description="Files the rig was fitted from.")
    gel: GelEntry | None = Field(default=None, description="Of a tactile sensor only (versions 3, 5 and 7).")
