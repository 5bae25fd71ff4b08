"""Formats, axes and units of exported files."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Literal, TypeAlias

from vntoolkit.errors import BadInput
from vntoolkit.options.base import File, Named, OptionalFile, Options, named, positive, within
from vntoolkit.options.footage import ReadingLimits
from vntoolkit.options.shared import FrameOptions, MovedFootageOptions


class NormalConvention(Enum):
    """Axes of a normal map file.

    OPENGL: x right, y up, z towards the viewer (Blender, DiLiGenT, ours; the default). DIRECTX: the same with
    y down (green flipped). OPENCV: x right, y down, z away from the viewer, the camera frame itself.
    """

    OPENGL = "opengl"
    DIRECTX = "directx"
    OPENCV = "opencv"

    @property
    def signs(self) -> tuple[float, float, float]:
        """Factors of x, y, z between the camera frame and this convention; their own inverse."""
        return {"opengl": (1.0, -1.0, -1.0), "directx": (1.0, 1.0, -1.0), "opencv": (1.0, 1.0, 1.0)}[
            self.value
        ]


NormalConventionName: TypeAlias = Literal["opengl", "directx", "opencv"]


class MeshUpAxis(Enum):
    """Which axis of a mesh file points up.

    Y: x right, y up, z towards the viewer (ours, MeshLab's, glTF's; the default). Z: x right, y away from the
    viewer, z up (Blender's own, CAD's, robotics').
    """

    Y = "y"
    Z = "z"

    @property
    def meaning(self) -> str:
        """The three axes in words."""
        if self is MeshUpAxis.Y:
            return "x right, y up, z towards the viewer"
        return "x right, y away from the viewer, z up"


@dataclass(frozen=True, kw_only=True)
class CleanOptions(Options):
    """What to clean."""

    smallest_piece: Annotated[int, within(0)] = 100
    """Connected pieces with fewer triangles are removed; 0 for none."""
    largest_hole: Annotated[int, within(0)] = 30
    """Holes with at most this many boundary edges are closed; 0 for none."""
    most_faces: Annotated[int | None, within(1, words="at least one triangle to remain")] = None
    """Reduce to this many triangles by quadric edge collapse; default: keep all."""


class ExportFormat(Enum):
    """Format of an export."""

    PLY = "ply"  # a mesh a frame
    OBJ = "obj"  # a mesh a frame
    STL = "stl"  # a mesh a frame
    USD = "usd"  # one animated file
    GLB = "glb"  # one animated file of a registered surface, else one a frame
    POINTS = "points"  # a point cloud a frame, .ply: one point a pixel that has a depth
    NPZ = "npz"  # arrays: one file a frame, and one of a registered surface
    DILIGENT = "diligent"  # one folder a frame, laid out like the benchmark's
    PNG = "png"  # 16-bit normal maps
    HEIGHTS = "heights"  # a 16-bit picture of heights a frame, and its scale
    LOCAL_SHAPE = "local-shape"  # heights without longer wavelengths, an EXR and a picture a frame
    CURVATURE = "curvature"  # mean and Gaussian, an EXR and a picture a frame
    PROFILE = "profile"  # heights along a line, a CSV and a picture a frame
    ROUGHNESS = "roughness"  # ISO 25178's height parameters, a JSON a frame
    SUR = "sur"  # heights, of Digital Surf's programs
    X3P = "x3p"  # heights, of ISO 25178-72
    RRD = "rrd"  # one recording for the Rerun viewer
    MCAP = "mcap"  # one recording of ROS 2 messages


ExportFormatName: TypeAlias = Literal[
    "ply", "obj", "stl", "usd", "glb", "points", "npz", "diligent", "png",
    "heights", "local-shape", "curvature", "profile", "roughness", "sur", "x3p", "rrd", "mcap",
]  # fmt: skip
INSPECTED = (
    ExportFormat.HEIGHTS,
    ExportFormat.LOCAL_SHAPE,
    ExportFormat.CURVATURE,
    ExportFormat.PROFILE,
    ExportFormat.ROUGHNESS,
    ExportFormat.SUR,
    ExportFormat.X3P,
)


class ExportedSurface(Enum):
    """Which meshes: of one topology, or a new one every frame."""

    AUTO = "auto"  # the registered surface where there is one
    TRACKED = "tracked"
    FRAMES = "frames"


class FileUnit(Enum):
    """Length unit of exported files."""

    M = "m"
    CM = "cm"
    MM = "mm"

    @property
    def metres(self) -> float:
        """Its length."""
        return {"m": 1.0, "cm": 0.01, "mm": 0.001}[self.value]


_OF_MESHES = (ExportFormat.PLY, ExportFormat.OBJ, ExportFormat.STL, ExportFormat.USD, ExportFormat.GLB)


@dataclass(frozen=True, kw_only=True)
class ExportOptions(CleanOptions):
    """Options of an export."""

    to: ExportFormat
    """The format. usd: one animated file (set the frame rate of Blender's scene to the capture's, since
    Blender keeps its own). glb: one animated file of a registered surface, else one a frame. ply, obj, stl: a
    mesh a frame. points: a point cloud a frame as .ply, of all pixels with a depth. npz: arrays. png: 16-bit
    normal maps. diligent: a folder a frame, laid out like the benchmark's. heights, local-shape, curvature,
    profile, roughness, sur, x3p: for inspection, see the guide. rrd: one recording of all, for the Rerun
    viewer. mcap: depth and contact as messages of ROS 2, at the times of the recording."""
    normal_convention: Named[NormalConvention, NormalConventionName] = named(NormalConvention.OPENGL)
    """Axes of normal maps (png, npz, diligent)."""
    units: Named[FileUnit | None, Literal["m", "cm", "mm"] | None] = named(None)
    """Length unit of the files, for a result that has a scale. Default: metres, and millimetres in STL, which
    states no unit; without a scale, lengths stay as they are."""
    up: Named[MeshUpAxis, Literal["y", "z"]] = named(MeshUpAxis.Y)
    """Axis that points up in meshes."""
    scale: Annotated[float | None, positive("a positive number of metres")] = None
    """Metres for a length of 1 in a result that has no scale of its own (lengths in pixels, or free)."""
    mesh: Named[ExportedSurface, Literal["auto", "tracked", "frames"]] = named(ExportedSurface.AUTO)
    """Which meshes: tracked (the registered surface), frames (those of each frame), or auto (the registered
    one where there is one)."""
    centre: bool = True
    """Move the registered surface so that its template stands above the origin, its hem on the floor; the
    file's camera is where it was, seen from there."""
    longest: Annotated[float | None, positive("a positive wavelength")] = None
    """For inspection: wavelengths above this are removed, so that the form goes and the relief stays (the L
    filter of ISO 25178). In millimetres; in pixels where the result has no scale."""
    shortest: Annotated[float | None, positive("a positive wavelength")] = None
    """For inspection: wavelengths below this are removed, so that noise goes (the S filter)."""
    line: tuple[float, float, float, float] | None = None
    """For --to profile: column and row of the first pixel, then of the last."""
    clean: bool = False
    """Remove small pieces of the meshes and close small holes (pymeshlab). --most-faces and the like imply
    it."""

    @property
    def cleaning(self) -> CleanOptions | None:
        """What is cleaned of the frames' meshes; None for nothing."""
        asked = self.part(CleanOptions)
        return asked if self.clean or asked != CleanOptions() else None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.to is ExportFormat.GLB and (
            self.up is not MeshUpAxis.Y or self.units not in (None, FileUnit.M)
        ):
            raise BadInput("a GLB has metres and y up by its standard: leave out --units and --up")
        if self.to is ExportFormat.MCAP and (self.units, self.scale) != (None, None):
            raise BadInput("mcap: its depth is in the result's own unit: leave out --units and --scale")
        self._require_inspectable()
        if self.cleaning is not None and self.to not in _OF_MESHES:
            raise BadInput(f"cleaning is for meshes, and {self.to.value} has none: leave out --clean")

    def _require_inspectable(self) -> None:
        asked = (self.longest, self.shortest, self.line)
        if self.to not in INSPECTED:
            if asked != (None, None, None):
                raise BadInput(
                    f"{self.to.value}: longest, shortest and line are for inspection; leave them out"
                )
            return
        if self.units is not None:
            raise BadInput(f"{self.to.value}: its lengths are millimetres, or pixels; leave out --units")
        if self.longest is not None and self.shortest is not None and self.longest <= self.shortest:
            raise BadInput("longest: expected a longer wavelength than --shortest")
        if self.to is ExportFormat.LOCAL_SHAPE and self.longest is None:
            raise BadInput("local-shape: expected --longest, the wavelength above which relief is removed")
        if self.to is ExportFormat.CURVATURE and self.longest is not None:
            raise BadInput("curvature: a form is not removed from it; leave out --longest")
        if (self.to is ExportFormat.PROFILE) != (self.line is not None):
            raise BadInput("--line COLUMN ROW COLUMN ROW and --to profile belong together")


@dataclass(frozen=True, kw_only=True)
class ExportArguments(FrameOptions, MovedFootageOptions, ExportOptions, ReadingLimits):
    """What `export` takes."""

    folder: File = field(kw_only=False)
    """The folder that `vntoolkit reconstruct` wrote."""
    to: ExportFormat | ExportFormatName  # type: ignore[assignment]
    out: OptionalFile = named(None)
    """The file (usd, glb) or folder to write; default FOLDER/export/…."""
    background: OptionalFile = named(None)
    """The background image that the reconstruction subtracted."""
    overwrite: bool = False
    """Replace an export with other options in the folder."""
