"""Meshes and motion that are none are refused by one line: the file, what was expected, what came."""

import numpy as np
import pytest

from tests.result_files import write_mesh_sequence
from vntoolkit.errors import BadMesh, BadMotion, CannotWrite
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.motion.asf import read_asf_amc
from vntoolkit.io.motion.bvh import read_bvh
from vntoolkit.io.results.sequences import MeshSequenceWriter, read_mesh_sequence

TRIANGLE = Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]], dtype=np.int32))

HEAD = "ply\nformat ascii 1.0\n"
POINT = HEAD + "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("a.ply", HEAD + "element cheese 1\nproperty float x\nend_header\n1\n", "an element 'vertex' with"),
        ("a.ply", HEAD + "end_header\n", "an element 'vertex' with x, y and z"),
        (
            "a.ply",
            POINT + "element face 1\nproperty list uchar int corners\nend_header\n0 0 0\n1 0\n",
            "the faces have no list 'vertex_indices'",
        ),
        (
            "a.ply",
            POINT + "end_header\n0 0 0\n",
            "holds points but no faces; read it as a point cloud",
        ),
        ("a.ply", "ply\nelement vertex 0\nend_header\n", "the PLY header names no format"),
        ("a.ply", "ply\nformat ascii 1.0\ncheese\nend_header\n", "unknown line in the PLY header: 'cheese'"),
        ("a.ply", "ply\nformat ascii 1.0\n", "the PLY header has no end"),
        ("a.obj", "v 1 2\nv 1 2\nv 3 4\nf 1 2 3\n", "a vertex has 2 numbers, expected x y z"),
        ("a.obj", "v 1 2 3\nv 1 2\nv 3 4 5\nf 1 2 3\n", "rows of differing length"),
        ("a.obj", "v 1 2 3\nf 1 2 3\n", "line 2 is malformed: 'f 1 2 3'"),
        ("a.obj", "v 1 2 3\n", "holds no mesh"),
    ],
)  # fmt: skip
def test_meshes_that_are_none(tmp_path, name, text, line):
    (tmp_path / name).write_text(text)
    with pytest.raises(BadMesh, match=line):
        read_mesh(tmp_path / name)


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


def test_confidence_comes_with_every_frame_or_with_none(tmp_path):
    with MeshSequenceWriter(tmp_path, TRIANGLE) as writer:
        writer.append(np.eye(3))
        with pytest.raises(BadMesh, match="with every frame or with none"):
            writer.append(np.eye(3), np.ones(3))


SKELETON = """:units
  length {length}
:root
  order TX TY TZ
  axis {axis}
  position 0 0 0
  orientation 0 0 {turn}
:bonedata
{bone}
:hierarchy
  begin
    root spine
  end
"""
BONE = "begin\nname spine\ndirection 0 1 0\nlength {length}\naxis 0 0 0 XYZ\ndof {dof}\nend"


@pytest.mark.parametrize(
    ("changed", "line"),
    [
        ({"length": "0"}, "expected a positive length unit, got 0"),
        ({"axis": "XYW"}, "root axis: expected an order of axes such as XYZ, got 'XYW'"),
        ({"turn": "nan"}, "root orientation: expected three finite numbers"),
        ({"bone": "begin\nbegin"}, "a bone begins inside another one"),
        ({"bone": "name spine"}, "expected begin, got 'name'"),
        ({"bone": "begin\nname spine"}, "the last bone has no end: the file is truncated"),
        ({"bone": BONE.format(length="-1", dof="rx")}, "bone spine: expected a length, got -1"),
        ({"bone": BONE.format(length="1", dof="rx rx")}, "bone spine, dof: expected channels among"),
        ({"bone": "\n".join([BONE.format(length="1", dof="rx")] * 2)}, "bone spine occurs twice"),
    ],
)
def test_skeletons_that_are_none(tmp_path, changed, line):
    good = {"length": "1", "axis": "XYZ", "turn": "0", "bone": BONE.format(length="1", dof="rx")}
    (tmp_path / "a.amc").write_text(":FULLY-SPECIFIED\n:DEGREES\n1\nroot 0 0 0\nspine 1\n")
    (tmp_path / "a.asf").write_text(SKELETON.format(**good))
    assert len(read_asf_amc(tmp_path / "a.asf", tmp_path / "a.amc").rotations) == 1
    (tmp_path / "a.asf").write_text(SKELETON.format(**(good | changed)))
    with pytest.raises(BadMotion, match=line):
        read_asf_amc(tmp_path / "a.asf", tmp_path / "a.amc")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("HIERARCHY\nMOTION\nFrames: 1\nFrame Time: 0.1\n0\n", "no ROOT in the hierarchy"),
        (f"HIERARCHY\nROOT {'x' * 9000}\n", "the name of a joint has 4096 characters"),
        ("HIERARCHY\nROOT a\n{\n", "no MOTION section: the file is truncated or not BVH"),
        ("HIERARCHY\nROOT a\n{\nJOINT a\n{\n", r"joint 'a' occurs twice or has no name \(a cycle\?\)"),
        ("HIERARCHY\nROOT a\n{\nMOTION\n", "1 unmatched braces in the hierarchy"),
    ],
)
def test_motion_that_is_none(tmp_path, text, line):
    (tmp_path / "a.bvh").write_text(text)
    with pytest.raises(BadMotion, match=line):
        read_bvh(tmp_path / "a.bvh")
