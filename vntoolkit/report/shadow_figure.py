"""Pictures of self-shadows: how they were found (like Figure 4 of brostow2011), what they cost (Figure 5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.io.images import write_png
from vntoolkit.io.label_images import LABEL_LEGEND, label_colours
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.report.pictures import Picture, picture_of_normals
from vntoolkit.report.raycast_view import View, picture_of

_DISPLAY_GAMMA = 1 / 2.2
_FULL_ERROR_DEG = 40.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Recovery:
    """One way of dealing with shadows: the normals and the depth that came of it."""

    normals: NormalMap
    depth: DepthMap


def write_detection_figure(
    path: Path | str,
    frame: LinearFrame,
    response: LightResponse,
    labels: Mapping[str, VisibilityLabels],
    mask: Mask,
) -> None:
    """Write film, the share of each light, and the labels of every method by name, with their legend."""
    contributions = np.clip(frame.rgb - response.ambient, 0, None) @ response.contributions_from_rgb.T
    top = np.maximum(np.percentile(contributions[mask], 99, axis=0), 1e-6) if mask.any() else np.ones(3)
    tiles = {"film": _displayed(frame.rgb)}
    for k in range(3):
        share = np.clip(contributions[..., k : k + 1] / top[k], 0, 1)
        tiles[f"light {k}"] = _displayed(np.repeat(share, 3, axis=-1))
    for name, found in labels.items():
        tiles[name] = np.where(mask[..., None], label_colours(found), 0).astype(np.uint8)
    legend = {name: _web_colour(label) for label, name in _used(labels, mask)}
    _write_tiles(path, {name: _cropped(tile, mask) for name, tile in tiles.items()}, columns=4, legend=legend)


def write_recovery_figure(
    path: Path | str,
    recoveries: Mapping[str, Recovery],
    camera: Camera,
    truth: NormalMap | None = None,
) -> None:
    """Write normals, a view of the surface from the side, and the error (black 0, white 40°) of each way."""
    tiles: dict[str, Picture] = {}
    for name, recovery in recoveries.items():
        mask = recovery.normals.mask
        tiles[f"{name}: normals"] = _cropped(picture_of_normals(recovery.normals, ground=0), mask)
        height, width = tiles[f"{name}: normals"].shape[:2]
        tiles[f"{name}: from the side"] = _seen_from_the_side(recovery.depth, camera, width, height)
        if truth is not None:
            both = mask & truth.mask
            cosine = (recovery.normals.normals_in_camera * truth.normals_in_camera).sum(-1)
            error = np.where(both, np.rad2deg(np.arccos(np.clip(cosine, -1, 1))), 0.0)
            grey = np.repeat(np.clip(error / _FULL_ERROR_DEG, 0, 1)[..., None], 3, axis=-1)
            title = f"{name}: error, mean {error[both].mean():.1f}°"
            tiles[title] = _cropped((255 * grey).astype(np.uint8), mask)
    _write_tiles(path, tiles, columns=2 if truth is None else 3, legend={})


def _used(labels: Mapping[str, VisibilityLabels], mask: Mask) -> list[tuple[int, str]]:
    seen = {int(label) for found in labels.values() for label in np.unique(found[mask])}
    return [(label, LABEL_LEGEND[str(label)]) for label in sorted(seen)]


def _web_colour(label: int) -> str:
    return "#" + "".join(f"{channel:02x}" for channel in label_colours(np.uint8(label)))


def _displayed(linear: FloatArray) -> Picture:
    return (255 * np.clip(linear, 0, 1) ** _DISPLAY_GAMMA).astype(np.uint8)


def _cropped(picture: Picture, mask: Mask) -> Picture:
    if not mask.any():
        return picture
    v, u = np.nonzero(mask)
    return picture[v.min() : v.max() + 1, u.min() : u.max() + 1]


def _seen_from_the_side(depth: DepthMap, camera: Camera, width: int, height: int) -> Picture:
    mesh = mesh_from_depth(depth, camera)
    low, high = np.percentile(mesh.vertices, [1, 99], axis=0)
    view = View(
        centre=(low + high) / 2,
        height=1.2 * float(high[1] - low[1]),
        azimuth_deg=-50.0,
        elevation_deg=10.0,
        width_px=width,
        height_px=height,
    )
    return picture_of([mesh], view)


def _write_tiles(
    path: Path | str, tiles: Mapping[str, Picture], columns: int, legend: Mapping[str, str]
) -> None:
    """Lay titled pictures out in rows, with matplotlib, and write one PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    rows = -(-len(tiles) // columns)
    height, width = next(iter(tiles.values())).shape[:2]
    figure = Figure(figsize=(3.2 * columns, (3.2 * height / width + 0.35) * rows + 0.4), dpi=120)
    canvas = FigureCanvasAgg(figure)
    for i, axes in enumerate(figure.subplots(rows, columns, squeeze=False).ravel()):
        axes.set_axis_off()
        if i < len(tiles):
            name = list(tiles)[i]
            axes.imshow(tiles[name])
            axes.set_title(name, fontsize=9)
    if legend:
        patches = [Patch(facecolor=colour, edgecolor="0.5", label=name) for name, colour in legend.items()]
        figure.legend(handles=patches, loc="lower center", ncols=4, fontsize=8, frameon=False)
    figure.tight_layout(rect=(0, 0.07 if legend else 0, 1, 1))
    canvas.draw()
    write_png(path, np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3]))
