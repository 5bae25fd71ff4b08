"""The look that every figure shares, maps as pictures for people, and pictures in rows under headings.

Curves and areas have colours that colour-blind eyes tell apart."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from vntoolkit.arrays import ByteArray, FloatArray, LinearImage, Mask, VisibilityLabels, box_of
from vntoolkit.display import SCREEN_GAMMA
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.footage.image_writing import resized_image, write_png
from vntoolkit.io.maps_and_meshes.label_images import MATERIAL_PALETTE, label_colours
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.pipeline.opened_result import OpenedResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, FAINT = "#27313f", "#7d8999"
# Told apart by all common kinds of colour vision (okabe2008).
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9"
SERIES = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY)
DASHES = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (6, 1.4, 1.2, 1.4)), (0, (3, 1)), (0, (8, 2)))
ERROR_COLOURS = "inferno"  # of every map of errors: brighter is worse, in grey print too
PNG_DPI = 160
_STYLE = {
    "svg.fonttype": "none",  # text stays text: smaller, sharp, can be searched
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e9ee",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "lines.linewidth": 1.6,
}


def new_figure(width_in: float = 6.2, height_in: float = 2.9) -> Figure:
    """Return an empty figure in the shared style; draw on it inside `report_style`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


@contextmanager
def new_axes(width_in: float = 6.2, height_in: float = 2.9, **style: Any) -> Iterator[Any]:
    """Yield the axes of a new figure, to be drawn on in the shared style."""
    with report_style(**style):
        yield new_figure(width_in, height_in).subplots()


def report_style(**more: Any) -> AbstractContextManager[None]:
    """Draw in the shared style while the block runs: curves differ in colour and in dashes."""
    import matplotlib
    from cycler import cycler

    curves = cycler(color=SERIES) + cycler(linestyle=DASHES)
    return matplotlib.rc_context(cast(Any, {**_STYLE, "axes.prop_cycle": curves, **more}))


def write_figure(figure: Figure, path: Path | str, *, dpi: int = PNG_DPI) -> None:
    """Write a figure as PNG or SVG, by the suffix, atomically; the same figure gives the same bytes."""
    suffix = Path(path).suffix.lower()
    with report_style(**{"svg.hashsalt": "vntoolkit"}), atomic_path(path) as draft:
        if suffix == ".svg":
            figure.savefig(draft, format="svg", metadata={"Date": None, "Creator": None})
        else:
            figure.savefig(draft, format="png", dpi=dpi, metadata={"Software": None})


Picture = ByteArray
GROUND = 255  # grey value where a map is invalid
_LIGHT = np.array([-0.45, -0.55, -0.70])  # from the surface: left, above, before it
_AMBIENT = 0.10
_PLASTER = 0.78


def displayed(linear: FloatArray | LinearImage) -> Picture:
    """Return linear light (h, w, 3), full scale 1, as a screen shows it."""
    return (255 * np.clip(linear, 0, 1) ** (1 / SCREEN_GAMMA)).astype(np.uint8)


def pictures_of_frame(
    result: OpenedResult, number: int, *, ground: int, beside_labels: int | None = None
) -> dict[str, Picture]:
    """Return what there is of a frame: captured, normals, depth (as relief), shadows and materials, so named.

    Of a gel also dents: depth in mm, on one scale for all frames.

    ground: grey value where a map is invalid; beside_labels: for those, default as for all.
    """
    normal_map, depth_map = result.normals(number), result.depth(number)
    labels, captured = result.labels(number), result.picture(number)
    pictures: dict[str, Picture] = {} if captured is None else {"captured": captured}
    pictures["normals"] = picture_of_normals(normal_map, ground=ground)
    if depth_map is not None:
        pictures["depth"] = picture_of_depth(depth_map, result.camera, ground=ground)
        if result.rig.gel is not None:
            from vntoolkit.report.dents import picture_of_dents, scale_end_mm

            depths = [entry.contact_depth_mm or 0.0 for entry in result.entries.values()]
            pictures["dents"] = picture_of_dents(depth_map, scale_end_mm(max(depths, default=0.0)), ground)
    if labels is not None:
        beside = ground if beside_labels is None else beside_labels
        pictures["shadows"] = picture_of_labels(labels, normal_map.mask, ground=beside)
    materials = result.materials(number)
    if materials is not None:
        coloured = MATERIAL_PALETTE[materials]
        pictures["materials"] = np.where(normal_map.mask[..., None], coloured, np.uint8(ground))
    return pictures


def picture_of_normals(normal_map: NormalMap, ground: int = GROUND) -> Picture:
    """Return the usual colours (h, w, 3): red to the right, green up, blue to the viewer."""
    towards_viewer = normal_map.normals_in_camera * np.array([1, -1, -1], np.float32)
    coloured = np.where(normal_map.mask[..., None], 127.5 * (towards_viewer + 1), ground)
    return coloured.astype(np.uint8)


def picture_of_depth(depth_map: DepthMap, camera: Camera, ground: int = GROUND) -> Picture:
    """Return the surface (h, w, 3) as plaster lit from the upper left, its normals taken from the depth."""
    normals = normals_from_depth(depth_map, camera)
    light = _LIGHT / np.linalg.norm(_LIGHT)
    brightness = _AMBIENT + (1 - _AMBIENT) * np.clip(normals @ light, 0, 1)
    grey = 255 * np.clip(_PLASTER * brightness, 0, 1) ** (1 / SCREEN_GAMMA)
    seen = depth_map.mask & (normals[..., 2] != 0)
    return np.repeat(np.where(seen, grey, ground)[..., None], 3, axis=2).astype(np.uint8)


def picture_of_labels(labels: VisibilityLabels, mask: Mask | None, ground: int = GROUND) -> Picture:
    """Return the colours (h, w, 3) of the lights that arrive, as in shadows/*.png."""
    coloured = label_colours(labels)
    return coloured if mask is None else np.where(mask[..., None], coloured, np.uint8(ground))


def short_label(label: int) -> str:
    """Return which lights a shadow label says to arrive, in few words."""
    lights = [str(light) for light in range(3) if label >> light & 1]
    return ("none", f"light {''.join(lights)}", f"lights {', '.join(lights)}", "all three")[len(lights)]


def web_colour(label: int) -> str:
    """Return the colour of a shadow label as the web writes it."""
    return "#" + "".join(f"{channel:02x}" for channel in label_colours(np.uint8(label)))


def normals_from_depth(depth_map: DepthMap, camera: Camera) -> FloatArray:
    """Return (h, w, 3) unit normals of the surface through the depths, 0 where a neighbour is missing.

    The cross product of central differences of the unprojected points, so it holds for any camera.
    """
    points = camera.points_from_depth(np.where(depth_map.mask, depth_map.depth, np.nan))
    du, dv = np.full_like(points, np.nan), np.full_like(points, np.nan)
    du[:, 1:-1] = points[:, 2:] - points[:, :-2]
    dv[1:-1] = points[2:] - points[:-2]
    across = np.cross(dv, du)  # x right, y down: this order points at the viewer
    length = np.linalg.norm(across, axis=2, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.nan_to_num(across / length, nan=0.0)


def cropped(pictures: list[Picture], mask: Mask, margin_px: int = 6) -> list[Picture]:
    """Cut pictures of one size to the box around a mask, the same for all."""
    box = box_of(mask, margin_px)
    return [picture[box] for picture in pictures] if mask.any() else pictures


_PAGE_PX = 1060  # where a page shows a picture of this width, letters have their size as written
_LETTER_PX, _LINE_PX, _GAP_PX = 12.0, 24, 8
_SWATCH_PX, _ENTRY_PX, _SCALE_PX = 13, 170, 260


@dataclass(frozen=True, kw_only=True)
class ErrorScale:
    """The scale of an error map. most: value of the brightest colour, and of all beyond it. unit: as text."""

    most: float
    unit: str = "°"


NORMAL_ERRORS = ErrorScale(most=30.0)


@dataclass(frozen=True, kw_only=True)
class _Text:
    """A text at x, y, pixels from the upper left. side: which part of it stands at x."""

    x: float
    y: float
    text: str
    side: str = "center"


def picture_of_errors(errors: FloatArray, compared: Mask, scale: ErrorScale, ground: int = 255) -> Picture:
    """Return errors (h, w) as colours (h, w, 3), dark for none, a grey `ground` where none was compared."""
    from matplotlib import colormaps

    coloured = 255 * colormaps[ERROR_COLOURS](np.clip(errors / scale.most, 0, 1))[..., :3]
    return np.where(compared[..., None], coloured, ground).astype(np.uint8)


def write_tiles(
    path: Path | str, rows: Sequence[Mapping[str, Picture]], names: Sequence[str] = (), **more: Any
) -> None:
    """Write what `tiled` returns, which takes the same arguments, as PNG."""
    write_png(path, tiled(rows, names, **more))


def tiled(
    rows: Sequence[Mapping[str, Picture]],
    names: Sequence[str] = (),
    *,
    legend: Mapping[str, str] | None = None,
    scale: ErrorScale | None = None,
    height_px: int = 420,
) -> Picture:
    """Return pictures (h, w, 3) by their headings, row by row, as one picture.

    A row's headings are written where they differ from those of the row above. names: a line over each row,
    or none. legend: web colour by what it means. scale: of the error maps among them. height_px: of a picture
    at most; larger ones are shrunk.
    """
    if not rows or (names and len(names) != len(rows)):
        raise BadInput("tiles: expected at least one row, and a name for every row or for none")
    shrunk = [{title: _shrunk(picture, height_px) for title, picture in row.items()} for row in rows]
    sizes = [[picture.shape[:2] for picture in row.values()] for row in shrunk]
    widths = [max(row[k][1] for row in sizes if k < len(row)) for k in range(max(map(len, sizes)))]
    lefts = np.concatenate([[0], np.cumsum(np.array(widths) + _GAP_PX)[:-1]])
    zoom = max(1.0, (lefts[-1] + widths[-1]) / _PAGE_PX)
    line, top = round(_LINE_PX * zoom), 0
    texts: list[_Text] = []
    places: list[tuple[int, int, Picture]] = []
    for i, row in enumerate(shrunk):
        if names:
            top += round(_GAP_PX * zoom) if i else 0
            texts.append(_Text(x=0, y=top + line / 2, text=names[i], side="left"))
            top += line
        if i == 0 or list(row) != list(shrunk[i - 1]):
            middles = [(left + width / 2) for left, width in zip(lefts, widths, strict=True)]
            texts += [_Text(x=x, y=top + line / 2, text=t) for x, t in zip(middles, row, strict=False)]
            top += line
        places += [(top, int(left), picture) for left, picture in zip(lefts, row.values(), strict=False)]
        top += max(height for height, _ in sizes[i]) + _GAP_PX
    below = line * (bool(legend) + bool(scale))
    width = max(int(lefts[-1]) + widths[-1], _SCALE_PX if below else 0)
    canvas = np.full((top + below, width, 3), 255, np.uint8)
    for y, x, picture in places:
        canvas[y : y + picture.shape[0], x : x + picture.shape[1]] = picture
    if legend:
        texts += _paint_legend(canvas, legend, top + line / 2, zoom)
    if scale is not None:
        texts += _paint_scale(canvas, scale, top + below - line / 2, zoom)
    return _lettered(canvas, texts, zoom)


def _shrunk(picture: Picture, height_px: int) -> Picture:
    height, width = picture.shape[:2]
    return resized_image(picture, max(1, round(max(height, width) * min(1.0, height_px / height))))


def _letters(size: float) -> ImageFont.FreeTypeFont:
    """Matplotlib's letters: Pillow's own lack ≥, and the Greek and Cyrillic of file names."""
    from matplotlib import get_data_path

    return ImageFont.truetype(Path(get_data_path(), "fonts", "ttf", "DejaVuSans.ttf"), size)


def _lettered(canvas: Picture, texts: Sequence[_Text], zoom: float) -> Picture:
    picture = Image.fromarray(canvas)
    pen, font = ImageDraw.Draw(picture), _letters(_LETTER_PX * zoom)
    anchors = {"left": "lm", "center": "mm", "right": "rm"}
    for each in texts:
        pen.text((each.x, each.y), each.text, fill=INK, font=font, anchor=anchors[each.side])
    return np.asarray(picture)


def _paint_legend(canvas: Picture, legend: Mapping[str, str], y: float, zoom: float) -> list[_Text]:
    """Paint a swatch for each entry; return the entries' texts."""
    from matplotlib.colors import to_rgb

    step = min(canvas.shape[1] / len(legend), _ENTRY_PX * zoom)
    side, top = round(_SWATCH_PX * zoom), round(y - _SWATCH_PX * zoom / 2)
    texts = []
    for i, (name, colour) in enumerate(legend.items()):
        left = round(i * step)
        canvas[top : top + side, left : left + side] = 130  # a rim, for white on white
        inner = np.array(to_rgb(colour)) * 255
        canvas[top + 1 : top + side - 1, left + 1 : left + side - 1] = inner.astype(np.uint8)
        texts.append(_Text(x=left + 1.5 * side, y=y, text=name, side="left"))
    return texts


def _paint_scale(canvas: Picture, scale: ErrorScale, y: float, zoom: float) -> list[_Text]:
    """Paint the colours from 0 to the most, at the right; return the texts at either end."""
    long = round(min(_SCALE_PX * zoom, 0.4 * canvas.shape[1]))
    thick, right = round(_SWATCH_PX * zoom), round(canvas.shape[1] - 60 * zoom)
    steps = np.linspace(0, scale.most, long)[None].repeat(thick, axis=0)
    top = round(y - thick / 2)
    everywhere = np.ones(steps.shape, dtype=bool)
    canvas[top : top + thick, right - long : right] = picture_of_errors(steps, everywhere, scale)
    return [
        _Text(x=right - long - 6 * zoom, y=y, text=f"error  0{scale.unit}", side="right"),
        _Text(x=right + 6 * zoom, y=y, text=f"≥ {scale.most:g}{scale.unit}", side="left"),
    ]


def row_of_frame(
    frame: LinearFrame,
    normal_map: NormalMap,
    depth_map: DepthMap,
    camera: Camera,
    truth: NormalMap,
    scale: ErrorScale,
) -> dict[str, Picture]:
    """Return the pictures (h, w, 3) by their headings, cut to the mask of the normals; errors in degrees."""
    from vntoolkit.evaluation.angular_error import angular_error_map

    errors, compared = angular_error_map(normal_map, truth)
    pictures = {
        "captured": displayed(frame.rgb),
        "normals": picture_of_normals(normal_map),
        "relief": picture_of_depth(depth_map, camera),
        "error of the normals": picture_of_errors(errors, compared, scale),
    }
    cut = cropped(list(pictures.values()), normal_map.mask)
    return dict(zip(pictures, cut, strict=True))
