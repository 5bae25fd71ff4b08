"""The pose of what touches a gel in every frame of a reconstruction, as a table."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np

from vntoolkit.io.atomic import write_text
from vntoolkit.io.maps_and_meshes.masks import read_mask
from vntoolkit.pipeline.opened_result import OpenedResult, read_result
from vntoolkit.tactile.pose import ObjectPose, Touched, TrackedPose

_COLUMNS = (
    "frame,contact,lost,x_mm,y_mm,z_mm,turn_x_deg,turn_y_deg,turn_z_deg,error_mm,error_deg,unobservable"
)


def write_object_poses(folder: Path, target: Path) -> list[TrackedPose]:
    """Write object.csv into `target`: a line a frame, its place and turn since the first of its contact."""
    result = read_result(folder, says_missing=False)
    tracker = ObjectPose(result.camera)
    poses = {n: tracker(touched) for n in result.frames_to_track if (touched := _touched(result, n))}
    write_text(target / "object.csv", "\n".join([_COLUMNS, *map(_row, poses, poses.values())]) + "\n")
    return list(poses.values())


def _touched(result: OpenedResult, number: int) -> Touched | None:
    depth_map = result.depth(number)
    if depth_map is None or not result.folder.has(number, "normals", "contact"):
        return None
    depth_mm = 1000.0 * depth_map.depth
    error_mm = None
    if depth_map.error_percent is not None and depth_map.mask.any():
        error_mm = depth_map.error_percent * (0.01 * np.ptp(depth_mm[depth_map.mask]))
    touched: Touched = SimpleNamespace(
        normals=result.normals(number).normals_in_camera,
        depth_mm=depth_mm,
        contact=read_mask(result.folder.file("contact", number)),
        error_mm=error_mm,
    )
    return touched


def _row(number: int, pose: TrackedPose) -> str:
    motion = pose.now_from_first
    values = (*motion.translation, *np.degrees(motion.rotation_vector), pose.error_mm, pose.error_deg)
    numbers = ",".join(f"{value:.4f}" for value in values)
    return f"{number},{pose.contact},{int(pose.lost)},{numbers},{len(pose.unobservable)}"
