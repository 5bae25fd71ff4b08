"""Meshes at the edge of what a format holds: odd kinds of numbers, names with blanks, nothing at all."""

import numpy as np
import pytest

from tests.usd_reading import read_usd_sequence
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.maps_and_meshes.glb import write_glb
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.maps_and_meshes.usd import write_usd_sequence
from vntoolkit.io.results.sequences import MeshSequenceWriter, read_mesh_sequence

TRIANGLE = Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]]))
NOTHING = Mesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), np.int32))


TRIANGLE_ROWS = "0 0 0\n1 0 0\n0 1 0\n"


def ply_text(kind="float", colour="", rows=TRIANGLE_ROWS, face="list uchar int", corners="3 0 1 2\n"):
    """A triangle as a PLY, whose numbers may be of odd kinds."""
    colours = "".join(f"property {colour} {name}\n" for name in ("red", "green", "blue") if colour)
    return (
        f"ply\nformat ascii 1.0\nelement vertex 3\nproperty {kind} x\nproperty {kind} y\nproperty {kind} z\n"
        f"{colours}element face 1\nproperty {face} vertex_indices\nend_header\n{rows}{corners}"
    )


def test_whole_numbers_are_positions_too(tmp_path):
    (tmp_path / "a.ply").write_text(ply_text(kind="uchar"))
    mesh = read_mesh(tmp_path / "a.ply")
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, -1, 0]]
    assert mesh.vertices.dtype == np.float64


def test_colours_of_16_bits_keep_their_share_of_full_scale(tmp_path):
    rows = "0 0 0 32896 0 65535\n1 0 0 0 0 0\n0 1 0 0 0 0\n"
    (tmp_path / "a.ply").write_text(ply_text(colour="ushort", rows=rows))
    assert read_mesh(tmp_path / "a.ply").colours[0] == pytest.approx([128 / 255, 0, 1])


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_a_clip_needs_a_rate(tmp_path, rate):
    with pytest.raises(BadInput, match="frame rate: expected a positive number"):
        write_glb(tmp_path / "a.glb", TRIANGLE, [np.eye(3)] * 2, frame_rate_hz=rate)
    with pytest.raises(BadInput, match="frame rate: expected a positive number"):
        MeshSequenceWriter(tmp_path / "b", TRIANGLE, frame_rate_hz=rate)
    assert not list(tmp_path.iterdir())


def test_a_clip_of_nothing_is_refused(tmp_path):
    with pytest.raises(BadMesh, match="at least one frame and one triangle"):
        write_glb(tmp_path / "a.glb", NOTHING, [NOTHING.vertices], frame_rate_hz=30.0)


def test_a_moving_mesh_ends_with_the_last_whole_frame(tmp_path):
    """A run that is killed between the two files leaves a confidence without its vertices."""
    with MeshSequenceWriter(tmp_path, TRIANGLE) as writer:
        for frame in range(3):
            writer.append(np.eye(3) + frame, np.full(3, 0.5))
        writer._vertices.truncate(2)
    sequence = read_mesh_sequence(tmp_path)
    assert (sequence.vertices.shape, sequence.uncertainty_px.shape) == ((2, 3, 3), (2, 3))
    (tmp_path / "sequence.json").write_text('{"frame_rate_hz": 1' + "0" * 400 + "}")
    with pytest.raises(BadMesh, match="expected JSON with frame_rate_hz"):
        read_mesh_sequence(tmp_path)


def test_a_usd_without_colours_comes_back(tmp_path):
    write_usd_sequence(tmp_path / "a.usdc", TRIANGLE, [np.eye(3)] * 2, frame_rate_hz=30.0)
    sequence = read_usd_sequence(tmp_path / "a.usdc")
    assert sequence.vertices.tolist() == [np.eye(3).tolist()] * 2
    assert sequence.template.colours is None
    assert sequence.template.uv is None
