"""Meshes and motion that are none are refused by one line: the file, what was expected, what came."""

import numpy as np
import pytest

from tests.io.test_mesh_edges import ply_text
from tests.result_files import write_mesh_sequence
from vntoolkit.errors import BadMesh, CannotWrite
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.results.sequences import MeshSequenceWriter, read_mesh_sequence

TRIANGLE = Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]], dtype=np.int32))

XYZ = "property float x\nproperty float y\nproperty float z\n"
ASCII = "ply\nformat ascii 1.0\n"
BINARY = "ply\nformat binary_little_endian 1.0\n"
POINT = f"{ASCII}element vertex 1\n{XYZ}"
OTHER_LIST = f"{POINT}element face 1\nproperty list uchar int corners\nend_header\n0 0 0\n1 0\n"
NO_VERTICES = f"{ASCII}element cheese 1\nproperty float x\nend_header\n1\n"
LISTS, ROWS_OF_LISTS = "list uchar float", "1 0 1 0 1 0\n2 0 0 1 0 1 0\n1 1 1 0 1 0\n"


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("a.ply", "", "is empty"),
        ("a.ply", "hello", "is not a PLY"),
        ("a.ply", NO_VERTICES, "an element 'vertex' with x, y and z"),
        ("a.ply", f"{ASCII}end_header\n", "an element 'vertex' with x, y and z"),
        ("a.ply", ply_text(kind=LISTS, rows=ROWS_OF_LISTS), "expected an element 'vertex' with x, y"),
        ("a.ply", OTHER_LIST, "the faces have no list 'vertex_indices'"),
        ("a.ply", ply_text(face="int", corners="2\n"), "the faces have no list 'vertex_indices'"),
        ("a.ply", ply_text(face="list float int"),
         "unknown line in the PLY header: 'property list float int"),
        ("a.ply", ply_text(face=LISTS, corners="3 0 nan 2\n"),
         "corners are numbers of vertices, got float32"),
        ("a.ply", ply_text(face=LISTS, corners="3 0 1.7 2\n"),
         "corners are numbers of vertices, got float32"),
        ("a.ply", ply_text(corners="3 0 -1 2\n"), "a face names vertex -1, there are 3"),
        ("a.ply", ply_text(corners="3 0 1 7\n"), "names vertex 7, there are 3"),
        ("a.ply", ply_text(rows="0 0 0\n", corners=""), r"malformed or cut off \(.* more than are left\)"),
        ("a.ply", f"{BINARY}element vertex 2\n{XYZ}end_header\n0123456", "'vertex' is malformed or cut off"),
        ("a.ply", f"{BINARY}element vertex 4000000000\n{XYZ}end_header\n", "promises 4000000000 rows"),
        ("a.ply", ply_text(rows="0 nan 0\n1 0 0\n0 1 0\n"), "a.ply: vertices: 1 of 9 values are NaN"),
        ("a.ply", f"{POINT}end_header\n0 0 0\n", "holds points but no faces, expected a mesh"),
        ("a.ply", "ply\nelement vertex 0\nend_header\n", "the PLY header names no format"),
        ("a.ply", f"{ASCII}cheese\nend_header\n", "unknown line in the PLY header: 'cheese'"),
        ("a.ply", f"{POINT}property quaternion q\nend_header\n",
         "unknown line in the PLY header: 'property quaternion q'"),
        ("a.ply", ASCII, "the PLY header has no end"),
        ("a.obj", "v 1 2\nv 1 2\nv 3 4\nf 1 2 3\n", "a vertex has 2 numbers, expected x y z"),
        ("a.obj", "v 1 2 3\nv 1 2\nv 3 4 5\nf 1 2 3\n", "rows of differing length"),
        ("a.obj", "v 1 2 3\nf 1 2 3\n", "line 2 is malformed: 'f 1 2 3'"),
        ("a.obj", "v 0 0\nv x 0 0\n", "line 2 is malformed: 'v x 0 0'"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf\n", "line 4 is malformed"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2\n", "a face has 2 corners"),
        ("a.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "a.obj: vertices: 1 of 9 values are NaN"),
        ("a.obj", "v 1 2 3\n", "holds no mesh"),
    ],
)  # fmt: skip
def test_meshes_that_are_none(tmp_path, name, text, line):
    (tmp_path / name).write_text(text)
    with pytest.raises(BadMesh, match=line) as caught:
        read_mesh(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_moving_meshes_that_do_not_fit_together(tmp_path):
    moving = MeshSequence(template=TRIANGLE, vertices=np.eye(3, dtype=np.float32)[None])
    write_mesh_sequence(tmp_path, moving)
    larger = Mesh(vertices=np.zeros((4, 3)), faces=TRIANGLE.faces)
    with pytest.raises(BadMesh, match="holds a moving mesh of 3 vertices, not 4; overwrite it"):
        MeshSequenceWriter(tmp_path, larger, resume=True)
    np.save(tmp_path / "vertices.npy", np.zeros((1, 4, 3), np.float32))
    with pytest.raises(BadMesh, match="expected shape any × 3 × 3, got 1 × 4 × 3"):
        MeshSequenceWriter(tmp_path, TRIANGLE, resume=True)
    (tmp_path / "sequence.json").write_text("{}")
    with pytest.raises(BadMesh, match="expected JSON with frame_rate_hz"):
        read_mesh_sequence(tmp_path)
    (tmp_path / "vertices.npy").unlink(missing_ok=True)
    (tmp_path / "vertices.npy").mkdir()
    with pytest.raises(CannotWrite, match=r"cannot write .*vertices\.npy"):
        MeshSequenceWriter(tmp_path, TRIANGLE)


def test_a_frame_of_no_numbers_or_without_the_confidence_of_the_others(tmp_path):
    with MeshSequenceWriter(tmp_path, TRIANGLE) as writer:
        with pytest.raises(BadMesh, match="NaN or infinite"):
            writer.append(np.full((3, 3), np.nan))
        writer.append(np.eye(3))
        with pytest.raises(BadMesh, match="with every frame or with none"):
            writer.append(np.eye(3), np.ones(3))
