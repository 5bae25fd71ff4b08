"""Objects and fits refuse arrays of another kind or shape than they say."""

import numpy as np
import pytest

from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.garment_fit import fit_similarity
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.pipeline.smoothing import smoothed_over_time


def test_marks_of_clipping_are_booleans() -> None:
    """Bytes would be taken for numbers: the inverse of 1 is 254, which is as true."""
    with pytest.raises(BadInput, match="clipped mask: expected booleans, got uint8"):
        LinearFrame(rgb=np.zeros((2, 2, 3)), clipped=np.zeros((2, 2), np.uint8))


def test_a_similarity_needs_pairs_of_points() -> None:
    with pytest.raises(BadInput, match="target points: expected shape 3 × 3, got 4 × 3"):
        fit_similarity(np.eye(3), np.eye(4)[:, :3])
    with pytest.raises(BadInput, match="source points: 9 of 9 values are NaN"):
        fit_similarity(np.full((3, 3), np.nan), np.eye(3))
    with pytest.raises(BadInput, match="on a line; choose three"):
        fit_similarity(np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(BadInput, match="on a line; choose three"):
        fit_similarity(np.zeros((0, 3)), np.zeros((0, 3)))


def test_a_matrix_without_translation_is_no_transform() -> None:
    with pytest.raises(BadInput, match="translation: expected shape 3, got 0"):
        RigidTransform.from_matrix(np.eye(3))
    assert RigidTransform.from_matrix(np.eye(4)[:3]).translation.tolist() == [0, 0, 0]


def test_colours_may_be_a_list() -> None:
    mesh = Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]]), colours=[[0, 0, 1.0]] * 3)
    assert mesh.colours.shape == (3, 3)
    with pytest.raises(BadMesh, match="colours: expected shape 3 × 3, got 2 × 3"):
        Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]]), colours=[[0, 0, 1.0]] * 2)


@pytest.mark.parametrize("sameness", [0.0, -1.0, np.nan])
def test_frames_are_not_blended_without_a_scale(sameness) -> None:
    frames = [np.full((1, 1, 3), value, np.uint8) for value in (10, 20, 30)]
    with pytest.raises(BadInput, match="sameness: expected a positive number"):
        smoothed_over_time(*frames, 8, sameness)
