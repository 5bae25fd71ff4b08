"""Equation 1 and its inverse undo each other; what has no normal gets none."""

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.normals.inversion import normals_from_frame, relative_albedo_from_frame
from vntoolkit.options.normals import ClippedPixels, InversionOptions
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse, rgb_from_normals

DIRECTIONS = np.array([[0.6, 0.0, -0.8], [-0.36, 0.48, -0.8], [-0.36, -0.48, -0.8]])
COLOURS = np.array([[0.5, 0.05, 0.02], [0.06, 0.6, 0.1], [0.0, 0.1, 0.4]])
RESPONSE = LightResponse(
    matrix=COLOURS.T @ DIRECTIONS, ambient=np.array([0.02, 0.01, 0.03]), light_colours=COLOURS
)


def normals_near_the_axis(rng: np.random.Generator, shape: tuple[int, int], spread: float = 0.3):
    normals = np.concatenate([rng.normal(0, spread, (*shape, 2)), -np.ones((*shape, 1))], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def frame_of(rgb, clipped=None) -> LinearFrame:
    clipped = np.zeros(rgb.shape[:2], bool) if clipped is None else clipped
    return LinearFrame(rgb=rgb.astype(np.float32), clipped=clipped)


def test_inversion_undoes_the_forward_model(rng) -> None:
    truth = normals_near_the_axis(rng, (37, 53))
    albedo = rng.uniform(0.5, 1.5, (37, 53, 1))
    rgb = (rgb_from_normals(truth, RESPONSE) - RESPONSE.ambient) * albedo + RESPONSE.ambient
    result = normals_from_frame(frame_of(rgb), RESPONSE)
    assert result.mask.all()
    assert angles_deg(result.normals_in_camera, truth).max() < 1e-3  # float32 colours through M⁻¹


def test_weight_is_one_at_the_expected_albedo_and_half_at_the_tolerance(rng) -> None:
    truth = normals_near_the_axis(rng, (1, 3))
    lengths = np.array([1.0, 1.25, 0.5])[None, :, None]
    rgb = (rgb_from_normals(truth, RESPONSE) - RESPONSE.ambient) * lengths + RESPONSE.ambient
    weight = normals_from_frame(frame_of(rgb), RESPONSE).weight
    assert weight[0, 0] == pytest.approx(1.0, abs=1e-5)
    # (1.25 − 1/1.25)/2 = 0.225 of a tolerance of 0.25: the departure is symmetric in brighter and darker
    assert weight[0, 1] == pytest.approx(1 / (1 + (0.225 / 0.25) ** 2), rel=1e-4)
    assert weight[0, 2] == pytest.approx(1 / (1 + (0.75 / 0.25) ** 2), rel=1e-4)
    paler = InversionOptions(relative_albedo=0.5)
    assert normals_from_frame(frame_of(rgb), RESPONSE, options=paler).weight[0, 2] == pytest.approx(1.0)


def test_pixels_without_a_normal_are_invalid_and_zero_never_nan(rng) -> None:
    truth = normals_near_the_axis(rng, (2, 5))
    rgb = rgb_from_normals(truth, RESPONSE)
    rgb[0, 0] = RESPONSE.ambient  # no light at all: length 0
    rgb[0, 1] = 1e25  # whose square overflows
    rgb[0, 2] = -1e25
    rgb[0, 3] = rgb_from_normals(np.array([0.1, 0.2, 0.97]), RESPONSE)  # faces away
    mask = np.ones((2, 5), bool)
    mask[0, 4] = False
    result = normals_from_frame(frame_of(rgb), RESPONSE, mask)
    assert not result.mask[0].any()
    assert result.mask[1].all()
    assert np.all(result.normals_in_camera[0] == 0)
    assert np.all(result.weight[0] == 0)


def test_clipped_pixels_keep_a_tenth_of_their_weight_or_go(rng) -> None:
    rgb = rgb_from_normals(normals_near_the_axis(rng, (2, 2)), RESPONSE)
    clipped = np.array([[True, False], [False, False]])
    kept = normals_from_frame(frame_of(rgb, clipped), RESPONSE)
    assert kept.mask.all()
    assert kept.weight[0, 0] == pytest.approx(0.1, rel=1e-4)
    options = InversionOptions(clipped=ClippedPixels.EXCLUDE)
    dropped = normals_from_frame(frame_of(rgb, clipped), RESPONSE, options=options)
    assert np.array_equal(dropped.mask, ~clipped)


def test_camera_noise_tilts_normals_by_what_the_inverse_predicts(rng) -> None:
    truth = normals_near_the_axis(rng, (200, 200))
    sigma = 0.002
    rgb = rgb_from_normals(truth, RESPONSE) + rng.normal(0, sigma, truth.shape)
    error = angles_deg(normals_from_frame(frame_of(rgb), RESPONSE).normals_in_camera, truth)
    # first order: the tangential part of M⁻¹ noise; its mean square is σ² (|M⁻¹|² − |nᵀM⁻¹|²)
    inverse = RESPONSE.inverse
    along = truth @ inverse
    predicted = sigma * np.sqrt(np.mean(np.sum(inverse**2) - np.sum(along**2, axis=-1)))
    assert np.deg2rad(np.sqrt(np.mean(error**2))) == pytest.approx(predicted, rel=0.03)


def test_relative_albedo_is_measured_on_lit_pixels(rng) -> None:
    rgb = 0.7 * rgb_from_normals(normals_near_the_axis(rng, (40, 40)), LightResponse(matrix=RESPONSE.matrix))
    rgb[:10] = 0.0
    frame = frame_of(rgb)
    assert relative_albedo_from_frame(frame, LightResponse(matrix=RESPONSE.matrix)) == pytest.approx(
        0.7, rel=1e-4
    )
    with pytest.raises(BadInput, match="no lit pixel"):
        relative_albedo_from_frame(frame_of(np.zeros((4, 4, 3))), RESPONSE)


def test_refusals(rng) -> None:
    frame = frame_of(np.ones((4, 5, 3)))
    with pytest.raises(BadInput, match="mask: expected shape 4 × 5, got 5 × 4"):
        normals_from_frame(frame, RESPONSE, np.ones((5, 4), bool))
    with pytest.raises(BadInput, match="mask: expected booleans, got uint8"):
        relative_albedo_from_frame(frame, RESPONSE, np.full((4, 5), 255, np.uint8))


def test_a_frame_that_is_not_finite_is_refused() -> None:
    for value in (np.nan, np.inf):
        with pytest.raises(BadInput, match="frame: expected finite light"):
            frame_of(np.full((2, 3, 3), value))


def test_the_response_of_a_gel_is_refused() -> None:
    level = np.array([0.4, 0.3, 0.5])  # of the untouched gel, as `calibrate presses` fits it
    matrix = np.vstack([[0.3, -0.2, -0.1], [0.0, 0.3, -0.3], -level]).T
    gel = LightResponse(matrix=matrix, ambient=-level)
    with pytest.raises(BadInput, match=r"got a gel's, .* take `Gel`, which rectifies"):
        normals_from_frame(frame_of(np.full((2, 3, 3), 0.2)), gel)
