"""What an inspector wants of every frame: heights, local shape, curvature, a profile, roughness."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import DepthMap, LengthUnit
from vntoolkit.inspection.curvature import curvature, signed_picture
from vntoolkit.inspection.heights import HeightMap, heights_from_depth, regression_filtered
from vntoolkit.io import atomic
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.exr import write_exr
from vntoolkit.options.export import ExportFormat
from vntoolkit.pipeline.export import ExportSource, FrameFormat

_MM = 1000.0  # per metre
_UM = 1000.0  # per millimetre
_FULL = 65535  # of a 16-bit picture, whose 0 says that nothing is measured


def inspection_format(source: ExportSource) -> FrameFormat:
    """Return how frames are written; raise `BadInput` where lengths are asked for that are not known."""
    unit_and_factor(source)
    suffixes = {
        ExportFormat.HEIGHTS: ".png",
        ExportFormat.PROFILE: ".csv",
        ExportFormat.ROUGHNESS: ".json",
        ExportFormat.SUR: ".sur",
        ExportFormat.X3P: ".x3p",
    }
    suffix = suffixes.get(source.options.to, ".exr")
    return FrameFormat(write=_write, suffix=suffix, made_from=("normals", "depth"), needs="depth")


def unit_and_factor(source: ExportSource) -> tuple[str, float]:
    """Return the unit, mm or without a scale the width of a pixel on the subject, and lengths in it."""
    unit, scale, to = source.result.length_unit, source.options.scale, source.options.to
    if unit is LengthUnit.METRE and scale is not None:
        raise BadInput("scale: the result has lengths in metres already; leave out --scale")
    if unit is LengthUnit.METRE or scale is not None:
        return "mm", _MM * (1.0 if scale is None else scale)
    if to in (ExportFormat.SUR, ExportFormat.X3P):
        raise BadInput(
            f"{to.value}: its lengths are micrometres and the result has no scale; give "
            "--scale METRES for a length of 1, or reconstruct with --distance"
        )
    return "px", float(source.result.camera.matrix[0, 0]) if unit is LengthUnit.FREE else 1.0


def _write(source: ExportSource, path: Path, number: int) -> None:
    """Write the file of a frame."""
    options, depth_map = source.options, source.result.depth(number)
    assert depth_map is not None
    if options.to is ExportFormat.CURVATURE:
        return _write_curvature(source, path, depth_map, number)
    unit, factor = unit_and_factor(source)
    heights = heights_from_depth(depth_map, source.result.camera, factor=factor)
    part = heights.part(longest=options.longest, shortest=options.shortest)
    match options.to:
        case ExportFormat.HEIGHTS:
            _write_picture(path, part, unit)
        case ExportFormat.LOCAL_SHAPE:
            write_png(path.with_suffix(".png"), signed_picture(part.heights, part.mask))
            values = np.where(part.mask, part.heights, np.nan).astype(np.float32)
            pitch = "{:.9g} {:.9g}".format(*part.pitch)
            stated = {"vntoolkit.lengthUnit": unit, "vntoolkit.pitch": pitch}
            write_exr(path, {"height": values}, attributes=stated)
        case ExportFormat.PROFILE:
            assert options.line is not None  # the options ask for it
            lengths, values = part.along(options.line[:2], options.line[2:])
            known = ("" if np.isnan(value) else f"{value:.9g}" for value in values)
            rows = [f"{length:.9g},{value}" for length, value in zip(lengths, known, strict=True)]
            atomic.write_text(path, "\n".join([f"distance_{unit},height_{unit}", *rows]) + "\n")
        case ExportFormat.ROUGHNESS:
            from vntoolkit.inspection.roughness import roughness

            values_by_name = {name: round(value, 9) for name, value in roughness(part).items()}
            atomic.write_text(path, json.dumps({"unit": unit, **values_by_name}, indent=1) + "\n")
        case _:
            from vntoolkit.inspection.roughness import surface_file

            atomic.write_bytes(path, surface_file(part, path.suffix[1:], micrometres=_UM))
    return None


def _write_curvature(source: ExportSource, path: Path, depth_map: DepthMap, number: int) -> None:
    normal_map, camera = source.result.normals(number), source.result.camera
    unit, factor = unit_and_factor(source)
    mask, normals = depth_map.mask & normal_map.mask, normal_map.normals_in_camera
    points = factor * camera.points_from_depth(np.where(depth_map.mask, depth_map.depth, np.nan))
    if source.options.shortest is not None:
        grid = heights_from_depth(replace(depth_map, mask=mask), camera, factor=factor)
        deviations = grid.deviations_px(source.options.shortest)
        parts: list[FloatArray] = [regression_filtered(normals[..., k], mask, deviations) for k in range(3)]
        smooth = np.stack(parts, axis=-1)
        normals = smooth / np.maximum(np.linalg.norm(smooth, axis=-1, keepdims=True), 1e-12)
    mean, gaussian, known = curvature(points, normals, mask)
    write_png(path.with_suffix(".png"), signed_picture(mean, known))
    planes = {
        name: np.where(known, values, np.nan).astype(np.float32)
        for name, values in (("mean", mean), ("gaussian", gaussian))
    }
    write_exr(path, planes, attributes={"vntoolkit.lengthUnit": unit})


def _write_picture(path: Path, part: HeightMap, unit: str) -> None:
    """Write heights from 1 to 65535, and beside them what these mean."""
    least, most = (float(bound(part.heights[part.mask])) for bound in (np.min, np.max))
    share = (part.heights - least) / ((most - least) or 1.0)
    stored = np.where(part.mask, np.rint(1.0 + share * (_FULL - 1)), 0).astype(np.uint16)
    told = {
        "unit": unit,
        "height_at_1": least,
        "height_at_65535": most,
        "not_measured": 0,
        "pitch": part.pitch,
    }
    atomic.write_text(path.with_suffix(".json"), json.dumps(told, indent=1) + "\n")
    write_png(path, stored)
