import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.evaluation.angular_error import compare_normals, summarise_angles
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.photometry.fit_quality import angles_deg


def unit_vectors(rng: np.random.Generator, *shape: int) -> np.ndarray:
    vectors = rng.normal(size=(*shape, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.mark.parametrize("angle_deg", [1e-7, 0.3, 45, 90, 179.999999])
def test_a_rotation_about_a_normal_axis_is_its_angle(angle_deg: float, rng: np.random.Generator) -> None:
    axis = unit_vectors(rng)
    start = np.cross(axis, unit_vectors(rng))
    start /= np.linalg.norm(start)
    turned = RigidTransform.from_rotation_vector(axis * np.deg2rad(angle_deg)).rotate(start)
    assert angles_deg(start, turned) == pytest.approx(angle_deg, rel=1e-7)


def test_a_normal_that_was_not_found_is_as_far_from_all_others() -> None:
    assert angles_deg(np.zeros(3), np.array([0.0, 0.0, -1.0])) == 90.0


def test_only_common_pixels_count(rng: np.random.Generator) -> None:
    normals = unit_vectors(rng, 4, 6)
    flipped = normals.copy()
    flipped[0] *= -1
    mask, other = np.ones((4, 6), bool), np.ones((4, 6), bool)
    other[0] = False
    error = compare_normals(
        NormalMap(normals_in_camera=normals, mask=mask), NormalMap(normals_in_camera=flipped, mask=other)
    )
    assert error.pixels == 18
    assert error.mean_deg == pytest.approx(0, abs=1e-5)


def test_summary_of_known_angles() -> None:
    error = summarise_angles(np.array([0.0, 4, 8, 16, 32]))
    assert (error.mean_deg, error.median_deg) == (12, 8)
    assert (error.below_5, error.below_10, error.below_20) == (0.4, 0.6, 0.8)
    assert error.std_deg == pytest.approx(np.std([0, 4, 8, 16, 32]))


def test_refusals(rng: np.random.Generator) -> None:
    small = NormalMap(normals_in_camera=unit_vectors(rng, 4, 6), mask=np.ones((4, 6), bool))
    large = NormalMap(normals_in_camera=unit_vectors(rng, 8, 6), mask=np.ones((8, 6), bool))
    empty = NormalMap(normals_in_camera=unit_vectors(rng, 4, 6), mask=np.zeros((4, 6), bool))
    with pytest.raises(BadInput, match="measured normal map is 6×4 but reference normal map is 6×8"):
        compare_normals(small, large)
    with pytest.raises(BadInput, match="mask is empty"):
        compare_normals(small, empty)
