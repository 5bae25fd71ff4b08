import numpy as np
import pytest

from vntoolkit.geometry.rigid import RigidTransform


@pytest.fixture
def b_from_a(rng: np.random.Generator) -> RigidTransform:
    return RigidTransform.from_rotation_vector(rng.normal(size=3), rng.normal(size=3))


def test_inverse_undoes(b_from_a: RigidTransform, rng: np.random.Generator) -> None:
    x_in_a = rng.normal(size=(20, 3))
    np.testing.assert_allclose(b_from_a.inverse().apply(b_from_a.apply(x_in_a)), x_in_a, atol=1e-12)


def test_composition_is_application_in_turn(b_from_a: RigidTransform, rng: np.random.Generator) -> None:
    c_from_b = RigidTransform.from_rotation_vector(rng.normal(size=3), rng.normal(size=3))
    x_in_a = rng.normal(size=(20, 3))
    np.testing.assert_allclose(
        (c_from_b @ b_from_a).apply(x_in_a), c_from_b.apply(b_from_a.apply(x_in_a)), atol=1e-12
    )


def test_matrix_and_rotation_vector_round_trip(b_from_a: RigidTransform) -> None:
    again = RigidTransform.from_matrix(b_from_a.matrix)
    np.testing.assert_allclose(again.rotation_vector, b_from_a.rotation_vector, atol=1e-12)
    np.testing.assert_allclose(again.translation, b_from_a.translation)


def test_directions_ignore_translation() -> None:
    moved = RigidTransform(translation=np.array([5.0, 6, 7]))
    np.testing.assert_array_equal(moved.rotate(np.array([0.0, 0, 1])), [0, 0, 1])


def test_arrays_are_read_only(b_from_a: RigidTransform) -> None:
    with pytest.raises(ValueError, match="read-only"):
        b_from_a.translation[0] = 1
