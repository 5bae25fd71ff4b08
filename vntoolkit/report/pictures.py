"""Maps as pictures for people: normals in their usual colours, depth as a lit relief, shadows by light."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, LinearImage, Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.io.maps_and_meshes.label_images import label_colours
from vntoolkit.pipeline.opened_result import OpenedResult

Picture = npt.NDArray[np.uint8]
GROUND = 255  # grey value where a map is invalid
_LIGHT = np.array([-0.45, -0.55, -0.70])  # from the surface: left, above, before it
_AMBIENT = 0.10
_PLASTER = 0.78
_DISPLAY_GAMMA = 1 / 2.2


def displayed(linear: FloatArray | LinearImage) -> Picture:
    """Return linear light (h, w, 3), full scale 1, as a screen shows it."""
    return (255 * np.clip(linear, 0, 1) ** _DISPLAY_GAMMA).astype(np.uint8)


def sampled(numbers: tuple[int, ...], count: int) -> tuple[int, ...]:
    """Return at most `count` of the frame numbers, evenly spread, the first and the last among them."""
    places = np.linspace(0, len(numbers) - 1, min(count, len(numbers))).round().astype(int)
    return tuple(numbers[place] for place in dict.fromkeys(places.tolist()))


def pictures_of_frame(
    result: OpenedResult, number: int, *, ground: int, beside_normals: int, beside_labels: int | None = None
) -> dict[str, Picture]:
    """Return what there is of a frame: captured, normals, depth (as relief) and shadows, by these names.

    ground: grey value where a map is invalid; beside_normals, beside_labels: for those, default as for all.
    """
    normal_map, depth_map = result.normals(number), result.depth(number)
    labels, captured = result.labels(number), result.picture(number)
    pictures: dict[str, Picture] = {} if captured is None else {"captured": captured}
    if normal_map is not None:
        pictures["normals"] = picture_of_normals(normal_map, ground=beside_normals)
    if depth_map is not None:
        pictures["depth"] = picture_of_depth(depth_map, result.camera, ground=ground)
    if labels is not None:
        mask = None if normal_map is None else normal_map.mask
        beside = ground if beside_labels is None else beside_labels
        pictures["shadows"] = picture_of_labels(labels, mask, ground=beside)
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
    grey = 255 * np.clip(_PLASTER * brightness, 0, 1) ** _DISPLAY_GAMMA
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
    if not mask.any():
        return pictures
    v, u = np.nonzero(mask)
    rows = slice(max(0, v.min() - margin_px), v.max() + 1 + margin_px)
    columns = slice(max(0, u.min() - margin_px), u.max() + 1 + margin_px)
    return [picture[rows, columns] for picture in pictures]
