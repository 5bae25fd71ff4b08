import numpy as np
import pytest

from tests.attached_shadow import shaded_rgb_from_normals
from vntoolkit.photometry.frame import ALL_LIT, count_lit, labels_from_lit, lit_from_labels
from vntoolkit.photometry.response import LightResponse, rgb_from_normals

DIRECTIONS = np.array([[0.5, 0.1, -0.9], [-0.4, 0.4, -0.8], [0.0, -0.5, -0.85]])
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
COLOURS = np.array([[0.8, 0.1, 0.02], [0.07, 0.7, 0.1], [0.01, 0.12, 0.6]])


@pytest.fixture
def response() -> LightResponse:
    return LightResponse(
        matrix=COLOURS.T @ DIRECTIONS, ambient=np.array([0.02, 0.01, 0.03]), light_colours=COLOURS
    )


def test_inverse_gives_the_normal_back(response: LightResponse, rng: np.random.Generator) -> None:
    normals = rng.normal(size=(30, 3))
    rgb = rgb_from_normals(normals, response)
    np.testing.assert_allclose((rgb - response.ambient) @ response.inverse.T, normals, atol=1e-12)


def test_matrix_splits_into_colours_and_directions(response: LightResponse) -> None:
    np.testing.assert_allclose(response.light_directions, DIRECTIONS, atol=1e-12)
    np.testing.assert_allclose(response.lights, DIRECTIONS, atol=1e-12)


def test_without_colours_a_channel_is_a_light() -> None:
    response = LightResponse(matrix=2 * DIRECTIONS)
    np.testing.assert_allclose(response.light_directions, DIRECTIONS, atol=1e-12)


def test_attached_shadow_removes_one_light_and_its_crosstalk(response: LightResponse) -> None:
    away_from_first = np.cross(DIRECTIONS[1], DIRECTIONS[2])
    away_from_first *= -np.sign(away_from_first @ DIRECTIONS[0])
    normal = away_from_first + 0.3 * (DIRECTIONS[1] + DIRECTIONS[2])
    assert normal @ DIRECTIONS[0] < 0 < min(normal @ DIRECTIONS[1], normal @ DIRECTIONS[2])
    expected = (
        COLOURS[1] * (normal @ DIRECTIONS[1]) + COLOURS[2] * (normal @ DIRECTIONS[2]) + response.ambient
    )
    np.testing.assert_allclose(shaded_rgb_from_normals(normal, response), expected)


def test_labels_round_trip() -> None:
    labels = np.arange(8, dtype=np.uint8)
    lit = lit_from_labels(labels)
    np.testing.assert_array_equal(labels_from_lit(lit), labels)
    np.testing.assert_array_equal(count_lit(labels), lit.sum(axis=-1))
    assert labels_from_lit(np.ones(3, bool)) == ALL_LIT
