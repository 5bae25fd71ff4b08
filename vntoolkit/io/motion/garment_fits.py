"""The JSON file that corrects the fit of a garment: metres, degrees, y up."""

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, FiniteFloat
from scipy.spatial.transform import Rotation

from vntoolkit.geometry.garment_fit import GarmentFit, Landmark
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.files import read_json
from vntoolkit.io.rigs import Entry

_Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
_EXPECTED = "a JSON file that corrects how a garment sits"
_ZERO: _Triple = (0.0, 0.0, 0.0)


class _Landmark(Entry):
    vertex: int = Field(ge=0)
    joint: str
    offset_m: _Triple = _ZERO


class _Fit(Entry):
    version: Literal[1]
    scale: FiniteFloat = Field(default=1.0, gt=0)
    rotation_deg: _Triple = _ZERO
    translation_m: _Triple = _ZERO
    landmarks: tuple[_Landmark, ...] = ()
    pose_deg: dict[str, _Triple] = Field(default_factory=dict)
    bind_frame: int | None = Field(default=None, ge=0)


def read_garment_fit(path: Path | str) -> GarmentFit:
    """Read a fit file into camera axes; angles turn about x, then y, then z. Raises `BadInput`."""
    fit = _Fit.read(read_json(path, expected=_EXPECTED), str(path))
    turn = graphics_from_camera(np.eye(3))
    return GarmentFit(
        scale=fit.scale,
        adjustment=RigidTransform(
            rotation=turn @ Rotation.from_euler("xyz", fit.rotation_deg, degrees=True).as_matrix() @ turn,
            translation=turn @ np.array(fit.translation_m),
        ),
        landmarks=tuple(
            Landmark(vertex=mark.vertex, joint=mark.joint, offset=turn @ np.array(mark.offset_m))
            for mark in fit.landmarks
        ),
        pose={
            joint: Rotation.from_euler("xyz", graphics_from_camera(np.array(angles)), degrees=True).as_quat()
            for joint, angles in fit.pose_deg.items()
        },
        bind_frame=fit.bind_frame,
    )
