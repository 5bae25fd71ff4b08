"""Errors of a reconstruction of simulated footage."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from vntoolkit.arrays import FloatArray
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.angular_error import AngularError, compare_normals
from vntoolkit.evaluation.depth_error import DepthError, compare_depths
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.io.maps_and_meshes.maps import read_depth_map, read_normal_map
from vntoolkit.io.rigs import read_rig
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.response import LightResponse
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.pipeline.simulate import SimulationFolder


@dataclass(frozen=True, kw_only=True)
class FrameComparison:
    """One frame against the truth. depth: None where the result holds none."""

    number: int
    normals: AngularError
    depth: DepthError | None


def compare_with_truth(
    result: OpenedResult, simulated: Path, numbers: Sequence[int] | None = None
) -> Iterator[FrameComparison]:
    """Yield frames of a result against the truth in the folder that `simulate` wrote, one at a time.

    numbers: of the frames, None for all. Raises `BadInput` where that folder holds no truth for a frame.
    """
    for number in numbers or result.numbers:
        depth, normals = result.depth(number), result.normals(number)
        of_depth = None
        if depth is not None:
            of_depth = compare_depths(depth, true_depth(simulated, number), result.camera)
        of_normals = compare_normals(normals, true_normals(simulated, number))
        yield FrameComparison(number=number, normals=of_normals, depth=of_depth)


def true_normals(simulated: Path, number: int) -> NormalMap:
    """Read the true normals of a simulated frame."""
    return read_normal_map(_truth_file(simulated, "normals", number))


def true_depth(simulated: Path, number: int) -> DepthMap:
    """Read the true depth of a simulated frame, metres."""
    return read_depth_map(_truth_file(simulated, "depth", number))


def light_errors_deg(response: LightResponse, simulated: Path) -> FloatArray:
    """Return (3,) the angles in degrees between the rows of M, channel by channel, and the true ones."""
    truth = read_rig(SimulationFolder(root=simulated).truth / "rig.json").response
    return angles_deg(response.matrix, truth.matrix)


def _truth_file(simulated: Path, kind: str, number: int) -> Path:
    path = SimulationFolder(root=simulated).map_file(kind, number)
    if not path.exists():
        raise BadInput(f"{path}: the simulated capture holds no truth for frame {number}")
    return path
