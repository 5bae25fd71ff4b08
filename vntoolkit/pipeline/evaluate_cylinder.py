"""Figure 7: normals of a sequence against one fitted cylinder, and the fit against the truth."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from vntoolkit.arrays import FloatArray, Vector3
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.angular_error import compare_normals
from vntoolkit.evaluation.cylinder import Cylinder, axis_error_deg, radius_from_distance, side_angles
from vntoolkit.evaluation.cylinder_fit import CylinderOptions, fit_cylinder
from vntoolkit.evaluation.silhouette import silhouette_from_image
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.files import parse_json, read_text, require_file
from vntoolkit.io.maps_and_meshes.maps import read_normal_map
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.pipeline.simulate import SimulationFolder

logger = logging.getLogger(__name__)
_SEED = 0  # the same folder gives the same numbers


@dataclass(frozen=True, kw_only=True)
class TrueDeviation:
    """One frame against the simulator: of the fit's axis, of its radius, and of all normals."""

    axis_deg: float
    radius_percent: float
    normals_mean_deg: float
    normals_std_deg: float


@dataclass(frozen=True, kw_only=True)
class CylinderFrameError:
    """One frame: angles between its normals and the fitted cylinder's. truth: where it is known."""

    frame: int
    pixels: int
    mean_deg: float
    std_deg: float
    truth: TrueDeviation | None = None


@dataclass(frozen=True, kw_only=True)
class CylinderEvaluation:
    """A sequence: mean and standard deviation over all pixels of all frames; radius as the fit states it."""

    radius: float
    frame_rate_hz: float
    mean_deg: float
    std_deg: float
    frames: tuple[CylinderFrameError, ...]


@dataclass(frozen=True, kw_only=True)
class CylinderTruth:
    """The folder that `simulate` wrote for a cylinder whose axis is the object's y axis."""

    folder: SimulationFolder

    @cached_property
    def poses(self) -> FloatArray:
        """(frames, 4, 4) camera_from_object."""
        path = self.folder.truth / "poses.json"
        content = parse_json(read_text(path), str(path))
        try:
            poses = np.array(content["camera_from_object"], dtype=np.float64)
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"{path}: expected camera_from_object, a 4 × 4 matrix a frame") from error
        require_shape(poses, (None, 4, 4), f"{path}: camera_from_object")
        return poses

    @cached_property
    def radius_m(self) -> float:
        """Radius in metres."""
        path = self.folder.truth / "scene.json"
        content = parse_json(read_text(path), str(path))
        try:
            scene, facts = content["scene"], content["facts"]
            if scene == "cylinder":
                return float(facts["radius_m"])
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"{path}: expected scene, and facts with the radius_m of a cylinder") from error
        raise BadInput(f"{self.folder.root}: holds the scene {scene}, not a cylinder")

    def axis(self, number: int) -> tuple[Vector3, Vector3]:
        """Return direction and a point of the axis in the camera frame, metres."""
        if number >= len(self.poses):
            raise BadInput(
                f"{self.folder.root}: has {len(self.poses)} frames, the reconstruction frame {number}"
            )
        return self.poses[number, :3, 1], self.poses[number, :3, 3]


def evaluate_cylinder(
    result: OpenedResult,
    simulated: Path | None = None,
    options: CylinderOptions | None = None,
    on_frame: Callable[[int], None] = lambda number: None,
) -> CylinderEvaluation:
    """Fit one cylinder to all frames of a reconstruction and measure their normals against it.

    Measured are the pixels that hold a normal, within the silhouette, on the cylinder's side.

    simulated: folder that `simulate` wrote, for the truth. on_frame: told every frame twice, when it is
    fitted and when it is measured. Raises `BadInput`, `SolverFailed` with the frame's place.
    """
    truth = None if simulated is None else CylinderTruth(folder=SimulationFolder(root=simulated))
    fits = fit_cylinder(
        (seen for _, seen in _observations(result, on_frame)),
        result.camera,
        np.random.default_rng(_SEED),
        options,
    )
    frames, total = [], np.zeros(3)
    for cylinder, (number, seen) in zip(fits, _observations(result, on_frame), strict=True):
        normal_map, silhouette = seen
        subject = replace(normal_map, mask=normal_map.mask & (silhouette > 0.5))
        measured = side_angles(cylinder, subject, result.camera, f"frame {number}")
        angles = measured.angles_deg[measured.side]
        total += [len(angles), angles.sum(), (angles**2).sum()]
        frames.append(
            CylinderFrameError(
                frame=number,
                pixels=len(angles),
                mean_deg=float(angles.mean()),
                std_deg=float(angles.std()),
                truth=None if truth is None else _deviation(cylinder, normal_map, truth, result, number),
            )
        )
    mean = total[1] / total[0]
    return CylinderEvaluation(
        radius=fits[0].radius,
        frame_rate_hz=result.manifest.input.playing_rate_hz,
        mean_deg=float(mean),
        std_deg=float(np.sqrt(max(total[2] / total[0] - mean**2, 0.0))),
        frames=tuple(frames),
    )


def _observations(
    result: OpenedResult, on_frame: Callable[[int], None]
) -> Iterator[tuple[int, tuple[NormalMap, FloatArray]]]:
    """Number, normals and silhouette of every frame; without footage the normals' mask is the silhouette."""
    from_image = True
    for number in result.numbers:
        normal_map = _normals(result, number)
        silhouette: FloatArray = normal_map.mask.astype(np.float64)
        if from_image:
            try:
                linear = result.linear(number)
            except BadInput as problem:
                logger.info("the silhouettes are those of the normal maps: %s", problem)
                from_image = False
            else:
                silhouette = silhouette_from_image(linear.rgb)
        yield number, (normal_map, silhouette)
        on_frame(number)


def _normals(result: OpenedResult, number: int) -> NormalMap:
    normal_map = result.normals(number)
    assert normal_map is not None, "a result lists the frames that have normals"
    return normal_map


def _deviation(
    cylinder: Cylinder, normal_map: NormalMap, truth: CylinderTruth, result: OpenedResult, number: int
) -> TrueDeviation:
    direction, point = truth.axis(number)
    true_map = read_normal_map(require_file(truth.folder.map_file("normals", number, ".exr")))
    error = compare_normals(normal_map, true_map)
    radius = radius_from_distance(cylinder, result.camera, point)
    return TrueDeviation(
        axis_deg=axis_error_deg(cylinder, direction),
        radius_percent=100.0 * (radius / truth.radius_m - 1.0),
        normals_mean_deg=error.mean_deg,
        normals_std_deg=error.std_deg,
    )
