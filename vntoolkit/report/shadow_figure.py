"""Pictures of self-shadows: detection (as Figure 4 of brostow2011) and errors (Figure 5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.io.maps_and_meshes.label_images import label_colours
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.report.pictures import Picture, cropped, displayed, picture_of_normals, short_label, web_colour
from vntoolkit.report.raycast_view import View, picture_of
from vntoolkit.report.tiles import ErrorScale, picture_of_errors, write_tiles

_SCALE = ErrorScale(most=40.0)
_GROUND = 205  # beside the subject: white means lit by all
_LIGHT_TILES = 4  # film and three lights


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
    """Write film, the share of each light, and below the labels of every method by name, with a legend."""
    contributions = np.clip(frame.rgb - response.ambient, 0, None) @ response.contributions_from_rgb.T
    top = np.maximum(np.percentile(contributions[mask], 99, axis=0), 1e-6) if mask.any() else np.ones(3)
    tiles = {"film": displayed(frame.rgb)}
    for k in range(3):
        share = np.clip(contributions[..., k : k + 1] / top[k], 0, 1)
        tiles[f"light {k}"] = displayed(np.repeat(share, 3, axis=-1))
    for name, found in labels.items():
        tiles[name] = np.where(mask[..., None], label_colours(found), _GROUND).astype(np.uint8)
    cut = dict(zip(tiles, cropped(list(tiles.values()), mask, 0), strict=True))
    first = dict(list(cut.items())[:_LIGHT_TILES])
    legend = {short_label(label): web_colour(label) for label in _used(labels, mask)}
    write_tiles(path, [first, {name: cut[name] for name in cut if name not in first}], legend=legend)


def write_recovery_figure(
    path: Path | str,
    recoveries: Mapping[str, Recovery],
    camera: Camera,
    truth: NormalMap | None = None,
) -> None:
    """Write normals, a view of the surface from the side, and the error of each way of `recoveries`."""
    rows: list[dict[str, Picture]] = []
    names = []
    for name, recovery in recoveries.items():
        mask = recovery.normals.mask
        normals = cropped([picture_of_normals(recovery.normals)], mask, 0)[0]
        height, width = normals.shape[:2]
        row = {
            "normals": normals,
            "surface from the side": _seen_from_the_side(recovery.depth, camera, width, height),
        }
        mean = ""
        if truth is not None:
            both = mask & truth.mask
            cosine = (recovery.normals.normals_in_camera * truth.normals_in_camera).sum(-1)
            error = np.where(both, np.rad2deg(np.arccos(np.clip(cosine, -1, 1))), 0.0)
            row["error of the normals"] = cropped([picture_of_errors(error, both, _SCALE)], mask, 0)[0]
            mean = f": mean error {error[both].mean():.1f}°"
        rows.append(row)
        names.append(f"{name}{mean}")
    write_tiles(path, rows, names, scale=None if truth is None else _SCALE)


def _used(labels: Mapping[str, VisibilityLabels], mask: Mask) -> list[int]:
    return sorted({int(label) for found in labels.values() for label in np.unique(found[mask])})


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
