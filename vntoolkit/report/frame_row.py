"""One frame as a row of tiles: captured, normals, relief, and the error where the truth is known."""

from __future__ import annotations

from vntoolkit.evaluation.angular_error import angular_error_map
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.report.pictures import Picture, cropped, displayed, picture_of_depth, picture_of_normals
from vntoolkit.report.tiles import ErrorScale, picture_of_errors


def row_of_frame(
    frame: LinearFrame,
    normal_map: NormalMap,
    depth_map: DepthMap,
    camera: Camera,
    truth: NormalMap,
    scale: ErrorScale,
) -> dict[str, Picture]:
    """Return the pictures (h, w, 3) by their headings, cut to the mask of the normals; errors in degrees."""
    errors, compared = angular_error_map(normal_map, truth)
    pictures = {
        "captured": displayed(frame.rgb),
        "normals": picture_of_normals(normal_map),
        "relief": picture_of_depth(depth_map, camera),
        "error of the normals": picture_of_errors(errors, compared, scale),
    }
    cut = cropped(list(pictures.values()), normal_map.mask)
    return dict(zip(pictures, cut, strict=True))
