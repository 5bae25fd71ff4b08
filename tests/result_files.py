"""Whole moving meshes written, true flow and point clouds read, for the tests of what a run writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vntoolkit.arrays import Flow
from vntoolkit.geometry.mesh import MeshSequence
from vntoolkit.geometry.point_cloud import PointCloud
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.maps_and_meshes.exr import read_exr
from vntoolkit.io.results.sequences import MeshSequenceWriter
from vntoolkit.libraries import import_open3d


def write_mesh_sequence(folder: Path | str, sequence: MeshSequence) -> None:
    """Write a whole moving mesh."""
    with MeshSequenceWriter(folder, sequence.template, frame_rate_hz=sequence.frame_rate_hz) as writer:
        for frame in range(len(sequence)):
            uncertain = None if sequence.uncertainty_px is None else sequence.uncertainty_px[frame]
            writer.append(sequence.vertices[frame], uncertain)


def read_flow(path: Path | str) -> Flow:
    """Read optical flow (h, w, 2) in pixels from the channels du, dv of an EXR."""
    channels, _ = read_exr(path)
    return np.stack([channels["du"], channels["dv"]], axis=-1).astype(np.float32)


def read_point_cloud(path: Path | str) -> PointCloud:
    """Read the vertices of a PLY, with normals and colours, into the camera frame: by Open3D."""
    cloud = import_open3d().io.read_point_cloud(str(path))
    return PointCloud(
        points=graphics_from_camera(np.asarray(cloud.points)),
        normals=graphics_from_camera(np.asarray(cloud.normals)),
        colours=np.asarray(cloud.colors, dtype=np.float32),
    )
