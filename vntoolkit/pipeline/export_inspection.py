"""What an inspector wants of every frame: heights, local shape, curvature, a profile, roughness."""

import csv
import io
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
from vntoolkit.options.export import ExportFormat, ExportOptions
from vntoolkit.pipeline.export import FrameExport
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.pipeline.tracked_folder import Tracks

_MM = 1000.0  # per metre
_UM = 1000.0  # per millimetre
_FULL = 65535  # of a 16-bit picture, whose 0 says that nothing is measured


class Inspected(FrameExport):
    """Files of heights in millimetres; of a result without a scale, in widths of a pixel on the subject."""

    made_from, needs = ("normals", "depth"), "depth"
    has_lengths = False  # of those that --units tells

    def __init__(self, result: OpenedResult, track: Tracks | None, options: ExportOptions) -> None:
        super().__init__(result, track, options)
        self.suffix = {
            ExportFormat.HEIGHTS: ".png",
            ExportFormat.PROFILE: ".csv",
            ExportFormat.ROUGHNESS: ".json",
            ExportFormat.SUR: ".sur",
            ExportFormat.X3P: ".x3p",
        }.get(options.to, ".exr")
        self.unit, self.factor = self._unit_and_factor()

    def _unit_and_factor(self) -> tuple[str, float]:
        unit, scale = self.result.length_unit, self.options.scale
        if unit is LengthUnit.METRE and scale is not None:
            raise BadInput("scale: the result has lengths in metres already; leave out --scale")
        if unit is LengthUnit.METRE or scale is not None:
            return "mm", _MM * (1.0 if scale is None else scale)
        if self.options.to in (ExportFormat.SUR, ExportFormat.X3P):
            raise BadInput(
                f"{self.options.to.value}: its lengths are micrometres and the result has no scale; give "
                "--scale METRES for a length of 1, or reconstruct with --distance"
            )
        return "px", float(self.result.camera.matrix[0, 0]) if unit is LengthUnit.FREE else 1.0

    def write(self, out: Path, number: int) -> None:
        """Write the file of a frame."""
        path, depth_map = self.place(out, number), self.result.depth(number)
        assert depth_map is not None
        if self.options.to is ExportFormat.CURVATURE:
            return self._write_curvature(path, depth_map, number)
        heights = heights_from_depth(depth_map, self.result.camera, factor=self.factor)
        part = heights.part(longest=self.options.longest, shortest=self.options.shortest)
        match self.options.to:
            case ExportFormat.HEIGHTS:
                self._write_picture(path, part)
            case ExportFormat.LOCAL_SHAPE:
                write_png(path.with_suffix(".png"), signed_picture(part.heights, part.mask))
                values = np.where(part.mask, part.heights, np.nan).astype(np.float32)
                write_exr(path, {"height": values}, attributes=self._stated(part))
            case ExportFormat.PROFILE:
                self._write_profile(path, part)
            case ExportFormat.ROUGHNESS:
                from vntoolkit.inspection.roughness import roughness

                values_by_name = {name: round(value, 9) for name, value in roughness(part).items()}
                atomic.write_text(path, json.dumps({"unit": self.unit, **values_by_name}, indent=1) + "\n")
            case _:
                from vntoolkit.inspection.roughness import surface_file

                atomic.write_bytes(path, surface_file(part, self.suffix[1:], micrometres=_UM))
        return None

    def _stated(self, part: HeightMap) -> dict[str, str]:
        return {"vntoolkit.lengthUnit": self.unit, "vntoolkit.pitch": "{:.9g} {:.9g}".format(*part.pitch)}

    def _write_curvature(self, path: Path, depth_map: DepthMap, number: int) -> None:
        normal_map, camera = self.result.normals(number), self.result.camera
        mask, normals = depth_map.mask & normal_map.mask, normal_map.normals_in_camera
        points = self.factor * camera.points_from_depth(np.where(depth_map.mask, depth_map.depth, np.nan))
        if self.options.shortest is not None:
            grid = heights_from_depth(replace(depth_map, mask=mask), camera, factor=self.factor)
            deviations = grid.deviations_px(self.options.shortest)
            parts: list[FloatArray] = [
                regression_filtered(normals[..., k], mask, deviations) for k in range(3)
            ]
            smooth = np.stack(parts, axis=-1)
            normals = smooth / np.maximum(np.linalg.norm(smooth, axis=-1, keepdims=True), 1e-12)
        mean, gaussian, known = curvature(points, normals, mask)
        write_png(path.with_suffix(".png"), signed_picture(mean, known))
        planes = {
            name: np.where(known, values, np.nan).astype(np.float32)
            for name, values in (("mean", mean), ("gaussian", gaussian))
        }
        write_exr(path, planes, attributes={"vntoolkit.lengthUnit": self.unit})

    def _write_picture(self, path: Path, part: HeightMap) -> None:
        """Write heights from 1 to 65535, and beside them what these mean."""
        least, most = (float(bound(part.heights[part.mask])) for bound in (np.min, np.max))
        share = (part.heights - least) / ((most - least) or 1.0)
        stored = np.where(part.mask, np.rint(1.0 + share * (_FULL - 1)), 0).astype(np.uint16)
        told = {
            "unit": self.unit,
            "height_at_1": least,
            "height_at_65535": most,
            "not_measured": 0,
            "pitch": part.pitch,
        }
        atomic.write_text(path.with_suffix(".json"), json.dumps(told, indent=1) + "\n")
        write_png(path, stored)

    def _write_profile(self, path: Path, part: HeightMap) -> None:
        line = self.options.line
        assert line is not None  # the options ask for it
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow([f"distance_{self.unit}", f"height_{self.unit}"])
        rows.writerows(
            [f"{length:.9g}", f"{height:.9g}" if np.isfinite(height) else ""]
            for length, height in zip(*part.along(line[:2], line[2:]), strict=True)
        )
        atomic.write_text(path, text.getvalue())
