"""Maps as pictures for people: normals in their usual colours, depth as a lit relief, shadows by light."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.io.images import resized_image
from vntoolkit.io.label_images import label_colours

Picture = npt.NDArray[np.uint8]
GROUND = 255  # grey value where a map is invalid
_LIGHT = np.array([-0.45, -0.55, -0.70])  # from the surface: left, above, before it
_AMBIENT = 0.10
_PLASTER = 0.78
_DISPLAY_GAMMA = 1 / 2.2


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


def strip_of(pictures: list[Picture], height_px: int, gap_px: int = 6, ground: int = GROUND) -> Picture:
    """Set pictures of one size side by side, shrunk to at most `height_px`, with gaps."""
    height, width = pictures[0].shape[:2]
    largest = round(max(height, width) * min(1.0, height_px / height))
    shrunk = [resized_image(picture, largest) for picture in pictures]
    gap = np.full((shrunk[0].shape[0], gap_px, 3), ground, np.uint8)
    cells = [cell for picture in shrunk for cell in (gap, picture)]
    return np.concatenate(cells[1:], axis=1)
