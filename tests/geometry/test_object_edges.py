"""Objects of geometry and photometry refuse what they cannot be: one table of calls and lines."""

import re

import numpy as np
import pytest

import vntoolkit as vt
from vntoolkit.errors import BadInput, BadMesh, BadMotion, BadRig
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.garment_fit import fit_similarity
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.geometry.motion import Skeleton
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.normals.photometric_stereo import normals_from_lights
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.gel import TERMS, GelResponse
from vntoolkit.photometry.response import LightResponse, ResponseVariation
from vntoolkit.photometry.transfer import Transfer, linear_from_integers
from vntoolkit.pipeline.smoothing import smoothed_over_time

NAN, UNKNOWN = np.nan, np.full((3, 3), np.nan)
SIZE = {"width": 64, "height": 48}
TRIANGLE = np.array([[0, 1, 2]])
POINT = np.zeros((1, 3))
LINE = np.outer(np.arange(4.0), [1, 2, 3])
FACING = np.tile(np.float32([0.6, 0.0, -0.8]), (24, 32, 1))
MASK = np.ones((24, 32), bool)
LIGHTS = np.array([[0.4, 0.0, -0.9], [-0.2, 0.35, -0.9], [-0.2, -0.35, -0.9]])
IN_ONE_PLANE = np.array([[1, 0, 0], [0, 1, 0], [0.7, 0.7, 0.0]])
IMAGES = np.full((3, 4, 5), 0.5)
SHADED = np.clip(FACING @ LIGHTS.T, 0, None).transpose(2, 0, 1)
PINHOLE = Camera.pinhole(**SIZE, focal_px=9.0)


def pinhole(matrix, **more):
    return Camera(model=CameraModel.PINHOLE, width=4, height=4, matrix=matrix, **more)


def lens(count):
    return Camera.from_matrix(np.diag([80.0, 80, 1]), **SIZE, distortion=[0.1] * count)


def mesh(vertices=None, faces=TRIANGLE, **more):
    return Mesh(vertices=np.eye(3) if vertices is None else vertices, faces=faces, **more)


def skeleton(names, parents):
    return Skeleton(names=tuple(names), parents=np.array(parents), offsets=np.zeros((len(names), 3)))


def variation(powers, scale_px=1.0):
    known = {"matrices": np.zeros((1, 3, 3)), "ambients": np.zeros((1, 3)), "centre_px": np.zeros(2)}
    return ResponseVariation(powers=np.array(powers), scale_px=scale_px, **known)


def gel(**changed):
    parts = {"coefficients": np.zeros((TERMS, 2)), "centre_px": np.zeros(2), "scale_px": 40.0, "reach": 0.5}
    return GelResponse(**parts | changed)


def smoothed(sameness):
    return smoothed_over_time(*(np.full((1, 1, 3), value, np.uint8) for value in (10, 20, 30)), 8, sameness)


VIEW = Rectification(corners_px=(0, 0, 9, 0, 0, 9, 9, 9), width_mm=9, height_mm=9, pixel_mm=1)
REFUSALS = [
    (lambda: pinhole(np.zeros((3, 3))), BadInput, "positive focal"),
    (lambda: pinhole(np.diag([9.0, 9, 2])), BadInput, r"0, 0, 1 in its last row, got \[0\.0, 0\.0, 2\.0\]"),
    (lambda: pinhole(np.eye(3), distortion=[0.1, 0, 0, 0]), BadInput, "no distortion"),
    (lambda: Camera.pinhole(**SIZE, focal_px=(1, 2, 3)), BadInput, "one focal length, or f_x and f_y, got 3"),
    (lambda: PINHOLE.points_from_depth(np.ones((64, 48))), BadInput, "expected shape 48 × 64"),
    (lambda: lens(6), BadInput, "got 6 numbers; calibrate"),
    (lambda: lens(12), BadInput, "got 12 numbers, those of a thin prism"),
    (lambda: lens(14), BadInput, "a tilted sensor"),
    (lambda: mesh(faces=np.array([[0, 1, 3]])), BadMesh, "outside the 3 vertices"),
    # An index beyond 32 bits does not wrap round.
    (lambda: mesh(faces=np.array([[0, 1, 2**32 + 2]])), BadMesh, "outside the 3 vertices"),
    (lambda: mesh(np.eye(3) * NAN), BadMesh, "NaN"),
    (lambda: mesh(colours=[[0, 0, 1.0]] * 2), BadMesh, "colours: expected shape 3 × 3, got 2 × 3"),
    (lambda: MeshSequence(template=mesh(), vertices=np.zeros((2, 5, 3))), BadMesh,
     "moving vertices: expected shape any × 3 × 3"),
    (lambda: NormalMap(normals_in_camera=FACING * [1, -1, -1], mask=MASK), BadInput,
     r"n_z > 0 in 100% of the pixels: multiply by \[1, -1, -1\]"),
    (lambda: NormalMap(normals_in_camera=2 * FACING, mask=MASK), BadInput, "expected unit length, got 2"),
    (lambda: fit_similarity(np.eye(3), np.eye(4)[:, :3]), BadInput,
     "target points: expected shape 3 × 3, got 4 × 3"),
    (lambda: fit_similarity(UNKNOWN, np.eye(3)), BadInput, "source points: 9 of 9 values are NaN"),
    (lambda: fit_similarity(POINT, POINT), BadInput, "on a line; choose three"),
    (lambda: fit_similarity(POINT[:0], POINT[:0]), BadInput, "on a line; choose three"),
    (lambda: fit_similarity(LINE, LINE), BadInput, "on a line; choose three"),
    (lambda: RigidTransform.from_matrix(np.eye(3)), BadInput, "translation: expected shape 3, got 0"),
    (lambda: RigidTransform(rotation=np.diag([1.0, 1, -1])), BadInput, "orthonormal"),
    (lambda: RigidTransform(rotation=2 * np.eye(3)), BadInput, "orthonormal"),
    (lambda: RigidTransform(rotation=UNKNOWN), BadInput, "rotation: 9 of 9 values are NaN"),
    (lambda: skeleton("abc", [-1, 2, 1]), BadMotion, "parent must come before"),
    (lambda: skeleton("aa", [-1, 0]), BadMotion, "every joint name once"),
    (lambda: skeleton("ab", [-1, -1]), BadMotion, "one root"),
    # Bytes would be taken for booleans: the inverse of 1 is 254, which is as true.
    (lambda: LinearFrame(rgb=np.zeros((2, 2, 3)), clipped=np.zeros((2, 2), np.uint8)), BadInput,
     "clipped mask: expected booleans, got uint8"),
    (lambda: LinearFrame(np.zeros((3, 4, 3), np.uint8)), BadInput,
     "expected linear light, full scale = 1, got uint8: divide by"),
    (lambda: LightResponse(matrix=1e-30 * np.eye(3)), BadRig, re.escape("M is 1e-30: expected about 1")),
    (lambda: LightResponse(matrix=1e30 * np.eye(3)), BadRig, re.escape("M is 1e+30: expected about 1")),
    (lambda: LightResponse(matrix=[[1.0, 0, -1], [0, 1, -1], [1, 1, -2]]), BadRig, "singular"),
    (lambda: LightResponse(matrix=UNKNOWN), BadRig, "NaN"),
    (lambda: variation([[2, 2]]), BadRig, "total degree 1 to 3"),
    (lambda: variation([[1, 0]], 0.0), BadRig, "positive scale"),
    (lambda: variation([[1, 0], [0, 1]]), BadRig, "matrices: expected shape 2"),
    (lambda: gel(coefficients=np.zeros((3, 2))), BadRig, "gel: coefficients"),
    (lambda: gel(reach=0.0), BadRig, "positive scale and reach"),
    (lambda: gel(errors_deg=[[3.0, 1.0], [2.0, 1.0]]), BadRig, "growing tilts"),
    (lambda: gel(rectification=VIEW), BadRig, "size as filmed"),
    *((lambda text=text: Transfer.from_text(text), BadInput, "transfer: expected")
      for text in ("", "rec2020", "gamma", "gamma:x", "srgb:2", "gamma:0")),
    (lambda: linear_from_integers(np.zeros((2, 2, 3), np.int32), Transfer()), BadInput, "8- or 16-bit"),
    *((lambda value=value: smoothed(value), BadInput, "sameness: expected a positive number")
      for value in (0.0, -1.0, NAN)),
    (lambda: normals_from_lights(SHADED, LIGHTS * [1, -1, -1]), BadInput,
     r"lights: .* multiply by \[1, -1, -1\]"),
    (lambda: normals_from_lights(IMAGES, IN_ONE_PLANE), BadInput, "one plane"),
    (lambda: normals_from_lights(IMAGES[[0, 1, 2, 2]], np.vstack([LIGHTS, POINT])), BadInput,
     "a light has no strength"),
    (lambda: normals_from_lights(IMAGES[:2], LIGHTS[:2]), BadInput, "at least three lights"),
    (lambda: normals_from_lights(IMAGES[:2], LIGHTS), BadInput, "one for each light"),
    (lambda: normals_from_lights(IMAGES, LIGHTS, MASK), BadInput, "mask: expected shape 4 × 5"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("call", "error", "line"), REFUSALS, ids=[f"{k}: {line}" for k, (_, _, line) in enumerate(REFUSALS)]
)
def test_what_cannot_be_is_refused_by_a_line_that_says_why(call, error, line):
    with pytest.raises(error, match=line):
        call()


def test_a_matrix_of_three_rows_and_colours_in_a_list_are_taken():
    assert RigidTransform.from_matrix(np.eye(4)[:3]).translation.tolist() == [0, 0, 0]
    assert mesh(colours=[[0, 0, 1.0]] * 3).colours.shape == (3, 3)


def test_arrays_on_files_axes_are_taken_where_they_are_no_normals():
    assert NormalMap(normals_in_camera=FACING * [1, -1, -1], mask=~MASK).mask.sum() == 0
    assert vt.evaluate_normals(FACING, NormalMap(normals_in_camera=FACING, mask=MASK)).mean_deg == 0.0
    assert normals_from_lights(0.8 * SHADED, LIGHTS).mask.all()


def test_a_pinhole_camera_takes_two_focal_lengths():
    matrix = Camera.pinhole(width=640, height=480, focal_px=(900, 905)).matrix
    assert (matrix[0, 0], matrix[1, 1]) == (900, 905)
